"""developability.png: what it costs to cut a rest shape from flat cloth, sag against the largest angle defect."""

from pathlib import Path

from voile.errors import InputError

INK, LINE = "#1b1f24", "#1f5fa8"


def draw_trade(path: str | Path, trade: list[dict[str, float]], width: float = 6.0) -> None:
    """Draw the trade as PNG, `width` inches wide; trade: share of the way to the developable rest shape, largest angle
    defect (rad) there and sag (over the size) of its simulation.

    Raises InputError if the file cannot be written.
    """
    from matplotlib.figure import Figure  # without pyplot, which also looks for windows

    figure = Figure(figsize=(width, 0.7 * width), layout="constrained")
    axes = figure.subplots()
    defect, sag = [step["defect"] for step in trade], [100.0 * step["sag"] for step in trade]
    axes.plot(defect, sag, "o-", color=LINE)
    for step, x, y in zip(trade, defect, sag, strict=True):
        axes.annotate(
            f"{100.0 * step['share']:g} %", (x, y), (6, 6), textcoords="offset points", color=INK, fontsize=8
        )
    axes.set_xlabel("largest angle defect [rad]")
    axes.set_ylabel("sag [% of the size]")
    axes.set_title(
        f"the way to a developable rest shape: defect {defect[-1]:.1e} rad, sag {sag[-1]:.2g} %",
        loc="left", fontsize=10, color=INK,
    )  # fmt: skip
    axes.spines[["top", "right"]].set_visible(False)
    axes.margins(0.12)
    try:
        figure.savefig(path, dpi=160)
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror}") from error
