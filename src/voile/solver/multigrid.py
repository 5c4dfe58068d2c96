"""Large systems without a factor: conjugate gradients, preconditioned by multigrid over coarser levels of the mesh.

A V-cycle smooths by Chebyshev's method on each level, whose matrix is what the finer one's does to interpolated fields
(Galerkin); the coarsest is factored. Iterations hardly grow with the mesh, and memory grows as the unknowns do.
"""

import numpy as np
from petsc4py import PETSc

from voile.errors import InputError
from voile.problem.imperfection import imperfection
from voile.problem.problem import Problem
from voile.problem.transfer import transfers
from voile.solver.linear import DEFAULTS, LinearSolver, negative_pivots, set_defaults, use_cholesky

# Unknowns from which on it is the default: a factor of so many takes 10 GiB and a minute.
LARGE = 1_000_000
COARSEST = 10_000  # unknowns that are worth no level: a factor of them takes 0.2 s
# Of a solve: Newton's steps then reduce a residual as much each, and take the same number as with exact ones.
RELATIVE = 1e-5
ENOUGH = 0.1  # of what a nonlinear solve is to reach: below, another digit is worth nothing
MOST = 50  # iterations; fresh levels take 10 to 25, and a factor of a million unknowns costs as much as 60
SLOWER = 1.5  # times the iterations for a digit with a fresh hierarchy, from which on an old one is made anew
SHARP = 0.01  # relative residual of the smallest eigenvalue: its sign is what counts
SOUGHT = 100  # iterations for it
OPTIONS = {
    "pc_mg_galerkin": "both",
    "mg_levels_ksp_type": "chebyshev",
    "mg_levels_ksp_max_it": "3",  # on 100,000 triangles 17 iterations with 2, 14 with 3 and with 4
    "mg_levels_pc_type": "jacobi",
    "mg_coarse_ksp_type": "preonly",
    **{f"mg_coarse_{name}": value for name, value in DEFAULTS.items()},
}


def asked() -> bool:
    """Whether the options choose it."""
    return bool(PETSc.Options().getString("pc_type", "") == PETSc.PC.Type.MG)


def unfit(contact: bool, potential: bool, turned: bool) -> str:
    """What a problem has that levels cannot serve, empty where nothing: contact, loads without a potential, or supports
    along local axes."""
    if contact:
        return "contact"
    if not potential:
        return "loads without a potential"
    return "supports along local axes" if turned else ""


def with_levels(problem: Problem, direct: LinearSolver) -> LinearSolver:
    """What solves a problem's symmetric systems: by multigrid where options ask for it, or else, without any choice,
    where there are many unknowns; by `direct` elsewhere. Raises InputError where it is asked for and cannot be."""
    why = unfit(problem.contact is not None, problem.conservative, problem.turned)
    if asked() and why:
        raise InputError(
            f"PETSc options: pc_type mg with {why}; allowed: in statics without contact, with loads that have a "
            "potential and supports along the global axes"
        )
    large = problem.unknowns > LARGE and not PETSc.Options().hasName("pc_type")
    if why or not (asked() or large):
        return direct
    direct = direct.indefinite  # at this size two factors do not fit
    use_cholesky(direct.ksp.pc)
    if down := transfers(problem, COARSEST):
        return Multigrid(problem, direct, down)
    set_defaults(OPTIONS)
    direct.ksp.setOptionsPrefix("mg_coarse_")  # the mesh itself is the coarsest
    return direct


class Multigrid(LinearSolver):
    """Symmetric systems of a problem by conjugate gradients over the interpolations `down` to its levels, by `direct`
    where these find that the matrix is not positive definite. `negative` is then at least 1, else None: nothing has
    counted."""

    def __init__(self, problem: Problem, direct: LinearSolver, down: list[PETSc.Mat]):
        super().__init__(PETSc.KSP().create(comm=problem.comm), direct.counts)
        self.problem, self.direct, self._down = problem, direct, down
        self._matrix: PETSc.Mat | None = None
        self._made = self._fresh = False
        # Iterations for each digit of the first and the last solve with the levels' matrices.
        self._first = self._last = self._aim = 0.0
        set_defaults(OPTIONS)

    def factor(self, matrix: PETSc.Mat, operator: PETSc.Mat | None = None) -> bool:
        """Takes the matrix. The levels' matrices are made anew where the last ones have become slow."""
        self._matrix, self.usable, self.negative = matrix, True, None
        if not self._made:
            self._begin()
        renews = self._last > SLOWER * self._first or not self._first
        self._set_up(renews)
        return True

    def aim(self, tolerance: float) -> None:
        """See LinearSolver."""
        self._aim = ENOUGH * tolerance

    def solve(self, b: PETSc.Vec, x: PETSc.Vec) -> None:
        """See LinearSolver."""
        if self.negative or not (self._iterated(b, x) or self._renewed(b, x)):
            assert self._matrix
            self.direct.factor(self._matrix)
            self.usable, self.negative = self.direct.usable, self.direct.negative
            if self.usable:
                self.direct.solve(b, x)
            else:
                x.set(float("nan"))

    def positive(self, matrix: PETSc.Mat) -> bool:
        """Whether the matrix is positive definite: the sign of its smallest eigenvalue, which LOBPCG finds with the
        V-cycle; by a factor where it does not."""
        self.factor(matrix)
        if self.negative:
            return False
        value = self._smallest(matrix)
        return super().positive(matrix) if value is None else value > 0.0

    def destroy(self) -> None:
        """Frees all."""
        self.ksp.destroy()
        self.direct.destroy()

    def _begin(self) -> None:
        """Makes the levels."""
        ksp, down = self.ksp, self._down
        ksp.setType(PETSc.KSP.Type.CG)
        ksp.setNormType(PETSc.KSP.NormType.UNPRECONDITIONED)
        ksp.setTolerances(rtol=RELATIVE, atol=0.0, max_it=MOST)
        ksp.setOperators(self._matrix)
        ksp.pc.setType(PETSc.PC.Type.MG)
        ksp.pc.setMGLevels(len(down) + 1)
        for level, interpolation in enumerate(reversed(down), start=1):
            ksp.pc.setMGInterpolation(level, interpolation)
        use_cholesky(ksp.pc.getMGCoarseSolve().pc)
        ksp.setFromOptions()
        self._made = True

    def _set_up(self, renews: bool) -> None:
        """Makes the levels' matrices if wanted; `negative` where the coarsest shows that the finest is not positive."""
        ksp = self.ksp
        with self.counts.factorising():
            ksp.pc.setReusePreconditioner(not renews)
            ksp.setOperators(self._matrix)
            ksp.setUp()
            coarsest = ksp.pc.getMGCoarseSolve()
            coarsest.pc.setUp()  # else it is factored in the first solve
        self._fresh = renews
        if renews:
            self._first = self._last = 0.0
            self.negative = negative_pivots(coarsest.pc) or None

    def _iterated(self, b: PETSc.Vec, x: PETSc.Vec) -> bool:
        ksp = self.ksp
        if not PETSc.Options().hasName("ksp_atol"):
            ksp.setTolerances(atol=self._aim)
        with self.counts.solving():
            ksp.solve(b, x)
        count, first, last = ksp.getIterationNumber(), b.norm(), ksp.getResidualNorm()
        self._last = count / max(np.log10(max(first, 1e-300) / max(last, 1e-300)), 1.0)
        self._first = self._first or self._last
        self.counts.krylov += count
        return bool(ksp.getConvergedReason() > 0)

    def _renewed(self, b: PETSc.Vec, x: PETSc.Vec) -> bool:
        """The same with fresh matrices of the levels, where they were old."""
        if self._fresh:
            return False
        self._set_up(renews=True)
        return not self.negative and self._iterated(b, x)

    def _smallest(self, matrix: PETSc.Mat) -> float | None:
        """Smallest eigenvalue (N/m) with the diagonal of the mass, over its mean: the residual is then as large as the
        eigenvalue's error; None where the search does not converge."""
        from slepc4py import SLEPc

        diagonal = self.problem.mass()
        diagonal.scale(diagonal.getSize() / diagonal.sum())
        mass = PETSc.Mat().createAIJ(matrix.getSizes(), nnz=(1, 0), comm=matrix.comm)
        mass.setDiagonal(diagonal)
        mass.assemble()
        eps = SLEPc.EPS().create(comm=matrix.comm)
        eps.setOptionsPrefix("stability_")
        eps.setOperators(matrix, mass)
        eps.setProblemType(SLEPc.EPS.ProblemType.GHEP)
        eps.setType(SLEPc.EPS.Type.LOBPCG)
        eps.setWhichEigenpairs(SLEPc.EPS.Which.SMALLEST_REAL)
        eps.setDimensions(1)
        eps.setTolerances(SHARP, SOUGHT)
        st = eps.getST()
        st.setType(SLEPc.ST.Type.PRECOND)
        inner = st.getKSP()
        inner.setType(PETSc.KSP.Type.PREONLY)
        inner.pc.setType(PETSc.PC.Type.PYTHON)
        inner.pc.setPythonContext(Cycle(self.ksp.pc))
        eps.setInitialSpace([imperfection(self.problem)])
        eps.setFromOptions()
        with self.counts.solving():
            eps.solve()
        self.counts.krylov += eps.getIterationNumber()
        value = eps.getEigenvalue(0).real if eps.getConverged() else None
        eps.destroy()
        mass.destroy()
        return value


class Cycle:
    """Context of a PETSc PC of type python: another one, which nobody sets up anew."""

    def __init__(self, pc: PETSc.PC):
        self.pc = pc

    def apply(self, _: PETSc.PC, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """y = a V-cycle for x."""
        self.pc.apply(x, y)
