"""Holes of a triangle mesh closed without new vertices: the triangulation of each border loop with the least area.

Barequet & Sharir, Filling gaps in the boundary of a polyhedron (CAGD 12, 1995): dynamic programming over chords, which
takes loop length cubed; edges that the mesh has already are no chords.
"""

import numpy as np

from voile.arrays import Flags, Ints, Reals
from voile.mesh.topology import boundary_loops, build_topology

FLAT = 1e-4  # altitude over longest edge: flatter triangles close no hole
LONGEST = 300  # edges of a loop: a minute of it


def border_loops(points: Reals, triangles: Ints) -> list[Ints]:
    """Border loops of an edge-manifold, oriented mesh, longest (m) first."""
    return boundary_loops(triangles, build_topology(triangles), points)


def fill(points: Reals, triangles: Ints, loop: Ints) -> Ints | None:
    """Triangles (len(loop) - 2, 3) that close a border loop (k,), oriented as their neighbours; None where every way
    uses an edge or a triangle that the mesh has."""
    n, ring = len(loop), loop[::-1]  # neighbours run along the loop, fillings against it
    if len(np.unique(ring)) < n:
        return None
    x = points[ring]
    taken = _taken(triangles, ring)
    cost, middle = np.full((n, n), np.inf), np.zeros((n, n), dtype=np.int64)
    cost[np.arange(n - 1), np.arange(1, n)] = 0.0
    for width in range(2, n):
        for i in range(n - width):
            k = i + width
            if taken[i, k] and width < n - 1:
                continue
            between = np.arange(i + 1, k)
            one, other, base = x[between] - x[i], x[between] - x[k], x[k] - x[i]
            area = np.linalg.norm(np.cross(one, base), axis=1)
            longest = np.maximum(np.einsum("ij,ij->i", one, one), np.einsum("ij,ij->i", other, other))
            flat = area <= FLAT * np.maximum(longest, base @ base)
            total = cost[i, between] + cost[between, k] + np.where(flat, np.inf, area)
            best = int(total.argmin())
            cost[i, k], middle[i, k] = total[best], between[best]
    if not np.isfinite(cost[0, n - 1]):
        return None
    made, open_chords = [], [(0, n - 1)]
    while open_chords:
        i, k = open_chords.pop()
        if k - i > 1:
            j = int(middle[i, k])
            made.append((ring[i], ring[j], ring[k]))
            open_chords += [(i, j), (j, k)]
    found = np.array(made, dtype=np.int64)
    known = set(map(tuple, np.sort(triangles, axis=1).tolist()))
    return None if known.intersection(map(tuple, np.sort(found, axis=1).tolist())) else found


def _taken(triangles: Ints, ring: Ints) -> Flags:
    """(n, n) whether two vertices of a ring are joined by an edge of the mesh."""
    place = np.full(triangles.max() + 1, -1)
    place[ring] = np.arange(len(ring))
    sides = place[triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)]
    sides = sides[(sides >= 0).all(axis=1)]
    taken = np.zeros((len(ring), len(ring)), dtype=bool)
    taken[sides[:, 0], sides[:, 1]] = taken[sides[:, 1], sides[:, 0]] = True
    return taken
