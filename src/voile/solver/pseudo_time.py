"""Pseudo-time: implicit steps in which the shell's mass pulls it back to where the step started; slip is measured from
there. The pull fades from step to step. A shell that nothing holds slides on and on: then there is no equilibrium,
and the direction is known. But between layers steps are solved sharply, and nothing but a step that fails decides on
the next one's length, so that the way is the same for all numbers of ranks.
"""

from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from petsc4py import PETSc

from voile.contact.state import State
from voile.problem.anchor import Anchor, difference
from voile.problem.scales import round_off, slow_rate
from voile.solver.ways import KICKS, NEUTRAL, Outcome, Place

if TYPE_CHECKING:
    from voile.solver.frictional import FrictionalSolver

STEPS = 300
FEW = 4  # updates of the reactions in a step
SHORT = 40  # iterations of a descent where reactions lag behind
FAR = 0.01  # sizes of the shell that a step may move before friction is known
PATIENCE = 8  # steps at most without the semismooth method
DONE, UNFINISHED = 1, 2
FIRST_RATE, LAST_RATE = 30.0, 1e7  # in slow rates
FADE, RAISE = 0.5, 4.0  # factor of the rate after a step, and after one that failed
ROUGH, REDUCED = 2e-3, 0.06  # tolerance of a step between layers, of the loads and of the norm at its start
NEAR = 0.01  # pull, of the loads, under which the semismooth method is tried without it
GONE = 1.0  # sizes of the shell after which it has slid away
NOISES = 10.0  # times round-off that a step is solved to at best
BLURRED = 0.1  # of the tolerance: round-off of the unknowns beyond which they are counted anew


class PseudoTime:
    """One way to an equilibrium, by the methods of a solver with contact."""

    def __init__(self, solver: "FrictionalSolver"):
        self.solver, self.problem, self.contact = solver, solver.problem, solver.contact
        # steps without, and between, tries of the semismooth method; whether descent still settles them
        self._wait, self._patience, self._settles = 0, 0, True
        self._carried = True  # obstacles have taken along what sticks to them
        self._watchful = False

    def run(self, y: PETSc.Vec, wanted: float, watchful: bool = False) -> Outcome:
        """watchful: no step may lead through an obstacle."""
        self._watchful = watchful
        solver, problem, base = self.solver, self.problem, self.solver.base
        self._wait, self._patience, kick = 0, 0, 0
        self._settles, self._carried = not self.contact.itself, not self.contact.moves
        mass, slow = problem.mass(), slow_rate(problem)
        loads, began = max(problem.load_norm(y), wanted / 1e-8), self.contact.state.copy()
        # peak: of the pull (N) since the semismooth method was last tried without it
        rate, peak, pull, origin = FIRST_RATE * slow, np.inf, np.inf, base.here(y)
        try:
            for _ in range(STEPS):
                home, place = y.copy(), base.here(y)
                problem.anchor = Anchor(home, rate, mass)
                done = self._step(y, wanted, ROUGH * loads, 0.5 * pull)
                if done and self._passes(y, place):
                    done = 0
                self._carried |= bool(done)
                if not done:
                    rate *= 1.0 if self._sharpened(y, wanted) else RAISE
                    if rate > LAST_RATE * slow:
                        return self._failed(f"no step of pseudo-time converges; {solver.missed(y)}")
                    continue
                if problem.largest_motion(difference(y, base.unknowns(origin))) > GONE:
                    return replace(self._failed(self._slides(difference(y, home))), gone=True)
                if done == UNFINISHED:
                    continue
                pull = problem.norm(problem.anchor.pull(y))
                peak = max(peak, pull)
                rate *= FADE
                if pull <= min(NEAR * loads, 0.3 * peak):
                    peak, problem.anchor = pull, None
                    found = self._arrives(y, wanted, began)
                    if found.converged:
                        return found
                    if not found.saddle or solver.beside(y, found.saddle, kick):
                        continue
                    if kick == KICKS:
                        return self._failed("no way off a saddle")
                    growth = solver.kick(y, found.saddle, kick)
                    if growth <= NEUTRAL * slow:
                        return Outcome(True, "pseudo-time")
                    kick, rate, peak = kick + 1, 2.0 * growth, 0.0
        finally:
            problem.anchor = None
        return self._failed(f"{STEPS} steps of pseudo-time did not settle")

    def _failed(self, reason: str) -> Outcome:
        return Outcome(False, "pseudo-time", reason)

    def _arrives(self, y: PETSc.Vec, wanted: float, began: State) -> Outcome:
        """What the semismooth method finds from here, with the slip since the load step `began` where it can."""
        solver, place = self.solver, self.solver.base.here(y)
        solver.begin(y)
        found = solver.attempt(solver.directly, y, wanted)
        if not (found.converged or found.saddle) and self._sharpened(y, wanted):
            found = solver.attempt(solver.directly, y, wanted)
        if found.converged and self._passes(y, place):
            return self._failed("the way on leads through an obstacle")
        if found.converged and (self.problem.held or self.contact.moves):
            self._recall(y, wanted, began)
        return replace(found, way="pseudo-time")

    def _passes(self, y: PETSc.Vec, place: Place) -> bool:
        """Whether the way from a place to y leads through an obstacle, where that is watched; y then is there again."""
        if not self._watchful:
            return False
        solver, problem = self.solver, self.problem
        before, now = problem.positions(solver.base.unknowns(place)), problem.load_factor
        if not solver.passes(before, now, problem.positions(y)):
            return False
        solver.base.put(y, place)
        return True

    def _sharpened(self, y: PETSc.Vec, wanted: float) -> bool:
        """Whether the round-off of large unknowns blurred the residual: they are counted from y on then."""
        if round_off(self.problem, y)[0] <= BLURRED * wanted:
            return False
        self.solver.base.move(y)
        return True

    def _recall(self, y: PETSc.Vec, wanted: float, began: State) -> None:
        """An equilibrium whose slip is that of the whole load step, begun in that state, where there is one near: that
        of pseudo-time is measured from its own last step."""
        found, state = self.contact.state.copy(), self.contact.state
        state.reference, state.factor, state.layers = began.reference, began.factor, began.layers
        if not self.solver.attempt(self.solver.directly, y, wanted).converged:
            self.contact.state = found

    def _step(self, y: PETSc.Vec, wanted: float, rough: float, pull: float) -> int:
        """DONE, UNFINISHED or (0) failed: by the semismooth method, which waits longer and longer after it has failed,
        else by descent until the reactions have settled. The first step is also that of moving obstacles. Where
        supports move the shell friction must remember: the laws hold in every step. Else, once such a descent has
        failed, a part of their mismatch is left to the next step; between layers at once, which take long to settle,
        and whose steps are only as sharp as the last step's pull (N) demands."""
        solver = self.solver
        if self._carried:
            solver.begin(y)
        reduced = REDUCED * solver.norm(y)
        rough = max(wanted, min(rough, reduced))
        sharp = max(wanted, NOISES * max(round_off(self.problem, y)))
        tolerance = rough if self.contact.itself else sharp
        exact = self.problem.held and not self.contact.itself
        self._wait -= 1
        if self._wait < 0:
            if solver.attempt(solver.directly, y, tolerance).converged:
                self._patience = 0
                return DONE
            self._wait = self._patience = min(max(2 * self._patience, 1), PATIENCE)
        if exact or self._settles:
            descent = partial(solver.by_descent, softest=1.0, updates=FEW, rough=rough)
            self._settles = solver.attempt(descent, y, tolerance).converged
            if self._settles or exact:
                return DONE if self._settles else 0
        if self.contact.itself:
            tolerance = max(wanted, pull if np.isfinite(pull) else reduced)
        return self._lagged_descent(y, tolerance)

    def _lagged_descent(self, y: PETSc.Vec, tolerance: float) -> int:
        """One descent and one update of the reactions. Where there are none yet there is no friction either: such a
        step must not go far. What snaps takes many iterations: unfinished, it goes on from where it is."""
        solver, contact, problem, home = self.solver, self.contact, self.problem, y.copy()
        fresh = problem.everywhere(not any(normal.any() for normal in contact.state.normal))
        contact.freeze(problem.positions(y), problem.load_factor)
        solver.disturb(y)
        solver.newton.descend = True
        done = solver.run(solver.newton, y, tolerance, SHORT)
        far = fresh and problem.largest_motion(difference(y, home)) > FAR
        if far or not (done or solver.snes.reason == PETSc.SNES.ConvergedReason.DIVERGED_MAX_IT):
            home.copy(y)
            return 0
        if done:
            contact.adopt(problem.positions(y), problem.load_factor)
        return DONE if done else UNFINISHED

    def _slides(self, step: PETSc.Vec) -> str:
        """Which way the shell leaves, on what."""
        problem = self.problem
        mean = problem.mean_motion(step)
        way = mean / max(float(np.linalg.norm(mean)), 1e-300)
        bodies = ", ".join(f"{name} (friction {mu:g})" for name, mu in self.contact.frictions)
        return (
            f"the shell slides or falls: no equilibrium within its own size; it moves along "
            f"({way[0]:.3f}, {way[1]:.3f}, {way[2]:.3f}) past {bodies}"
        )
