"""A sewing pattern as data: plane pieces laid out side by side, and how they are sewn. Lengths are in metres.

All pieces lie right side up, grain line upwards, each counter-clockwise.
"""

import re
from dataclasses import dataclass

from voile.arrays import Ints, Reals


@dataclass(frozen=True)
class Notches:
    """q notches of a piece: points (q, 2) on the sew line, unit directions (q, 2) into the piece, allowance (q,) from
    there to the cut line, labels, which are the same on both sides of a seam."""

    points: Reals
    inward: Reals
    allowance: Reals
    labels: tuple[str, ...]


@dataclass(frozen=True)
class Piece:
    """One panel: points (v, 2), triangles (f, 3) and their stretches s1 >= s2 (f, 2) from the surface to the plane.

    outline (b,): the points along the sew line, counter-clockwise; cut: corners (c, 2) of the cut line, outside by
    the seam allowance, then those of holes where the allowance closes around some; turns (t,): the points where
    the sew line has a corner; grain (2, 2): lower and upper end of the grain line; notches.
    """

    name: str
    points: Reals
    triangles: Ints
    stretches: Reals
    outline: Ints
    cut: tuple[Reals, ...]
    turns: Ints
    grain: Reals
    notches: Notches


@dataclass(frozen=True)
class SewnSeam:
    """A seam: label; indices of the pieces on either side (the same twice in a dart); the points of either side's
    run, in the same direction; the lengths of both runs in the plane; the seam's allowance; and its ease: by how much
    the first side is meant to be longer."""

    label: str
    pieces: tuple[int, int]
    sides: tuple[Ints, Ints]
    lengths: tuple[float, float]
    allowance: float
    ease: float

    @property
    def mismatch(self) -> float:
        """Difference of the two lengths, beside the ease."""
        return abs(self.lengths[0] - self.lengths[1] - self.ease)


@dataclass(frozen=True)
class Pattern:
    """Pieces and seams; allowance: from the sew line to the cut line where no seam has its own; tolerance: the mismatch
    of lengths that sewing takes up, seams beyond it are named in the summary. mirrors: the piece that each is the
    mirror image of, itself in the middle; none where symmetry was not asked for; symmetrised: how far points moved
    for it. fabric: width and length of the cloth that the pieces are laid on, None where they are in rows."""

    pieces: tuple[Piece, ...]
    seams: tuple[SewnSeam, ...]
    allowance: float
    tolerance: float
    mirrors: tuple[int, ...] = ()
    symmetrised: float = 0.0
    fabric: tuple[float, float] | None = None


def is_called(panel: str, name: str) -> bool:
    """Whether a rule's name means a panel: its own, or that of the group it is a numbered piece of."""
    return panel == name or re.fullmatch(re.escape(name) + r"-\d+", panel) is not None
