"""What adds to a problem's potential beside elasticity and loads: inertia, contact with frozen reactions."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from voile.contact.state import Contact
from voile.problem.matrix import Blocks


@dataclass(frozen=True)
class Point:
    """Where a potential is evaluated: positions (local vertices, 3) m at the load factor `time`."""

    positions: np.ndarray
    time: float


class Term(Protocol):
    """A part of the potential that depends on positions."""

    def energy(self, at: Point) -> float:
        """This rank's share of it (J)."""
        ...

    def force(self, at: Point) -> np.ndarray:
        """(local vertices, 3) minus its gradient (N), complete for what this rank's unknowns move."""
        ...

    def blocks(self, at: Point, convex: bool) -> Blocks:
        """Its Hessian by vertices (N/m); convex: without what makes it indefinite."""
        ...

    def longest_step(self, at: Point, motion: np.ndarray) -> float:
        """Share of a motion (local vertices, 3) m that it admits, at most 1."""
        ...


@dataclass
class Inertia:
    """coefficient/2 |x - predicted|^2_M: one implicit step in time. mass (local vertices,) kg, lumped; own (local
    vertices,) marks those counted here; coefficient (1/s^2) and predicted (local vertices, 3) m are the scheme's.
    Over the unknowns the mass is C^T M C. Directors have none: they follow at every instant."""

    mass: np.ndarray
    own: np.ndarray
    coefficient: float
    predicted: np.ndarray

    def energy(self, at: Point) -> float:
        away = ((at.positions - self.predicted) ** 2).sum(axis=1)
        return 0.5 * self.coefficient * float((self.mass * away)[self.own].sum())

    def force(self, at: Point) -> np.ndarray:
        return self.coefficient * self.mass[:, None] * (self.predicted - at.positions)

    def blocks(self, at: Point, convex: bool) -> Blocks:
        yield mass_blocks(self.mass, self.coefficient)

    def longest_step(self, at: Point, motion: np.ndarray) -> float:
        return 1.0


@dataclass
class AugmentedContact:
    """The augmented Lagrangian of contact with frozen reactions (see contact.state)."""

    contact: Contact

    def energy(self, at: Point) -> float:
        return self.contact.energy(at.positions, at.time)

    def force(self, at: Point) -> np.ndarray:
        return self.contact.force(at.positions, at.time, frozen=True)

    def blocks(self, at: Point, convex: bool) -> Blocks:
        return self.contact.blocks(at.positions, at.time, convex)

    def longest_step(self, at: Point, motion: np.ndarray) -> float:
        return self.contact.free_share(at.positions, at.positions + motion)


def mass_blocks(mass: np.ndarray, coefficient: float) -> tuple[np.ndarray, np.ndarray]:
    """The vertices with mass (kg) and coefficient times it, (p, 3, 3)."""
    vertex = np.flatnonzero(mass)
    return vertex, coefficient * mass[vertex, None, None] * np.eye(3)
