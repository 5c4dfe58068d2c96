"""`voile plot`: quantities of a run against time or load, one panel each."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from voile.arrays import Reals
from voile.errors import InputError
from voile.files import replacing
from voile.post.camera import parse_scene
from voile.post.render import INK, LINE
from voile.post.series import SINCE_THE_START, Recorded, Series
from voile.results import read_result

if TYPE_CHECKING:
    from matplotlib.figure import Figure

COLOURS = ("#2b6ca3", "#e58a3c", "#3d8f5f", "#8c1c2e", "#7a5ea8", "#5b6570", "#c2a21d", "#3aa5b5", "#b5589a")
AXES = ("x", "y", "z")
WIDE, HIGH = 8.0, 3.2  # inches, of a panel
FEW = 30  # points of a line that are marked each


def plot(
    path: str | os.PathLike[str], out_png: str | os.PathLike[str], quantities: Sequence[str] = ("energies",)
) -> Path:
    """Draw quantities of the result `path` against its time or load factor into `out_png`; returns its path.

    quantities: "energies" or names of `Recorded.names`, or FIELD:VERTEX. Raises InputError for one that is not there, a
    single step, and a file that cannot be written.
    """
    out = Path(out_png)
    if out.suffix.lower() != ".png":
        raise InputError(f"{out}: plots are written as .png")
    with read_result(path) as result:
        head = parse_scene(result.scene_text).get("scene", {})
        in_time = head.get("task", "statics") == "dynamics"
        recorded = Recorded(result, in_time)
        panels = [recorded.series(name) for name in quantities]
        for name, panel in zip(quantities, panels, strict=True):
            if max(len(s.at) for s in panel) < 2:
                raise InputError(f"{result.path}: one step only of {name}: no line to plot")
    _draw(out, panels, list(quantities), "time [s]" if in_time else "load factor", head.get("name", ""))
    return out


def _draw(out: Path, panels: list[list[Series]], titles: list[str], along: str, name: str) -> None:
    picture = figure(panels, titles, along)
    if name:
        picture.suptitle(name, x=0.02, ha="left", color=INK, parse_math=False)
    with replacing(out) as file:
        picture.savefig(file, dpi=150, format="png")


def figure(panels: list[list[Series]], titles: list[str], along: str) -> Figure:
    """The panels one below the other over the same axis, `along`; titles: what each shows."""
    from matplotlib.figure import Figure  # without pyplot, which also looks for windows

    made = Figure(figsize=(WIDE, HIGH * len(panels) + 0.6), layout="constrained")
    grid = made.subplots(len(panels), 1, sharex=True, squeeze=False)
    for axes, panel, title in zip(grid[:, 0], panels, titles, strict=True):
        _draw_panel(axes, panel, title)
    grid[-1, 0].set_xlabel(along, color=INK)
    return made


def _draw_panel(axes: Any, panel: list[Series], title: str) -> None:
    """Lines with a legend beside them; energies since the start dashed, vectors by components and length."""
    lines = [line for series in panel for line in _lines(series)]
    for k, (label, series, values) in enumerate(lines):
        axes.plot(
            series.at, values, label=label, color=COLOURS[k % len(COLOURS)], linewidth=1.4,
            linestyle="--" if series.name.endswith(SINCE_THE_START) or label == "length" else "-",
            marker="." if len(series.at) <= FEW else None,
        )  # fmt: skip
    if len(lines) > 1:
        axes.legend(loc="center left", bbox_to_anchor=(1.01, 0.5), frameon=False, fontsize=9, labelcolor=INK)
    unit = f" [{panel[0].unit}]" if panel[0].unit else ""
    axes.set_ylabel(title.replace("_", " ") + unit, color=INK)
    axes.grid(color=LINE, alpha=0.2, linewidth=0.6)
    axes.spines[["top", "right"]].set_visible(False)
    axes.margins(x=0.01)
    axes.tick_params(colors=INK)


def _lines(series: Series) -> list[tuple[str, Series, Reals]]:
    """Label, series and values (k,) of each of its lines."""
    if series.values.ndim == 1:
        return [(series.name.replace("_", " "), series, series.values)]
    parts = [(axis, series, series.values[:, k]) for k, axis in enumerate(AXES)]
    return [*parts, ("length", series, np.linalg.norm(series.values, axis=1))]
