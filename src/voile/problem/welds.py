"""Stiff joints: sheets that join along an edge keep their angle.

A sheet's direction at an edge is the mean of its triangles' directions about it. With psi_k the turn of triangle k
about the edge since the start, the energy is stiffness/2 r^2 of r = (psi_2 + psi_3 - psi_0 - psi_1)/2, the turn of one
sheet, triangles 2 and 3, against the other. A sheet that goes on across the edge may still bend there.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from voile.arrays import Flags, Ints, Reals
from voile.mesh.welds import turned
from voile.problem.matrix import Blocks
from voile.problem.moments import turn_derivative
from voile.problem.terms import Hessian, Point, Term

SHARES = np.array([-0.5, -0.5, 0.5, 0.5])  # of the four triangles' turns
CORNERS = np.array([[2 + k, 0, 1] for k in range(4)])  # of the triangles, among an edge's six vertices


@dataclass
class Welds(Term):
    """Of the edges on this rank: local vertices (k, 6), stiffness (k,) N m, angles (k, 2) at the start; own (k,) marks
    those counted here. Of all (w,): `everywhere` (w, 6) their vertices in the input, `here` (w,) which are here."""

    vertices: Ints
    everywhere: Ints
    here: Flags
    stiffness: Reals
    angles: Reals
    own: Flags

    @classmethod
    def of(cls, rows: Reals) -> Welds:
        """Those of Part.welds."""
        everywhere, local = rows[:, :6].astype(np.int64), rows[:, 9:15].astype(np.int64)
        here = local[:, 0] >= 0
        kept = rows[here]
        return cls(local[here], everywhere, here, kept[:, 6], kept[:, 7:9], kept[:, 15].astype(bool))

    def _turn(self, x: Reals) -> Reals:
        """(k,) r at vertices (k, 6, 3)."""
        change = turned(x) - self.angles
        return np.asarray((np.mod(change + np.pi, 2.0 * np.pi) - np.pi).mean(axis=1))

    def energies(self, at: Point) -> dict[str, float]:
        each = self.stiffness * self._turn(at.positions[self.vertices]) ** 2
        return {"springs": 0.5 * float(each[self.own].sum())}

    def forces(self, at: Point) -> Reals:
        x, total = at.positions[self.vertices], np.zeros_like(at.positions)
        moment = self.stiffness * self._turn(x)
        np.subtract.at(total, self.vertices, moment[:, None, None] * gradient(x))
        return at.over_dofs(total)

    def blocks(self, at: Point, which: Hessian) -> Blocks:
        """A safe Hessian leaves out that of r."""
        x = at.positions[self.vertices]
        slope = gradient(x).reshape(-1, 18)
        one = self.stiffness[:, None, None] * slope[:, :, None] * slope[:, None, :]
        if which.safe < 1.0:
            one += ((1.0 - which.safe) * self.stiffness * self._turn(x))[:, None, None] * hessian(x)
        blocks = np.zeros((len(self.here), 18, 18))  # the pattern is that of all
        blocks[self.here] = one
        yield self.everywhere, blocks


def gradient(x: Reals) -> Reals:
    """(k, 6, 3) of r at vertices (k, 6, 3): that of a triangle's turn is (e_0 . e_j) N / (|N|^2 |e_0|) at corner j,
    with e_j the edge across from it and N = e_0 x e_1 (src/cpp/geometry.hpp)."""
    found = np.zeros_like(x)
    for share, corners in zip(SHARES, CORNERS, strict=True):
        corner = x[:, corners]
        e = np.roll(corner, -2, axis=1) - np.roll(corner, -1, axis=1)
        normal = np.cross(e[:, 0], e[:, 1])
        scale = np.einsum("ki,ki->k", normal, normal) * np.linalg.norm(e[:, 0], axis=1)
        along = np.einsum("ki,kji->kj", e[:, 0], e) / scale[:, None]
        found[:, corners] += share * along[:, :, None] * normal[:, None]
    return found


def hessian(x: Reals) -> Reals:
    """(k, 18, 18) that of r."""
    found = np.zeros((len(x), 18, 18))
    for share, corners in zip(SHARES, CORNERS, strict=True):
        place = (3 * corners[:, None] + np.arange(3)).ravel()
        columns = turn_derivative(x[:, corners], np.eye(9).reshape(9, 1, 3, 3)).reshape(9, -1, 9)
        found[np.ix_(np.arange(len(x)), place, place)] -= share * columns.transpose(1, 2, 0)
    return 0.5 * (found + found.transpose(0, 2, 1))  # the turns' skew parts cancel up to round-off
