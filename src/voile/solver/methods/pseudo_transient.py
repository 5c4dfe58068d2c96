"""Pseudo-time: implicit Euler steps without velocity (Inertia with the step's start as predicted position).

Steps are as long as they converge, and rough: one descent with frozen reactions, then one update of these, so that the
laws lag behind by a step. Slip is measured from the step's start. Once inertia is small beside the loads, the
semismooth method finishes without it. A shell that nothing holds slides on and on: then there is no equilibrium.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from voile.problem.augmented import AugmentedContact
from voile.problem.contact import contact_of, leads_through
from voile.problem.imperfection import perturb
from voile.problem.inertia import Inertia
from voile.problem.problem import Problem
from voile.problem.scales import round_off, slow_rate
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
    supports move and half of the least gap. last_rate: hopeless.
    fade: of the rate after a fair step, its square after an easy one, of at most so many iterations; raise_: after one
    that failed. iterations of a descent; rough: its tolerance over the loads or the norm that it starts with; drapes
    take half as many iterations as with 0.1. sharpest: over the loads, no step needs less, and differences of the
    potential drown in round-off there. near: inertia over the loads under which the semismooth method is tried,
    and again when it fell to a third. blurred: of the tolerance, beyond which the round-off of large unknowns makes
    them be counted anew. astray: sizes of the shell; a watched step may not lead deeper into an obstacle: rough steps
    lie a little inside. longest_pause: steps at most until a length that was refused is tried again.
    """

    steps: int = 300
    first_rate: float = 7.7
    fresh_rate: float = 180.0
    fresh: float = 0.01
    last_rate: float = 1e7
    fade: float = 1.0 / 3.0
    raise_: float = 4.0
    easy: int = 4
    fair: int = 10
    iterations: int = 100
    rough: float = 0.3
    sharpest: float = 1e-5
    near: float = 1e-3
    blurred: float = 0.1
    astray: float = 0.01
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
        return self._follow(problem, y, tolerance, None)

    def leave(self, problem: Problem, y: PETSc.Vec, tolerance: float) -> Outcome:
        """As `solve`, from a saddle."""
        return self._follow(problem, y, tolerance, problem.save(y))

    def _follow(self, problem: Problem, y: PETSc.Vec, tolerance: float, saddle: State | None) -> Outcome:
        options, contact = self.options, contact_of(problem)
        slow = slow_rate(problem) * _share(problem, y)
        loads, start = max(problem.load_norm(y), tolerance / 1e-8), problem.save(y)
        rate, kicks, peak, driven = options.first_rate * slow, 0, np.inf, _driven(problem)
        if self._fresh(problem):
            rate = options.fresh_rate * slow
        slips = not contact.moves  # what sticks has gone along with moving obstacles
        wait, pause = 0, 1  # steps until a longer one is tried, after the next refusal
        for _ in range(options.steps):
            if saddle:
                if kicks == KICKS:
                    return self._failed("no way off a saddle")
                growth = kick(self.work, problem, y, saddle, self.perturbation, kicks)
                if growth <= NEUTRAL * slow:
                    return Outcome(True, self.name, watched=self.watches)
                kicks, rate, peak, saddle = kicks + 1, 2.0 * growth, 0.0, None
            before = problem.save(y)
            if slips:
                contact.begin(problem.positions(y), problem.time)
            inertial = Inertia(problem.vertex_mass(), problem.own, rate, problem.positions(y))
            step = problem.with_terms(AugmentedContact(contact), inertial)
            room = self._room(step, y, driven)
            done = self._step(step, y, tolerance, loads, room)
            if done is None or not self._admissible(problem, before, y):
                problem.restore(y, before)
                rate *= 1.0 if self._sharpened(problem, y, tolerance) else options.raise_
                wait, pause = pause, min(2 * pause, options.longest_pause)
                if rate > options.last_rate * slow:
                    missed = self.descent.nonlinear.missed(self.name, y)
                    return self._failed(f"no step of pseudo-time converges; {missed.reason}")
                continue
            slips = True
            moved = difference(y, problem.unknowns_of(start))
            if problem.largest_motion(moved) > GONE and not problem.supported:
                last = difference(y, problem.unknowns_of(before))
                return replace(self._failed(_slides(problem, last)), gone=True)
            if not done:
                continue
            inertia = step.term_norm(inertial, y)
            peak = max(peak, inertia) if np.isfinite(peak) else inertia
            held, wait = (rate if wait else 0.0), max(wait - 1, 0)
            if not self._fresh(problem):
                rate = max(self._next(rate, slow), held)
            elif not held and problem.largest_motion(difference(y, problem.unknowns_of(before))) < 0.3 * room:
                rate *= options.fade  # it falls on, or hangs freely
            if inertia > min(options.near * loads, 0.3 * peak):
                continue
            peak = inertia
            found = self._arrives(problem, y, tolerance, start)
            if found.converged:
                return found
            if found.saddle and not self._beside(problem, y, found.saddle, kicks):
                saddle = found.saddle
        return self._failed(f"{options.steps} steps of pseudo-time did not settle")

    def _failed(self, reason: str) -> Outcome:
        return Outcome(False, self.name, reason)

    def _fresh(self, problem: Problem) -> bool:
        """Whether no contact bears yet."""
        return problem.everywhere(not any(normal.any() for normal in contact_of(problem).history.normal))

    def _next(self, rate: float, slow: float) -> float:
        """The rate after a step that converged: longer steps where it was easy, else towards the first length."""
        options, iterations = self.options, self.descent.nonlinear.iterations
        first = options.first_rate * slow
        if iterations <= options.easy:
            return options.fade**2 * rate
        if iterations <= options.fair:
            return options.fade * rate
        return max(first, options.fade**2 * rate) if rate > first else min(first, rate / options.fade)

    def _admissible(self, problem: Problem, before: State, y: PETSc.Vec) -> bool:
        """Whether the step from a state to y may be taken."""
        return True

    def _astray(self, problem: Problem) -> Callable[[PETSc.Vec], bool] | None:
        """Tells of an iterate that leads no step that may be taken."""
        return None

    def _room(self, problem: Problem, y: PETSc.Vec, driven: float) -> float:
        """Sizes by which a step without friction may move from y; driven: by which supports have moved."""
        contact, x = contact_of(problem), problem.positions(y)
        gaps = [contact.gap(k, x, problem.time)[problem.own] for k in range(len(contact.obstacles))]
        least = min((float(gap.min(initial=np.inf)) for gap in gaps), default=0.0)
        least = max(problem.comm.allreduce(least, op=MPI.MIN), 0.0) if not contact.itself else 0.0
        return self.options.fresh + 2.0 * driven + 0.5 * least / problem.size()

    def _step(
        self, problem: Problem, y: PETSc.Vec, tolerance: float, loads: float, room: float
    ) -> bool | None:
        """One descent and one update of the reactions: True; False where it goes on from where it is (what snaps takes
        many iterations); None where it failed. room: see `_room`."""
        options, contact, begun = self.options, contact_of(problem), y.copy()
        fresh = self._fresh(problem)
        contact.freeze(problem.positions(y), problem.time)
        f = y.duplicate()
        problem.residual(y, f)
        if not contact.itself:  # layers take long to settle again
            perturb(problem, y, self.perturbation)
        rough = max(tolerance, options.rough * min(f.norm(), loads), options.sharpest * loads)
        astray = self._astray(problem)

        def too_far(at: PETSc.Vec) -> bool:
            return fresh and problem.largest_motion(difference(at, begun)) > room

        def vain(at: PETSc.Vec) -> bool:
            return too_far(at) or bool(astray and astray(at))

        done = self.descent.run(problem, y, rough, options.iterations, vain)
        if too_far(y):
            return None
        if done:
            contact.adopt(problem.positions(y), problem.time)
            return True
        unfinished = self.descent.nonlinear.snes.reason == PETSc.SNES.ConvergedReason.DIVERGED_MAX_IT
        return False if unfinished else None

    def _arrives(self, problem: Problem, y: PETSc.Vec, tolerance: float, start: State) -> Outcome:
        """What the semismooth method finds from here, with the slip since the `start` of the load step where it
        can."""
        contact, before = contact_of(problem), problem.save(y)
        contact.begin(problem.positions(y), problem.time)
        found = attempt(self.semismooth, problem, y, tolerance)
        if not (found.converged or found.saddle) and self._sharpened(problem, y, tolerance):
            found = attempt(self.semismooth, problem, y, tolerance)
        if found.converged and not self._admissible(problem, before, y):
            problem.restore(y, before)
            return self._failed("the way on leads through an obstacle")
        if found.converged and (problem.held or contact.moves):
            found = self._recall(problem, y, tolerance, start) or found
        return replace(found, method=self.name, watched=self.watches)

    def _sharpened(self, problem: Problem, y: PETSc.Vec, tolerance: float) -> bool:
        """Whether the round-off of large unknowns blurred the residual: they are counted from y on then."""
        if round_off(problem, y)[0] <= self.options.blurred * tolerance:
            return False
        problem.move_origin(y)
        return True

    def _recall(self, problem: Problem, y: PETSc.Vec, tolerance: float, start: State) -> Outcome | None:
        """An equilibrium whose slip is that of the whole load step, where there is one near: that of pseudo-time is
        measured from its own last step."""
        contact, began = contact_of(problem), start.history
        assert began is not None
        found, history = contact.history.copy(), contact.history
        history.reference, history.time, history.layers = began.reference, began.time, began.layers
        again = attempt(self.semismooth, problem, y, tolerance)
        if again.converged:
            return again
        contact.history = found
        return None

    def _beside(self, problem: Problem, y: PETSc.Vec, saddle: State, kicks: int) -> bool:
        """Whether y is already further from a saddle than the next kick would put it."""
        moved = problem.largest_motion(difference(y, problem.unknowns_of(saddle)))
        return moved * problem.size() > reach(self.perturbation, kicks)


class WatchedTransient(PseudoTransient):
    """No step may lead a vertex through an obstacle."""

    watches = True

    def _admissible(self, problem: Problem, before: State, y: PETSc.Vec) -> bool:
        was, now = problem.positions(problem.unknowns_of(before)), problem.time
        return not leads_through(problem, was, now, problem.positions(y), self.options.astray)

    def _astray(self, problem: Problem) -> Callable[[PETSc.Vec], bool] | None:
        return Astray(problem, self.options.astray)


def _share(problem: Problem, y: PETSc.Vec) -> float:
    """Of the full loads, those at the problem's load factor: what they move in a step is the same. A tablecloth that
    slid off a drum under a tenth of its weight took 5,100 iterations in steps for all of it, 3,300 so."""
    full = problem.at(1.0).load_norm(y)
    return max(problem.load_norm(y) / full, LEAST) if full else 1.0


def _driven(problem: Problem) -> float:
    """How far supports have moved since the step's start, in sizes of the shell."""
    moved = problem.part.supports.between(contact_of(problem).history.time, problem.time)
    return problem.in_sizes(moved[: problem.layout.vertices])


def _slides(problem: Problem, step: PETSc.Vec) -> str:
    """Which way the shell leaves with a step."""
    own = problem.motion(step)[problem.own]
    return slides(problem, "no equilibrium within its own size", problem.comm.allreduce(own.sum(axis=0)))
