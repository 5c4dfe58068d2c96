"""developability.png: what it costs to cut a rest shape from flat cloth, sag against the largest angle defect."""

from pathlib import Path

import numpy as np

from voile.files import replacing

INK, LINE = "#1b1f24", "#1f5fa8"


def draw_trade(path: str | Path, trade: list[dict[str, float | None]], width: float = 6.0) -> None:
    """Draw the trade as PNG, `width` inches wide; trade: share of the way to the developable rest shape, largest angle
    defect (rad) there and sag (over the size) of its simulation, None where it has none: a gap.

    Raises InputError if the file cannot be written.
    """
    from matplotlib.figure import Figure  # without pyplot, which also looks for windows

    figure = Figure(figsize=(width, 0.7 * width), layout="constrained")
    axes = figure.subplots()
    share, defect, sag = (
        np.array([step[key] for step in trade], dtype=float) for key in ("share", "defect", "sag")
    )
    sag *= 100.0
    axes.plot(defect, sag, "o-", color=LINE)
    for part, x, y in zip(share, defect, sag, strict=True):
        if np.isfinite(y):
            axes.annotate(
                f"{100.0 * part:g} %", (x, y), (6, 6), textcoords="offset points", color=INK, fontsize=8
            )
    axes.set_xlabel("largest angle defect [rad]")
    axes.set_ylabel("sag [% of the size]")
    axes.set_title(
        f"the way to a developable rest shape: defect {defect[-1]:.1e} rad, sag {_percent(sag[-1])}",
        loc="left", fontsize=10, color=INK,
    )  # fmt: skip
    axes.spines[["top", "right"]].set_visible(False)
    axes.margins(0.12)
    with replacing(path) as file:
        figure.savefig(file, dpi=160, format="png")


def _percent(sag: float) -> str:
    return f"{sag:.2g} %" if np.isfinite(sag) else "unknown"
