"""Newton's method on a potential, as a PETSc SNES of type python.

Each step minimises a quadratic model. Its matrix is the exact Hessian where the inertia of the factorisation says
that it is positive definite, else the kernels' positive semidefinite one; where steps stay short, a multiple of the
mass is added (one step of pseudo-transient continuation), which fades as the steps recover. The line search demands
sufficient decrease of the potential; where round-off hides the decrease, or the loads have no potential, it looks
at the slope instead (Hager & Zhang 2005, approximate Wolfe conditions).
"""

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
from petsc4py import PETSc

from voile.problem.discrete import Problem
from voile.problem.scales import round_off, slow_rate

SUFFICIENT = 1e-4  # fraction of the predicted decrease that a step must reach (Armijo)
REACH = 0.2  # longest full step: displacement over the size of the shell
LEAP = 5  # mixed steps of a leap
SHORTEST = 1e-10  # relative step length at which the line search gives up
PATIENCE = 2  # steps before an indefinite exact Hessian is tried again
ENERGY_NOISE = 1e-11  # relative size under which differences of the potential are round-off
IDLE = 3  # steps without halving the residual after which round-off is suspected
NEAR = 10.0  # times its round-off a residual is not worth more steps
FAR = 1e3  # times the residual what seems round-off is a singular shape: no area, a hinge at 180 degrees
_REASON = PETSc.SNES.ConvergedReason  # newer and older petsc4py call it differently
NOT_FINITE = getattr(_REASON, "DIVERGED_FUNCTION_NANORINF", None) or _REASON.DIVERGED_FNORM_NAN
WORK_SPACE, MOST_WORK_SPACE = (-8, -9), 1000  # MUMPS' errors for too little of it; ICNTL(14) in per cent


def negative_pivots(pc: PETSc.PC) -> int | None:
    """Negative eigenvalues counted by the factorisation (at least 1 where it broke down); None where the
    preconditioner does not tell."""
    if pc.getType() != PETSc.PC.Type.CHOLESKY:
        return None
    factor = pc.getFactorMatrix()
    if pc.getFactorSolverType() == "mumps":  # INFOG(1): error, INFOG(12): negative pivots
        return 1 if factor.getMumpsInfog(1) < 0 else factor.getMumpsInfog(12)
    try:
        return int(factor.getInertia()[0])
    except PETSc.Error:
        return None


def add_mass(matrix: PETSc.Mat, mass: PETSc.Vec, shift: float) -> None:
    """Adds shift times the diagonal mass to a tangent."""
    shifted = mass.copy()
    shifted.scale(shift)
    matrix.setDiagonal(shifted, addv=PETSc.InsertMode.ADD_VALUES)


def renew(pc: PETSc.PC, matrix: PETSc.Mat) -> None:
    """Drops a factorisation that the pattern has outgrown, which PETSc 3.26 does not notice on several ranks."""
    if pc.getAttr("coupled") != matrix.getAttr("coupled"):
        pc.reset()
        pc.setAttr("coupled", matrix.getAttr("coupled"))


@contextmanager
def timed(solver) -> Iterator[None]:
    """Adds the time within to solver.seconds."""
    began = time.perf_counter()
    yield
    solver.seconds += time.perf_counter() - began


def use_cholesky(pc: PETSc.PC) -> None:
    """LDL^T by MUMPS; options may choose otherwise."""
    pc.setType(PETSc.PC.Type.CHOLESKY)
    pc.setFactorSolverType("mumps")


def factorisation_error(pc: PETSc.PC) -> int:
    """MUMPS' error code of the last factorisation, negative (users' guide, INFOG(1)); 0 without one."""
    if pc.getType() not in (PETSc.PC.Type.CHOLESKY, PETSc.PC.Type.LU) or pc.getFactorSolverType() != "mumps":
        return 0
    return min(pc.getFactorMatrix().getMumpsInfog(1), 0)


def _more_work_space(pc: PETSc.PC) -> bool:
    """Doubles what the next factorisation may use beyond its estimate; False where that would be absurd."""
    percent = 2 * max(pc.getFactorMatrix().getMumpsIcntl(14), 20)
    PETSc.Options(pc.getOptionsPrefix() or "").setValue("mat_mumps_icntl_14", percent)
    return percent <= MOST_WORK_SPACE


class Skewed:
    """Context of a PETSc Mat of type python: the tangent, which is symmetric, and the skew part of the loads'."""

    def __init__(self, problem: Problem, tangent: PETSc.Mat):
        self.problem, self.tangent = problem, tangent

    def mult(self, _: PETSc.Mat, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """y = derivative of the residual along x."""
        self.tangent.mult(x, y)
        self.problem.add_skew(x, y)


@dataclass
class Step:
    """What the iterations did, for progress and tests."""

    iteration: int
    residual: float
    energy: float
    length: float
    exact: bool
    shift: float


class Newton:
    """Python context of the SNES; `problem` gives potential, residual and tangent."""

    mixed_limit = 25  # iterations of the fast steps
    descend = True  # False: fast steps only
    least_shift = 0.0  # 1/s^2 of mass always added (an unsupported shell)

    def __init__(self, problem: Problem):
        self.problem = problem
        self.steps: list[Step] = []
        self.shift = 0.0
        self.negative: int | None = None
        self.usable = True  # the last factorisation can solve
        self.seconds = 0.0  # in factorisations and solves
        self._mass: PETSc.Vec | None = None
        self._wait = self._idle = 0
        self._best = np.inf
        self.stalled = False  # round-off is all that is left of the residual, above the tolerance
        self._rest = self._patience = 0  # steps until, and between, leaps

    def solve(self, snes: PETSc.SNES, b: PETSc.Vec | None, y: PETSc.Vec) -> None:
        """Iterates until SNES's convergence test says so; sets its reason."""
        problem = self.problem
        residual = snes.getFunction()[0]
        direction, trial, trial_residual = y.duplicate(), y.duplicate(), y.duplicate()
        self.steps, self.shift, self._wait, self.stalled = [], 0.0, 0, False
        self._best, self._idle = np.inf, 0
        snes.computeFunction(y, residual)
        energy, norm = self._energy(y), residual.norm()
        snes.setIterationNumber(0)
        snes.setFunctionNorm(norm)
        snes.logConvergenceHistory(norm, 0)
        snes.setConvergedReason(self._test(snes, 0, y, direction, norm))
        snes.monitor(0, norm)
        if snes.reason:
            return
        if not self.descend:
            if not self._mixed(snes, y, residual, direction) and not snes.reason:
                snes.setConvergedReason(PETSc.SNES.ConvergedReason.DIVERGED_MAX_IT)
            return
        for it in range(1, snes.getTolerances()[3] + 1):
            if snes.reason:
                return
            exact, slope = self._direction(snes, y, residual, direction)
            if slope is None:
                snes.setConvergedReason(PETSc.SNES.ConvergedReason.DIVERGED_LINEAR_SOLVE)
                return
            length, new_energy = self._search(y, direction, energy, norm, slope, trial, trial_residual)
            if length == 0.0:
                if not self._regularise():
                    snes.setConvergedReason(PETSc.SNES.ConvergedReason.DIVERGED_LINE_SEARCH)
                    return
                continue
            if exact and length < 0.5 and problem.conservative and self._rest == 0:
                new_energy = self._leap(snes, y, direction, new_energy, trial, trial_residual)
            self._rest = max(self._rest - 1, 0)
            trial.copy(y)
            trial_residual.copy(residual)
            energy, norm = new_energy, residual.norm()
            self._adapt(length)
            self.steps.append(Step(it, norm, energy, length, exact, self.shift))
            direction.scale(length)
            snes.setIterationNumber(it)
            snes.setFunctionNorm(norm)
            snes.logConvergenceHistory(norm, 0)
            snes.setConvergedReason(self._test(snes, it, y, direction, norm))
            snes.monitor(it, norm)
            if not snes.reason and self._stalls(y, norm):
                snes.setConvergedReason(PETSc.SNES.ConvergedReason.DIVERGED_LINE_SEARCH)
        if not snes.reason:
            snes.setConvergedReason(PETSc.SNES.ConvergedReason.DIVERGED_MAX_IT)

    def _mixed(self, snes, y, residual, direction) -> bool:
        """Full Newton steps whose geometric stiffness uses linearly extrapolated stresses. They ignore the potential
        on their way, so only a converged minimum counts; else y is put back."""
        start = y.copy()
        first = norm = snes.getFunctionNorm()
        for it in range(1, min(self.mixed_limit, snes.getTolerances()[3]) + 1):
            minimum = self._factor(snes, y, "exact" if it == 1 else "mixed")
            if not self.usable:
                break
            self._apply_inverse(snes, residual, direction)
            if not np.isfinite(direction.norm()):
                break
            self._limit(y, direction)
            self.problem.predict(y, direction)
            y.axpy(1.0, direction)
            snes.computeFunction(y, residual)
            norm = residual.norm()
            if not np.isfinite(norm) or (it > 3 and norm > 1e8 * first):
                break
            self.steps.append(Step(it, norm, np.nan, 1.0, False, 0.0))
            snes.setIterationNumber(it)
            snes.setFunctionNorm(norm)
            snes.logConvergenceHistory(norm, 0)
            snes.monitor(it, norm)
            reason = self._test(snes, it, y, direction, norm)
            if reason > 0 and minimum:
                snes.setConvergedReason(reason)
                return True
            if reason > 0:
                break
            if minimum and self._stalls(y, norm):
                snes.setConvergedReason(PETSc.SNES.ConvergedReason.DIVERGED_LINE_SEARCH)
                return False
        start.copy(y)
        return False

    def _leap(self, snes, y, direction, energy, trial, trial_residual) -> float:
        """Where stretching cuts the line search short: the whole step and some mixed steps after it (a watchdog, as
        Chamberlain et al. 1982). Leaves their end in trial if its potential is below `energy`, that of the line
        search; else waits twice as long as before until the next leap. Returns the potential of trial."""
        there, step, residual = y.duplicate(), direction.copy(), y.duplicate()
        y.copy(there)
        best = energy
        for _ in range(LEAP):
            self._limit(there, step)
            self.problem.predict(there, step)
            there.axpy(1.0, step)
            new = self._energy(there)
            self.problem.residual(there, residual)
            if new < best:
                best = new
                there.copy(trial)
                residual.copy(trial_residual)
            elif best < energy:
                break
            if not np.isfinite(residual.norm()) or not self._factor(snes, there, "mixed"):
                break
            self._apply_inverse(snes, residual, step)
        self._patience = 0 if best < energy else min(max(2 * self._patience, 1), 64)
        self._rest = self._patience
        return best

    def _stalls(self, y: PETSc.Vec, norm: float) -> bool:
        """Whether the residual has stopped falling near the round-off of the unknowns."""
        self._idle = 0 if norm < 0.5 * self._best else self._idle + 1
        self._best = min(norm, self._best)
        if self._idle >= IDLE:
            noise = max(round_off(self.problem, y))
            self.stalled = norm / NEAR < noise < FAR * norm
        return self.stalled

    def _limit(self, y: PETSc.Vec, direction: PETSc.Vec) -> None:
        """Shortens a step from y that would move or turn something beyond what a linearisation can mean, or carry a
        layer of the shell through another."""
        largest = self.problem.largest_motion(direction)
        if largest > REACH:
            direction.scale(REACH / largest)
        direction.scale(self.problem.free_share(y, direction))

    def _test(self, snes, it, y, direction, norm):
        if not np.isfinite(norm):
            return NOT_FINITE
        return snes.callConvergenceTest(it, y.norm(), direction.norm() if it else 0.0, norm)

    def _energy(self, y: PETSc.Vec) -> float:
        return self.problem.energy(y) if self.problem.conservative else 0.0

    # ---- direction ----

    def _direction(self, snes, y, residual, direction) -> tuple[bool, float | None]:
        """Solves for a descent direction; (whether the exact Hessian served, slope along it or None)."""
        self._wait -= 1
        exact = self._wait < 0
        if exact and not self._factor(snes, y, "exact"):
            exact, self._wait = False, PATIENCE
        if not exact:
            while not self._factor(snes, y, "safe"):
                if not self._regularise():
                    return False, None
        slope = self._solve(snes, residual, direction)
        if slope is None and exact:
            exact = False
            slope = self._solve(snes, residual, direction) if self._factor(snes, y, "safe") else None
        return exact, slope

    def _solve(self, snes, residual, direction) -> float | None:
        self._apply_inverse(snes, residual, direction)
        slope = residual.dot(direction)
        return slope if np.isfinite(slope) and slope < 0.0 else None

    def _apply_inverse(self, snes, residual, direction) -> None:
        with timed(self):
            snes.ksp.solve(residual, direction)
        direction.scale(-1.0)

    def _factor(self, snes: PETSc.SNES, y: PETSc.Vec, kind: str) -> bool:
        """Assembles and factors; False if that fails or the matrix is not positive definite."""
        matrix = snes.getJacobian()[0]
        self.problem.tangent(y, matrix, kind)
        shift = max(self.shift, self.least_shift)
        if shift > 0.0:
            if self._mass is None:
                self._mass = self.problem.mass()
            add_mass(matrix, self._mass, shift)
        pc = snes.ksp.pc
        with timed(self):
            if not self.usable:
                pc.reset()  # PETSc leaves a MUMPS instance that failed once as it is
            renew(pc, matrix)
            snes.ksp.setOperators(self._operator(matrix), matrix)
            pc.setUp()
            while factorisation_error(pc) in WORK_SPACE and _more_work_space(pc):
                pc.reset()
                snes.ksp.setOperators(self._operator(matrix), matrix)
                pc.setUp()
        self.usable = not factorisation_error(pc)
        negative = negative_pivots(pc)
        if kind != "safe" and self.shift == 0.0:
            self.negative = negative
        return not negative

    def _operator(self, matrix: PETSc.Mat) -> PETSc.Mat:
        """The linear systems' matrix: the tangent, with its skew part where loads have no potential."""
        if self.problem.conservative:
            return matrix
        return PETSc.Mat().createPython(matrix.getSizes(), Skewed(self.problem, matrix), matrix.comm)

    def _regularise(self) -> bool:
        """Raises the shift (pseudo-transient continuation); False when it is beyond use."""
        self.shift = max(10.0 * self.shift, self._first_shift())
        return self.shift < 1e12 * self._first_shift()

    def _adapt(self, length: float) -> None:
        first = self._first_shift()
        if length < 0.1:
            self.shift = max(4.0 * self.shift, first)
        elif length > 0.5 and self.shift:
            self.shift = 0.1 * self.shift if self.shift > 0.1 * first else 0.0

    def _first_shift(self) -> float:
        """Inverse square of the time (s) in which the load moves the shell by about its size."""
        return slow_rate(self.problem)

    # ---- line search ----

    def _search(self, y, direction, energy, norm, slope, trial, trial_residual) -> tuple[float, float]:
        """Backtracks from the full step; (0, energy) if no length is acceptable."""
        problem = self.problem
        length = problem.free_share(y, direction)
        noise = ENERGY_NOISE * abs(energy)
        while length > SHORTEST:
            trial.waxpy(length, direction, y)
            new = self._energy(trial)
            if np.isfinite(new):
                decrease = new - energy
                if (
                    problem.conservative
                    and decrease <= SUFFICIENT * length * slope
                    and -length * slope > noise
                ):
                    problem.residual(trial, trial_residual)
                    return length, new
                if not problem.conservative or decrease <= noise:
                    problem.residual(trial, trial_residual)
                    new_slope = trial_residual.dot(direction)
                    if np.isfinite(new_slope) and self._flat_enough(
                        new_slope, slope, trial_residual.norm(), norm
                    ):
                        return length, new
                guess = (
                    -0.5 * slope * length**2 / (decrease - slope * length)
                    if decrease > slope * length
                    else 0.0
                )
                length = min(max(guess, 0.1 * length), 0.5 * length)
            else:
                length *= 0.25
        return 0.0, energy

    def _flat_enough(self, new_slope: float, slope: float, new_norm: float, norm: float) -> bool:
        if self.problem.conservative:
            return new_slope <= (2 * SUFFICIENT - 1) * slope and new_slope >= 0.9 * slope
        return abs(new_slope) <= 0.9 * abs(slope) or new_norm < norm
