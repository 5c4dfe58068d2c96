"""What Newton steps have in common: their factor, their bounds, and when round-off ends them."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from petsc4py import PETSc

from voile.arrays import Reals
from voile.problem.problem import Problem
from voile.problem.scales import round_off
from voile.solver.linear import LinearSolver
from voile.solver.methods.method import NOT_FINITE, Method, Nonlinear, Outcome, Workspace

WORTH = 100.0  # tolerances: a residual that round-off leaves above is no equilibrium worth the name
REACH = 0.2  # longest full step: displacement over the size of the shell

Run = Callable[[Problem, PETSc.Vec, float], Outcome]


class Stalling(Protocol):
    """A method that knows whether only round-off was left of its last residual, above the tolerance; `negative`:
    eigenvalues of its last tangent, None where not known."""

    stalled: bool
    negative: int | None
    nonlinear: Nonlinear


@dataclass
class Step:
    """What an iteration did, for progress and tests."""

    iteration: int
    residual: float
    energy: float
    length: float
    exact: bool
    shift: float


class Skewed:
    """Context of a PETSc Mat of type python: the tangent, which is symmetric, and the skew part of the loads'."""

    def __init__(self, problem: Problem, tangent: PETSc.Mat):
        self.problem, self.tangent = problem, tangent

    def mult(self, _: PETSc.Mat, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """y = derivative of the residual along x."""
        self.tangent.mult(x, y)
        self.problem.add_skew(x, y)


def factor(work: Workspace, problem: Problem, y: PETSc.Vec, kind: str) -> LinearSolver:
    """The tangent at y, factored. Systems are solved with its skew part, too, where loads have no potential."""
    work.symmetric.factor(work.matrix, _assembled(work, problem, y, kind))
    return work.symmetric


def factor_definite(
    work: Workspace, problem: Problem, y: PETSc.Vec, kind: str, shift: float | Reals = 0.0, share: float = 1.0
) -> LinearSolver:
    """As `factor`, of a tangent that serves only if it is positive definite, with a multiple of the mass (1/s^2); of a
    safe one that share, the rest exact."""
    work.symmetric.factor_definite(work.matrix, _assembled(work, problem, y, kind, shift, share))
    return work.symmetric


def _assembled(
    work: Workspace, problem: Problem, y: PETSc.Vec, kind: str, shift: float | Reals = 0.0, share: float = 1.0
) -> PETSc.Mat:
    """The operator of systems with the tangent, which is left in the workspace's matrix."""
    matrix = work.matrix
    problem.tangent(y, matrix, kind, shift=shift, share=share)
    if problem.conservative:
        return matrix
    return PETSc.Mat().createPython(matrix.getSizes(), Skewed(problem, matrix), matrix.comm)


def descent_direction(linear: LinearSolver, residual: PETSc.Vec, direction: PETSc.Vec) -> float:
    """direction = -A^-1 residual; the slope of the potential along it (J)."""
    linear.solve(residual, direction)
    direction.scale(-1.0)
    return float(residual.dot(direction))


def limit(problem: Problem, y: PETSc.Vec, direction: PETSc.Vec) -> float:
    """Shortens a step from y that would move something beyond what a linearisation can mean, or carry a layer of the
    shell through another or a hinge through 180 degrees; the share of it that is left."""
    length = min(1.0, REACH / max(problem.largest_motion(direction), 1e-300))
    direction.scale(length)
    admitted = problem.longest_step(y, direction)
    direction.scale(admitted)
    return length * admitted


def test(snes: PETSc.SNES, iteration: int, y: PETSc.Vec, direction: PETSc.Vec, norm: float) -> int:
    """Tells SNES of an iterate; the reason to stop, or 0."""
    snes.setIterationNumber(iteration)
    snes.setFunctionNorm(norm)
    snes.logConvergenceHistory(norm, 0)
    snes.monitor(iteration, norm)
    if not np.isfinite(norm):
        return int(NOT_FINITE)
    return int(snes.callConvergenceTest(iteration, y.norm(), direction.norm() if iteration else 0.0, norm))


def to_round_off(problem: Problem, y: PETSc.Vec, norm: float, tolerance: float) -> str:
    """Why a residual (N) that has stopped falling at y is as good as converged; empty where it is not: where the
    evaluation itself is more exact, or the tolerance far."""
    computed = round_off(problem, y)[1]
    if computed < tolerance or norm > WORTH * tolerance:
        return ""
    return by_round_off(norm, tolerance, f" ({computed:.1e} N)")


def by_round_off(norm: float, tolerance: float, known: str = "") -> str:
    """What is said of a residual (N) that only round-off, as far as it is known, leaves above the tolerance."""
    return f"converged to round-off{known}: residual {norm:.1e} N, tolerance {tolerance:.1e} N"


def sharpened(run: Run, newton: Stalling, problem: Problem, y: PETSc.Vec, tolerance: float) -> Outcome:
    """A run of a method to round-off: where the rounding of large displacements hides that it has converged they are
    counted anew from the shape reached; what then remains is round-off of the evaluation, and accepted as such."""
    outcome = run(problem, y, tolerance)
    if not newton.stalled:
        return outcome
    problem.move_origin(y)
    outcome = run(problem, y, tolerance)
    norm = newton.nonlinear.norm
    reason = to_round_off(problem, y, norm, tolerance) if newton.stalled else ""
    return Outcome(True, outcome.method, reason, norm=norm, negative=newton.negative) if reason else outcome


class Sharpened:
    """A method without contact, to round-off."""

    def __init__(self, method: Method, newton: Stalling):
        self.method, self.newton = method, newton

    def solve(self, problem: Problem, y: PETSc.Vec, tolerance: float) -> Outcome:
        """See Method."""
        return sharpened(self.method.solve, self.newton, problem, y, tolerance)


@dataclass
class Stall:
    """Whether a residual has stopped falling near the round-off of the unknowns."""

    idle: int = 3  # steps without halving the residual after which round-off is suspected
    near: float = 10.0  # times its round-off a residual is not worth more steps
    far: float = (
        1e3  # times the residual what seems round-off is a singular shape: no area, a hinge at 180 degrees
    )
    best: float = np.inf
    waited: int = 0

    def reached(self, problem: Problem, y: PETSc.Vec, norm: float, falls: bool = False) -> bool:
        """Whether the iterate y with this norm (N) is where it ends. falls: a potential still does, beyond its own
        round-off."""
        self.waited = 0 if norm < 0.5 * self.best else self.waited + 1
        self.best = min(norm, self.best)
        if falls or self.waited == 0 or self.waited % self.idle:  # round-off costs three residuals
            return False
        noise = max(round_off(problem, y))
        return norm / self.near < noise < self.far * norm
