"""pattern.png: the pieces of a pattern coloured by their distortion, with names, grain, notches and seam labels."""

from pathlib import Path
from typing import Any

import numpy as np

from voile.arrays import Reals
from voile.files import replacing
from voile.post.pattern_svg import (
    CLOTH,
    arrows,
    fabric_corners,
    mark_length,
    name_height,
    notch_lines,
    seam_labels,
    slope,
)
from voile.results import Pattern, Piece

INK, SEAM, NOTCH = "#1b1f24", "#1f5fa8", "#b3261e"
BOX = {"facecolor": "white", "alpha": 0.8, "linewidth": 0, "pad": 1.0}
EXACT = 1e-6  # below this distortion there is nothing to colour
LETTER = 0.012  # length of marks, of the drawing's size


def draw_pattern(path: str | Path, pattern: Pattern, width: float = 12.0) -> None:
    """Draw the pattern as PNG, `width` inches wide. Distortion of a triangle: the larger of s1 - 1 and 1 - s2.

    Raises InputError if the file cannot be written.
    """
    from matplotlib.figure import Figure  # without pyplot, which also looks for windows

    cloth = fabric_corners(pattern)
    everything = np.concatenate([*(piece.cut[0] for piece in pattern.pieces), cloth])
    low, size = everything.min(axis=0), np.ptp(everything, axis=0)
    tall = min(max(0.86 * width * size[1] / size[0] + 0.8, 3.0), 1.4 * width)
    figure = Figure(figsize=(width, tall))
    margins = {"left": 0.6 / width, "right": 1 - 0.2 / width, "bottom": 0.6 / tall, "top": 1 - 0.4 / tall}
    axes: Any = figure.subplots(gridspec_kw=margins)
    shares = [np.maximum(p.stretches[:, 0] - 1, 1 - p.stretches[:, 1]) for p in pattern.pieces]
    worst = max(float(share.max()) for share in shares)
    # the colours end where 99 % of the triangles do: one pointed corner does not hide the rest
    limit = max(float(np.percentile(np.concatenate(shares), 99)), EXACT)
    letter, scale = LETTER * max(size), 0.86 * width * 72 / size[0]  # m; points per m
    axes.plot(*np.vstack([cloth, cloth[:1]]).T, "--", color=INK, linewidth=0.8)
    for piece, share in zip(pattern.pieces, shares, strict=True):
        colours = _draw_piece(axes, piece, share, limit, letter)
        _write_name(axes, piece, _percent(share.max()), scale)
    for _, label, at, inward, height in seam_labels(pattern):
        points = float(np.clip(height * scale, 3.0, 9.0))
        style = {"color": SEAM, "fontsize": points, "weight": "bold", "ha": "center", "va": "center"}
        style |= {"rotation": slope(inward), "rotation_mode": "anchor"}
        axes.text(
            *(at + 1.1 * points / scale * inward),
            label,
            bbox=BOX,
            **style,
        )
    axes.set_aspect("equal")
    axes.set_xlim(low[0] - letter, low[0] + size[0] + letter)
    axes.spines[["top", "right"]].set_visible(False)
    axes.set_xlabel("m")
    count = ", ".join(
        f"{len(things)} {name}{'s' * (len(things) != 1)}"
        for name, things in (("panel", pattern.pieces), ("seam", pattern.seams))
    )
    axes.set_title(f"{count}; largest distortion: {_percent(worst)}", loc="left", fontsize=11, color=INK)
    if worst > EXACT:
        figure.colorbar(
            colours, label="distortion [%]", shrink=0.6, pad=0.01, fraction=0.08, aspect=25, extend="max"
        )
    with replacing(path) as file:
        figure.savefig(file, dpi=160, format="png")


def _draw_piece(axes: Any, piece: Piece, share: Reals, limit: float, letter: float) -> Any:
    """Cloth, distortion (f,) and lines of a piece; returns what the colour bar needs."""
    for k, ring in enumerate(piece.cut):
        axes.fill(*ring.T, facecolor="white" if k else CLOTH, edgecolor=INK, linewidth=0.9)
    colours = axes.tripcolor(
        *piece.points.T, piece.triangles, 100 * share, cmap="YlGnBu", vmin=0, vmax=100 * limit
    )
    outline = piece.points[piece.outline]
    axes.plot(*np.vstack([outline, outline[:1]]).T, color=SEAM, linewidth=0.8)
    mark = mark_length(piece, letter)
    for line in notch_lines(piece, mark):
        axes.plot(*line.T, color=NOTCH, linewidth=1.2)
    for line in (piece.grain, *arrows(piece.grain, mark)):
        axes.plot(*line.T, color=INK, linewidth=0.9)
    axes.plot(*piece.points[piece.turns].T, "x", color=INK, markersize=4, markeredgewidth=0.8)
    return colours


def _write_name(axes: Any, piece: Piece, figure: str, scale: float) -> None:
    """Name and distortion on the grain line, as small as the piece asks for; scale: points per m."""
    room = name_height(piece, max(len(piece.name), len(figure)))
    size = float(np.clip(room * scale, 4.0, 9.0))
    style = {"color": INK, "fontsize": size, "ha": "center", "va": "center", "linespacing": 1.3, "bbox": BOX}
    axes.text(*piece.grain.mean(axis=0), f"{piece.name}\n{figure}", **style)


def _percent(share: float) -> str:
    return f"{100 * share:.2g} %" if share > EXACT else "exact"
