"""A sewing pattern as data: plane pieces laid out side by side, and how they are sewn. Lengths are in metres.

All pieces lie right side up, grain line upwards, each counter-clockwise.
"""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Notches:
    """q notches of a piece: points (q, 2) on the sew line, unit directions (q, 2) into the piece, labels, which are
    the same on both sides of a seam."""

    points: np.ndarray
    inward: np.ndarray
    labels: tuple[str, ...]


@dataclass(frozen=True)
class Piece:
    """One panel: points (v, 2), triangles (f, 3) and their stretches s1 >= s2 (f, 2) from the surface to the plane.

    outline (b,): the points along the sew line, counter-clockwise; cut: corners (c, 2) of the cut line, outside by
    the seam allowance, then those of holes where the allowance closes around some; turns (t,): the points where
    the sew line has a corner; grain (2, 2): lower and upper end of the grain line; notches.
    """

    name: str
    points: np.ndarray
    triangles: np.ndarray
    stretches: np.ndarray
    outline: np.ndarray
    cut: tuple[np.ndarray, ...]
    turns: np.ndarray
    grain: np.ndarray
    notches: Notches


@dataclass(frozen=True)
class SewnSeam:
    """A seam: label; indices of the pieces on either side (the same twice in a dart); the points of either side's
    run, in the same direction; and the lengths of both runs in the plane."""

    label: str
    pieces: tuple[int, int]
    sides: tuple[np.ndarray, np.ndarray]
    lengths: tuple[float, float]

    @property
    def mismatch(self) -> float:
        """Difference of the two lengths."""
        return abs(self.lengths[0] - self.lengths[1])


@dataclass(frozen=True)
class Pattern:
    """Pieces and seams; allowance: from the sew line to the cut line; tolerance: the mismatch of lengths that sewing
    takes up, seams beyond it are named in the summary."""

    pieces: tuple[Piece, ...]
    seams: tuple[SewnSeam, ...]
    allowance: float
    tolerance: float
