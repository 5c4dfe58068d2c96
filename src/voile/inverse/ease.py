"""Ease: one side of a seam made longer than the other, which sewing gathers in (as a sleeve's cap in its armhole).

The cloth near that side takes on another metric: stretched along the seam, less and less with the distance from it.
Laid flat again with least distortion, its panel has a longer side; how much stretch it takes is found by iteration.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import shapely

from voile.arrays import Reals
from voile.errors import NotConverged
from voile.inverse.flatten import FlatPanels, distortion, relax
from voile.inverse.panels import Panels
from voile.inverse.rules import SeamRule, sides

REACH = 0.5  # of the side's length: where the stretch ends
ACCURACY = 1e-8  # m
ROUNDS = 60


def wanted_ease(panels: Panels, rules: Sequence[SeamRule]) -> list[float | None]:
    """By how much (m) each seam's first side is to be longer than its second; None where no rule says so."""
    found: list[float | None] = [None] * len(panels.seams)
    for k, seam in enumerate(panels.seams):
        for rule in rules:
            order = sides(panels, seam, rule)
            if rule.ease and order:
                found[k] = rule.ease * (1.0 if order == (0, 1) else -1.0)
    return found


def add_ease(flat: FlatPanels, rules: Sequence[SeamRule]) -> FlatPanels:
    """The panels with the ease that rules ask for: the longer side of each seam grows. Raises NotConverged where a
    panel cannot take it."""
    panels, ease = flat.panels, wanted_ease(flat.panels, rules)
    eased = [k for k, wish in enumerate(ease) if wish is not None]
    if not eased:
        return flat
    grows = {k: 0 if (ease[k] or 0.0) > 0 else 1 for k in eased}
    stretch, x = dict.fromkeys(eased, 0.0), flat.coordinates.copy()
    within = {k: _influence(flat, k, grows[k]) for k in eased}
    for _ in range(ROUNDS):
        error = {}
        for k in eased:
            lengths = [_length(x[side]) for side in panels.seams[k].sides]
            error[k] = abs(ease[k] or 0.0) - (lengths[grows[k]] - lengths[1 - grows[k]])
            stretch[k] += error[k] / lengths[grows[k]]
        if max(abs(e) for e in error.values()) < ACCURACY:
            stretches = distortion(panels.points[panels.vertex], panels.corners, x)
            return replace(flat, coordinates=x, stretches=stretches)
        for panel in {panels.seams[k].panels[grows[k]] for k in eased}:
            here, own = panels.panel == panel, np.flatnonzero(panels.vertex_panel == panel)
            change = np.zeros((np.count_nonzero(here), 2, 2)) + np.eye(2)
            for k in eased:
                if panels.seams[k].panels[grows[k]] == panel:
                    change = change + stretch[k] * within[k]
            corners = panels.corners[here]
            shapes = np.einsum("tij,tcj->tci", change, flat.coordinates[corners])
            shapes = np.concatenate([shapes, np.zeros((*shapes.shape[:2], 1))], axis=2)
            x[own] = relax(x[own], corners - own[0], shapes, panels.names[panel])
    worst = max(eased, key=lambda k: abs(error[k]))
    names = " and ".join(panels.names[k] for k in panels.seams[worst].panels)
    raise NotConverged(
        f"ease between {names}: {abs(error[worst]):.1e} m short of what was asked for; ask for less"
    )


def _influence(flat: FlatPanels, seam: int, side: int) -> Reals:
    """(m', 2, 2) of the panel's triangles: t t^T with the seam's direction t, times 1 at the seam to 0 at its reach."""
    panels, run = flat.panels, flat.panels.seams[seam].sides[side]
    points = flat.coordinates[run]
    corners = flat.coordinates[panels.corners[panels.panel == panels.seams[seam].panels[side]]]
    middle, line = shapely.points(corners.mean(axis=1)), shapely.LineString(points)
    arc = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1)))
    at = shapely.line_locate_point(line, middle)
    edges = np.diff(points, axis=0)
    edges /= np.linalg.norm(edges, axis=1)[:, None]
    ends = (
        at + np.array([[-1.0], [1.0]]) * ACCURACY * arc[-1]
    )  # beside a vertex both edges count, whichever comes first
    tangent = edges[np.clip(np.searchsorted(arc, ends) - 1, 0, len(edges) - 1)].sum(axis=0)
    tangent /= np.linalg.norm(tangent, axis=1)[:, None]
    weight = np.clip(1.0 - shapely.distance(line, middle) / (REACH * arc[-1]), 0.0, 1.0)
    found: Reals = np.einsum("t,ti,tj->tij", weight, tangent, tangent)
    return found


def _length(points: Reals) -> float:
    return float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())
