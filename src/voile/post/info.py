"""`voile info`: the figures of a result as text."""

import os
from collections import Counter
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from voile.arrays import Reals
from voile.post.quantities import available, quantity
from voile.results import read_result, read_summary

ROUND_OFF = 1e-12


def info(path: str | os.PathLike[str]) -> str:
    """Steps, extents, range of every field at the last step, and the figures of `summary.json` beside it.

    path: a result file or its directory. Raises InputError for what is not a result.
    """
    with read_result(path) as result:
        low, high = result.points().min(axis=0), result.points().max(axis=0)
        values = result.values
        lines = [
            f"{result.path}: result format {result.format_version}, "
            + (", ".join(f"{k} {v}" for k, v in result.versions.items()) or "versions not recorded"),
            f"  mesh          {result.n_points} vertices, {result.n_cells} triangles"
            + (f", groups {', '.join(result.group_names)}" if result.group_names else ""),
            f"  steps         {result.n_steps}, value {values[0]:.6g} to {values[-1]:.6g}",
            f"  extent        {_vector(low)} to {_vector(high)} m at the last step",
            "  last step     smallest, largest (magnitude of vectors)",
        ]
        for name in available(result):
            if name in ("start", "rest", "input_vertex", "group"):
                continue
            q = quantity(result, name)
            size = q.values if q.values.ndim == 1 else np.linalg.norm(q.values, axis=1)
            smallest, largest = np.nanmin(size), np.nanmax(size)
            lines.append(f"    {name:18s} {smallest:12.5g} {largest:12.5g} {q.unit:6s} {q.title}".rstrip())
        for name, figure in result.scalars().items():
            if not name.startswith("support_"):  # the summary has a table of them
                lines.append(f"    {name:18s} {figure:12.6g}")
        beside = result.path.with_name("summary.json")
    if beside.is_file():
        lines += ["  summary", *_tree(read_summary(beside), "    ")]
    return "\n".join(lines)


def _tree(summary: dict[str, Any], indent: str) -> list[str]:
    lines = []
    for depth, key, text in rows(summary):
        before = indent + "  " * depth
        lines.append(f"{before}{key}" if text is None else f"{before}{key:24s} {text}")
    return lines


def rows(summary: dict[str, Any], depth: int = 0) -> Iterator[tuple[int, str, str | None]]:
    """Depth, name and text of each figure of a summary; text None for what heads the deeper ones that follow."""
    for key, value in summary.items():
        if isinstance(value, dict):
            yield depth, key, None
            yield from rows(value, depth + 1)
        elif key == "obstacles":
            for obstacle in value:
                yield depth, obstacle["name"], _totals(obstacle)
        elif key in ("supports", "sections"):
            for support in value:
                yield depth, support["name"], exerted(support)
        else:
            if key in ("method", "ways"):  # "ways" before version 0.2
                value = [f"{way} {count}" for way, count in Counter(value).items()]
            yield depth, key, ", ".join(map(str, value)) if isinstance(value, list) else str(value)


def _totals(obstacle: dict[str, Any]) -> str:
    """What the shell gets from an obstacle."""
    return (
        f"{obstacle['vertices']} vertices, {obstacle['area']:.4g} m^2, force {_vector(obstacle['force'])} N, "
        f"moment {_vector(obstacle['moment'])} N m"
    )


def exerted(support: dict[str, Any]) -> str:
    """What the shell gets from a [[fix]], or across a [[section]]'s cut."""
    return (
        f"force {_vector(support['force'])} N, moment {_vector(support['moment'])} N m about "
        f"{_vector(support['about'])} m"
    )


def _vector(x: Sequence[float] | Reals) -> str:
    """Four digits; components that are round-off of the largest are 0."""
    x = np.asarray(x, dtype=float)
    shown = np.where(np.abs(x) > ROUND_OFF * np.abs(x).max(), x, 0.0)
    return "(" + ", ".join(f"{v:.4g}" for v in shown) + ")"
