"""Supports as they move in time, and what is sewn to them."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from voile.arrays import Ints, Reals
from voile.contact.motion import Motion


@dataclass
class Supports:
    """points (h, 3) m: start places of the supported vertices that may move; motions: rows of them, and how they move;
    carry (dofs, 3h): takes their displacements along the seams."""

    points: Reals
    motions: Sequence[tuple[Ints, Motion]]
    carry: sp.csr_matrix

    @property
    def move(self) -> bool:
        """Whether any does."""
        return any(motion.moves for _, motion in self.motions)

    @property
    def ends(self) -> float:
        """Time after which none moves."""
        return max((motion.ends for _, motion in self.motions), default=0.0)

    def between(self, start: float, end: float) -> Reals:
        """(dofs,) prescribed displacement from time start to end (m)."""
        if start == end or not self.motions:
            return np.zeros(self.carry.shape[0])
        moved = np.zeros_like(self.points)
        for rows, motion in self.motions:
            moved[rows] += motion.between(self.points[rows], start, end)
        found: Reals = self.carry @ moved.ravel()
        return found

    def of(self, dofs: Ints) -> "Supports":
        """What concerns some degrees of freedom."""
        carry = self.carry[dofs]
        needed = np.unique(carry.indices // 3)
        columns = (3 * needed[:, None] + np.arange(3)).ravel()
        motions = []
        for rows, motion in self.motions:
            mine = np.flatnonzero(np.isin(rows, needed))
            motions.append((np.searchsorted(needed, rows[mine]), motion.of(mine)))
        return Supports(self.points[needed], motions, carry[:, columns].tocsr())
