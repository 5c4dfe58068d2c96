"""The sewing pattern of flattened panels: grain, layout, cut line, notches, and what a summary says of it."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import shapely
from numpy.typing import ArrayLike

from voile.arrays import Ints, Reals
from voile.errors import InputError
from voile.inverse.cut_line import cut_line
from voile.inverse.ease import add_ease, wanted_ease
from voile.inverse.flatten import FlatPanels
from voile.inverse.grain import grains
from voile.inverse.panels import Panels, Seam
from voile.inverse.rules import NO_RULES, Rules, allowances, check_rules
from voile.inverse.symmetric import mirror_map, mirrored_rules, partners, symmetrised
from voile.mesh import METRES, Notches, Pattern, Piece, SewnSeam, Stitches, write_obj

UP = (0.0, 1.0, 0.0)
CORNER = np.radians(30.0)  # turn of the sew line at a turn point
REACH = 0.01  # of the perimeter: the directions before and after a point are those of chords so long
NOTCHES = (1 / 3, 2 / 3)  # of a seam
NOTCHED = 0.05  # m: a shorter seam needs no notches between its ends
GAP = 0.04  # m between pieces


def make_pattern(
    flat: FlatPanels,
    allowance: float = 0.0,
    grain: ArrayLike | None = UP,
    tolerance: float = 2e-3,
    rules: Rules = NO_RULES,
) -> Pattern:
    """The pattern, panels in their order, in rows from left to right, each with its grain line upwards.

    allowance: of the cut line, m; grain: direction in space that the grain line follows, the panel's long axis
    where it runs across the panel or for None; tolerance: mismatch of a seam's lengths that sewing takes up, m;
    rules: what is asked of single panels and seams, and of symmetry.
    Raises InputError for a negative allowance, a grain that is no direction, a panel that overlaps itself, rules that
    mean nothing here and panels that do not mirror each other; NotConverged for ease that a panel cannot take.
    """
    if not (np.isfinite(allowance) and allowance >= 0):
        raise InputError(f"pattern: seam allowance = {allowance}, allowed: 0 or more, in metres")
    check_rules(flat.panels, rules.panels, rules.seams)
    panels, mirrors, moved = flat.panels, tuple[int, ...](), 0.0
    if rules.symmetric is not None:
        mirror = mirror_map(panels, rules.symmetric)
        mirrors = tuple(partners(panels, mirror))
        even, moved = symmetrised(panels, flat.coordinates, mirror)
        flat = replace(flat, coordinates=even)  # ease is then that of the panels as they are cut
    rules = mirrored_rules(panels, rules)
    flat = add_ease(flat, rules.seams)
    x = flat.coordinates.copy()
    for k, along in enumerate(grains(flat, grain, rules.panels)):
        own = panels.vertex_panel == k
        x[own] = _turned(x[own], along)
    if mirrors:
        x, _ = symmetrised(panels, x, mirror)
    widths, at_seam = allowances(panels, rules.seams, allowance)
    outlines = zip(panels.outlines, widths, panels.names, strict=True)
    cuts = [cut_line(x[outline], width, name) for outline, width, name in outlines]
    shifts = _layout([rings[0] for rings in cuts])
    x += shifts[panels.vertex_panel]
    turns = [outline[_corners(x[outline])] for outline in panels.outlines]
    labels = [_label(k) for k in range(len(panels.seams))]
    pieces, corners = [], frozenset(np.concatenate(turns).tolist())
    for k, name in enumerate(panels.names):
        own = np.flatnonzero(panels.vertex_panel == k)
        here, first = panels.panel == k, own[0]
        pieces.append(
            Piece(
                name,
                x[own],
                panels.corners[here] - first,
                flat.stretches[here],
                panels.outlines[k] - first,
                tuple(ring + shifts[k] for ring in cuts[k]),
                turns[k] - first,
                _grain_line(x[panels.outlines[k]]),
                _notches(k, panels.seams, labels, at_seam, x, corners),
            )
        )
    ease = [wish or 0.0 for wish in wanted_ease(panels, rules.seams)]
    seams = [_sewn(*seam, x, panels) for seam in zip(panels.seams, labels, at_seam, ease, strict=True)]
    return Pattern(tuple(pieces), tuple(seams), float(allowance), float(tolerance), mirrors, moved)


def _turned(x: Reals, grain: Reals) -> Reals:
    """Points (v, 2) turned so that `grain` points up."""
    return np.column_stack([x @ np.array([grain[1], -grain[0]]), x @ grain])


def _layout(cuts: list[Reals]) -> Reals:
    """Shifts (P, 2) that put the pieces beside each other in rows, their lower edges level; rows go down."""
    low = np.array([cut.min(axis=0) for cut in cuts])
    size = np.array([np.ptp(cut, axis=0) for cut in cuts])
    width = max(size[:, 0].max(), 2.0 * np.sqrt(np.prod(size + GAP, axis=1).sum()))
    place, rows = np.zeros_like(low), [[0]]
    for k in range(1, len(cuts)):
        if size[rows[-1], 0].sum() + GAP * len(rows[-1]) + size[k, 0] > width:
            rows.append([])
        rows[-1].append(k)
    below = 0.0
    for row in rows:
        below -= size[row, 1].max()
        place[row, 0] = np.cumsum(size[row, 0] + GAP) - size[row, 0] - GAP
        place[row, 1] = below
        below -= GAP
    found: Reals = place - [0.0, place[:, 1].min()] - low
    return found


def _corners(outline: Reals) -> Ints:
    """Indices of the points where the sew line turns by more than CORNER, the sharpest one within REACH."""
    ends = np.vstack([outline, outline[:1]])
    along = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(ends, axis=0), axis=1)))
    total, s = along[-1], along[:-1]
    reach = REACH * total
    before, after = (
        np.column_stack([np.interp(s + shift, along, ends[:, i], period=total) for i in (0, 1)])
        for shift in (-reach, reach)
    )
    one, two = outline - before, after - outline
    angle = abs(np.arctan2(one[:, 0] * two[:, 1] - one[:, 1] * two[:, 0], np.einsum("ti,ti->t", one, two)))
    chosen: list[int] = []
    for k in np.argsort(-angle, kind="stable"):
        distance = abs(s[chosen] - s[k])
        if angle[k] > CORNER and (np.minimum(distance, total - distance) >= reach).all():
            chosen.append(int(k))
    return np.sort(np.array(chosen, dtype=np.int64))


def _grain_line(outline: Reals) -> Reals:
    """Lower and upper end (2, 2): the middle three fifths of the longest upright line through the centroid."""
    piece = shapely.make_valid(shapely.Polygon(outline))
    x = piece.centroid.x
    low, high = outline[:, 1].min(), outline[:, 1].max()
    inside = shapely.get_parts(piece.intersection(shapely.LineString([(x, low), (x, high)])))
    ends = np.sort(shapely.get_coordinates(max(inside, key=lambda part: part.length))[:, 1])[[0, -1]]
    return np.column_stack([[x, x], ends.mean() + 0.6 * (ends - ends.mean())])


def _label(k: int) -> str:
    """A, B, ... Z, AA, AB, ..."""
    return (_label(k // 26 - 1) if k >= 26 else "") + chr(ord("A") + k % 26)


def _notches(
    k: int,
    seams: Sequence[Seam],
    labels: list[str],
    widths: list[float],
    x: Reals,
    corners: frozenset[int],
) -> Notches:
    """Of panel k: at NOTCHES of every seam that is long enough, and where one ends without a corner on either side."""
    points, inward, allowance, names = [], [], [], []
    for seam, label, width in zip(seams, labels, widths, strict=True):
        for side in (0, 1):
            if seam.panels[side] != k:
                continue
            run, at = seam.sides[side], seam.at[side]
            ends = [t for t, e in ((0.0, 0), (1.0, -1)) if not corners.issuperset(s[e] for s in seam.sides)]
            inner = NOTCHES if np.linalg.norm(np.diff(x[run], axis=0), axis=1).sum() >= NOTCHED else ()
            for t in sorted({*inner, *ends}):
                edge = min(int(np.searchsorted(at, t, side="right")) - 1, len(at) - 2)
                tangent = x[run[edge + 1]] - x[run[edge]]
                left = np.array([-tangent[1], tangent[0]]) / np.linalg.norm(tangent)
                points.append(
                    x[run[edge]]
                    + (t - at[edge]) / (at[edge + 1] - at[edge]) * (x[run[edge + 1]] - x[run[edge]])
                )
                inward.append(left if side == 0 else -left)  # the first side follows its outline
                allowance.append(width)
                names.append(f"{label}{round(3 * t)}")
    return Notches(
        np.reshape(points, (-1, 2)), np.reshape(inward, (-1, 2)), np.array(allowance), tuple(names)
    )


def _sewn(seam: Seam, label: str, allowance: float, ease: float, x: Reals, panels: Panels) -> SewnSeam:
    lengths = [float(np.linalg.norm(np.diff(x[side], axis=0), axis=1).sum()) for side in seam.sides]
    first = np.searchsorted(panels.vertex_panel, seam.panels)
    sides = (seam.sides[0] - first[0], seam.sides[1] - first[1])
    return SewnSeam(label, seam.panels, sides, (lengths[0], lengths[1]), allowance, ease)


def pattern_summary(pattern: Pattern) -> dict[str, Any]:
    """Figures of a pattern: lengths in m, areas in m^2; distortion is the larger of s1 - 1 and 1 - s2.

    Per panel: area, perimeter, distortion (largest and area-weighted mean), stretch (largest s1 - 1), compression
    (largest 1 - s2), area_ratio (plane over surface), seams (labels). Per seam: panels, both lengths, mismatch.
    """
    worst = [np.maximum(p.stretches[:, 0] - 1, 1 - p.stretches[:, 1]) for p in pattern.pieces]
    panels = {}
    for k, piece in enumerate(pattern.pieces):
        corners = piece.points[piece.triangles]
        area = 0.5 * np.linalg.det(corners[:, 1:] - corners[:, :1])
        surface = area / piece.stretches.prod(axis=1)
        outline = piece.points[piece.outline]
        panels[piece.name] = {
            "area": float(area.sum()),
            "perimeter": float(np.linalg.norm(outline - np.roll(outline, 1, axis=0), axis=1).sum()),
            "distortion": float(worst[k].max()),
            "mean_distortion": float(surface @ worst[k] / surface.sum()),
            "stretch": float(piece.stretches[:, 0].max() - 1),
            "compression": float(1 - piece.stretches[:, 1].min()),
            "area_ratio": float(area.sum() / surface.sum()),
            "seams": [seam.label for seam in pattern.seams if k in seam.pieces],
        }
    seams = {
        seam.label: {
            "panels": [pattern.pieces[k].name for k in seam.pieces],
            "lengths": list(seam.lengths),
            "mismatch": seam.mismatch,
            "allowance": seam.allowance,
            "ease": seam.ease,
        }
        for seam in pattern.seams
    }
    mirrored = {}
    if pattern.mirrors:
        names = [
            [pattern.pieces[k].name, pattern.pieces[m].name] for k, m in enumerate(pattern.mirrors) if k <= m
        ]
        mirrored = {"symmetric": {"mirrored": names, "moved": pattern.symmetrised}}
    return {
        "panels": panels,
        "seams": seams,
        **mirrored,
        "distortion": float(max(strain.max() for strain in worst)),
        "seam_mismatch": max((seam.mismatch for seam in pattern.seams), default=0.0),
        "seam_tolerance": pattern.tolerance,
        "seams_beyond_tolerance": [s.label for s in pattern.seams if s.mismatch > pattern.tolerance],
        "allowance": pattern.allowance,
    }


def sewing(panels: Panels) -> Stitches:
    """The panels' stitches, after those that join all copies of a surface vertex to the first; panel vertices."""
    _, first, label = np.unique(panels.vertex, return_index=True, return_inverse=True)
    slave = np.setdiff1d(np.arange(len(panels.vertex)), first)
    master = first[label][slave]
    joins = Stitches(slave, master, master, np.zeros(len(slave)))
    if panels.stitches is None:
        return joins
    parts = [
        [getattr(s, end) for s in (joins, panels.stitches)] for end in ("slave", "first", "second", "weight")
    ]
    return Stitches(*(np.concatenate(part) for part in parts))


def write_rest_obj(path: str | Path, panels: Panels, pattern: Pattern, rest: Reals, comment: str) -> None:
    """Write the panels apart, as an OBJ that sews and drapes: rest positions (n, 3) of the surface's vertices as `v`,
    the pattern as `vt`, a group for each panel, and `stitch` records. Metres. InputError if it cannot be written."""
    write_obj(
        path,
        np.asarray(rest)[panels.vertex],
        panels.corners,
        np.concatenate([piece.points for piece in pattern.pieces]),
        groups=(panels.panel, panels.names),
        stitches=sewing(panels),
        comment=f"{METRES}\n{comment}",
    )
