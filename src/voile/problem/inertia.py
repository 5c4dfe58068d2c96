"""Inertia of one implicit step in time, and the forces on it from before."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from voile.arrays import Flags, Ints, Reals
from voile.problem.matrix import Blocks
from voile.problem.terms import Hessian, Point, Term


@dataclass
class Inertia(Term):
    """coefficient/2 |x - predicted|^2_M. mass (local vertices,) kg, lumped; own (local vertices,) marks those counted
    here; coefficient (1/s^2, one or (local vertices, 3)) and predicted (local vertices, 3) m are the scheme's. Over the
    unknowns the mass is C^T M C. Directors have none: they follow at every instant."""

    name = "inertia"
    mass: Reals
    own: Flags
    coefficient: float | Reals
    predicted: Reals

    def energies(self, at: Point) -> dict[str, float]:
        away = (self.coefficient * (at.positions - self.predicted) ** 2).sum(axis=1)
        return {self.name: 0.5 * float((self.mass * away)[self.own].sum())}

    def forces(self, at: Point) -> Reals:
        found = np.zeros(len(at.u) + len(at.phi))
        at_vertices = found[: len(at.u)].reshape(-1, 3)
        np.subtract(self.predicted, at.positions, out=at_vertices)
        at_vertices *= self._firmness
        return found

    @cached_property
    def _firmness(self) -> Reals:
        """(local vertices, 3) N/m."""
        return self.coefficient * np.repeat(self.mass[:, None], 3, axis=1)

    def blocks(self, at: Point, which: Hessian) -> Blocks:
        yield mass_blocks(self.mass, self.coefficient)


@dataclass
class Dead(Term):
    """A constant force (dofs,) N, counted where own (dofs,) says."""

    force: Reals
    own: Flags

    def energies(self, at: Point) -> dict[str, float]:
        away = np.concatenate([at.displacement, at.phi])
        return {"dead": -float((self.force * away)[self.own].sum())}

    def forces(self, at: Point) -> Reals:
        return self.force


def mass_blocks(mass: Reals, coefficient: float | Reals) -> tuple[Ints, Reals]:
    """The vertices with mass (kg) and coefficient (one, (n, 1) or (n, 3)) times it, (p, 3, 3)."""
    vertex = np.flatnonzero(mass)
    scaled = (coefficient * mass[:, None])[vertex]
    return vertex, scaled[:, :, None] * np.eye(3)
