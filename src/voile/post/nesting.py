"""Pieces of a pattern laid on a fabric of given width, in as little length as a search finds, grain along the fabric.

The search is sparrow's (Gardeyn, Vanden Berghe & Wauters, arXiv:2509.13329, 2025), by its Python package spyrrow.
"""

from dataclasses import replace

import numpy as np
import shapely

from voile.arrays import Reals
from voile.errors import InputError, NotConverged
from voile.results import Pattern, Piece

ROUNDING = 0.125  # of the gap: how far outlines may be simplified; two such leave most of the gap
SEED = 0
OVERLAP = 1e-9  # m^2, round-off of areas


def nested(pattern: Pattern, width: float, gap: float, turn: bool, seconds: float) -> Pattern:
    """The pattern on a fabric `width` wide, pieces `gap` apart or nearly so (m); its length is in `fabric`.

    turn: whether pieces may lie upside down, for cloth without a nap. Raises InputError for a piece wider than the
    fabric; NotConverged where the search ends with pieces that overlap.
    """
    _check(pattern, width, gap, seconds)
    import spyrrow

    items = [spyrrow.Item(str(k), _outline(p, gap), 1, [0.0, 180.0] if turn else [0.0])
             for k, p in enumerate(pattern.pieces)]  # fmt: skip
    config = spyrrow.StripPackingConfig(
        early_termination=True, total_computation_time=max(1, round(seconds)), num_workers=1, seed=SEED
    )
    found = spyrrow.StripPackingInstance("pattern", strip_height=width, items=items).solve(config)
    pieces = list(pattern.pieces)
    for item in found.placed_items:
        k = int(item.id)
        across = np.array(item.translation)[::-1]  # the strip lies, the fabric stands
        pieces[k] = _moved(pieces[k], -1.0 if round(item.rotation) % 360 else 1.0, across)
    low = min(piece.cut[0][:, 1].min() for piece in pieces) - 0.5 * gap
    pieces = [_moved(piece, 1.0, np.array([0.0, -low])) for piece in pieces]
    length = max(piece.cut[0][:, 1].max() for piece in pieces) + 0.5 * gap
    laid = replace(pattern, pieces=tuple(pieces), fabric=(width, float(length)))
    _prove(laid)
    return laid


def efficiency(pattern: Pattern) -> float:
    """Share of the fabric that the pieces use, seam allowances included; the pattern must be laid on one."""
    if pattern.fabric is None:
        raise ValueError("a pattern in rows has no fabric")
    return float(sum(_area(piece).area for piece in pattern.pieces) / (pattern.fabric[0] * pattern.fabric[1]))


def _check(pattern: Pattern, width: float, gap: float, seconds: float) -> None:
    for name, value in (("--width", width), ("--seconds", seconds)):
        if not 0 < value < np.inf:
            raise InputError(f"{name} {value:g}; allowed: above 0")
    if not 0 <= gap < width:
        raise InputError(f"--gap {gap:g}; allowed: 0 to the fabric's width, {width:g} m")
    for piece in pattern.pieces:
        wide = float(np.ptp(piece.cut[0][:, 0])) + gap
        if wide > width:
            raise InputError(
                f"--width {width:g}: piece {piece.name!r} and its gap are {wide:.4g} m wide across its grain; allowed: "
                "at least that"
            )


def _outline(piece: Piece, gap: float) -> list[tuple[float, float]]:
    """Corners of the cut line, half a gap outside, in the coordinates of the strip: along, then across."""
    reach = max(
        0.5 * gap, 1e-4
    )  # m: an outline without any gap may still be simplified to tenths of a millimetre
    grown = shapely.Polygon(piece.cut[0]).buffer(reach, join_style="mitre", mitre_limit=1.5)
    ring = shapely.get_coordinates(grown.simplify(2 * ROUNDING * reach).exterior)
    return [(float(y), float(x)) for x, y in ring]


def _moved(piece: Piece, sign: float, by: Reals) -> Piece:
    """The piece turned by 180 degrees about the origin where sign is -1, then moved."""
    notches = replace(
        piece.notches, points=sign * piece.notches.points + by, inward=sign * piece.notches.inward
    )
    grain = sign * piece.grain + by
    return replace(
        piece, points=sign * piece.points + by, cut=tuple(sign * ring + by for ring in piece.cut),
        grain=grain[np.argsort(grain[:, 1])], notches=notches,
    )  # fmt: skip


def _area(piece: Piece) -> shapely.Polygon:
    return shapely.Polygon(piece.cut[0], piece.cut[1:])


def _prove(pattern: Pattern) -> None:
    """Raises NotConverged where pieces overlap, or one is not on the fabric."""
    assert pattern.fabric
    width, length = pattern.fabric
    cloth = shapely.box(0.0, 0.0, width, length)
    areas = [shapely.Polygon(piece.cut[0]) for piece in pattern.pieces]
    for k, area in enumerate(areas):
        if area.difference(cloth).area > OVERLAP:
            raise NotConverged(
                f"piece {pattern.pieces[k].name!r} does not lie on the fabric; give more --seconds"
            )
        for m in range(k):
            if area.intersection(areas[m]).area > OVERLAP:
                names = f"{pattern.pieces[k].name!r} and {pattern.pieces[m].name!r}"
                raise NotConverged(f"pieces {names} overlap; give more --seconds")
