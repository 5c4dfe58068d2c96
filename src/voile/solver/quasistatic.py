"""Quasi-static paths with contact and dry friction: load steps whose order matters, to stable ends.

A leap is a step in which the shell moves far more than supports and obstacles do and than the step before lets expect,
or to an equilibrium that slip makes unstable: either the step was too long and Newton's method fell on another branch,
or the shell snaps. Motion along a branch goes to zero with the load step, that of a snap does not: shorter steps tell
them apart, and find where it snaps.
"""

from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from voile.problem.anchor import difference
from voile.problem.contact import contact_of, contact_report
from voile.problem.discrete import Problem
from voile.problem.rest import field_vector
from voile.problem.scales import slow_rate
from voile.solver.frictional import FrictionalSolver
from voile.solver.newton import Newton
from voile.solver.path import LoadStep, Path, Progress, StaticsOptions, load_steps, tolerance
from voile.solver.stability import smallest_eigenpair
from voile.solver.ways import NEUTRAL, Outcome, Place, Way

EASY = 10  # Newton iterations up to which a load step grows
CUTS = 2  # quartered load steps before the ways that leave the branch are tried
LEAP = 5.0  # times the motion to be expected that a step may make
NOTABLE = 0.01  # sizes of the shell: a smaller motion is none
SHORTEST = 1.0 / 64.0  # of the load steps' length: a leap in less is a snap
RESTLESS = 4  # snaps from which their onset is not looked for
QUIET = 0.25  # of the load steps' length: a step without a snap from which it is again
NEARBY = 1e-3  # sizes: a gap at which an obstacle touches
ROUNDS = 6  # solves at one load until the tolerance, taken from the state, has settled


@dataclass
class Pace:
    """How long the next load step is, after how many cuts, and what the last ones let expect of it: rate, motion in
    sizes of the shell per load factor; stable, whether it starts from a stable equilibrium; snaps since the last longer
    step without one."""

    nominal: float
    most: int  # cuts
    factor: float = 0.0
    cuts: int = 0
    rate: float = np.inf
    stable: bool = True
    snaps: int = 0

    def __post_init__(self) -> None:
        self.step = self.longest = self.nominal

    @property
    def target(self) -> float:
        """Load factor at the end of the next step."""
        return 1.0 if self.factor + self.step > 1.0 - 1e-9 else self.factor + self.step

    @property
    def last_resort(self) -> bool:
        return self.cuts >= self.most

    @property
    def shortest(self) -> bool:
        short = self.target - self.factor <= SHORTEST * self.nominal
        return self.most == 0 or short or self.snaps >= RESTLESS

    def failed(self) -> None:
        """After a step without an equilibrium."""
        self.cuts += 1
        self.step = self.longest if self.last_resort else 0.25 * self.step

    def whole(self) -> None:
        """After a step that failed where nothing but the loads leads the shell: all that is left of them at once."""
        self.step = self.longest = self.nominal = 1.0

    def leapt(self) -> None:
        """After a step that has to be taken back."""
        self.step = self.longest = 0.25 * (self.target - self.factor)

    def done(self, iterations: int, moved: float, leaps: bool) -> None:
        self.rate = self.rate if leaps else moved / (self.target - self.factor)
        quiet = not leaps and self.target - self.factor >= QUIET * self.nominal
        self.snaps = 0 if quiet else self.snaps + leaps
        self.factor, self.cuts, self.longest = self.target, 0, self.nominal
        self.step = min(2.0 * self.step, self.nominal) if iterations <= EASY else self.step


def follow_contact(
    problem: Problem,
    snes: PETSc.SNES,
    newton: Newton,
    y: PETSc.Vec,
    options: StaticsOptions,
    path: Path,
    on_step: Progress | None,
) -> None:
    """Load steps of 1/load_steps, no longer: friction depends on the path. Where the semismooth method fails, the
    step is cut; where cuts do not help (buckling, slip that runs away), the other ways take the whole step; where that
    fails and nothing moves, the full load is tried at once. A leap is cut, too, until it is certain that the shell
    snaps."""
    solver = FrictionalSolver(problem, snes, newton, options.perturbation, options.fast)
    # A smaller load does not hold what nothing holds.
    pace = Pace(1.0 / load_steps(problem, options), CUTS if problem.supported else 0)
    moving = problem.moves or solver.contact.moves
    problem.load_factor = 0.0
    begin(problem, y)
    while pace.factor < 1.0:
        if path.attempts >= options.max_steps:
            problem.load_factor = pace.factor
            path.reason = f"max_steps = {options.max_steps} load steps ended at load factor {pace.factor:g}"
            return
        path.attempts += 1
        problem.load_factor, start = pace.target, solver.base.here(y)
        if solver.contact.moves and not problem.held:
            _carry(problem, y, pace)
        done, outcome = _solve(solver, y, options, path, ways=3 if pace.last_resort else 1)
        solver.base.unknowns(start).copy(path.state)
        if done is None:
            if pace.last_resort and pace.nominal < 1.0 and not (moving or outcome.gone):
                pace.whole()
                continue
            if pace.last_resort:
                path.reason = f"{outcome.reason}; at load factor {pace.target:g}"
                problem.load_factor = pace.factor
                return
            pace.failed()
            continue
        if problem.held and solver.passes(start.state.reference, pace.factor, problem.positions(y)):
            again = _past_obstacles(solver, y, start, options, path)
            done = again or replace(done, way=f"{done.way}, through an obstacle")
        moved = problem.largest_motion(difference(y, path.state))
        stable = not options.stability or done.negative == 0 or solver.stable(y)
        leaps = moved > LEAP * _expected(problem, pace) or (pace.stable and not stable)
        if leaps and not pace.shortest:
            solver.base.put(y, start)
            pace.leapt()
            continue
        if options.stability and (leaps or not stable or pace.target == 1.0):
            done, stable = _settle(solver, y, done, options, path)
        done.way = f"snap by {done.way}" if leaps and problem.supported else done.way
        pace.done(done.iterations, moved, leaps)
        pace.stable = stable
        y.copy(path.state)
        path.steps.append(done)
        if on_step:
            on_step(done, y)
        begin(problem, y)
    path.converged, path.reason = True, "residual below tolerance"


def begin(problem: Problem, y: PETSc.Vec) -> None:
    """Slip is measured from here on."""
    contact_of(problem).begin(problem.positions(y), problem.load_factor)


def _carry(problem: Problem, y: PETSc.Vec, pace: Pace) -> None:
    """Moves a shell that nothing holds with the obstacle that bears it, or else touches most of it, over the next
    load step, where there is friction: it starts where it sticks, however far that is."""
    contact, x = contact_of(problem), problem.positions(y)
    bears = np.array([normal[problem.own].sum() for normal in contact.state.normal[: len(contact.obstacles)]])
    near = [contact.gap(k, x, pace.factor) <= NEARBY * problem.size() for k in range(len(bears))]
    touches = np.array([np.count_nonzero(part[problem.own]) for part in near], dtype=float)
    bears, touches = problem.comm.allreduce(np.array([bears, touches]))
    most = int(np.argmax(bears if bears.any() else touches))
    if (bears[most] or touches[most]) and contact.obstacles[most].friction > 0.0:
        there = contact.obstacles[most].carry(x, pace.factor, pace.target)
        y.axpy(1.0, field_vector(problem, there - x))


def _expected(problem: Problem, pace: Pace) -> float:
    """Motion in sizes of the shell that the next load step should make: that of the step before, of supports, or of
    obstacles beside the shell."""
    start, end, contact = pace.factor, pace.target, contact_of(problem)
    state = contact.state
    x = state.reference[problem.own]
    paths = [(end - start) * problem.part.lift[: state.reference.size]]
    paths += [(o.carry(x, start, end) - x).ravel() for o in contact.obstacles]
    farthest = max(float(np.abs(path).max(initial=0.0)) for path in paths)
    driven = problem.comm.allreduce(farthest, op=MPI.MAX) / problem.size()
    return max(pace.rate * (end - start), driven, NOTABLE / LEAP)


def _solve(
    solver: FrictionalSolver,
    y: PETSc.Vec,
    options: StaticsOptions,
    path: Path,
    ways: int,
    first: Way | None = None,
) -> tuple[LoadStep | None, Outcome]:
    """The equilibrium at the problem's load factor, first found by `first`, by default as the solver does; no step
    where there is none."""
    problem, snes = solver.problem, solver.snes
    iterations, way = 0, ""
    for _ in range(ROUNDS):
        outcome = solver.solve(y, tolerance(problem, y, options), ways, first)
        first = None
        iterations += solver.iterations
        path.newton_iterations += solver.iterations
        path.seconds |= {"linear_solve": solver.seconds, "contact": solver.contact.seconds}
        if not outcome.converged:
            return None, outcome
        way = way or outcome.way  # the first one found it, later ones only sharpen it
        norm, asked = snes.getFunctionNorm(), snes.getTolerances()[1]
        if norm <= tolerance(problem, y, options):
            break
    done = LoadStep(
        problem.load_factor,
        iterations,
        norm,
        asked,
        problem.energies(y),
        solver.semismooth.negative,
        contact_report(problem, y),
        way,
    )
    return done, outcome


def _past_obstacles(
    solver: FrictionalSolver, y: PETSc.Vec, start: Place, options: StaticsOptions, path: Path
) -> LoadStep | None:
    """The load step again in pseudo-time, in steps that do not lead through obstacles, from where it began; None, and y
    as it is, where that has no end."""
    leapt = solver.base.here(y)
    solver.base.put(y, start)
    done, _ = _solve(solver, y, options, path, ways=1, first=partial(solver.pseudo_time.run, watchful=True))
    if done is None:
        solver.base.put(y, leapt)
    return done


def _settle(
    solver: FrictionalSolver, y: PETSc.Vec, done: LoadStep, options: StaticsOptions, path: Path
) -> tuple[LoadStep, bool]:
    """Tests a state on the contacts' tangent space; leaves a saddle, which slip may have hidden so far. The step, and
    whether it is stable, which the path says of its end."""
    problem, stable, value = solver.problem, solver.stable(y), None
    if not stable and solver.leave(y, done.tolerance):
        begin(problem, y)
        again, _ = _solve(solver, y, options, path, ways=1)
        done, stable = again or done, solver.stable(y)
    if problem.load_factor == 1.0:
        if options.eigenvalue or not stable:
            scale = 0.0 if stable else slow_rate(problem)
            value, _ = smallest_eigenpair(problem, solver.stability_matrix(y), scale)
            stable = value >= -NEUTRAL * slow_rate(problem)  # a spin about a single contact has none
        path.stable, path.smallest_eigenvalue = stable, value
    return done, stable
