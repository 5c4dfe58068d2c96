"""Edges of the triangles of a stored shape."""

import numpy as np

from voile.arrays import Ints, triangle_sides


def edges(triangles: Ints) -> tuple[Ints, Ints]:
    """(e, 2) ascending vertex pairs of the edges, and (e,) how many triangles each has."""
    tri = np.asarray(triangles, dtype=np.int64)
    n = int(tri.max(initial=0)) + 1
    keys, count = np.unique(triangle_sides(tri) @ [n, 1], return_counts=True)
    return np.column_stack(np.divmod(keys, n)), count


def boundary_edges(triangles: Ints) -> Ints:
    """(b, 2) vertex pairs of the edges with one triangle only."""
    pairs, count = edges(triangles)
    found: Ints = pairs[count == 1]
    return found


def hinges(triangles: Ints) -> Ints:
    """(k, 4): vertices i, j of each inner edge and the triangles left and right of it, seen from i to j."""
    tri = np.asarray(triangles, dtype=np.int64)
    start, end = tri[:, [0, 1, 2]].ravel(), tri[:, [1, 2, 0]].ravel()
    owner = np.repeat(np.arange(len(tri)), 3)
    n = int(tri.max(initial=0)) + 1
    key, twin = start * n + end, end * n + start
    order = np.argsort(key)
    at = np.minimum(np.searchsorted(key, twin, sorter=order), len(key) - 1)
    half = order[at]
    inner = (key[half] == twin) & (start < end)
    found: Ints = np.column_stack([start, end, owner, owner[half]])[inner]
    return found
