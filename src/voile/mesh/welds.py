"""Edges along which sheets join (mesh.joints) at an angle that they keep."""

import numpy as np

from voile.arrays import Reals
from voile.mesh.surface import Surface
from voile.mesh.topology import Topology


def welds(surface: Surface, topology: Topology, stiffness: float, plate: Reals) -> Reals | None:
    """(w, 9) for every sheet that joins another along an edge: the edge's vertices, those across it in the sheet it
    joins, those across it in its own (twice the same where the sheet ends there), a stiffness (N m per radian), and the
    angles from the first two to the last two about the edge. None without `stiffness` (N m per m) of the joint.

    plate (m,): bending stiffness (N m) of the triangles. A triangle at the end of its sheet bends half as much as its
    sheet, for the end has no moment: the half that is missing acts in series with the joint.
    """
    if not stiffness:
        return None
    ends = np.sort(surface.first_copies[topology.edges], axis=1)
    place, count = np.unique(ends, axis=0, return_inverse=True, return_counts=True)[1:]
    place = place.ravel()
    across: dict[int, list[int]] = {int(edge): [] for edge in np.flatnonzero(count[place] > 1)}
    for half, edge in enumerate(topology.triangle_edges.ravel()):
        if int(edge) in across:
            across[int(edge)].append(half)
    first: dict[int, int] = {}
    rows = []
    for edge in sorted(across, key=lambda edge: (-len(across[edge]), edge)):
        joined = first.setdefault(int(place[edge]), edge)
        if joined != edge:
            rows.append([*topology.edges[joined], *_both(across[joined]), *_both(across[edge])])
    if not rows:
        return None
    found = np.array(rows)
    ending = found[:, 4] == found[:, 5]
    bends = plate[found[:, 4] // 3]
    found[:, 2:] = surface.triangles.ravel()[found[:, 2:]]
    x = surface.points[found]
    along, away = x[:, 1] - x[:, 0], x[:, 4] - x[:, 0]
    length = np.linalg.norm(along, axis=1)
    height = np.linalg.norm(np.cross(along, away), axis=1) / length
    missing = np.where(ending, height / (2.0 * bends), 0.0)
    return np.column_stack([found, length / (1.0 / stiffness + missing), turned(x)])


def _both(halves: list[int]) -> list[int]:
    """The two half edges of an edge, twice the same at the end of a sheet."""
    return [halves[0], halves[-1]]


def turned(x: Reals) -> Reals:
    """(w, 2) angles about edges x_0 x_1 from x_2 to x_4 and from x_3 to x_5, of points (w, 6, 3)."""
    along = x[:, 1] - x[:, 0]
    along = along / np.linalg.norm(along, axis=1, keepdims=True)
    away = x[:, 2:] - x[:, :1]
    away = away - np.einsum("wki,wi->wk", away, along)[:, :, None] * along[:, None]
    one, other = away[:, :2], away[:, 2:]
    sine = np.einsum("wki,wi->wk", np.cross(one, other), along)
    found: Reals = np.arctan2(sine, np.einsum("wki,wki->wk", one, other))
    return found
