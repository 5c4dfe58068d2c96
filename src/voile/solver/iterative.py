"""Systems that inertia makes easy: Krylov's method with an incomplete factorisation, a complete one where that fails.

Over short steps in time c M is as large as the stiffness, so a vertex feels only its surroundings. There a few
iterations, each as cheap as the matrix is small, do what takes a complete factor far longer.
"""

from petsc4py import PETSc

from voile.solver.linear import Counts, LinearSolver, set_defaults

# Of a solve. Where something slips three corrections follow with the same factor, and leave the cube of theirs; a
# step of Newton's method stands alone, and a coarser one is noise from which sheets in the wind flutter early.
SYMMETRIC, CORRECTED = 1e-10, 1e-4
# Of a step that is `wanted`: where a few iterations (QUICK) reduce the residual by FORCED, the system is well enough
# conditioned for Newton's method to go on from there; and no solve goes below ENOUGH of the step's tolerance.
FORCED, QUICK, ENOUGH = 1e-3, 12, 1e-8
# Iterations that cost about a third of MUMPS' LU: measured 40 at 17,787 unknowns; LU grows as their power 3/2.
LEAST, PER_ROOT = 30, 0.3
RESTART = 60  # vectors that GMRES keeps

# Its order follows the bandwidth: a quarter fewer iterations than along the Hilbert curve.
ORDERED = {"pc_factor_mat_ordering_type": "rcm"}


class Iterative(LinearSolver):
    """`direct`'s systems, by Krylov's method as long as `tries` holds and it converges; from then on by `direct`.

    `tries` is set by whoever knows that inertia makes the matrices easy, and anew in every step, so that a step depends
    on nothing but itself; with it `wanted` (N), the tolerance of a step without contact or drag; the option
    ksp_max_it = 0 ends it, too. `negative` is None where no complete factor has counted. Conjugate gradients end at the
    first negative curvature, and then `direct` counts.
    """

    def __init__(self, direct: LinearSolver, counts: Counts, prefix: str, symmetric: bool):
        super().__init__(direct.indefinite.ksp, counts)
        self.symmetric = symmetric
        self.direct, self.tries, self._iterates, self.wanted = direct, False, False, 0.0
        self._given: tuple[PETSc.Mat, PETSc.Mat | None] | None = None
        krylov = self.krylov = PETSc.KSP().create(comm=direct.ksp.comm)
        krylov.setOptionsPrefix(prefix)
        part = "" if krylov.comm.size == 1 else "sub_"
        set_defaults({prefix + part + name: value for name, value in ORDERED.items()})
        krylov.setType(PETSc.KSP.Type.CG if symmetric else PETSc.KSP.Type.GMRES)
        krylov.setGMRESRestart(RESTART)
        krylov.pc.setType(PETSc.PC.Type.BJACOBI if part else PETSc.PC.Type.ILU)

    def factor(self, matrix: PETSc.Mat, operator: PETSc.Mat | None = None) -> bool:
        """See LinearSolver."""
        self._given, krylov = (matrix, operator), self.krylov
        most = max(LEAST, int(PER_ROOT * matrix.size[0] ** 0.5))
        krylov.setTolerances(
            rtol=SYMMETRIC if self.symmetric else CORRECTED, atol=ENOUGH * self.wanted, max_it=most
        )
        if self.wanted:  # tolerances are of the residual (N) itself
            krylov.setNormType(PETSc.KSP.NormType.UNPRECONDITIONED)
        krylov.setFromOptions()
        self._iterates = self.tries = self.tries and krylov.getTolerances()[3] > 0
        if not self._iterates:
            return self._factor()
        with self.counts.factorising():
            if self._coupled != matrix.getAttr("coupled"):
                krylov.pc.reset()
            self._coupled = matrix.getAttr("coupled")
            krylov.setOperators(operator or matrix, matrix)
            krylov.setUp()
        self.usable, self.negative = True, None
        return True

    @property
    def leaves(self) -> float:
        """See LinearSolver."""
        return (SYMMETRIC if self.symmetric else CORRECTED) if self._iterates else 0.0

    def solve(self, b: PETSc.Vec, x: PETSc.Vec) -> None:
        """See LinearSolver."""
        if self._iterates:
            if self._iterated(b, x):
                return
            self.tries = self._iterates = False
            if not self._factor():
                x.set(float("nan"))
                return
        self.direct.solve(b, x)

    def _iterated(self, b: PETSc.Vec, x: PETSc.Vec) -> bool:
        """Whether iterations, the quick ones or all, end at a solution x."""
        krylov, (_, _, _, most) = self.krylov, self.krylov.getTolerances()
        exact = SYMMETRIC if self.symmetric else CORRECTED
        asked = [(FORCED, min(QUICK, most))] * (self.wanted > 0.0) + [(exact, most)]
        for goes_on, (relative, count) in enumerate(asked):
            krylov.setTolerances(rtol=relative, max_it=count)
            krylov.setInitialGuessNonzero(goes_on > 0)
            with self.counts.solving():
                krylov.solve(b, x)
            self.counts.krylov += krylov.getIterationNumber()
            if krylov.getConvergedReason() > 0:
                break
        krylov.setTolerances(rtol=exact, max_it=most)
        return bool(krylov.getConvergedReason() > 0)

    def forget(self) -> None:
        """See LinearSolver."""
        self.direct.forget()

    def destroy(self) -> None:
        """Frees both factors."""
        self.krylov.destroy()
        self.direct.destroy()

    def _factor(self) -> bool:
        assert self._given
        self.direct.factor(*self._given)
        self.usable, self.negative = self.direct.usable, self.direct.negative
        return self.usable
