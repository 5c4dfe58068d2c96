"""Semismooth Newton method for equilibrium together with Signorini's and Coulomb's laws.

Unknowns are displacements, director angles and the reactions of the contacts that may carry one. Per iteration: one
factorisation of the shell's tangent, to which each active contact adds a 3x3 penalty block, and a few more solves with
it that turn those into the exact linearised laws, the reactions being multipliers. Without slip the matrix is symmetric
and the factorisation counts negative eigenvalues on the contacts' tangent space; with slip it is not, and LU serves.
SNES prefix semismooth_.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from petsc4py import PETSc

from voile.contact.contact import Linearised
from voile.errors import InputError
from voile.problem.contact import contact_of, measured_pairs
from voile.problem.problem import Problem
from voile.problem.state import State
from voile.solver.linear import LinearSolver
from voile.solver.methods.method import Nonlinear, Outcome, Workspace
from voile.solver.methods.steps import WORTH, Stall, by_round_off, limit, sharpened, test

_REASON = PETSc.SNES.ConvergedReason
STILL = 1e-15  # sizes: a Newton step that moves no vertex by more is round-off


@dataclass
class Options:
    """iterations: those that converge take under 30, a front of contacts that moves row by row up to 60. corrections:
    solves with one factorisation that turn penalties into constraints, to round-off with three. patience:
    iterations without halving the norm after which it will not converge, or cycles. growth of the norm beyond which it
    has left. whole: share of a Newton step that layers of the shell must leave, for one that they cut is mostly one
    that contacts which contradict each other have led astray: in time, with a cut, runs took seven more iterations and
    hardly any converged."""

    iterations: int = 60
    corrections: int = 3
    patience: int = 6
    growth: float = 1e8
    whole: float = 0.95


class Semismooth:
    """Its SNES's function norm is that of residual and mismatch. `negative`: negative eigenvalues on the contacts'
    tangent space after the last run; None where slip hides them. `still`: it ended where Newton steps move no vertex
    any more, above the tolerance: a director angle without stiffness (`sin` at 90 degrees) has half as many digits."""

    name = "semismooth"

    def __init__(self, work: Workspace, options: Options | None = None):
        self.work, self.options = work, options or Options()
        self.nonlinear = Nonlinear(work, "semismooth_", Iteration(self))
        self.negative: int | None = None
        self.stalled = self.still = False

    def solve(self, problem: Problem, y: PETSc.Vec, tolerance: float) -> Outcome:
        """See Method."""
        return sharpened(self._run, self, problem, y, tolerance)

    def _run(self, problem: Problem, y: PETSc.Vec, tolerance: float) -> Outcome:
        self.stalled = self.still = False
        done = self.nonlinear.run(problem, y, tolerance, self.options.iterations) or self.still
        if self.nonlinear.snes.getType() != PETSc.SNES.Type.PYTHON:
            raise InputError(
                f"-snes_type {self.nonlinear.snes.getType()}: contact is solved by the program's own method; "
                "allowed: none, or -contact_snes_type where nothing rubs"
            )
        if done and self.negative:
            reason = "the semismooth Newton method ended at a saddle"
            return Outcome(False, self.name, reason, saddle=problem.save(y))
        if not done:
            return self.nonlinear.missed(self.name, y)
        reason = by_round_off(self.nonlinear.norm, tolerance) if self.still else ""
        return Outcome(True, self.name, reason, norm=self.nonlinear.norm, negative=self.negative)


@dataclass
class Course:
    """How the norm (N) went: the first, the least, and iterations since it was halved last."""

    first: float = 0.0
    best: float = np.inf
    idle: int = 0

    def take(self, norm: float) -> None:
        """Of the next iterate."""
        self.first = self.first or norm
        self.idle = 0 if norm < 0.5 * self.best else self.idle + 1
        self.best = min(norm, self.best)


@dataclass
class Held:
    """An equilibrium to come back to, its norm (N), SNES's reason."""

    state: State
    norm: float
    reason: int


class Iteration:
    """The iteration of its SNES."""

    def __init__(self, method: Semismooth):
        self.method, self.work, self.options = method, method.work, method.options
        self.left = 0.0  # of a first step that was not enough: the norm over the tolerance

    def solve(self, snes: PETSc.SNES, b: PETSc.Vec | None, y: PETSc.Vec) -> None:
        """Iterates until SNES's convergence test says so; sets its reason. The reactions are in the contact's state."""
        snes.setConvergedReason(self._iterate(snes, y) or _REASON.DIVERGED_MAX_IT)

    def _iterate(self, snes: PETSc.SNES, y: PETSc.Vec) -> int:
        """The reason to end, 0 where it gives up."""
        problem, tolerance, most = (
            self.method.nonlinear.problem,
            snes.getTolerances()[1],
            snes.getTolerances()[3],
        )
        direction, course, stall = y.duplicate(), Course(), Stall()
        held: Held | None = None
        linear: Linearised | None = None
        for it in range(most + 1):
            norm = float(np.hypot(*law_norms(problem, y, snes.getFunction()[0], tolerance)))
            course.take(norm)
            self.left = norm / tolerance if it else 0.0
            reason = test(
                snes, it, y, direction, norm if norm <= self.options.growth * course.first else np.nan
            )
            if held and reason <= 0:  # as where the tangent is singular
                reason = self._back(snes, y, held)
            if reason and (it or reason < 0):
                return reason
            # What holds from the start takes one step for its inertia, and to be sharper.
            held = Held(problem.save(y), norm, reason) if reason else None
            stalled = not self.method.negative and stall.reached(problem, y, norm)
            if it == most or course.idle > self.options.patience or stalled:
                self.method.stalled = stalled
                return 0
            linear = contact_of(problem).linearise(problem.positions(y), problem.time, linear)
            if not self._solve(linear, "mixed" if it else "exact", y, direction):
                return self._back(snes, y, held) if held else _REASON.DIVERGED_LINEAR_SOLVE
            waited = course.idle >= stall.idle  # or else reactions still move
            near = waited and norm <= WORTH * tolerance
            if near and not held and problem.largest_motion(direction) < STILL:
                self.method.still = True
                return 0
            length = self._step(linear, y, direction)
            if contact_of(problem).itself and length < self.options.whole:
                return self._back(snes, y, held) if held else 0
        return 0

    def _solve(self, linear: Linearised, kind: str, y: PETSc.Vec, direction: PETSc.Vec) -> bool:
        """Whether there is a Newton step by a kind of tangent, in direction; counts its negative eigenvalues."""
        problem = self.method.nonlinear.problem
        problem.tangent(y, self.work.matrix, kind, linear.blocks())
        symmetric = problem.everywhere(linear.symmetric)
        solver = self.work.symmetric if symmetric else self.work.unsymmetric
        if solver.factor(self.work.matrix):
            self._direction(solver, linear, y, direction)
        self.method.negative = solver.negative if solver.usable else None
        return bool(solver.usable and np.isfinite(direction.norm()))

    def _step(self, linear: Linearised, y: PETSc.Vec, direction: PETSc.Vec) -> float:
        """Takes as much of a Newton step as may be: that share."""
        problem = self.method.nonlinear.problem
        length = limit(problem, y, direction)
        problem.predict(y, direction)
        y.axpy(1.0, direction)
        linear.reactions(length)
        return length

    def _back(self, snes: PETSc.SNES, y: PETSc.Vec, held: Held) -> int:
        """y and the reactions are again those of a state that converged; the reason why it did."""
        self.method.nonlinear.problem.restore(y, held.state)
        snes.setFunctionNorm(held.norm)
        return held.reason

    def _direction(
        self, solver: LinearSolver, linear: Linearised, y: PETSc.Vec, direction: PETSc.Vec
    ) -> None:
        """The Newton step."""
        problem = self.method.nonlinear.problem
        forces = problem.forces(y)

        def residual(f: PETSc.Vec) -> None:
            problem.unbalanced(forces, f, linear.force())

        # The first step may be all. Where another one would miss the tolerance by what a solve leaves, one is enough.
        corrections = 1 if solver.leaves * self.left > 1.0 else self.options.corrections
        closed_step(problem, linear, solver, self.work.matrix, residual, direction, corrections)


def closed_step(
    problem: Problem,
    linear: Linearised,
    solver: LinearSolver,
    matrix: PETSc.Mat,
    residual: Callable[[PETSc.Vec], None],
    step: PETSc.Vec,
    corrections: int,
) -> None:
    """The Newton step on which active contacts keep their laws: corrects reactions and step until the penalties carry
    nothing. residual(f): that with the present reactions of `linear`; matrix: factored by the solver."""
    f, image, part = (step.duplicate() for _ in range(3))
    step.set(0.0)
    for _ in range(corrections):
        residual(f)
        matrix.mult(step, image)
        f.axpy(1.0, image)
        solver.solve(f, part)
        step.axpy(-1.0, part)
        linear.advance(problem.motion(step))


def law_norms(problem: Problem, y: PETSc.Vec, f: PETSc.Vec, tolerance: float) -> tuple[float, float]:
    """Norms of the equilibrium's residual, left in f, and of the laws' mismatch (N); tolerance: theirs (N)."""
    contact, x = contact_of(problem), problem.positions(y)
    pairs = measured_pairs(problem, x, tolerance)
    problem.residual(y, f, contact.projected(pairs))
    mismatch = problem.comm.allreduce(contact.missed(pairs))
    return f.norm(), float(np.sqrt(mismatch))
