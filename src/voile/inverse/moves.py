"""Moves on the manifold of equilibria beside a target, of shapes s with rest shapes z: R(s, z) = 0.

    K ds + D dz = r,   K = dR/ds,   D = dR/dz,

are known by their ds: dz = D^-1 (r - K ds). One LU factorisation of D at a point, with K's own fill, and one Cholesky
factorisation of the metric of displacements, for good, serve for all of them. The length of a move counts both,

    |ds|^2_A + weight |dz|^2_B,

so that moves stay short where D is nearly singular and the direct branch turns back. A and B are metrics of
displacements and of their gradients over a short length.
"""

import math
from dataclasses import dataclass

import numpy as np
from petsc4py import PETSc

from voile.arrays import Flags, Reals
from voile.inverse.direct import Direct
from voile.problem.rest import rest_areas
from voile.solver.columns import orthonormal, products, times
from voile.solver.linear import symmetric, unsymmetric

WEIGHT = 1.0  # of the rest shape's moves beside the shape's: with less they grow rough, and simulations leave answers
# Times that, where steps grow short or simulations leave answers anyway; down to this.
LOOSER, LEAST_WEIGHT = 0.1, 0.02
REACH = 0.05  # sizes of the shell, over which gradients count
DESCENTS = 4  # of conjugate gradients, for moves


@dataclass
class Move:
    """A displacement of the shape and a change of the rest shape, on the problem's unknowns; or a gradient by both."""

    s: PETSc.Vec
    z: PETSc.Vec

    def dot(self, other: "Move") -> float:
        return float(self.s.dot(other.s) + self.z.dot(other.z))

    def axpy(self, factor: float, other: "Move") -> None:
        self.s.axpy(factor, other.s)
        self.z.axpy(factor, other.z)


@dataclass
class Tangent:
    """Moves from a point: `s` and `z` (own, p) of a basis of orthonormal ones, the coordinates (p, g) in it of the
    gradients that it was made for, and the quadratic form of ds alone."""

    s: Reals
    z: Reals
    slopes: Reals
    form: Reals


Slopes = dict[tuple[int, int], Move]


class Moves:
    """Of a target on which the direct method has stopped; `free` (own,) marks the shape's unknowns that move, `movable`
    tells whether there are any."""

    def __init__(self, direct: Direct, held: Flags):
        """held: (n,) local vertices that stay where they are in the target."""
        self.target, self.problem, problem = direct.target, direct.problem, direct.problem
        self.mass = problem.mass()  # of all points: that of the target itself
        self.free = self.target.rest.is_vertex.copy()
        self.weight = WEIGHT
        self.rest_metric = self._create_metric(WEIGHT)
        self.across = self.target.tangent.duplicate()
        self.solver = unsymmetric(problem.comm, "nearest_", direct.target.counts)
        self.metric_solver = symmetric(
            problem.comm, PETSc.KSP.Type.PREONLY, 0.0, direct.target.counts, "nearest_metric_"
        )
        self.hold(held)

    def linearise(self, stiffness: PETSc.Mat, matrix: PETSc.Mat) -> bool:
        """Takes the manifold's tangent where K and D are these; False where D cannot be factored."""
        stiffness.copy(self.across, PETSc.Mat.Structure.SAME_NONZERO_PATTERN)
        return self.solver.factor(matrix)

    def hold(self, vertex: Flags) -> None:
        """Keeps local vertices (n,) where they are from now on."""
        field = np.repeat(vertex[:, None], 3, axis=1).astype(float)
        self.restrict(self.target.field_vector(field).array_r == 0.0)

    def restrict(self, free: Flags) -> None:
        """Only these unknowns (own,) are free from now on, of those that are."""
        self.free &= free
        self.metric = self._create_metric(1.0)
        self.metric_solver.factor(self.metric)
        self.movable = bool(self.problem.comm.allreduce(int(self.free.sum())))

    def _create_metric(self, weight: float) -> PETSc.Mat:
        """weight (M + (REACH L)^2 G) / (M L^2) on `free`, M the mass, G the integral of mass times gradients, L the
        size; a like diagonal elsewhere."""
        problem, part = self.problem, self.problem.part
        area, gradient = rest_areas(part)
        slope = gradient / area[:, None, None]
        local = np.einsum("tai,tbi,t->tab", slope, slope, area * part.fabric[0] * part.fabric[3])
        blocks = np.zeros((len(area), 21, 21))
        for axis in range(3):
            blocks[:, axis:9:3, axis:9:3] = local
        matrix = problem.create_matrix()
        problem.assemble(matrix, blocks * (REACH * problem.size()) ** 2, ())
        matrix.setDiagonal(self.mass, addv=PETSc.InsertMode.ADD_VALUES)
        matrix.scale(3.0 * weight / (self.mass.sum() * problem.size() ** 2))
        idle = np.flatnonzero(~self.free) + part.first_global
        matrix.zeroRowsColumns(
            idle.astype(np.int32), 3.0 * weight / (self.mass.getSize() * problem.size() ** 2)
        )
        return matrix

    def loosen(self) -> bool:
        """Counts the rest shape's moves less from now on; False where they count the least already."""
        if self.weight <= LEAST_WEIGHT:
            return False
        self.weight *= LOOSER
        self.rest_metric.scale(LOOSER)
        return True

    def weigh(self, s: PETSc.Vec) -> PETSc.Vec:
        """The gradient of |s|^2_A / 2 on what may move."""
        out, free = s.duplicate(), s.copy()
        free.array[~self.free] = 0.0
        self.metric.mult(free, out)
        return out

    def still(self) -> Move:
        """The move that is none."""
        return Move(self.problem.create_vector(), self.problem.create_vector())

    def length(self, move: Move) -> float:
        """sqrt(|ds|^2_A + weight |dz|^2_B): for a translation, over the size."""
        out, total = move.s.duplicate(), 0.0
        for metric, part in ((self.metric, move.s), (self.rest_metric, move.z)):
            metric.mult(part, out)
            total += out.dot(part)
        return math.sqrt(max(total, 0.0))

    def _answer(self, s: Reals) -> Reals:
        """dz (own, p) that keeps the balance under displacements s (own, p)."""
        return -self.solver.solutions(times(self.across, s))

    def _reduced(self, s: Reals, z: Reals) -> Reals:
        """Gradients (own, p) by s alone, with dz as it follows, of those by s and z."""
        gradient = s - times(self.across, self.solver.solutions(z, transposed=True))
        gradient[~self.free] = 0.0
        return gradient

    def tangent(self, pull: Move, slopes: Slopes, residual: PETSc.Vec) -> tuple[Tangent, Move]:
        """The moves along a gradient and those of a matrix, each about the steepest for its length; about the shortest
        move that takes away a residual (N)."""
        alone, comm, last = self._alone(residual), self.problem.comm, 1 + len(slopes)
        slope = self._reduced(*_stacked([pull, *slopes.values(), self._beside(alone)]))
        weight = np.zeros((last + 1, 3))
        weight[0, 0] = weight[last, 2] = 1.0
        weight[1:last, 1] = [1.0 if i == j else 2.0 for i, j in slopes]
        s, z = self._descend(slope, weight)
        least = self.move(s[:, last], alone + z[:, last])
        slope, s, z = slope[:, :last], s[:, :last], z[:, :last]
        near = products(s, times(self.metric, s), comm)
        gram = near + products(z, times(self.rest_metric, z), comm)
        basis = orthonormal(0.5 * (gram + gram.T))
        form = basis.T @ near @ basis
        return Tangent(s @ basis, z @ basis, basis.T @ products(s, slope, comm), form), least

    def _descend(self, left: Reals, weight: Reals) -> tuple[Reals, Reals]:
        """Moves (own, p) of about the least length but for gradients (own, p) by ds: conjugate gradients on groups of
        columns, each one vector, squares by weight (p, groups), preconditioned by the metric of displacements. The
        moves are linear in the gradients: they do not depend on how modes of one eigenvalue are told apart. All groups
        go on at once: a factor is read as often for many columns as for one."""
        comm, before, group = self.problem.comm, np.full(weight.shape[1], math.inf), weight.argmax(axis=1)
        s, z, ahead = np.zeros_like(left), np.zeros_like(left), np.zeros_like(left)
        for _ in range(DESCENTS):
            steep = self.metric_solver.solutions(left)
            now = comm.allreduce(np.einsum("ij,ij->j", left, steep) @ weight)
            ahead = steep + (now / before)[group] * ahead
            across = self._answer(ahead)
            bent = times(self.metric, ahead) - self._reduced(
                np.zeros_like(ahead), -times(self.rest_metric, across)
            )
            curved = comm.allreduce(np.einsum("ij,ij->j", ahead, bent) @ weight)
            # none along what round-off bends the other way
            length = np.divide(now, curved, out=np.zeros_like(now), where=curved > 1e-300)[group]
            s, z, left, before = (
                s + length * ahead,
                z + length * across,
                left - length * bent,
                np.maximum(now, 1e-300),
            )
        return s, z

    def move(self, s: Reals, z: Reals) -> Move:
        """Of columns (own,)."""
        move = self.still()
        move.s.array[:], move.z.array[:] = s, z
        return move

    def least_move(self, residual: PETSc.Vec) -> Move:
        """About the shortest move that takes away a residual (N)."""
        alone = self._alone(residual)
        s, z = self._descend(self._reduced(*_stacked([self._beside(alone)])), np.ones((1, 1)))
        return self.move(s[:, 0], alone + z[:, 0])

    def _alone(self, residual: PETSc.Vec) -> Reals:
        """(own,) the rest shape's move that takes away a residual by itself."""
        return self.solver.solutions(residual.array_r[:, None])[:, 0]

    def _beside(self, z: Reals) -> Move:
        """The gradient of what moves may spare of the length of dz (own,)."""
        alone, spared = self.problem.create_vector(), self.still()
        alone.array[:] = -z
        self.rest_metric.mult(alone, spared.z)
        return spared


def _stacked(gradients: list[Move]) -> tuple[Reals, Reals]:
    """(own, p) of the shape and of the rest shape."""
    s, z = ([getattr(g, part).array_r for g in gradients] for part in "sz")
    return np.stack(s, axis=1), np.stack(z, axis=1)
