"""Equilibria beside a target: shapes displaced from it, their rest shapes, softest modes, and how these change.

A neighbour has a displacement s of the shape and a rest shape z with R(s, z) = 0. Neither follows from the other where
dR/dz or K = dR/ds is singular; together they always do: moves on the manifold of equilibria solve

    min |ds|^2_A / 2 + weight |dz|^2_B / 2 - (a, ds) - (b, dz)   with   K ds + (dR/dz) dz = r,

one factorisation for all at a place. A and B are metrics of displacements and of their gradients over a short length.
"""

import math
from dataclasses import dataclass, field

import numpy as np
from petsc4py import PETSc
from slepc4py import SLEPc

from voile.inverse.direct import Direct
from voile.problem.rest import rest_areas
from voile.problem.scales import slow_rate
from voile.solver.linear import add_mass, factorisation_error, use_cholesky

CUT = 30.0  # slow rates above the margin under which modes are known
MODES = 12  # at most
WEIGHT = 1e-2  # of the rest shape's moves beside the shape's
ALONG = 1e-4  # sizes of the shell: differences along modes
REACH = 0.05  # sizes of the shell, over which gradients count
RESTORATIONS = 15  # moves
WORST = 100.0  # growth of the residual in one of them
WORK_SPACE = 100  # per cent, of MUMPS beyond its estimate: pivoting wants it
TOLERANCE = 1e-10  # residual over the loads' norm


@dataclass
class Move:
    """A displacement of the shape and a change of the rest shape, on the problem's unknowns; or a gradient by both."""

    s: PETSc.Vec
    z: PETSc.Vec

    def dot(self, other: "Move") -> float:
        return self.s.dot(other.s) + self.z.dot(other.z)

    def axpy(self, factor: float, other: "Move") -> None:
        self.s.axpy(factor, other.s)
        self.z.axpy(factor, other.z)


@dataclass
class Place:
    """A stable equilibrium: displacement s of the shape from the target, its rest shape z, the fraction of the load,
    the margin (1/s^2), the lowest eigenvalues (1/s^2) and their modes of unit mass."""

    s: PETSc.Vec
    z: PETSc.Vec
    fraction: float
    margin: float
    values: np.ndarray = field(default_factory=lambda: np.zeros(0))
    modes: list[PETSc.Vec] = field(default_factory=list)

    def beside(self, move: Move, load: float, margin: float) -> "Place":
        """Another place, not yet in equilibrium."""
        return Place(self.s + move.s, self.z + move.z, self.fraction + load, self.margin + margin)


class Neighbours:
    """Equilibria beside a target on which the direct method has stopped."""

    def __init__(self, direct: Direct, held: np.ndarray):
        """held: (n,) local vertices that stay where they are in the target."""
        self.direct, self.target, self.problem = direct, direct.target, direct.problem
        target, problem = self.target, self.problem
        target.rest.set(problem.create_vector())
        self.mass = problem.mass()  # of all places: that of the target itself
        self.masses = PETSc.Mat().createAIJ(target.tangent.getSizes(), nnz=1, comm=problem.comm)
        self.masses.setUp()
        self.masses.setDiagonal(self.mass)
        self.masses.assemble()
        self.slow = slow_rate(problem)
        self.cut = CUT * self.slow
        self.free = target.rest.is_vertex.copy()
        self.rest_metric = self._create_metric(WEIGHT)
        self.factor = PETSc.PC().create(comm=problem.comm)
        self.factor.setOptionsPrefix("nearest_")  # statics' own switch pivoting off
        use_cholesky(self.factor)
        options = PETSc.Options("nearest_")
        if not options.hasName("mat_mumps_icntl_14"):
            options.setValue("mat_mumps_icntl_14", WORK_SPACE)
        self.factor.setFromOptions()
        self.hold(held)

    def hold(self, vertex: np.ndarray) -> None:
        """Keeps local vertices (n,) where they are from now on."""
        field = np.repeat(vertex[:, None], 3, axis=1).astype(float)
        self.free &= self.target.field_vector(field).array_r == 0.0
        self.metric = self._create_metric(1.0)
        self.movable = self.problem.create_vector()
        self.movable.array[:] = self.free

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
        add_mass(matrix, self.mass, 1.0)
        matrix.scale(3.0 * weight / (self.mass.sum() * problem.size() ** 2))
        idle = np.flatnonzero(~self.free) + part.first_global
        matrix.zeroRowsColumns(
            idle.astype(np.int32), 3.0 * weight / (self.mass.getSize() * problem.size() ** 2)
        )
        return matrix

    def weigh(self, s: PETSc.Vec) -> PETSc.Vec:
        """The gradient of |s|^2_A / 2 on what may move."""
        out, free = s.duplicate(), s.copy()
        free.array[~self.free] = 0.0
        self.metric.mult(free, out)
        return out

    # ---- equilibria ----

    def go_to(self, place: Place) -> PETSc.Vec:
        """The problem at a place; its state."""
        place.s.copy(self.direct.moved)
        self.target.load(place.fraction)
        self.target.rest.set(place.z)
        self.target.hold(place.z)
        return self.direct.state(place.z)

    def linearise(self, place: Place) -> bool:
        """Takes the manifold's tangent at a place for `moves`; False where it cannot be factored."""
        y = self.go_to(place)
        self.direct.linearise(y)
        across = self.target.stiffness(y).copy()
        across.diagonalScale(None, self.movable)
        back, aside = across.copy(), self.direct.matrix.copy()
        back.transpose()
        aside.transpose()
        nest = PETSc.Mat().createNest(
            [[self.metric, None, back], [None, self.rest_metric, aside], [across, self.direct.matrix, None]],
            comm=self.problem.comm,
        )
        system = nest.convert(PETSc.Mat.Type.AIJ)
        system.setOption(PETSc.Mat.Option.SYMMETRIC, True)
        self.factor.setOperators(system)
        self.factor.setUp()
        for matrix in (nest, system, across, back, aside):
            matrix.destroy()  # now, rather than when Python cleans up
        return not factorisation_error(self.factor)

    def moves(self, gradients: list[Move], residual: PETSc.Vec | None = None) -> list[Move]:
        """The moves of the module's minimum with (a, b) each of the gradients and r the residual (N)."""
        n, last = len(self.free), 0.0 if residual is None else residual.array_r[:, None]
        right = np.zeros((3 * n, len(gradients)))
        right[:n] = np.where(self.free[:, None], np.stack([g.s.array_r for g in gradients], axis=1), 0.0)
        right[n : 2 * n] = np.stack([g.z.array_r for g in gradients], axis=1)
        right[2 * n :] = last
        found = []
        for column in self._solve(right).T:
            move = self.still()
            move.s.array[:] = np.where(self.free, column[:n], 0.0)
            move.z.array[:] = column[n : 2 * n]
            found.append(move)
        return found

    def still(self) -> Move:
        """The move that is none."""
        return Move(self.problem.create_vector(), self.problem.create_vector())

    def _solve(self, right: np.ndarray) -> np.ndarray:
        """Solutions for all columns of a right-hand side (local rows, k) at once: the factor is read once."""
        size, comm = ((len(right), PETSc.DECIDE), (PETSc.DECIDE, right.shape[1])), self.problem.comm
        given, found = (PETSc.Mat().createDense(size, comm=comm) for _ in range(2))
        for matrix in (given, found):
            matrix.setUp()
        given.getDenseArray()[:] = right
        for matrix in (given, found):
            matrix.assemble()
        self.factor.getFactorMatrix().matSolve(given, found)
        solution = found.getDenseArray().copy()
        for matrix in (given, found):
            matrix.destroy()  # now, rather than when Python cleans up
        return solution

    def settle(self, place: Place) -> bool:
        """Brings a place near the one linearised to equilibrium, at its shape or else with the least move, and finds
        its modes; whether it is stable, with the margin."""
        y, z = self.go_to(place), place.z.copy()
        if not self.direct.solve(z, place.fraction)[0]:
            place.z = z
        elif not self._restore(place):
            return False
        y = self.go_to(place)
        return self._find_modes(place, y)

    def _restore(self, place: Place) -> bool:
        """Equilibrium by moves, with a new factorisation where the last one has left more than a half."""
        f, norm = self.problem.create_vector(), math.inf
        for _ in range(RESTORATIONS):
            y = self.go_to(place)
            if self.target.bounds.broken(self.target.rest):
                return False
            self.target.residual(y, f)
            before, norm = norm, f.norm()
            if norm <= max(TOLERANCE * self.target.load_norm(y), self.direct.floor()):
                return True
            if not norm < WORST * before or (norm > 0.5 * before and not self.linearise(place)):
                return False
            f.scale(-1.0)
            (step,) = self.moves([self.still()], residual=f)
            place.s.axpy(1.0, step.s)
            place.z.axpy(1.0, step.z)
        return False

    # ---- modes ----

    def _find_modes(self, place: Place, y: PETSc.Vec) -> bool:
        """Eigenvalues less than a cut above the margin, and at least one; whether all are above it."""
        if self.direct.negative(place.z):
            return False
        matrix = self.target.stiffness(y)
        eps = SLEPc.EPS().create(comm=matrix.comm)
        eps.setOperators(matrix, self.masses)
        eps.setProblemType(SLEPc.EPS.ProblemType.GHEP)
        eps.setWhichEigenpairs(SLEPc.EPS.Which.TARGET_MAGNITUDE)
        eps.setTarget(-self.slow)  # below a stable spectrum
        eps.setDimensions(MODES)
        eps.setTolerances(1e-8, 200)
        st = eps.getST()
        st.setType(SLEPc.ST.Type.SINVERT)
        ksp = st.getKSP()
        ksp.setType(PETSc.KSP.Type.PREONLY)
        use_cholesky(ksp.pc)
        eps.solve()
        found = []
        for k in range(min(eps.getConverged(), MODES)):
            mode, weighed = self.problem.create_vector(), self.problem.create_vector()
            value = eps.getEigenpair(k, mode).real
            weighed.pointwiseMult(self.mass, mode)
            mode.scale(1.0 / math.sqrt(mode.dot(weighed)))
            found.append((value, mode))
        eps.destroy()
        if not found:
            return False
        found.sort(key=lambda pair: pair[0])
        if len(found) == MODES:
            self.cut = min(self.cut, max(found[-1][0] - place.margin, self.slow))
        kept = [pair for k, pair in enumerate(found) if not k or pair[0] < place.margin + self.cut]
        place.values, place.modes = np.array([value for value, _ in kept]), [mode for _, mode in kept]
        return bool(place.values[0] > place.margin)

    def slopes(self, place: Place) -> dict[tuple[int, int], Move]:
        """Gradients of v_i^T K v_j, i <= j, by shape and rest shape: (v_i^T R_y v_j) by central differences along
        v_i."""
        modes, y = place.modes, self.go_to(place)
        zero = y.duplicate()
        zero.set(0.0)
        slopes = {
            (i, j): Move(zero.copy(), zero.copy()) for i in range(len(modes)) for j in range(i, len(modes))
        }
        there, out = y.duplicate(), y.duplicate()
        for i, mode in enumerate(modes):
            step = ALONG * self.problem.size() / mode.norm(PETSc.NormType.INFINITY)
            for side in (step, -step):
                there.waxpy(side, mode, y)
                self.direct.linearise(there)
                stiffness = self.target.stiffness(there)
                for j in range(i, len(modes)):
                    stiffness.mult(modes[j], out)
                    slopes[i, j].s.axpy(0.5 / side, out)
                    self.direct.matrix.multTranspose(modes[j], out)
                    slopes[i, j].z.axpy(0.5 / side, out)
        for slope in slopes.values():
            slope.s.array[~self.free] = 0.0
        return slopes

    def load_slope(self, place: Place) -> PETSc.Vec:
        """The residual's derivative by the fraction of the load (N), in which it is linear."""
        y = self.go_to(place)
        less, more = y.duplicate(), y.duplicate()
        for side, f in ((-0.5, less), (0.5, more)):
            self.target.load(place.fraction + side)
            self.target.residual(y, f)
        self.target.load(place.fraction)
        return more - less
