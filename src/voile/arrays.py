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
