"""What a shell's contacts are with: rigid obstacles or the shell itself, one interface for the laws.

A partner has `count` contacts in the state, numbered in its own way, over vertices whose positions `widen` gives from
this rank's; `narrow` takes forces back. Its gaps, their geometry and the relative motion since the start of the step
are all that Signorini's and Coulomb's laws need.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from voile.contact.obstacles import Obstacle
from voile.contact.pairs import Geometry

if TYPE_CHECKING:
    from voile.contact.state import State


@dataclass
class OnObstacle:
    """Every local vertex with one obstacle, at `offset` (n,) m from it."""

    obstacle: Obstacle
    offset: np.ndarray
    free: np.ndarray
    own: np.ndarray

    @property
    def friction(self) -> float:
        return self.obstacle.friction

    def widen(self, x: np.ndarray) -> np.ndarray:
        return x

    def narrow(self, forces: np.ndarray) -> np.ndarray:
        return forces

    def gaps(self, x: np.ndarray, factor: float, state: State) -> np.ndarray:
        """(n,) m."""
        return self.obstacle.gap(x, factor) - self.offset

    def geometry(self, rows: np.ndarray, x: np.ndarray, factor: float, state: State) -> Geometry:
        """That of some contacts."""
        gap, gradient, curvature = self.obstacle.gap_derivatives(x[rows], factor)
        return Geometry(gap - self.offset[rows], gradient, curvature, rows[:, None], np.ones((len(rows), 1)))

    def moved(
        self, rows: np.ndarray, grip: np.ndarray, x: np.ndarray, factor: float, state: State
    ) -> np.ndarray:
        """(p, 3) relative motion of some contacts since the start of the step (m)."""
        return x[rows] - self.obstacle.carry(state.reference[rows], state.factor, factor)

    def movable(self, state: State) -> np.ndarray:
        """(n,) marks the contacts that have unknowns."""
        return self.free

    def counted(self, rows: np.ndarray, state: State) -> np.ndarray:
        """(p,) marks the contacts that count on this rank."""
        return self.own[rows]

    def places(self, code: np.ndarray, state: State) -> np.ndarray:
        """Rows of the contacts known by codes (p,): the vertices themselves."""
        return code

    def nearest(self, x: np.ndarray, factor: float, state: State) -> np.ndarray:
        """(n,) gap (m) of each vertex."""
        return self.gaps(x, factor, state)

    def least(self, vertex: np.ndarray, weight: np.ndarray, values: np.ndarray) -> np.ndarray:
        """(n,) the least of the values (p,) of a vertex's contacts, infinite without any."""
        least = np.full(len(self.free), np.inf)
        np.minimum.at(least, vertex[:, 0], values)
        return least
