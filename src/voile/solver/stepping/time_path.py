"""Paths in time: predict, solve the step, update; a step that fails is cut.

Each step is the problem at its end with an Inertia term. `Problem.contact` remembers where it began, so that friction's
slip is that of the step, relative to the obstacle.
"""

import math
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from voile.arrays import Flags, Reals, triangle_areas
from voile.problem.contact import contact_of, contact_report, pushed_vertices
from voile.problem.problem import Problem
from voile.problem.rest import field_vector
from voile.problem.scales import force_floor, mean_mass, slow_rate
from voile.problem.support_forces import driven
from voile.solver.linear import Counts
from voile.solver.methods.method import Outcome
from voile.solver.methods.semismooth import law_norms
from voile.solver.path_in_time import OnStep, TimeOptions, TimePath, TimeStep
from voile.solver.stepping.blame import crushed
from voile.solver.stepping.books import Books, Ended
from voile.solver.stepping.creation import Creation
from voile.solver.stepping.folds import Folds
from voile.solver.stepping.forces import StepForces
from voile.solver.stepping.schemes import ImplicitEuler, Kinematics, MoreauJean, Prediction, Scheme


@dataclass
class Options:
    """cut: of a step that failed. smallest: of the asked step, that is not cut any more. tiny: of the asked step; after
    most_tiny such steps in a row, three times as many as lead back from the smallest, the run ends (a large moment on a
    coarse strip went on in steps of 5e-7 of the asked). longer: of a step, over the last one that was cut. close: of a
    step, that the end may be beyond it. rest: of the way that the loads lead in a step from rest; an approach within it
    is no impact. digits: last places of the shell's size that positions may err by. finest: of the asked step, that no
    local error (an impact's) makes shorter. closes: of the most energy that there was, what the books may miss at the
    end; steps that take more than their share of it are solved more sharply."""

    cut: float = 0.25
    smallest: float = 1e-8
    tiny: float = 1e-3
    most_tiny: int = 50
    longer: float = 2.0
    close: float = 1e-6
    rest: float = 2.0
    digits: float = 4.0
    finest: float = 1.0 / 256.0
    closes: float = 5e-9


class StepSolver(Protocol):
    """Solves steps: a method whose problem has an Inertia term and, with contact, the step's start in the contact's
    history. y starts at a guess and ends at the step's end."""

    @property
    def counts(self) -> Counts:
        """Of its linear algebra."""
        ...

    def solve(self, problem: Problem, y: PETSc.Vec, tolerance: float) -> Outcome:
        """tolerance: of the residual's norm (N)."""
        ...

    def sharpen(self, problem: Problem, y: PETSc.Vec, tolerance: float) -> None:
        """Improves a solution y at the cost of an iteration."""
        ...


def start_path(problem: Problem, velocity: Reals) -> TimePath:
    """That of a shell at its start shape with velocities (local vertices, 3) m/s."""
    y = problem.create_vector()
    if problem.contact:  # what touches from the start on has not slipped
        problem.contact.begin(problem.positions(y), problem.time)
        problem.contact.sink(problem.positions(y), problem.time)
    return TimePath(y, start_kinematics(problem, y, velocity), Books(problem))


def let_out(problem: Problem) -> float:
    """Time (s) in which obstacles that the shell starts in let it out: so slowly that they stop no faster than the
    loads stop the shell, which is not thrown. Its kinetic energy stays below 3/16 of that of a fall of that depth."""
    deepest = max((float(depth.max(initial=0.0)) for depth in contact_of(problem).history.sunk), default=0.0)
    deepest = problem.comm.allreduce(deepest, op=MPI.MAX)
    return float(np.sqrt(6.0 * deepest / (slow_rate(problem) * problem.size())))


def start_kinematics(problem: Problem, y: PETSc.Vec, velocity: Reals) -> Kinematics:
    """At the unknowns y with velocities (local vertices, 3) m/s of what may move; the first acceleration is not
    known."""
    x, none = problem.positions(y), np.zeros_like(velocity)
    moving = problem.motion(field_vector(problem, velocity))
    return Kinematics(x, moving, none, none)


class Stepper:
    """Follows a problem in time with a step solver; `path` is told of everything."""

    def __init__(self, problem: Problem, options: TimeOptions, solver: StepSolver, path: TimePath):
        self.problem, self.asked, self.solver, self.path = problem.at(path.time), options, solver, path
        self.options, self.y, self.kinematics = Options(), path.state.copy(), path.kinematics
        self.damping, path.length = options.damping, path.length or options.time_step
        solver.counts.add(path.counts)
        path.counts = solver.counts
        self.mass, self.folds = mean_mass(problem), Folds()
        if not (problem.contact and problem.contact.itself):
            self.problem = self.problem.with_passing_hinges()
        self.fall = slow_rate(problem) * problem.size()  # m/s^2
        self.closes = let_out(problem) if problem.contact else 0.0  # s
        self.finest = self.options.finest * options.time_step  # s
        self.creation = Creation(problem)
        if not len(path.pushed):
            path.pushed = np.zeros(len(self.kinematics.positions), dtype=bool)
        laws: list[Any] = [*problem.shell.load_laws.values()] if problem.shell else []
        laws += problem.contact.obstacles if problem.contact else []
        own = max([problem.part.supports.ends, *(law.ends for law in laws)])
        self.changes = problem.comm.allreduce(own, op=MPI.MAX)  # s until which what is prescribed does

    def follow(self, on_step: OnStep | None = None) -> None:
        """To the duration; calls on_step after each step."""
        asked, path = self.asked, self.path
        if asked.scheme.memory and path.time == 0.0:
            self._begin()
        if path.count and self._rests(self._speed()):  # a run that was killed after its last step
            return
        tiny, failed = 0, ""  # steps so short, and why the last ones that were cut failed
        while path.time < asked.duration:
            h, end = self.path.length, path.time + self.path.length
            if asked.duration - path.time < (1.0 + self.options.close) * h:
                h, end = asked.duration - path.time, asked.duration
            path.attempts += 1
            done, outcome, wish = self._step(asked.scheme, h, end)
            if done is None:
                failed = outcome.reason
                path.length = min(self.options.cut * h, wish or h)
                if path.length < self.options.smallest * asked.time_step or self.creation.nonsense:
                    nonsense = self.creation.nonsense
                    wrong = f"; {asked.advice} help" if nonsense else crushed(self.problem, self.y)
                    path.reason = f"{outcome.reason}; at time {path.time:g} s{wrong}"
                    return
                continue
            grown = wish or max(path.length, self.options.longer * h)
            path.length = min(asked.time_step, grown)
            path.last, path.time = done, done.time
            path.methods.append(done.method)
            tiny = tiny + 1 if h < self.options.tiny * asked.time_step and failed else 0
            self.y.copy(path.state)
            path.kinematics = self.kinematics
            if on_step:
                on_step(done, path)
            if self._rests(done.speed):
                return
            if tiny > self.options.most_tiny:
                short = f"{tiny} steps in a row were shorter than {self.options.tiny:g} of dynamics.time_step"
                path.reason = f"{failed}; at time {path.time:g} s: {short}"
                return
        path.converged, path.reason = True, "end of the simulated time"

    def _rests(self, speed: float) -> bool:
        """Whether nothing is faster than asked for (now the fastest vertex has that speed, m/s), or would be in the
        time in which loads move the shell by its size, or as the scene goes on. The path says so."""
        limit, problem, path = self.asked.stop_at_rest, self.problem, self.path
        if not speed < limit or path.time < self.changes:
            return False
        acceleration = problem.in_sizes(self.kinematics.acceleration[problem.own]) * problem.size()
        if not acceleration < limit * float(np.sqrt(self._pushed() / problem.size())):
            return False
        path.converged, path.reason = True, f"at rest at time {path.time:g} s"
        return True

    def _pushed(self) -> float:
        """Acceleration by loads and air (m/s^2)."""
        problem, air, part = self.problem, self.asked.air, self.problem.part
        mass = problem.vertex_mass()[problem.own]
        area = triangle_areas(self.kinematics.positions, part.corners) @ part.weight
        whole = problem.comm.allreduce(np.array([area, mass.sum()]))
        blown = air.drag * float(air.velocity @ air.velocity) * whole[0] / whole[1] if air else 0.0
        loads = problem.load_norm(self.y) / problem.norm(np.repeat(mass, 3))
        return float(max(slow_rate(problem) * problem.size(), loads, blown))

    def _speed(self) -> float:
        """Of the fastest vertex (m/s)."""
        return self.problem.in_sizes(np.linalg.norm(self.kinematics.velocity, axis=1)) * self.problem.size()

    def _begin(self) -> None:
        """The acceleration at the start, of a trial step that no local error refuses, from which director angles are
        kept. Its error is of that step's order, and second order needs no better."""
        start, k = self.problem.save(self.y), self.kinematics
        done = self._step(ImplicitEuler(), self.finest, self.finest)[0]
        if done is not None:
            k = replace(k, acceleration=self.kinematics.acceleration, filtered=self.kinematics.acceleration)
        self.problem = self.problem.at(0.0)
        self.problem.restore(self.y, start)
        self.kinematics = k

    def _step(self, scheme: Scheme, h: float, end: float) -> tuple[TimeStep | None, Outcome, float]:
        """One step over h (s) to the time `end`, its outcome, and the length (s) that its local error allows, 0 where
        that is not known; nothing has changed where it fails."""
        y, k = self.y, self.kinematics
        start, before = self.problem.save(y), self.solver.counts.iterations
        problem = self.problem.at(end)
        self.folds.follow(self.problem, self.problem.point(y))
        forces = StepForces(problem, scheme, h, self.problem.point(y), k, self.damping, self.asked.air)
        prediction = scheme.predict(k, h)
        struck = self._begin_contact(forces, prediction)
        if not self._guess(problem, prediction):
            problem.restore(y, start)
            return None, Outcome(False, "", "supports carry a layer of the shell through another"), 0.0
        prediction, step, wanted, outcome = self._solve(forces, prediction, struck)
        self.path.seconds |= {"linear_solve": self.solver.counts.seconds}
        if problem.contact:
            self.path.seconds |= {"contact": problem.contact.seconds}
        if not outcome.converged:
            problem.restore(y, start)
            return None, outcome, 0.0
        ended, entries = self._ended(forces, prediction, wanted)
        if self._misses(entries, end):
            self.solver.sharpen(step, y, wanted)
            ended, entries = self._ended(forces, prediction, wanted)
        x = ended.after.positions
        refusal, wish = self._refusal(problem, prediction, start.time, h, x)
        refusal = refusal or self.creation.refusal(self.path.books, entries, h <= self.finest)
        if refusal:
            problem.restore(y, start)
            return None, Outcome(False, outcome.method, refusal), wish
        self.path.pushed = pushed_vertices(problem, x)
        self.path.supporting = ended.supporting() if problem.held else None
        self.problem, self.kinematics = problem, ended.after
        if scheme is self.asked.scheme:
            self.path.books.enter(entries)
            self.folds.lost = 0.0
        done = TimeStep(
            problem.time,
            h,
            self.solver.counts.iterations - before,
            *_residuals(step, y, wanted),
            wanted,
            problem.energies(y),
            contact_report(problem, y) if problem.contact else None,
            outcome.method,
            self._speed(),
        )
        return done, outcome, wish

    def _ended(
        self, forces: StepForces, prediction: Prediction, wanted: float
    ) -> tuple[Ended, dict[str, float]]:
        """A step that ends at y, solved to the tolerance `wanted` (N), and its entries in the books."""
        x = forces.problem.positions(self.y)
        after = forces.scheme.update(self.kinematics, forces.h, prediction, x)
        ended = Ended(forces, self.y, after, prediction, wanted, self.folds.lost)
        return ended, self.path.books.entries(ended)

    def _misses(self, entries: dict[str, float], end: float) -> bool:
        """Whether with a step up to the time `end` (s) the books miss more than their share."""
        books = self.path.books
        share = min(end / self.asked.duration, 1.0)
        return abs(books.error + entries["error"]) > self.options.closes * share * books.let(entries)

    def _refusal(
        self, problem: Problem, p: Prediction, began: float, h: float, x: Reals
    ) -> tuple[str, float]:
        """Why the step over h (s) to positions x (n, 3) may not be taken, empty where it may; and the length (s) that
        its local error allows, 0 where that is not asked."""
        k, asked = self.kinematics, self.asked
        if problem.contact:
            crosses = problem.contact.crosses(k.positions, began, x, problem.time)[problem.own]
            if not problem.everywhere(not crosses.any()):
                blurred = [f"; {o.name}: {o.blurred}" for o in problem.contact.obstacles if o.blurred]
                return f"a step leads through an obstacle{''.join(blurred)}", 0.0
        if not asked.accuracy:
            return "", 0.0
        jump = 0.5 * h * (p.velocity(x) - k.velocity)
        if asked.scheme.order == 2:
            smooth = h**2 / 12.0 * (p.acceleration(x) - k.acceleration)
            jump = np.where(np.broadcast_to(p.rate, x.shape) == 1.0 / h, jump, smooth)
        error = max(problem.in_sizes(jump[problem.own]) / asked.accuracy, float(np.finfo(float).tiny))
        options = self.options
        share = min(max(0.9 * error ** (-1.0 / (1 + asked.scheme.order)), options.cut), options.longer)
        fair = error <= 1.0 or h <= self.finest
        return "" if fair else "the local error of a step is too large", h * share

    def _solve(
        self, forces: StepForces, prediction: Prediction, struck: float | Reals
    ) -> tuple[Prediction, Problem, float, Outcome]:
        """The step's equations from the guess y, with implicit Euler wherever contact turns out to be active;
        their prediction, problem, tolerance (N) and outcome. struck: see `_begin_contact`."""
        problem, wanted = forces.problem, 0.0
        euler = ImplicitEuler().predict(self.kinematics, forces.h)
        euler = replace(euler, predicted=euler.predicted + struck, still=euler.still + struck)
        by_euler = self._by_euler(problem, driven(problem))
        while True:
            prediction = prediction.where(by_euler, euler)
            step = forces.balance(prediction)
            wanted = wanted or self._wanted(step, prediction)
            if not math.isfinite(wanted):
                return prediction, step, wanted, Outcome(False, "", "the loads are not finite")
            outcome = self.solver.solve(step, self.y, wanted)
            now = self._by_euler(problem, by_euler)
            if not outcome.converged or problem.everywhere(np.array_equal(now, by_euler)):
                return prediction, step, wanted, outcome
            by_euler = now

    def _begin_contact(self, forces: StepForces, prediction: Prediction) -> float | Reals:
        """Slip counts from here, impacts rebound: (n, 3) m, see `Contact.rebound`."""
        problem, k, h, begin = forces.problem, self.kinematics, forces.h, forces.start.time
        if not problem.contact:
            return 0.0
        fall, inertia = h**2 * self.fall, float(np.max(prediction.coefficient)) * self.mass
        problem.contact.begin(k.positions, begin, inertia, fall, self.closes)
        problem.contact.let_in(problem.time)
        if not isinstance(forces.scheme, MoreauJean):
            return 0.0
        rest, flight = self.options.rest * fall, (h * k.velocity, h**2 * k.acceleration)
        return problem.contact.rebound(k.positions, begin, problem.time, *flight, rest)

    def _by_euler(self, problem: Problem, known: Flags) -> Flags:
        """(local vertices, 3) components that are known to be implicit Euler's in this step, and those of vertices that
        bear on something now or did in the last step, with all that is sewn to them."""
        if not problem.contact or isinstance(self.asked.scheme, ImplicitEuler):
            return known
        bears = pushed_vertices(problem, problem.positions(self.y)) | self.path.pushed
        unknowns = problem.create_vector()
        dofs = np.concatenate([np.repeat(bears, 3).astype(float), np.zeros(len(problem.part.edge))])
        unknowns.array[:] = problem.layout.diagonal(dofs) > 0.0
        return np.asarray(known | (bears | problem.motion(unknowns).any(axis=1))[:, None], dtype=bool)

    def _guess(self, problem: Problem, prediction: Prediction) -> bool:
        """Goes as the last acceleration leads, as far as terms admit; where something pushed, as the velocity does,
        for an impact is over; what stuck to an obstacle goes with it. Layers that bear on each other do not go: where
        the step starts their gaps are none. Where supports move, layers must not pass through each other as all goes
        there at once, or as supports do alone and then the rest: whether they do not."""
        k, contact = self.kinematics, problem.contact
        goal = prediction.predicted + ~self.path.pushed[:, None] * k.acceleration / prediction.coefficient
        if contact:
            stuck, carried = contact.carried(k.positions, problem.time)
            goal[stuck] = carried[stuck]
        way = field_vector(problem, goal - k.positions)
        if contact and contact.itself and problem.moves:
            y = self.y.copy()
            y.axpy(problem.with_contact(None).longest_step(y, way), way)
            if contact.free_share(k.positions, problem.positions(y)) == 1.0:
                y.copy(self.y)
                return True
            if contact.free_share(k.positions, problem.positions(self.y)) < 1.0:
                return False
        if not (contact and contact.layered):
            self.y.axpy(problem.longest_step(self.y, way), way)
        return True

    def _wanted(self, problem: Problem, prediction: Prediction) -> float:
        """Tolerance of a step's residual (N): a share of the loads' norm, without loads of the largest forces so far
        that the guesses have met; no less than the round-off of the inertia and, without loads, of the forces."""
        loads, floor = self.problem.at(problem.time).load_norm(self.y), 0.0
        if not loads:
            f = problem.create_vector()
            problem.residual(self.y, f)
            loads, floor = max(self.path.largest, f.norm()), force_floor(problem)
            self.path.largest = loads
        heaviest = problem.norm(
            (prediction.coefficient * problem.vertex_mass()[:, None])[problem.own].ravel()
        )
        digits = self.options.digits * float(np.finfo(float).eps) * problem.size()
        return max(self.asked.tolerance * loads, digits * heaviest, floor)


def _residuals(problem: Problem, y: PETSc.Vec, tolerance: float) -> tuple[float, float]:
    """Norms (N) of a step's forces out of balance and of what contact's laws miss."""
    f = problem.create_vector()
    if problem.contact:
        return law_norms(problem, y, f, tolerance)
    problem.residual(y, f)
    return float(f.norm()), 0.0
