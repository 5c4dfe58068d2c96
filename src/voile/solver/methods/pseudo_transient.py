"""Pseudo-time: implicit Euler steps without velocity (Inertia with the step's start as predicted position).

Steps are as long as they converge, and rough: one descent with frozen reactions, then one update of these, so that the
laws lag behind by a step. Contact is softer after a long step: what slides along a body then meets it with many
vertices at once, where line searches would else end at the first. Slip is measured from the step's start. Once inertia
is small beside the loads, the semismooth method finishes without it. A shell that nothing holds slides on and
on: then there is no equilibrium.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from voile.arrays import Reals
from voile.problem.augmented import AugmentedContact
from voile.problem.contact import DEEP, contact_of, passes_through
from voile.problem.imperfection import perturb
from voile.problem.inertia import Inertia
from voile.problem.problem import Problem
from voile.problem.scales import round_off, slow_rate, strained_rate
from voile.problem.state import State, difference
from voile.solver.balance import slides
from voile.solver.cascade import attempt
from voile.solver.methods.astray import Astray
from voile.solver.methods.descent import Descent
from voile.solver.methods.method import Outcome, Workspace
from voile.solver.methods.semismooth import Semismooth
from voile.solver.stability import KICKS, NEUTRAL, kick, reach

LEAST = 1e-2  # share of the loads by which steps are longer at most
GONE = 1.0  # sizes of the shell after which one that is not held along every axis has slid away


@dataclass
class Options:
    """Rates are inverse squares of step lengths (1/s^2) over the slow rate g/size, of the share of the loads that acts.

    steps at most. first_rate: a step of 0.36 sqrt(size/g), the longest that descents finish in some 40
    iterations on sheets over a ball; ten drapes take as many in all with 0.3, a tenth more with 0.42. Energies at the
    end fall a little with its length. fresh_rate: while no contact bears yet there is
    no friction either; such a step must move less than `fresh` sizes, which it does at this rate, twice what
    supports move and half of the least gap; vertices inside an obstacle also by how deep they are. last_rate: hopeless.
    fade: of the rate after a fair step, its square after an easy one, of at most so many iterations; raise_: after one
    that failed. softer: contact's stiffness after a step of more than `long` iterations, over that before it, down to
    `softest` of the shell's; a fair step makes it as much harder again. 17 everyday scenes take 8,030 iterations so,
    10,126 where only steps without an end soften it. With 10 for `long` they take 7,924, but sheets end in higher
    folds. iterations of a descent; rough: its tolerance over the loads or the norm that it starts with; drapes take
    half as many iterations as with 0.1. sharpest: over the loads, no step needs less, and differences of the potential
    drown in round-off there. near: inertia over the loads under which the semismooth method is tried, and again when it
    fell to a third. blurred: of the tolerance, beyond which the round-off of large unknowns makes them be counted anew.
    longest_pause: steps at most until a length that was refused is tried again.
    """

    steps: int = 300
    first_rate: float = 7.7
    fresh_rate: float = 180.0
    fresh: float = 0.01
    last_rate: float = 1e7
    fade: float = 1.0 / 3.0
    raise_: float = 4.0
    softer: float = 0.1
    softest: float = 0.01
    easy: int = 4
    fair: int = 10
    long: int = 30
    iterations: int = 100
    rough: float = 0.3
    sharpest: float = 1e-5
    near: float = 1e-3
    blurred: float = 0.1
    longest_pause: int = 4


class PseudoTransient:
    """perturbation (m): off symmetry at each step's start, and off saddles."""

    name = "pseudo-transient"
    watches = False

    def __init__(
        self,
        work: Workspace,
        descent: Descent,
        semismooth: Semismooth,
        perturbation: float,
        options: Options | None = None,
    ):
        self.work, self.descent, self.semismooth = work, descent, semismooth
        self.perturbation, self.options = perturbation, options or Options()

    def solve(self, problem: Problem, y: PETSc.Vec, tolerance: float) -> Outcome:
        """See Method."""
        return _March(self, problem, y, tolerance).run()

    def leave(self, problem: Problem, y: PETSc.Vec, tolerance: float) -> Outcome:
        """As `solve`, from a saddle."""
        return _March(self, problem, y, tolerance).run(problem.save(y))

    def admits(self, problem: Problem, before: State, y: PETSc.Vec) -> bool:
        """Whether the step from a state to y may be taken."""
        return True

    def astray(self, problem: Problem) -> Callable[[PETSc.Vec], bool] | None:
        """Tells of an iterate that leads no step that may be taken."""
        return None


class WatchedTransient(PseudoTransient):
    """No step may lead a vertex through an obstacle."""

    watches = True

    def admits(self, problem: Problem, before: State, y: PETSc.Vec) -> bool:
        was, now, here = problem.positions(problem.unknowns_of(before)), problem.time, problem.positions(y)
        return not passes_through(problem, was, now, here)

    def astray(self, problem: Problem) -> Callable[[PETSc.Vec], bool] | None:
        return Astray(problem, DEEP)


class _March:
    """The steps of one run, which y follows. rate (1/s^2): of the next step's inertia; wait, pause: steps until a
    longer one is tried, now and after the next refusal; peak (N): the most inertia since the last kick; softness:
    contact's stiffness over the shell's."""

    def __init__(self, method: PseudoTransient, problem: Problem, y: PETSc.Vec, tolerance: float):
        self.method, self.options = method, method.options
        self.problem, self.y, self.tolerance = problem, y, tolerance
        self.contact, self.start, self.driven = contact_of(problem), problem.save(y), _driven(problem)
        self.loads = max(problem.load_norm(y), tolerance / 1e-8)
        self.slow = slow_rate(problem) * _share(problem, y)
        if not problem.load_norm(y):
            self.slow = max(self.slow, strained_rate(problem, y))
        self.rate = (self.options.fresh_rate if self._fresh() else self.options.first_rate) * self.slow
        self.wait, self.pause, self.kicks, self.peak = 0, 1, 0, np.inf
        self.softness = 1.0
        self.slips = not self.contact.moves  # what sticks has gone along with moving obstacles

    def run(self, saddle: State | None = None) -> Outcome:
        """To rest, from y or off a saddle."""
        problem, y, method = self.problem, self.y, self.method
        for _ in range(self.options.steps):
            if saddle:
                if self.kicks == KICKS:
                    return self._failed("no way off a saddle")
                if self._kick(saddle) <= NEUTRAL * self.slow:
                    return Outcome(True, method.name, watched=method.watches)
                saddle = None
            before, room = problem.save(y), self._room()
            inertia = Inertia(problem.vertex_mass(), problem.own, self.rate, problem.positions(y))
            done = self._step(inertia, room)
            if done is None or not method.admits(problem, before, y):
                problem.restore(y, before)
                if not self._shorten():
                    missed = method.descent.nonlinear.missed(method.name, y)
                    return self._failed(f"no step of pseudo-time converges; {missed.reason}")
                continue
            self.slips = True
            if self._motion(self.start) > GONE and not problem.supported:
                last = difference(y, problem.unknowns_of(before))
                return replace(self._failed(_slides(problem, last)), gone=True)
            if not (done and self._settles(problem.term_norm(inertia, y), before, room)):
                continue
            found = self._arrive()
            if found.converged:
                return found
            if found.saddle and not self._beside(found.saddle):
                saddle = found.saddle
        return self._failed(f"{self.options.steps} steps of pseudo-time did not settle")

    def _failed(self, reason: str) -> Outcome:
        return Outcome(False, self.method.name, reason)

    def _fresh(self) -> bool:
        """Whether no contact bears yet."""
        return self.problem.everywhere(not any(normal.any() for normal in self.contact.history.normal))

    def _motion(self, since: State) -> float:
        """Of y since a state, in sizes of the shell."""
        return self.problem.largest_motion(difference(self.y, self.problem.unknowns_of(since)))

    def _kick(self, saddle: State) -> float:
        """Puts y off a saddle; the rate (1/s^2) at which that grows."""
        method = self.method
        growth = kick(method.work, self.problem, self.y, saddle, method.perturbation, self.kicks)
        self.kicks, self.rate, self.peak = self.kicks + 1, 2.0 * growth, 0.0
        return growth

    def _beside(self, saddle: State) -> bool:
        """Whether y is already further from a saddle than the next kick would put it."""
        return self._motion(saddle) * self.problem.size() > reach(self.method.perturbation, self.kicks)

    # ---- lengths of steps ----

    def _room(self) -> float:
        """Sizes by which a step without friction may move from y; one in which layers meet, by `_slip` alone."""
        contact, problem = self.contact, self.problem
        least = float(_gap(problem, self.y)[problem.own].min(initial=np.inf)) if contact.obstacles else 0.0
        least = max(problem.comm.allreduce(least, op=MPI.MIN), 0.0)
        return float(self._slip() + 0.5 * least / problem.size())

    def _slip(self) -> float:
        """Sizes by which what meets in a step may slide without friction."""
        return self.options.fresh + 2.0 * self.driven

    def _shorten(self) -> bool:
        """After a step that failed; whether there is hope. One that went astray would go there again from counts of
        the unknowns as sharp as may be."""
        reason = self.method.descent.nonlinear.snes.reason
        blurred = 0 > reason != PETSc.SNES.ConvergedReason.DIVERGED_LOCAL_MIN and self._sharpened()
        self.rate *= 1.0 if blurred else self.options.raise_
        self.wait, self.pause = self.pause, min(2 * self.pause, self.options.longest_pause)
        return self.rate <= self.options.last_rate * self.slow

    def _settles(self, inertia: float, before: State, room: float) -> bool:
        """Whether a step that converged leaves so little inertia (N) that there may be an equilibrium near; chooses the
        next step's rate."""
        self.peak = max(self.peak, inertia) if np.isfinite(self.peak) else inertia
        held, self.wait = (self.rate if self.wait else 0.0), max(self.wait - 1, 0)
        if not self._fresh():
            self.rate = max(self._next(), held)
        elif not held and self._motion(before) < 0.3 * room:
            self.rate *= self.options.fade  # it falls on, or hangs freely
        if inertia > min(self.options.near * self.loads, 0.3 * self.peak):
            return False
        self.peak = inertia
        return True

    def _next(self) -> float:
        """The rate after a step that converged: longer steps where it was easy, else towards the first length."""
        options, rate, iterations = self.options, self.rate, self.method.descent.nonlinear.iterations
        first = options.first_rate * self.slow
        if iterations <= options.easy:
            return options.fade**2 * rate
        if iterations <= options.fair:
            return options.fade * rate
        return max(first, options.fade**2 * rate) if rate > first else min(first, rate / options.fade)

    def _soften(self, iterations: int) -> None:
        """Contact's stiffness after a descent of so many. Layers of the shell would collapse: theirs stays."""
        options = self.options
        if self.contact.itself:
            return
        if iterations > options.long:
            self.softness = max(options.softer * self.softness, options.softest)
        elif iterations <= options.fair:
            self.softness = min(self.softness / options.softer, 1.0)

    # ---- a step ----

    def _step(self, inertia: Inertia, room: float) -> bool | None:
        """One descent and one update of the reactions: True; False where it goes on from where it is (what snaps takes
        many iterations); None where it failed. room: see `_room`."""
        options, contact, problem, y = self.options, self.contact, self.problem, self.y
        if self.slips:
            contact.begin(problem.positions(y), problem.time)
        potential = AugmentedContact(contact, self.softness)
        potential.freeze(problem.point(y))
        step = problem.with_terms(potential, inertia)
        begun, fresh, f = y.copy(), self._fresh(), y.duplicate()
        depth = np.maximum(-_gap(problem, y), 0.0)
        step.residual(y, f)
        if not contact.itself:  # layers take long to settle again
            perturb(problem, y, self.method.perturbation)
        rough = max(self.tolerance, options.rough * min(f.norm(), self.loads), options.sharpest * self.loads)
        astray = self.method.astray(step)

        def too_far(at: PETSc.Vec) -> bool:
            if not fresh:
                return False
            moved = np.abs(problem.motion(difference(at, begun))).max(axis=1)
            return problem.in_sizes(np.maximum(moved - depth, 0.0)) > room

        def vain(at: PETSc.Vec) -> bool:
            return too_far(at) or bool(astray and astray(at))

        descent = self.method.descent
        done = descent.run(step, y, rough, options.iterations, vain)
        self._soften(descent.nonlinear.iterations)
        if too_far(y):
            return None
        if done:
            potential.update(problem.point(y))
            meets = bool(contact.itself) and not problem.everywhere(not contact.history.normal[-1].any())
            far = problem.largest_motion(difference(y, begun)) > self._slip()
            return None if fresh and meets and far else True
        unfinished = descent.nonlinear.snes.reason == PETSc.SNES.ConvergedReason.DIVERGED_MAX_IT
        return False if unfinished else None

    # ---- its end ----

    def _arrive(self) -> Outcome:
        """What the semismooth method finds from here, with the slip since the start of the load step where it can."""
        contact, problem, y, method = self.contact, self.problem, self.y, self.method
        before = problem.save(y)
        contact.begin(problem.positions(y), problem.time)
        found = attempt(method.semismooth, problem, y, self.tolerance)
        if not (found.converged or found.saddle) and self._sharpened():
            found = attempt(method.semismooth, problem, y, self.tolerance)
        if found.converged and not method.admits(problem, before, y):
            problem.restore(y, before)
            return self._failed("the way on leads through an obstacle")
        if found.converged and (problem.held or contact.moves):
            found = self._recall() or found
        return replace(found, method=method.name, watched=method.watches)

    def _sharpened(self) -> bool:
        """Whether the round-off of large unknowns blurred the residual: they are counted from y on then."""
        if round_off(self.problem, self.y)[0] <= self.options.blurred * self.tolerance:
            return False
        self.problem.move_origin(self.y)
        return True

    def _recall(self) -> Outcome | None:
        """An equilibrium whose slip is that of the whole load step, where there is one near: that of pseudo-time is
        measured from its own last step."""
        began, found, history = self.start.history, self.problem.save(self.y), self.contact.history
        assert began is not None
        history.reference, history.time, history.layers = began.reference, began.time, began.layers
        again = attempt(self.method.semismooth, self.problem, self.y, self.tolerance)
        if again.converged and self.method.admits(self.problem, found, self.y):
            return again
        self.problem.restore(self.y, found)
        return None


def _share(problem: Problem, y: PETSc.Vec) -> float:
    """Of the full loads, those at the problem's load factor: what they move in a step is the same. A tablecloth that
    slid off a drum under a tenth of its weight took 5,100 iterations in steps for all of it, 3,300 so."""
    full = problem.at(1.0).load_norm(y)
    return max(problem.load_norm(y) / full, LEAST) if full else 1.0


def _gap(problem: Problem, y: PETSc.Vec) -> Reals:
    """(local vertices,) distance (m) to the nearest obstacle, negative inside."""
    contact, x = contact_of(problem), problem.positions(y)
    gaps = [contact.gap(k, x, problem.time) for k in range(len(contact.obstacles))]
    found: Reals = np.min([np.full(len(x), np.inf), *gaps], axis=0)
    return found


def _driven(problem: Problem) -> float:
    """How far supports have moved since the step's start, in sizes of the shell."""
    moved = problem.part.supports.between(contact_of(problem).history.time, problem.time)
    return problem.in_sizes(moved[: problem.layout.vertices])


def _slides(problem: Problem, step: PETSc.Vec) -> str:
    """Which way the shell leaves with a step."""
    own = problem.motion(step)[problem.own]
    return slides(problem, "no equilibrium within its own size", problem.comm.allreduce(own.sum(axis=0)))
