"""Flat rectangles as arrays, for the examples."""

import numpy as np


def rectangle(cells: tuple[int, int], size: tuple[float, float]) -> tuple[np.ndarray, np.ndarray]:
    """Points (n, 3) of [0, size 0] x [0, size 1] at z = 0 and triangles (m, 3), whose diagonals alternate."""
    nx, ny = cells
    x, y = np.meshgrid(np.linspace(0, size[0], nx + 1), np.linspace(0, size[1], ny + 1), indexing="ij")
    i, j = (k.ravel() for k in np.meshgrid(range(nx), range(ny), indexing="ij"))
    a, b, c, d = (p * (ny + 1) + q for p, q in ((i, j), (i + 1, j), (i + 1, j + 1), (i, j + 1)))
    even = ((i + j) % 2 == 0)[:, None]
    first = np.where(even, np.c_[a, b, c], np.c_[a, b, d])
    second = np.where(even, np.c_[a, c, d], np.c_[b, c, d])
    return np.c_[x.ravel(), y.ravel(), 0 * x.ravel()], np.r_[first, second]
