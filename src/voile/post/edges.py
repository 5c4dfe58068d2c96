"""Edges of the triangles of a stored shape."""

import numpy as np

from voile.arrays import Ints


def boundary_edges(triangles: Ints) -> Ints:
    """(b, 2) vertex pairs of the edges with one triangle only."""
    tri = np.asarray(triangles, dtype=np.int64)
    pairs = tri[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    n = int(tri.max(initial=0)) + 1
    keys, count = np.unique(pairs.min(axis=1) * n + pairs.max(axis=1), return_counts=True)
    return np.column_stack(np.divmod(keys[count == 1], n))


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
