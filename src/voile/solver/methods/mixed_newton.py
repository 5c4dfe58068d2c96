"""Full Newton steps whose geometric stiffness uses linearly extrapolated stresses (Magisano, Leonetti & Garcea 2017).

They ignore the potential on their way, so only a converged minimum counts. SNES prefix mixed_.
"""

from dataclasses import dataclass

import numpy as np
from petsc4py import PETSc

from voile.problem.problem import Problem
from voile.solver.methods.method import Nonlinear, Outcome, Workspace
from voile.solver.methods.steps import Stall, Step, descent_direction, factor, limit, test

DIVERGED = PETSc.SNES.ConvergedReason.DIVERGED_MAX_IT
STALLED = PETSc.SNES.ConvergedReason.DIVERGED_LINE_SEARCH
ROUGH = 0.3  # contraction of a residual, from which on solves are exact
CORRECTIONS = 2  # with the last factor, which cost a step in time less than a new tangent


@dataclass
class Options:
    """iterations: those that converge take under 15, with large turns up to 25; growth of the residual, from the
    fourth iteration on, beyond which none has come back."""

    iterations: int = 25
    growth: float = 1e8


class MixedNewton:
    """After a run `stalled` says that only round-off is left of the residual, above the tolerance;
    y is then where that is, else back where it was. `negative`: eigenvalues of its last tangent."""

    name = "newton"

    def __init__(self, work: Workspace, options: Options | None = None):
        self.work, self.options = work, options or Options()
        self.nonlinear = Nonlinear(work, "mixed_", Iteration(self))
        self.steps: list[Step] = []
        self.stalled = False
        self.negative: int | None = None

    def solve(self, problem: Problem, y: PETSc.Vec, tolerance: float) -> Outcome:
        """See Method."""
        self.stalled, self.negative = False, None
        if self.nonlinear.run(problem, y, tolerance, self.options.iterations):
            return Outcome(True, self.name, norm=self.nonlinear.norm, negative=self.negative)
        return self.nonlinear.missed(self.name, y)


@dataclass
class Iteration:
    """The iteration of its SNES."""

    method: MixedNewton

    def solve(self, snes: PETSc.SNES, b: PETSc.Vec | None, y: PETSc.Vec) -> None:
        """Iterates until SNES's convergence test says so; sets its reason."""
        method, problem = self.method, self.method.nonlinear.problem
        residual, direction, start = snes.getFunction()[0], y.duplicate(), y.copy()
        stall = Stall(idle=1)  # full steps halve a residual near its round-off at once, or never
        method.steps = []
        snes.computeFunction(y, residual)
        first = before = norm = residual.norm()
        if method.work.rough and first > problem.load_norm(y):
            method.work.careful()
        reason = test(snes, 0, y, direction, norm)
        for it in range(1, snes.getTolerances()[3] + 1):
            if reason:
                break
            goes_on = norm * (norm / before) ** CORRECTIONS <= snes.getTolerances()[1]
            if not (goes_on and method.work.rough):
                linear = factor(method.work, problem, y, "exact" if it == 1 else "mixed")
            before = norm
            if not linear.usable or not np.isfinite(descent_direction(linear, residual, direction)):
                break
            method.negative = linear.negative if it == 1 else None  # the others are not exact
            minimum = not linear.negative
            limit(problem, y, direction)
            problem.predict(y, direction)
            y.axpy(1.0, direction)
            snes.computeFunction(y, residual)
            norm = residual.norm()
            if norm > ROUGH * before:
                method.work.careful()
            if not np.isfinite(norm) or (it > 3 and norm > method.options.growth * first):
                break
            method.steps.append(Step(it, norm, np.nan, 1.0, False, 0.0))
            reason = test(snes, it, y, direction, norm)
            if reason > 0 and not minimum:
                reason = 0
                break
            if not reason and minimum and stall.reached(problem, y, norm):
                method.stalled, reason = True, STALLED
        if not (reason > 0 or method.stalled):
            start.copy(y)
        snes.setConvergedReason(reason or DIVERGED)
