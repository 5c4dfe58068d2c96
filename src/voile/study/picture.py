"""study.png: error against seconds, the Pareto front marked."""

import itertools
from pathlib import Path
from typing import Any

import numpy as np

from voile.arrays import Reals
from voile.files import replacing
from voile.scene import Scene
from voile.study.analysis import Findings, Row
from voile.study.series import ENDS, SIZED
from voile.study.settings import COST, changes

INK, LINE = "#25303b", "#8a97a5"
COLOURS = ("#2b6ca3", "#e58a3c", "#3d8f5f", "#8c1c2e", "#7a5ea8", "#5b6570", "#c2a21d", "#3aa5b5", "#b5589a")
MARKS = "osD^vP*X"
ORDERED = (*SIZED, *ENDS)
CHANCE = 2.0  # times an error: what better resolved runs have, where it was small by chance
# Where a label may be beside its point: to the right (1), above (1), and so on; first what looks best.
PLACES = ((1, 1), (-1, -1), (-1, 1), (1, -1), (0, 1.2), (0, -1.2), (1.6, 0), (-1.6, 0), (0, 2.2), (0, -2.2))
ALONG = 20  # points of each piece of the front that labels keep off
LEAST = 1e-12  # an error drawn: nothing here is known to more


def draw(findings: Findings, path: Path) -> None:
    """Draws the rows that have an error; those of one kind, that differ in meshes, time steps or where iterations end
    only, in one colour. Raises InputError where the file cannot be written."""
    from matplotlib.figure import Figure  # pyplot, which keeps figures, takes 0.1 s longer to load

    figure = Figure(figsize=(8.0, 4.8), layout="constrained")
    axes = figure.subplots()
    axes.set_xscale("log")
    kinds = _kinds(findings)
    for k, (name, rows) in enumerate(kinds.items()):
        _draw_rows(
            axes,
            rows,
            name,
            color=COLOURS[k % len(COLOURS)],
            marker=MARKS[k // len(COLOURS) % len(MARKS)],
        )
    _draw_front(axes, findings)
    _dress(axes, findings, len(kinds))
    _name_front(axes, findings)
    with replacing(path) as file:
        figure.savefig(file, dpi=150, format="png")


def _draw_rows(axes: Any, rows: list[Row], name: str, **style: Any) -> None:
    """Their points, at the errors that count; faint their own, where these are small by chance."""
    axes.scatter(
        [r.seconds for r in rows], [_height(r.counted) for r in rows], s=34, zorder=3, label=name, **style
    )
    own = [row for row in rows if (row.counted or 0.0) > CHANCE * (row.error or 0.0)]
    axes.scatter(
        [r.seconds for r in own], [_height(r.error) for r in own], s=34, zorder=3, alpha=0.3, **style
    )


def _height(error: float | None) -> float:
    return max(error or 0.0, LEAST)


def _kinds(findings: Findings) -> dict[str, list[Row]]:
    """Rows with an error by their settings of kind."""
    plain = [n for n in findings.varied if n not in ORDERED and changes(n) != COST]
    found: dict[str, list[Row]] = {}
    for row in findings.rows:
        if row.error is not None:
            words = (
                v if isinstance(v := row.run.effective[n], str) else _short(n, v)
                for n in plain
                if row.run.effective[n] is not None
            )
            found.setdefault(", ".join(words), []).append(row)
    return found


def _draw_front(axes: Any, findings: Findings) -> None:
    front = [(row.seconds, _height(row.counted)) for row in findings.front]
    if not front:
        return
    axes.plot(*zip(*front, strict=True), color=INK, linewidth=1.2, zorder=2, label="front")
    axes.scatter(
        *zip(*front, strict=True), s=110, facecolors="none", edgecolors=INK, linewidths=1.2, zorder=4
    )


def _name_front(axes: Any, findings: Findings) -> None:
    """What the points of the front are, each beside its point where it covers the least: other labels, the points, the
    front's line, the axes' border."""
    front = [(row.seconds, _height(row.counted)) for row in findings.front]
    if not front:
        return
    axes.figure.get_layout_engine().execute(axes.figure)  # where things are, and stay: labels lie inside
    axes.figure.set_layout_engine("none")
    rows = [(r.seconds, _height(r.counted)) for rows in _kinds(findings).values() for r in rows]
    share = np.linspace(0.0, 1.0, ALONG)[:, None]
    x = axes.transData.transform(front)
    line = [a + share * (b - a) for a, b in itertools.pairwise(x)]
    taken, labels = np.concatenate([axes.transData.transform(rows), *line]), list[Any]()
    said = ""
    for row, point in zip(findings.front, front, strict=True):
        ordered = ((n, row.run.effective[n]) for n in findings.varied if n in ORDERED)
        words = ", ".join(_short(n, value) for n, value in ordered if value is not None)
        words, said = "" if words == said else words, words
        tried = [
            axes.annotate(
                words,
                point,
                xytext=(8 * right, 13 * up - 4),
                textcoords="offset points",
                ha=("center", "left", "right")[int(np.sign(right))],
                fontsize=8,
                color=INK,
            )
            for right, up in PLACES
        ]
        covers = [_covers(text.get_window_extent(), axes.bbox, labels, taken) for text in tried]
        best = tried[int(np.argmin(covers))]
        for text in tried:
            if text is not best:
                text.remove()
        labels.append(best.get_window_extent())


def _covers(box: Any, axes: Any, labels: list[Any], points: Reals) -> float:
    """How bad a place of a label is; boxes and points (k, 2) in pixels."""
    outside = not (axes.x0 <= box.x0 and box.x1 <= axes.x1 and axes.y0 <= box.y0 and box.y1 <= axes.y1)
    hidden = ((points > (box.x0, box.y0)) & (points < (box.x1, box.y1))).all(axis=1).sum()
    return float(len(points) * (outside + sum(box.overlaps(other) for other in labels)) + hidden)


def _short(name: str, value: Any) -> str:
    """A setting beside a point, or in the legend."""
    said = f"{value:g}" if isinstance(value, float) else value
    return value.stem if isinstance(value, Path) else f"{name.rpartition('.')[2].replace('_', ' ')} {said}"


def _plain(seconds: float, position: int) -> str:
    """Label of a tick at 1, 2 or 5 times a power of ten."""
    return f"{seconds:g}" if f"{seconds:e}"[0] in "125" else ""


def _dress(axes: Any, findings: Findings, kinds: int) -> None:
    from matplotlib.ticker import FuncFormatter

    axes.set_yscale("log")
    for which in ("major", "minor"):
        getattr(axes.xaxis, f"set_{which}_formatter")(FuncFormatter(_plain))
    axes.set_xlabel("CPU seconds" if findings.plan.study.study.clock == "cpu" else "seconds", color=INK)
    measures = ", ".join(m.name.replace("_", " ") for m in findings.plan.measures)
    axes.set_ylabel(f"relative error of {measures}", color=INK)
    for accuracy in findings.plan.study.study.accuracy:
        axes.axhline(accuracy, color=LINE, linewidth=0.7, linestyle=":")
    without = sum(row.error is None for row in findings.rows) - (findings.plan.reference is not None)
    named = [run.scene.scene.name for run in findings.plan.runs if isinstance(run.scene, Scene)]
    title = (next(iter(named), "") or findings.plan.scene.stem) + (
        f" ({without} runs without a result)" if without else ""
    )
    axes.set_title(title, loc="left", color=INK, fontsize=11)
    axes.grid(color=LINE, alpha=0.2, linewidth=0.6, which="both")
    axes.spines[["top", "right"]].set_visible(False)
    axes.tick_params(colors=INK, which="both")
    if kinds:
        axes.legend(frameon=False, fontsize=8, labelcolor=INK, loc="center left", bbox_to_anchor=(1.01, 0.5))
