"""What `voile validate` says: a table, JSON, a plot each."""

import textwrap
from pathlib import Path
from typing import Any

import numpy as np

from voile.files import replacing
from voile.post.plot import COLOURS
from voile.post.render import INK, LINE
from voile.validate.protocol import Check, Plot, Verdict

COLUMNS = ("protocol", "quantity", "value", "reference", "deviation", "bound", "pass")
WIDTHS = (20, 62, 12, 12, 10, 9, 4)
TITLE = 80  # letters that fit over a plot


def heading() -> str:
    """The table's first lines."""
    return _line(COLUMNS) + "\n" + _line(["-" * width for width in WIDTHS])


def lines(verdict: Verdict) -> list[str]:
    """A protocol's lines of the table."""
    name = verdict.protocol.name
    found = [_line((name, *cells(check))) for check in verdict.checks]
    if verdict.failure:
        found.append(_line((name, f"did not converge: {verdict.failure}", "", "", "", "", "no")))
    return found


def cells(check: Check) -> tuple[str, ...]:
    """A figure's cells, from its quantity on; relative deviations in per cent."""

    def off(value: float, sign: str) -> str:
        return f"{value:{sign}.3g}" if check.absolute else f"{100.0 * value:{sign}.2g} %"

    return (
        check.quantity,
        f"{check.value:.6g}",
        f"{check.reference:.6g}",
        off(check.deviation, "+"),
        off(check.bound, ""),
        "yes" if check.passed else "NO",
    )


def _line(parts: Any) -> str:
    padded = [
        f"{part:<{width}}" if k < 2 else f"{part:>{width}}"
        for k, (part, width) in enumerate(zip(parts, WIDTHS, strict=True))
    ]
    return "  ".join(padded).rstrip()


def summary(verdicts: list[Verdict], quick: bool, versions: dict[str, str]) -> dict[str, Any]:
    """All of it, for a JSON file."""
    return {
        "passed": all(verdict.passed for verdict in verdicts),
        "quick": quick,
        "versions": versions,
        "protocols": {
            verdict.protocol.name: {
                "text": verdict.protocol.text,
                "source": verdict.protocol.source,
                "passed": verdict.passed,
                "failure": verdict.failure,
                "notes": verdict.notes,
                "cpu_seconds": verdict.seconds,
                "checks": [
                    {
                        "quantity": check.quantity,
                        "value": _finite(check.value),
                        "reference": check.reference,
                        "deviation": _finite(check.deviation),
                        "absolute": check.absolute,
                        "bound": check.bound,
                        "passed": check.passed,
                    }
                    for check in verdict.checks
                ],
            }
            for verdict in verdicts
        },
    }


def _finite(value: float) -> float | None:
    return value if np.isfinite(value) else None


def draw(out: Path, plot: Plot, title: str) -> None:
    """The curves as PNG: lines, and points beside them in the same order of colours."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(6.4, 4.0), layout="constrained")
    try:
        paint(axes, plot)
        axes.set_title(textwrap.fill(title, TITLE), loc="left", color=INK, fontsize=10)
        with replacing(out) as file:
            figure.savefig(file, dpi=130, format="png")
    finally:
        plt.close(figure)


def paint(axes: Any, plot: Plot) -> None:
    """Draws the curves into axes: lines, and points, in the same order of colours, so that points have their line's."""
    markers, drawn = "os^Dv<>p*", {True: 0, False: 0}
    for curve in plot.curves:
        at = drawn[curve.points]
        drawn[curve.points] += 1
        style: dict[str, Any] = {"color": COLOURS[at % len(COLOURS)], "label": curve.label}
        if curve.points:
            style |= {"linestyle": "none", "marker": markers[at % len(markers)], "markersize": 4.5}
            style |= {"markerfacecolor": "none"}
        else:
            style |= {"linewidth": 1.4}
        axes.plot(curve.x, curve.y, **style)
    if "x" in plot.log:
        axes.set_xscale("log")
    if "y" in plot.log:
        axes.set_yscale("log")
    axes.set_xlabel(plot.x, color=INK)
    axes.set_ylabel(plot.y, color=INK)
    axes.legend(frameon=False, fontsize=8, labelcolor=INK)
    axes.grid(color=LINE, alpha=0.2, linewidth=0.6)
    axes.spines[["top", "right"]].set_visible(False)
    axes.tick_params(colors=INK)
