"""Grain lines: the direction of the warp on flat panels.

A panel that is sewn to itself is a tube, as a sleeve or a leg: its grain follows the tube's axis, from the middle of
one end to that of the other. Elsewhere it follows a direction in space, as the height, where the panel is not level;
else its long axis.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from voile.arrays import Ints, Reals
from voile.errors import InputError
from voile.inverse.flatten import FlatPanels
from voile.inverse.rules import PanelRule
from voile.mesh import is_called

LEVEL = 0.3  # mean slope of the grain direction on a panel below which the panel's long axis is its grain
SHORT = 0.2  # of the outline: the length of both sides of a seam that makes a tube; darts are shorter


def grains(flat: FlatPanels, direction: ArrayLike | None, rules: Sequence[PanelRule]) -> list[Reals]:
    """Unit direction (2,) of each panel's grain; direction: in space, for panels without a rule that are no tubes, the
    panel's long axis for None. Raises InputError for a direction that is none, and a rule "tube" for a panel that is
    none."""
    found = []
    for k, name in enumerate(flat.panels.names):
        own = [rule for rule in rules if is_called(name, rule.panel)]
        axis = _tube(flat, k)
        if own and own[-1].grain == "tube" and axis is None:
            raise InputError(
                f"pattern.panel: grain = 'tube' of {name!r}, which is not sewn to itself along its length; allowed: "
                "'long', or a direction"
            )
        wish = own[-1].grain if own else ("tube" if axis is not None else direction)
        along = axis if isinstance(wish, str) and wish == "tube" else wish
        found.append(_along(flat, k, None if isinstance(along, str) else along))
    return found


def _tube(flat: FlatPanels, k: int) -> Reals | None:
    """(3,) the axis of a panel that is a tube, upwards along y if it is not level, else along its seam."""
    panels = flat.panels
    points, outline = panels.points[panels.vertex], panels.outlines[k]
    length = _length(points[np.append(outline, outline[0])])
    for seam in panels.seams:
        both = np.concatenate(seam.sides)
        if seam.panels != (k, k) or len(np.unique(both)) < len(both):  # the sides of a dart meet
            continue
        if _length(points[seam.sides[0]]) < SHORT / 2 * length:
            continue
        ends = [_end(points, outline, seam.sides[0][e], seam.sides[1][e]) for e in (0, -1)]
        axis = ends[1] - ends[0]
        if np.linalg.norm(axis) > LEVEL * _length(points[seam.sides[0]]):
            return axis / np.linalg.norm(axis) * (-1.0 if axis[1] < 0 else 1.0)
    return None


def _end(points: Reals, outline: Ints, one: int, other: int) -> Reals:
    """(3,) the middle of the ring that a tube's outline makes between two points that are sewn together."""
    i, j = (int(np.flatnonzero(outline == v)[0]) for v in (one, other))
    runs = [np.roll(outline, -a)[: (b - a) % len(outline) + 1] for a, b in ((i, j), (j, i))]
    ring = points[min(runs, key=lambda run: _length(points[run]))]
    weights = np.linalg.norm(np.diff(ring, axis=0), axis=1)
    middle = 0.5 * (ring[1:] + ring[:-1])
    found: Reals = weights @ middle / weights.sum() if weights.sum() else ring[0]
    return found


def _length(points: Reals) -> float:
    return float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())


def _along(flat: FlatPanels, k: int, grain: ArrayLike | None) -> Reals:
    """Unit direction (2,): the mean slope of the height along `grain` over the flat panel."""
    panels = flat.panels
    corners = panels.corners[panels.panel == k]
    x = flat.coordinates[corners]
    if grain is not None:
        height = panels.points[panels.vertex[corners]] @ _unit(grain)
        one, two = x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]
        # the area-weighted mean of the gradient g: g . one = h1 - h0, g . two = h2 - h0, times twice the area
        rise = (height - height[:, :1])[:, 1:]
        slope = np.column_stack(
            [
                two[:, 1] * rise[:, 0] - one[:, 1] * rise[:, 1],
                one[:, 0] * rise[:, 1] - two[:, 0] * rise[:, 0],
            ]
        ).sum(axis=0)
        slope /= (one[:, 0] * two[:, 1] - one[:, 1] * two[:, 0]).sum()
        if np.linalg.norm(slope) >= LEVEL:
            upright: Reals = slope / np.linalg.norm(slope)
            return upright
    outline = flat.coordinates[panels.outlines[k]]
    _, _, axes = np.linalg.svd(outline - outline.mean(axis=0), full_matrices=False)
    found: Reals = axes[0]
    return found


def _unit(direction: ArrayLike) -> Reals:
    vector = np.asarray(direction, dtype=float)
    length = np.linalg.norm(vector)
    if vector.shape != (3,) or not 0 < length < np.inf:
        raise InputError(
            f"pattern: grain = {vector.tolist()}, allowed: a direction, three numbers not all zero"
        )
    found: Reals = vector / length
    return found
