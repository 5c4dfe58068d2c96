"""`voile report`: one page of a run, which opens anywhere: shapes that turn, plots, figures, pattern and notes."""

from __future__ import annotations

import os
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from voile.errors import InputError
from voile.files import replace
from voile.post.render import check_field
from voile.post.report_page import Page
from voile.post.report_shapes import opening, shown
from voile.results import Result, read_result

MEGABYTES = 5.0  # what mail takes without a question


@dataclass(frozen=True)
class Report:
    """What was written: its size in bytes, and how many of the run's steps and vertices it shows."""

    path: Path
    size: int
    steps: tuple[int, int]
    vertices: tuple[int, int]


def report(
    path: str | os.PathLike[str] | Result,
    out: str | os.PathLike[str],
    *,
    field: str | None = None,
    megabytes: float = MEGABYTES,
) -> Report:
    """Write a page of the result at `path`, or of an open one, to `out` (.html), which needs no other file and no
    network.

    field: the colours it opens with, as for `render`, those that need the scene's model of an open `voile.Result`
    alone; default: strain, or of several modes the first. megabytes: its
    size at most; runs with more to show lose steps, then vertices, and the page says so. Raises InputError for a field
    that is not there, a size that nothing fits in, and a file that cannot be written.
    """
    out = Path(out)
    if out.suffix.lower() not in (".html", ".htm"):
        raise InputError(f"{out}: pages are written as .html")
    with nullcontext(path) if isinstance(path, Result) else read_result(path) as result:
        if field is not None:
            check_field(result, field)
        page = Page(result)
        room = 1e6 * megabytes - page.size
        if not 0 < room < np.inf:
            raise InputError(
                f"size = {megabytes:g} MB; allowed: more than the {page.size / 1e6:.2f} MB of this page without shapes"
            )
        shapes = shown(result, room, field)
        text = page.text(shapes, opening(result, field)).encode()
        steps, vertices = (shapes.count, result.n_steps), (len(shapes.part.vertices), result.n_points)
    replace(out, text)
    return Report(out, len(text), steps, vertices)
