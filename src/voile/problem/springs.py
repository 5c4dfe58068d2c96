"""Elastic supports, and bars between vertices: ties, bands along edges."""

from dataclasses import dataclass

import numpy as np
from mpi4py import MPI

from voile.arrays import Flags, Ints, Reals
from voile.problem.matrix import Blocks
from voile.problem.partition import Part
from voile.problem.terms import Hessian, Point, Term
from voile.problem.welds import Welds

NAME = "springs"


def springs_of(part: Part, own: Flags, comm: MPI.Comm) -> tuple[Term, ...]:
    """The terms of a part's elastic supports, bars and welds, the same on all ranks; own (local vertices,): counted
    here."""
    there = comm.allreduce(np.array([len(part.springs), len(part.bars), len(part.welds)]))
    found: list[Term] = []
    if there[0]:
        home = part.points + part.closure[: part.points.size].reshape(-1, 3)
        found.append(Springs(part.springs, home, own))
    if there[1]:
        everywhere, ends = (part.bars[:, columns].astype(np.int64) for columns in ([0, 1], [4, 5]))
        here = ends[:, 0] >= 0
        stiffness, length, counted = part.bars[here][:, [2, 3, 6]].T
        found.append(Bars(ends[here], everywhere, here, stiffness, length, counted.astype(bool)))
    if there[2]:
        found.append(Welds.of(part.welds))
    return tuple(found)


@dataclass
class Springs(Term):
    """Of the vertices to their places `home` (local vertices, 3) m, with stiffness (local vertices, 3) N/m along each
    axis; own (local vertices,) marks those counted on this rank."""

    stiffness: Reals
    home: Reals
    own: Flags

    def energies(self, at: Point) -> dict[str, float]:
        each = self.stiffness * (at.positions - self.home) ** 2
        return {NAME: 0.5 * float(each[self.own].sum())}

    def forces(self, at: Point) -> Reals:
        return at.over_dofs(self.stiffness * (self.home - at.positions))

    def blocks(self, at: Point, which: Hessian) -> Blocks:
        vertex = np.flatnonzero(self.stiffness.any(axis=1))
        yield vertex, self.stiffness[vertex][:, :, None] * np.eye(3)


@dataclass
class Bars(Term):
    """stiffness/2 (l - length)^2 of the distance l of two vertices.

    Of the bars on this rank: local ends (b, 2), stiffness (b,) N/m, length (b,) m; own (b,) marks those counted here.
    Of all (c,): `everywhere` (c, 2) their vertices in the input, `here` (c,) which are on this rank.
    """

    ends: Ints
    everywhere: Ints
    here: Flags
    stiffness: Reals
    length: Reals
    own: Flags

    def _stretched(self, at: Point) -> tuple[Reals, Reals]:
        """(b,) distances and (b, 3) unit vectors from the first end to the second."""
        apart = at.positions[self.ends[:, 1]] - at.positions[self.ends[:, 0]]
        distance = np.linalg.norm(apart, axis=1)
        return distance, apart / np.maximum(distance, 1e-300)[:, None]

    def energies(self, at: Point) -> dict[str, float]:
        distance, _ = self._stretched(at)
        each = self.stiffness * (distance - self.length) ** 2
        return {NAME: 0.5 * float(each[self.own].sum())}

    def forces(self, at: Point) -> Reals:
        distance, along = self._stretched(at)
        pull = (self.stiffness * (distance - self.length))[:, None] * along
        total = np.zeros_like(at.positions)
        np.add.at(total, self.ends[:, 0], pull)
        np.subtract.at(total, self.ends[:, 1], pull)
        return at.over_dofs(total)

    def blocks(self, at: Point, which: Hessian) -> Blocks:
        """Across the bar its Hessian is the pull over the distance, which a safe one leaves out under compression."""
        distance, along = self._stretched(at)
        across = self.stiffness * (1.0 - self.length / np.maximum(distance, 1e-300))
        across = np.maximum(across, (1.0 - which.safe) * across)
        outer = along[:, :, None] * along[:, None, :]
        one = self.stiffness[:, None, None] * outer + across[:, None, None] * (np.eye(3) - outer)
        blocks = np.zeros(
            (len(self.here), 6, 6)
        )  # the pattern is that of all, the rows of this rank's own are filled
        blocks[self.here] = np.block([[one, -one], [-one, one]])
        yield self.everywhere, blocks
