"""Newton's method on a potential: a line search along directions of a positive definite matrix.

The matrix is the exact Hessian where the inertia of its factorisation says that it is positive definite. Else it is
blended with the kernels' positive semidefinite one (`safe`), of which no larger a share is taken than makes it positive
definite: by itself that one is far stiffer than the way off a saddle. Without contact, after a whole step with the
exact Hessian, a mixed tangent (see mixed_newton) serves where it is positive definite: a cloth of 4,225 vertices takes
6 iterations with it, 20 without. Where steps stay short, a multiple of the mass is added to the vertices that go far
(pseudo-transient continuation with local time steps), which fades as the steps recover: three vertices of a flap that
hangs by a corner are no reason to hold up a dress. The line search demands sufficient decrease of the potential; where
round-off hides the decrease, or the loads have no potential, it looks at the slope instead (Hager & Zhang 2005,
approximate Wolfe conditions). SNES prefix descent_, in pseudo-time transient_.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from voile.arrays import Reals
from voile.problem.problem import Problem
from voile.problem.scales import slow_rate
from voile.solver.linear import LinearSolver
from voile.solver.methods.method import Nonlinear, Outcome, Workspace
from voile.solver.methods.steps import Stall, Step, descent_direction, factor_definite, limit, test

_REASON = PETSc.SNES.ConvergedReason
Hopeless = Callable[[PETSc.Vec], bool]
Settled = Callable[[list[Step]], bool]


@dataclass
class Options:
    """iterations: a buckling cloth takes up to 300 from a flat start, a balloon whose membrane wrinkles without bending
    1,910. sufficient: share of the predicted decrease that a step must reach (Armijo; Nocedal & Wright 2006). steep:
    share of the slope left after a whole step from which on a longer one is tried (their curvature condition).
    shortest: relative step length at which the search gives up. patience: steps after which an indefinite exact Hessian
    is tried again; near the end it is what converges. noise: relative size under which differences of the potential are
    round-off. mixed_steps: those of a watchdog. far: share of the longest way of a vertex from which on one is held
    back where steps are short; the others go on as they did. shift: of the mass (1/s^2), always added: for a shell that
    nothing holds. stiffer: times the share of the safe matrix where a blend is not positive definite; hold: whole steps
    before the next lower share is tried then. Of 2 to 4 and 0 to 3 these took the fewest factorisations of a skirt
    (273; 290 with 3 and 0). least: share under which the exact Hessian is as likely to serve. creep: share of the
    potential's fall so far; ends, converged, where the last `look_back` steps fell by less."""

    iterations: int = 4000
    sufficient: float = 1e-4
    steep: float = 0.5
    shortest: float = 1e-10
    patience: int = 2
    noise: float = 1e-11
    mixed_steps: int = 5
    far: float = 0.1
    shift: float = 0.0
    stiffer: float = 4.0
    hold: int = 3
    least: float = 0.01
    creep: float = 0.0
    look_back: int = 20


def shorter(length: float, predicted: float, decrease: float) -> float:
    """The share of a step of `length` whose potential is least, by what the whole one changed (J). Along a Newton
    direction it is predicted (s - length s^2/2) + c s^4: what bends an inextensible shell stretches it by s^2."""
    slope, c = abs(predicted), decrease - predicted * (1.0 - 0.5 * length)
    if not c > 0.0:
        return 0.5
    share = float(min(1.0 / length, np.cbrt(slope / (4.0 * c))))  # above the root Newton's method is monotone
    for _ in range(10):
        rest = slope * (length * share - 1.0) + 4.0 * c * share**3
        share -= rest / (slope * length + 12.0 * c * share**2)
    return share


class Descent:
    """Minimises the potential of a problem. After a run `stalled` says that only round-off is left of the residual,
    above the tolerance; `negative` counts the tangent's negative eigenvalues, None where that is not known."""

    name = "descent"

    def __init__(self, work: Workspace, options: Options | None = None, prefix: str = "descent_"):
        self.work, self.options = work, options or Options()
        self.iteration = Iteration(self)
        self.nonlinear = Nonlinear(work, prefix, self.iteration)
        self.settled: Settled | None = None  # of the present run
        self.hopeless: Hopeless | None = None
        self.stalled = False
        self.negative: int | None = None

    @property
    def steps(self) -> list[Step]:
        """Those of the last run."""
        return self.iteration.steps

    def solve(self, problem: Problem, y: PETSc.Vec, tolerance: float) -> Outcome:
        """See Method."""
        if self.run(problem, y, tolerance):
            return Outcome(True, self.name, norm=self.nonlinear.norm, negative=self.negative)
        return self.nonlinear.missed(self.name, y)

    def run(
        self,
        problem: Problem,
        y: PETSc.Vec,
        tolerance: float,
        most: int | None = None,
        hopeless: Hopeless | None = None,
        settled: Settled | None = None,
    ) -> bool:
        """Whether the residual's norm came under the tolerance (N) within `most` iterations and before an iterate was
        `hopeless`; y ends where they end. settled: another test of convergence, by the steps so far."""
        self.stalled, self.negative, self.hopeless, self.settled = False, None, hopeless, settled
        return self.nonlinear.run(problem, y, tolerance, most or self.options.iterations)


@dataclass
class Iterate:
    """Unknowns, with the residual and the potential (J) there."""

    y: PETSc.Vec
    residual: PETSc.Vec
    energy: float = 0.0

    @property
    def norm(self) -> float:
        """The residual's (N)."""
        return float(self.residual.norm())

    def take(self, other: "Iterate") -> None:
        """Becomes a copy of another."""
        other.y.copy(self.y)
        other.residual.copy(self.residual)
        self.energy = other.energy


class Iteration:
    """The iteration of its SNES."""

    def __init__(self, method: Descent):
        self.method, self.work, self.options = method, method.work, method.options
        self.steps: list[Step] = []
        self.shift = np.zeros(0)  # (local vertices,) 1/s^2 of mass added while steps are short
        self._slow = 0.0  # 1/s^2, of the time in which the load moves the shell by about its size
        self._wait = 0  # steps until the exact Hessian is tried again
        self._share = 1.0  # of the safe matrix in its stead
        self._hold = 0  # whole steps until a lower one is tried
        self.forget()
        self._mixed = False  # whether a mixed tangent may replace the exact Hessian

    def forget(self) -> None:
        """Drops what former solves have taught."""
        self._rest = self._pause = 0  # steps until, and between, watchdogs

    def solve(self, snes: PETSc.SNES, b: PETSc.Vec | None, y: PETSc.Vec) -> None:
        """Iterates until SNES's convergence test says so; sets its reason."""
        problem = self.problem = self.method.nonlinear.problem
        here, trial = Iterate(y, snes.getFunction()[0]), Iterate(y.duplicate(), y.duplicate())
        direction, stall = y.duplicate(), Stall()
        self.steps, self._wait, self._share, self._hold = [], 0, 1.0, 0
        self.shift, self._slow = np.zeros(len(problem.vertex_mass())), slow_rate(problem)
        self._mixed = False
        snes.computeFunction(y, here.residual)
        here.energy = self._energy(y)
        reason = test(snes, 0, y, direction, here.norm)
        for it in range(1, snes.getTolerances()[3] + 1):
            if reason:
                break
            exact, slope = self._direction(here, direction)
            if slope is None:
                reason = _REASON.DIVERGED_LINEAR_SOLVE
                break
            length = self._search(here, direction, slope, trial)
            if length == 0.0:
                reason = 0 if self._regularise() else _REASON.DIVERGED_LINE_SEARCH
                continue
            if problem.conservative and length == 1.0:
                length = self._lengthen(here, direction, slope, trial)
            elif problem.conservative and exact and length < 0.5 and self._rest == 0:
                self._watchdog(here, direction, trial)
            falls = here.energy - trial.energy > self.options.noise * abs(here.energy)
            self._take(here, direction, trial, length, exact)
            self.steps.append(Step(it, here.norm, here.energy, length, exact, self._largest(self.shift)))
            reason = test(snes, it, y, direction, here.norm)
            if self.work.watch:
                self.work.watch(y)
            reason = reason or self._end(here, stall, falls)
        snes.setConvergedReason(reason or _REASON.DIVERGED_MAX_IT)

    def _take(self, here: Iterate, direction: PETSc.Vec, trial: Iterate, length: float, exact: bool) -> None:
        """Goes on to the trial, which a step of this length found; direction becomes the way there."""
        self._rest = max(self._rest - 1, 0)
        direction.waxpy(-1.0, here.y, trial.y)
        self._mixed = exact and length >= 1.0 and not self.problem.contact
        if self._mixed:
            self.problem.predict(here.y, direction)
        here.take(trial)
        self._adapt(length, direction)
        if not exact:
            self._soften(length)

    def _end(self, here: Iterate, stall: Stall, falls: bool) -> int:
        """Why it ends here, though SNES would go on; 0 where it does. falls: the potential, by the last step."""
        method = self.method
        if self._creeps() or (method.settled and method.settled(self.steps)):
            return int(_REASON.CONVERGED_ITS)
        if method.hopeless and method.hopeless(here.y):
            return int(_REASON.DIVERGED_LOCAL_MIN)
        method.stalled = stall.reached(self.problem, here.y, here.norm, falls)
        return int(_REASON.DIVERGED_LINE_SEARCH) if method.stalled else 0

    def _creeps(self) -> bool:
        steps, back = self.steps, self.options.look_back
        if not self.options.creep or len(steps) <= back:
            return False
        now = steps[-1].energy
        return steps[-1 - back].energy - now < self.options.creep * (steps[0].energy - now)

    def _watchdog(self, here: Iterate, direction: PETSc.Vec, trial: Iterate) -> None:
        """Where stretching cuts the line search short: the whole step and some mixed steps after it (Chamberlain et
        al. 1982). Leaves their end in trial if its potential is below that of the line search; else waits twice as long
        as before until the next try."""
        problem, searched = self.problem, trial.energy
        there, step = Iterate(here.y.copy(), here.y.duplicate()), direction.copy()
        for _ in range(self.options.mixed_steps):
            limit(problem, there.y, step)
            problem.predict(there.y, step)
            there.y.axpy(1.0, step)
            there.energy = self._energy(there.y)
            problem.residual(there.y, there.residual)
            if there.energy < trial.energy:
                trial.take(there)
            elif trial.energy < searched:
                break
            if not np.isfinite(there.norm):
                break
            linear = factor_definite(self.work, problem, there.y, "mixed", self._shift())
            if linear.usable and not linear.negative:
                descent_direction(linear, there.residual, step)
            if linear.negative or not linear.usable:  # iterations find it only now
                break
        self._pause = 0 if trial.energy < searched else min(max(2 * self._pause, 1), 64)
        self._rest = self._pause

    def _energy(self, y: PETSc.Vec) -> float:
        return self.problem.energy(y) if self.problem.conservative else 0.0

    # ---- direction ----

    def _direction(self, here: Iterate, direction: PETSc.Vec) -> tuple[bool, float | None]:
        """Solves for a descent direction; (whether the exact Hessian served, slope along it or None)."""
        self._wait -= 1
        if self._wait < 0:
            for kind in ("mixed", "exact") if self._mixed else ("exact",):
                slope = self._slope(self._factor(here.y, kind), here.residual, direction)
                if slope is not None:
                    return True, slope
            self._wait = self.options.patience
        while True:
            slope = self._slope(self._factor(here.y, "safe"), here.residual, direction)
            if slope is not None or not (self._stiffen() or self._regularise()):
                return False, slope

    def _stiffen(self) -> bool:
        """Raises the share of the safe matrix; False where it is the whole."""
        if self._share == 1.0:
            return False
        self._share, self._hold = min(1.0, self.options.stiffer * self._share), self.options.hold
        return True

    def _soften(self, length: float) -> None:
        """Lowers that share after a whole step, more where a longer one was better."""
        if length > 1.0 or (length == 1.0 and self._hold <= 0):
            self._share = max(self.options.least, self._share * (0.25 if length > 1.0 else 0.5))
        self._hold -= 1

    def _slope(self, linear: LinearSolver, residual: PETSc.Vec, direction: PETSc.Vec) -> float | None:
        """That of the potential along the direction (J); None where the matrix gives no descent direction."""
        if linear.negative or not linear.usable:
            return None
        slope = descent_direction(linear, residual, direction)
        descends = (
            np.isfinite(slope) and slope < 0.0 and not linear.negative
        )  # iterations may find it only here
        return slope if descends else None

    def _factor(self, y: PETSc.Vec, kind: str) -> LinearSolver:
        shift = self._shift()
        linear = factor_definite(self.work, self.problem, y, kind, shift, self._share)
        if kind != "safe" and self._largest(shift) == 0.0:
            self.method.negative = linear.negative if kind == "exact" else None
        return linear

    def _shift(self) -> Reals:
        return np.maximum(self.shift, self.options.shift)

    def _largest(self, values: Reals) -> float:
        """Of all ranks' vertices, none below 0."""
        return float(self.problem.reduced(float(values.max(initial=0.0)), MPI.MAX))

    def _regularise(self) -> bool:
        """Raises all shifts (pseudo-transient continuation); False when they are beyond use."""
        self.shift = np.maximum(10.0 * self.shift, self._slow)
        return self._largest(self.shift) < 1e12 * self._slow

    def _adapt(self, length: float, moved: PETSc.Vec) -> None:
        """The shifts after a step of this length that moved the unknowns."""
        if length < 0.1:
            way = np.linalg.norm(self.problem.layout.spread(moved)[0].reshape(-1, 3), axis=1)
            far = way > self.options.far * self._largest(way)
            self.shift[far] = np.maximum(4.0 * self.shift[far], self._slow)
        elif length > 0.5:
            self.shift = np.where(self.shift > 0.1 * self._slow, 0.1 * self.shift, 0.0)

    # ---- line search ----

    def _search(self, here: Iterate, direction: PETSc.Vec, slope: float, trial: Iterate) -> float:
        """Backtracks from the longest step that the problem admits to the trial; its length, 0 where none is
        acceptable."""
        problem, options = self.problem, self.options
        length, noise = problem.longest_step(here.y, direction), options.noise * abs(here.energy)
        while length > options.shortest:
            trial.y.waxpy(length, direction, here.y)
            trial.energy = self._energy(trial.y)
            if not np.isfinite(trial.energy):
                length *= 0.25
                continue
            decrease, predicted = trial.energy - here.energy, length * slope
            if problem.conservative and decrease <= options.sufficient * predicted and -predicted > noise:
                problem.residual(trial.y, trial.residual)
                return length
            if not problem.conservative or decrease <= noise:
                problem.residual(trial.y, trial.residual)
                new_slope = trial.residual.dot(direction)
                if np.isfinite(new_slope) and self._flat_enough(new_slope, slope, trial.norm, here.norm):
                    return length
            length *= min(max(shorter(length, predicted, decrease), 0.1), 0.5)
        return 0.0

    def _lengthen(self, here: Iterate, direction: PETSc.Vec, slope: float, trial: Iterate) -> float:
        """Doubles a whole step, to the trial, while the potential falls on nearly as steeply. Off a saddle the safe
        matrix is far stiffer than the way down, which whole steps would take in hundreds of parts. Returns the
        length."""
        problem, options = self.problem, self.options
        further, step = Iterate(here.y.duplicate(), here.y.duplicate()), direction.copy()
        length, noise = 1.0, options.noise * abs(trial.energy)
        while trial.residual.dot(direction) < options.steep * slope:
            step.scale(2.0)
            if problem.longest_step(here.y, step) < 1.0:
                break
            further.y.waxpy(1.0, step, here.y)
            further.energy = self._energy(further.y)
            problem.residual(further.y, further.residual)
            change = further.energy - trial.energy
            falls = change <= options.sufficient * length * slope
            if not (falls or (change <= noise and further.residual.dot(direction) <= 0.0)):
                break
            length *= 2.0
            trial.take(further)
        return length

    def _flat_enough(self, new_slope: float, slope: float, new_norm: float, norm: float) -> bool:
        if self.problem.conservative:
            flatter = new_slope >= 0.9 * slope or new_norm < norm  # `_lengthen` goes on along a short step
            return new_slope <= (2 * self.options.sufficient - 1) * slope and flatter
        return abs(new_slope) <= 0.9 * abs(slope) or new_norm < norm
