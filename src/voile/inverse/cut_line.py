"""Cut lines: a panel's sew line widened by its seam allowances."""

import numpy as np
import shapely

from voile.arrays import Reals
from voile.errors import InputError
from voile.inverse.flatten import overlaps

TOUCHING = 1e-8  # m
MITRE = 2.0  # longest corner of the cut line, in allowances


def cut_line(outline: Reals, allowance: Reals, name: str) -> tuple[Reals, ...]:
    """Rings (c, 2) of the cut line of a sew line (b, 2), counter-clockwise, the outer one first; allowance (b,), m, of
    the edge from each point to the next. InputError where the panel lies on itself."""
    if overlaps(outline):
        raise InputError(
            f"panel {name!r} overlaps itself when laid flat; cut it further, with seams or groups"
        )
    if not allowance.any():
        return (outline,)
    # the two sides of a cut without opening become one
    sides = shapely.set_precision(shapely.Polygon(outline), TOUCHING, mode="pointwise")
    sewn = shapely.make_valid(sides)
    if np.ptp(allowance) == 0:
        wide = sewn.buffer(allowance[0], join_style="mitre", mitre_limit=MITRE)
    else:
        strips = shapely.union_all([sewn, *_strips(outline, allowance)])
        wide = strips.buffer(TOUCHING, join_style="mitre").buffer(-TOUCHING, join_style="mitre")
    wide = shapely.orient_polygons(wide)
    return tuple(shapely.get_coordinates(ring)[:-1] for ring in (wide.exterior, *wide.interiors))


def _strips(outline: Reals, allowance: Reals) -> list[shapely.Polygon]:
    """What each edge adds outside, and each corner that points outwards: to where both cut lines meet."""
    along = np.roll(outline, -1, axis=0) - outline
    out = np.column_stack([along[:, 1], -along[:, 0]]) / np.linalg.norm(along, axis=1)[:, None]
    made = []
    for k, (p, width, normal) in enumerate(zip(outline, allowance, out, strict=True)):
        q, before, last = outline[(k + 1) % len(outline)], allowance[k - 1], out[k - 1]
        if width:
            made.append(shapely.Polygon([p, p + width * normal, q + width * normal, q]))
        turn = last[0] * normal[1] - last[1] * normal[0]
        if turn > 0 and (width or before):
            ends = [p + before * last, p + width * normal]
            tip = np.linalg.solve(np.array([last, normal]), [before, width]) if turn > TOUCHING else None
            if tip is not None and np.linalg.norm(tip) <= MITRE * max(width, before):
                ends.insert(1, p + tip)
            made.append(shapely.Polygon([p, *ends]))
    return [shapely.make_valid(strip) for strip in made]
