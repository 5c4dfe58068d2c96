"""Names of annotations for NumPy's arrays, whose shapes docstrings tell, and what all packages ask of arrays.

`Any` in them is a number's width, which NumPy's own operations leave open.
"""

from typing import Any, TypeAlias

import numpy as np

Reals: TypeAlias = np.ndarray[Any, np.dtype[np.floating[Any]]]
Ints: TypeAlias = np.ndarray[Any, np.dtype[np.integer[Any]]]
Flags: TypeAlias = np.ndarray[Any, np.dtype[np.bool_]]
Array: TypeAlias = np.ndarray[
    Any, np.dtype[Any]
]  # of any numbers: fields of files, what works on all of them


def sums(place: Ints, values: Reals, count: int = 0) -> Reals:
    """(at least count,) sums of values (k,) that go to the same places (k,)."""
    return np.asarray(np.bincount(place, values, count), dtype=float)


def row_sums(place: Ints, values: Reals, count: int) -> Reals:
    """(count, c) sums of rows (k, c) that go to the same places (k,)."""
    return np.stack([np.bincount(place, column, count) for column in values.T], axis=1)


def units(vectors: Reals) -> Reals:
    """Vectors (..., 3) over their lengths; none stays none."""
    found: Reals = vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-300)
    return found


def diagonal(points: Reals) -> float:
    """That of the bounding box of points (n, 3)."""
    return float(np.linalg.norm(np.ptp(points, axis=0)))


def area_vectors(points: Reals, triangles: Ints) -> Reals:
    """(m, 3) normals of triangles (m, 3) of points (n, 3), twice as long as their areas."""
    a, b, c = (points[triangles[:, k]] for k in range(3))
    found: Reals = np.cross(b - a, c - a)
    return found


def triangle_areas(points: Reals, triangles: Ints) -> Reals:
    """(m,) areas of triangles (m, 3) of points (n, 3)."""
    found: Reals = 0.5 * np.linalg.norm(area_vectors(points, triangles), axis=1)
    return found


def triangle_sides(triangles: Ints) -> Ints:
    """(3m, 2) ascending vertices of the sides of triangles (m, 3), one triangle's after the other's."""
    return np.sort(triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)


def border_sides(triangles: Ints) -> Ints:
    """(k, 2) ascending vertices of the sides that belong to one triangle alone."""
    sides, times = np.unique(triangle_sides(triangles), axis=0, return_counts=True)
    found: Ints = sides[times == 1]
    return found
