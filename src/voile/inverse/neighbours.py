"""Equilibria beside a target: shapes displaced from it, their rest shapes, softest modes, and how these change.

The shape's displacement s is free; its rest shape z(s) follows by the direct method. With dR/dz dz = -K ds the
stiffness projected on modes v changes by

    d(v_i^T K v_j)/ds = g_s - K (dR/dz)^-T g_z,   g = d(v_i^T R_y v_j), by central differences along v_i.
"""

import math
from dataclasses import dataclass, field

import numpy as np
from petsc4py import PETSc
from slepc4py import SLEPc

from voile.inverse.direct import Direct
from voile.problem.scales import slow_rate
from voile.solver.newton import use_cholesky

CUT = 30.0  # slow rates above the margin under which modes are known
MODES = 12  # at most
ALONG = 1e-4  # sizes of the shell: differences along modes


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


@dataclass
class Slopes:
    """At a place: pairs (i, j) of modes, the derivatives of v_i^T K v_j by the shape, the rest shape following, and by
    the rest shape alone, and the rest shape's derivative by the fraction of the load."""

    pairs: list[tuple[int, int]]
    by_shape: list[PETSc.Vec]
    by_rest: list[PETSc.Vec]
    loaded: PETSc.Vec


class Neighbours:
    """Equilibria beside a target, for which `direct` finds rest shapes."""

    def __init__(self, direct: Direct):
        self.direct, self.target, self.problem = direct, direct.target, direct.problem
        self.target.rest.set(self.problem.create_vector())
        self.mass = self.problem.mass()  # of all places: that of the target itself
        self.masses = PETSc.Mat().createAIJ(self.target.tangent.getSizes(), nnz=1, comm=self.problem.comm)
        self.masses.setUp()
        self.masses.setDiagonal(self.mass)
        self.masses.assemble()
        self.slow = slow_rate(self.problem)
        self.cut = CUT * self.slow

    def settle(self, place: Place) -> bool:
        """Balances a place's shape from its z on and finds its modes; whether it is stable, with the margin."""
        place.s.copy(self.direct.moved)
        reason, _, _ = self.direct.solve(place.z, place.fraction)
        if reason or self.direct.negative(place.z):
            return False
        self._find_modes(place)
        return bool(place.values[0] > place.margin)

    def _find_modes(self, place: Place) -> None:
        """Eigenvalues less than a cut above the margin, and at least one."""
        matrix = self.target.stiffness(self.direct.state(place.z))
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
        found.sort(key=lambda pair: pair[0])
        if len(found) == MODES:
            self.cut = min(self.cut, max(found[-1][0] - place.margin, self.slow))
        kept = [pair for k, pair in enumerate(found) if not k or pair[0] < place.margin + self.cut]
        place.values, place.modes = np.array([value for value, _ in kept]), [mode for _, mode in kept]

    def slopes(self, place: Place) -> Slopes:
        """Derivatives at a settled place; the direct method's factor is that of the place from then on."""
        direct, modes = self.direct, place.modes
        y = self.go_to(place)
        pairs = [(i, j) for i in range(len(modes)) for j in range(i, len(modes))]
        by_shape = [self.problem.create_vector() for _ in pairs]
        by_rest = [self.problem.create_vector() for _ in pairs]
        there, out = y.duplicate(), y.duplicate()
        for i, mode in enumerate(modes):
            step = ALONG * self.problem.size() / mode.norm(PETSc.NormType.INFINITY)
            for side in (step, -step):
                there.waxpy(side, mode, y)
                stiffness = self.target.stiffness(there)
                direct.linearise(there)
                for row in (row for row, pair in enumerate(pairs) if pair[0] == i):
                    stiffness.mult(modes[pairs[row][1]], out)
                    by_shape[row].axpy(0.5 / side, out)
                    direct.matrix.multTranspose(modes[pairs[row][1]], out)
                    by_rest[row].axpy(0.5 / side, out)
        self.factor(place)
        stiffness, held = self.target.stiffness(y), y.duplicate()
        for a, b in zip(by_shape, by_rest, strict=True):
            direct.lu.applyTranspose(b, held)
            stiffness.mult(held, out)
            a.axpy(-1.0, out)
            a.array[~self.target.rest.is_vertex] = 0.0
        return Slopes(pairs, by_shape, by_rest, self._by_load(place, y))

    def _by_load(self, place: Place, y: PETSc.Vec) -> PETSc.Vec:
        """Derivative of z by the fraction of the load at a fixed shape."""
        less, more, out = y.duplicate(), y.duplicate(), y.duplicate()
        for side, f in ((-0.5, less), (0.5, more)):  # loads are linear in it
            self.target.load(place.fraction + side)
            self.target.residual(y, f)
        self.target.load(place.fraction)
        self.direct.lu.apply(less - more, out)
        return out

    def go_to(self, place: Place) -> PETSc.Vec:
        """The problem at a place; its state."""
        place.s.copy(self.direct.moved)
        self.target.load(place.fraction)
        self.target.rest.set(place.z)
        self.target.hold(place.z)
        return self.direct.state(place.z)

    def factor(self, place: Place) -> None:
        """Makes the direct method's factor, and the target's tangent, those of a place."""
        y = self.go_to(place)
        self.direct.linearise(y)
        self.direct.lu.setOperators(self.direct.matrix)
        self.direct.lu.setUp()
        self.target.stiffness(y)

    def follow(self, place: Place, move: PETSc.Vec, load: float, loaded: PETSc.Vec) -> Place:
        """The place beside one with `factor` that a displacement and a step of the load lead to, z extrapolated."""
        push, dz = move.duplicate(), move.duplicate()
        self.target.tangent.mult(move, push)
        self.direct.lu.apply(push, dz)
        dz.axpby(load, -1.0, loaded)
        return Place(place.s + move, place.z + dz, place.fraction + load, place.margin)
