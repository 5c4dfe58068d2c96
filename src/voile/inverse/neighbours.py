"""Equilibria beside a target: shapes displaced from it, their rest shapes, softest modes, and how these change.

A neighbour has a displacement s of the shape and a rest shape z with R(s, z) = 0. Moves on this manifold of equilibria

    K ds + D dz = r,   K = dR/ds,   D = dR/dz,

are known by their ds: dz = D^-1 (r - K ds). One LU factorisation of D at a point, with K's own fill, and one Cholesky
factorisation of the metric of displacements, for good, serve for all of them. The length of a move counts both,

    |ds|^2_A + weight |dz|^2_B,

so that moves stay short where D is nearly singular and the direct branch turns back. A and B are metrics of
displacements and of their gradients over a short length.
"""

import math
from dataclasses import dataclass, field

import numpy as np
from petsc4py import PETSc

from voile.arrays import Flags, Reals
from voile.inverse.columns import Factor, orthonormal, products, times
from voile.inverse.direct import Direct
from voile.inverse.modes import Modes
from voile.problem.rest import rest_areas
from voile.problem.scales import slow_rate
from voile.problem.triangles import gather_triangles, spread_triangles
from voile.solver.anderson import Anderson

CUT = 20.0  # slow rates above the margin under which modes are known
WEIGHT = 1.0  # of the rest shape's moves beside the shape's: with less they grow rough, and simulations leave answers
LOOSER, LEAST_WEIGHT = (
    0.1,
    0.02,
)  # times that, where steps grow short or simulations leave answers anyway; down to this
ALONG = 1e-5  # sizes of the shell: differences along modes, whose error must not tell equal modes apart
EXACT = 1e-10  # residual over the loads' norm, of an answer
REACH = 0.05  # sizes of the shell, over which gradients count
CHORDS, RENEWALS = 20, 6  # iterations; factors
CONTRACTS = 0.3  # of the residual that one of them leaves at most
DEPTH = 5  # of them that Anderson's method looks back on
RESTORATIONS = 15  # moves
WORST = 100.0  # growth of the residual in one of them
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
class Checkpoint:
    """A stable equilibrium: displacement s of the shape from the target, its rest shape z, the fraction of the load,
    the margin (1/s^2), the lowest eigenvalues (1/s^2) and their modes of unit mass."""

    s: PETSc.Vec
    z: PETSc.Vec
    fraction: float
    margin: float
    values: Reals = field(default_factory=lambda: np.zeros(0))
    modes: list[PETSc.Vec] = field(default_factory=list)

    def beside(self, move: Move, load: float, margin: float) -> "Checkpoint":
        """Another point, not yet in equilibrium."""
        return Checkpoint(self.s + move.s, self.z + move.z, self.fraction + load, self.margin + margin)


@dataclass
class Tangent:
    """Moves from a point: `s` and `z` (own, p) of a basis of orthonormal ones, the coordinates (p, g) in it of the
    gradients that it was made for, and the quadratic form of ds alone."""

    s: Reals
    z: Reals
    slopes: Reals
    form: Reals


Slopes = dict[tuple[int, int], Move]


class Neighbours:
    """Equilibria beside a target on which the direct method has stopped."""

    def __init__(self, direct: Direct, held: Flags):
        """held: (n,) local vertices that stay where they are in the target."""
        self.direct, self.target, self.problem = direct, direct.target, direct.problem
        target, problem = self.target, self.problem
        target.rest.set(problem.create_vector())
        self.mass = problem.mass()  # of all points: that of the target itself
        self.slow = slow_rate(problem)
        self.cut = CUT * self.slow
        self.free = target.rest.is_vertex.copy()
        self.weight = WEIGHT
        self.rest_metric = self._create_metric(WEIGHT)
        self.modes = Modes(problem, self.mass)
        self.across = target.tangent.duplicate()
        self.factor = Factor(PETSc.PC.Type.LU, "nearest_", problem.comm)
        self.renewed = Factor(PETSc.PC.Type.LU, "nearest_", problem.comm)
        self.metric_factor = Factor(PETSc.PC.Type.CHOLESKY, "nearest_metric_", problem.comm)
        self.hold(held)

    def hold(self, vertex: Flags) -> None:
        """Keeps local vertices (n,) where they are from now on."""
        field = np.repeat(vertex[:, None], 3, axis=1).astype(float)
        self.restrict(self.target.field_vector(field).array_r == 0.0)

    def restrict(self, free: Flags) -> None:
        """Only these unknowns (own,) are free from now on, of those that are."""
        self.free &= free
        self.metric = self._create_metric(1.0)
        self.metric_factor.set(self.metric)
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

    # ---- equilibria ----

    def go_to(self, point: Checkpoint) -> PETSc.Vec:
        """The problem at a point; its state."""
        point.s.copy(self.direct.moved)
        self.target.load(point.fraction)
        self.target.rest.set(point.z)
        self.target.hold(point.z)
        return self.direct.state(point.z)

    def linearise(self, point: Checkpoint) -> bool:
        """Takes the manifold's tangent at a point; False where it cannot be factored."""
        y = self.go_to(point)
        self.direct.linearise(y)
        self.target.stiffness(y).copy(self.across, PETSc.Mat.Structure.SAME_NONZERO_PATTERN)
        return self.factor.set(self.direct.matrix)

    def settle(self, point: Checkpoint) -> bool:
        """Brings a point near the one linearised to equilibrium, at its shape or else with the least move, and finds
        its modes; whether there is one."""
        start = point.z.copy()
        if not self._balance(point):
            start.copy(point.z)
            if not self._restore(point):
                return False
        return self._find_modes(point)

    def polish(self, point: Checkpoint) -> None:
        """Brings the residual of a point in equilibrium down to round-off, or as near as Newton's method does."""
        before, self.direct.tolerance, kept = self.direct.tolerance, EXACT, point.z.copy()
        if not (self.linearise(point) and self._balance(point)):
            kept.copy(point.z)
        self.direct.tolerance = before

    def _tolerance(self, y: PETSc.Vec) -> float:
        return max(self.direct.tolerance * self.target.load_norm(y), self.direct.floor())

    def _balance(self, point: Checkpoint) -> bool:
        """Equilibrium at the point's shape, by chord steps that Anderson's method speeds up, with a new factor only
        where these contract the residual too little."""
        factor, f, step = self.factor, self.problem.create_vector(), self.problem.create_vector()
        chords, ahead = Anderson(self.problem.comm, len(f.array_r), DEPTH), step.array_r.copy()
        norm, least, anew, kept, poor = math.inf, math.inf, 0, point.z.copy(), 0
        for _ in range(CHORDS):
            y = self.go_to(point)
            self.target.residual(y, f)
            before, norm = norm, f.norm()
            if norm <= self._tolerance(y):
                return not self.target.bounds.broken(self.target.rest)
            if not norm < WORST * least:
                return False
            poor = poor + 1 if norm > CONTRACTS * before else 0
            if poor > 1 or norm > before:
                poor = 0
                if factor is self.factor and norm > least:  # a step of no use
                    kept.copy(point.z)
                    y = self.go_to(point)
                    self.target.residual(y, f)
                    norm = f.norm()
                anew += 1
                self.direct.linearise(y)
                factor = self.renewed
                chords.forget()
                if anew > RENEWALS or not factor.set(self.direct.matrix):
                    return False
            if norm < least:
                least = norm
                point.z.copy(kept)
            factor.pc.apply(f, step)
            step.scale(-1.0)
            chords.step(point.z.array_r, step.array_r, ahead)
            point.z.array[:] += ahead
        return False

    def _restore(self, point: Checkpoint) -> bool:
        """Equilibrium by least moves, with a new factorisation where the last one has left more than a half."""
        f, norm = self.problem.create_vector(), math.inf
        for _ in range(RESTORATIONS):
            y = self.go_to(point)
            if self.target.bounds.broken(self.target.rest):
                return False
            self.target.residual(y, f)
            before, norm = norm, f.norm()
            if norm <= self._tolerance(y):
                return True
            if not norm < WORST * before or (norm > CONTRACTS * before and not self.linearise(point)):
                return False
            f.scale(-1.0)
            step = self.least_move(f)
            point.s.axpy(1.0, step.s)
            point.z.axpy(1.0, step.z)
        return False

    # ---- moves ----

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
        return -self.factor.solve(times(self.across, s))

    def _reduced(self, s: Reals, z: Reals) -> Reals:
        """Gradients (own, p) by s alone, with dz as it follows, of those by s and z."""
        gradient = s - times(self.across, self.factor.solve(z, transposed=True))
        gradient[~self.free] = 0.0
        return gradient

    def tangent(self, pull: Move, slopes: Slopes) -> Tangent:
        """The moves along a gradient and those of a matrix, each about the steepest for its length."""
        gradients, weight = [pull, *slopes.values()], np.array([1.0 if i == j else 2.0 for i, j in slopes])
        slope, comm = self._reduced(*_stacked(gradients)), self.problem.comm
        parts = [self._descend(slope[:, :1], np.ones(1)), self._descend(slope[:, 1:], weight)]
        s, z = (np.hstack(pair) for pair in zip(*parts, strict=True))
        near = products(s, times(self.metric, s), comm)
        gram = near + products(z, times(self.rest_metric, z), comm)
        basis = orthonormal(0.5 * (gram + gram.T))
        return Tangent(s @ basis, z @ basis, basis.T @ products(s, slope, comm), basis.T @ near @ basis)

    def _descend(self, left: Reals, weight: Reals) -> tuple[Reals, Reals]:
        """Moves (own, p) of about the least length but for gradients (own, p) by ds: conjugate gradients on all columns
        as one vector, squares by weight (p,), preconditioned by the metric of displacements. The moves are linear in
        the gradients: they do not depend on how modes of one eigenvalue are told apart."""
        comm, before = self.problem.comm, math.inf
        s, z, ahead = np.zeros_like(left), np.zeros_like(left), np.zeros_like(left)
        for _ in range(DESCENTS):
            steep = self.metric_factor.solve(left)
            now = comm.allreduce(float(np.einsum("ij,ij->j", left, steep) @ weight))
            ahead = steep + now / before * ahead
            across = self._answer(ahead)
            bent = times(self.metric, ahead) - self._reduced(
                np.zeros_like(ahead), -times(self.rest_metric, across)
            )
            length = now / max(comm.allreduce(float(np.einsum("ij,ij->j", ahead, bent) @ weight)), 1e-300)
            s, z, left, before = (
                s + length * ahead,
                z + length * across,
                left - length * bent,
                max(now, 1e-300),
            )
        return s, z

    def moves(self, gradients: list[Move]) -> list[Move]:
        """The move along each gradient that is steepest for its length in ds."""
        s = self.metric_factor.solve(self._reduced(*_stacked(gradients)))
        return [self.move(*pair) for pair in zip(s.T, self._answer(s).T, strict=True)]

    def move(self, s: Reals, z: Reals) -> Move:
        """Of columns (own,)."""
        move = self.still()
        move.s.array[:], move.z.array[:] = s, z
        return move

    def least_move(self, residual: PETSc.Vec) -> Move:
        """About the shortest move that takes away a residual (N)."""
        alone = self.factor.solve(residual.array_r[:, None].copy())
        left = -self._reduced(np.zeros_like(alone), times(self.rest_metric, alone))
        s, z = self._descend(left, np.ones(1))
        return self.move(s[:, 0], alone[:, 0] + z[:, 0])

    # ---- modes ----

    def _find_modes(self, point: Checkpoint) -> bool:
        """Eigenvalues less than a cut above the margin, and at least one; whether they were found."""
        values, modes, below = self.modes.find(
            self.target.stiffness(self.go_to(point)), point.margin, self.cut
        )
        if not len(values) or below > int((values < point.margin).sum()):
            return False
        if not below and len(values) == self.modes.most:
            self.cut = min(self.cut, max(values[-1] - point.margin, self.slow))
        kept = max(int((values < point.margin + self.cut).sum()), 1)
        point.values, point.modes = values[:kept], [self._vector(mode) for mode in modes.T[:kept]]
        return True

    def _vector(self, column: Reals) -> PETSc.Vec:
        vector = self.problem.create_vector()
        vector.array[:] = column
        return vector

    def slopes(self, point: Checkpoint) -> Slopes:
        """Gradients of v_i^T K v_j, i <= j, by shape and rest shape: (v_i^T R_y v_j) by central differences along v_j.
        Masses, contact and the rest invariants' derivative do not change along it."""
        modes, problem, y = point.modes, self.problem, self.go_to(point)
        local, slopes = np.stack([spread_triangles(problem, mode) for mode in modes], axis=2), Slopes()
        kernel, right = problem.kernel, problem.kernel.rest_jacobian()[:, :, :18].transpose(0, 2, 1)
        there, out, directors = y.duplicate(), y.duplicate(), ~self.target.rest.is_vertex
        pulls = np.zeros((len(right), 21))
        for j, mode in enumerate(modes):
            step = ALONG * problem.size() / mode.norm(PETSc.NormType.INFINITY)
            along = [self.still().s for _ in range(j + 1)]
            rates = np.zeros((len(right), right.shape[2], j + 1))
            for side in (step, -step):
                there.waxpy(side, mode, y)
                stiffness, shape = self.target.stiffness(there), problem.shape(there)
                left = kernel.invariants_jacobian(*shape)
                rate = np.matmul(left, local[:, :, : j + 1])
                for i, slope in enumerate(along):
                    stiffness.mult(modes[i], out)
                    slope.axpy(0.5 / side, out)
                    change = kernel.mixed_along(*shape, np.ascontiguousarray(rate[:, :, i]))
                    rates[:, :, i] += 0.5 / side * change
            turned = np.matmul(right, rates)
            for i, slope in enumerate(along):
                pulls[:, :18] = turned[:, :, i]
                pull = gather_triangles(problem, pulls)
                pull.array[directors] += slope.array_r[directors]  # the director angles are z's
                slope.array[~self.free] = 0.0
                slopes[i, j] = Move(slope, pull)
        return slopes

    def load_slope(self, point: Checkpoint) -> PETSc.Vec:
        """The residual's derivative by the fraction of the load (N), in which it is linear."""
        y = self.go_to(point)
        less, more = y.duplicate(), y.duplicate()
        for side, f in ((-0.5, less), (0.5, more)):
            self.target.load(point.fraction + side)
            self.target.residual(y, f)
        self.target.load(point.fraction)
        return more - less


def _stacked(gradients: list[Move]) -> tuple[Reals, Reals]:
    """(own, p) of the shape and of the rest shape."""
    s, z = ([getattr(g, part).array_r for g in gradients] for part in "sz")
    return np.stack(s, axis=1), np.stack(z, axis=1)
