"""Structured meshes in parameters: grids of cells, and rings around a pole."""

from collections.abc import Sequence

import numpy as np

from voile.arrays import Ints, Reals

DIAGONALS = ("alternating", "crossed", "right")


def grid(nu: int, nv: int, diagonals: str = "alternating") -> tuple[Reals, Ints]:
    """Unit square in nu x nv cells: (u, v) (n, 2) in [0, 1] and counter-clockwise triangles (m, 3).

    diagonals: "alternating" turns every other one (union jack), "crossed" puts a vertex in each cell; neither
    prefers a direction. "right" turns all the same way.
    """
    if diagonals not in DIAGONALS:
        raise ValueError(f"diagonals = {diagonals!r}, allowed: {', '.join(DIAGONALS)}")
    u, v = np.meshgrid(np.linspace(0, 1, nu + 1), np.linspace(0, 1, nv + 1))
    points = np.column_stack([u.ravel(), v.ravel()])
    i, j = (a.ravel() for a in np.meshgrid(np.arange(nu), np.arange(nv)))
    a = j * (nu + 1) + i
    b, c, d = a + 1, a + nu + 2, a + nu + 1
    if diagonals == "crossed":
        middle = len(points) + np.arange(len(a))
        points = np.concatenate([points, np.column_stack([(i + 0.5) / nu, (j + 0.5) / nv])])
        corners = [(a, b, middle), (b, c, middle), (c, d, middle), (d, a, middle)]
        return points, np.stack([np.column_stack(t) for t in corners], axis=1).reshape(-1, 3)
    turned = ((i + j) % 2 == 1) & (diagonals == "alternating")
    one = np.where(turned[:, None], np.column_stack([a, b, d]), np.column_stack([a, b, c]))
    two = np.where(turned[:, None], np.column_stack([b, c, d]), np.column_stack([a, c, d]))
    return points, np.stack([one, two], axis=1).reshape(-1, 3)


def rings(counts: Sequence[int]) -> tuple[list[Reals], Ints]:
    """Triangles between rings of `counts` vertices each, 1 at a pole.

    Returns the positions in [0, 1) of the vertices along each ring, every other ring half a step later, and
    triangles (m, 3), vertices numbered ring after ring; counter-clockwise where ring after ring leads up and
    positions lead right, seen from outside.
    """
    late = np.arange(len(counts)) % 2
    first = np.concatenate([[0], np.cumsum(counts)])
    triangles = []
    for k in range(len(counts) - 1):
        n, m, a, b = counts[k], counts[k + 1], int(late[k]), int(late[k + 1])
        i, j = np.arange(n), np.arange(m)
        # each edge takes the other ring's vertex nearest to its middle; in a tie both take the same diagonal
        above = ((2 * i + 1 + a) * m - b * n + n) // (2 * n) % m
        below = -((m + a * m - (2 * j + 1 + b) * n) // (2 * m)) % n
        if n > 1:
            triangles.append(np.column_stack([i, (i + 1) % n, n + above]) + first[k])
        if m > 1:
            triangles.append(np.column_stack([n + (j + 1) % m, n + j, below]) + first[k])
    positions = [(np.arange(n) + 0.5 * half) / n for n, half in zip(counts, late, strict=True)]
    return positions, np.concatenate(triangles)
