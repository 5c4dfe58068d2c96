"""One equilibrium with contact and dry friction: three ways to it, each tried where the one before fails.

1. The semismooth Newton method, from where the shell is.
2. Descent: the augmented Lagrangian with frozen reactions is a potential, minimised by the descent method of statics;
   then the reactions are updated (a Tresca fixed point), and the semismooth method tried again.
3. Pseudo-time: implicit steps in which the shell's mass pulls it back to where the step started; slip is measured from
   there. The pull fades as steps become easy. A shell that nothing holds slides on and on: then there is no
   equilibrium, and the direction is known.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from petsc4py import PETSc

from voile.contact.kept import Kept
from voile.contact.state import State
from voile.errors import InputError
from voile.problem.anchor import Anchor, difference
from voile.problem.discrete import Problem
from voile.problem.scales import round_off, slow_rate
from voile.solver.complementarity import OPTION, Complementarity
from voile.solver.newton import Newton, negative_pivots, renew
from voile.solver.semismooth import MOST, Semismooth
from voile.solver.stability import smallest_eigenpair

UPDATES, FEW = 15, 4  # of the reactions; in a step of pseudo-time
ROUGHEST = 30.0  # first tolerance of the descents over the last
SOFTEST, HARDENING = (
    1e-4,
    30.0,
)  # contact's stiffness in the first descent, over the shell's; factor per update
DESCENT, SHORT = 300, 40  # iterations of one; where reactions lag behind
FAR = 0.01  # sizes of the shell that a step may move before friction is known
PSEUDO_STEPS = 300
PATIENCE = 8  # of them at most without the semismooth method
DONE, UNFINISHED = 1, 2  # steps of it
FIRST_RATE, LAST_RATE = 30.0, 1e7  # of pseudo-time, in slow rates
ROUGH, REDUCED = 2e-3, 0.06  # tolerance of a step of pseudo-time, of the loads and of the norm at its start
NEAR = 0.01  # pull, of the loads, under which the semismooth method is tried without it
KICKS = 5  # attempts to leave a saddle
SETTLED, NEARLY = (
    1e2,
    1e4,
)  # tolerances, of the balance with all contacts kept; where round-off stops it before
ROUND_OFF = 10.0  # times round-off a norm may be due to it
GONE = 1.0  # sizes of the shell after which it has slid away


@dataclass
class Outcome:
    """How an equilibrium was found (`way`), or the reason why not. gone: there is none, the shell slides away."""

    converged: bool
    way: str
    reason: str = ""
    gone: bool = False


Way = Callable[[PETSc.Vec, float], Outcome]


class FrictionalSolver:
    """Finds the equilibrium of a problem with contact at its load factor. `iterations` counts Newton iterations of
    the last `solve`, `seconds` factorisations and solves of all."""

    def __init__(
        self, problem: Problem, snes: PETSc.SNES, newton: Newton, perturbation: float = 1.0, fast: bool = True
    ):
        """perturbation off a saddle in thicknesses; fast: the semismooth method first, not where starts strain the
        shell far beyond its equilibrium."""
        assert problem.contact is not None
        self.perturbation, self.fast = perturbation * problem.thickness(), fast
        self.saddle: tuple[PETSc.Vec, State] | None = None
        self.problem, self.contact, self.snes, self.newton = problem, problem.contact, snes, newton
        self.semismooth = Semismooth(problem, self.contact)
        self.iterations = 0
        # steps of pseudo-time without, and between, tries of the semismooth method; whether descent still settles them
        self._wait, self._patience, self._settles = 0, 0, True

    @property
    def seconds(self) -> float:
        return self.semismooth.seconds + self.newton.seconds

    def solve(self, y: PETSc.Vec, wanted: float, ways: int = 3) -> Outcome:
        """y and the contact's state end at the equilibrium with a norm under `wanted` (N), or where they were."""
        self.iterations = 0
        if self._carried_through(y):
            return Outcome(
                False, "", "supports carry layers of the shell through each other in one load step"
            )
        outcome = Outcome(False, "")
        first = self._by_complementarity if PETSc.Options().hasName(OPTION) else self._directly
        later: list[Way] = [self._by_pseudo_time]
        if self.problem.supported:  # what nothing holds has no least potential
            later.insert(0, self._by_descent)
        near = [first, self._keeping] if self.fast else [self._keeping, first]
        for way in [*near, *later][: ways + 1]:
            self.saddle = None
            outcome = self._attempt(way, y, wanted)
            if not outcome.converged and way is first and self._at_saddle():
                outcome = self._attempt(self._off_saddle, y, wanted)
            if outcome.converged or outcome.gone:
                break
        return outcome

    def _attempt(self, way: Way, y: PETSc.Vec, wanted: float) -> Outcome:
        """One way; puts y and the reactions back where it fails."""
        start, state = y.copy(), self.contact.state.copy()
        outcome = way(y, wanted)
        if not outcome.converged:
            start.copy(y)
            self.contact.state = state
        return outcome

    # ---- the ways ----

    def _directly(self, y: PETSc.Vec, wanted: float) -> Outcome:
        done = self._run(self.semismooth, y, wanted, MOST)
        if done and self.semismooth.negative:
            self.saddle = y.copy(), self.contact.state.copy()
            return Outcome(False, "semismooth", "the semismooth Newton method ended at a saddle")
        return Outcome(done, "semismooth", "" if done else self._missed(y))

    def _keeping(self, y: PETSc.Vec, wanted: float) -> Outcome:
        """The semismooth method once the shell has settled around contacts that stay as they were: where it alone is
        disturbed, far from balance, the laws would first let go of them."""
        contact, problem = self.contact, self.problem
        kept = Kept(contact, problem.positions(y), problem.load_factor)
        if problem.everywhere(not kept.bears):
            return Outcome(False, "kept contacts", "nothing bears")
        self.newton.descend, contact.kept = True, kept
        try:
            settled = self._run(self.newton, y, SETTLED * wanted, DESCENT)
        finally:
            contact.kept = None
        if not settled and not self.snes.getFunctionNorm() <= NEARLY * wanted:
            return Outcome(False, "kept contacts", self._missed(y))
        return replace(self._directly(y, wanted), way="kept contacts")

    def _by_complementarity(self, y: PETSc.Vec, wanted: float) -> Outcome:
        """SNESVI, then a step of the semismooth method for the inertia."""
        if self.contact.itself or any(friction > 0.0 for _, friction in self.contact.frictions):
            raise InputError(
                f"-{OPTION}: SNESVI solves frictionless contact with obstacles; allowed: friction = 0 on all, "
                "contact.self_contact = false"
            )
        snes = Complementarity(self.problem, self.contact, self.snes.getJacobian()[0], y).solve(wanted)
        self.iterations += snes.getIterationNumber()
        if snes.getConvergedReason() <= 0:
            return Outcome(False, snes.getType(), f"{snes.getType()} did not converge")
        done = self._directly(y, wanted)
        return Outcome(done.converged, snes.getType(), done.reason)

    def _off_saddle(self, y: PETSc.Vec, wanted: float) -> Outcome:
        """Leaves the last saddle found along its softest mode, further and further."""
        assert self.saddle is not None
        saddle, state = self.saddle
        saddle.copy(y)
        self.contact.state = state.copy()
        _, mode = smallest_eigenpair(self.problem, self.stability_matrix(y), slow_rate(self.problem))
        outcome = Outcome(False, "descent", "no way off the saddle")
        # What nothing holds has no least potential.
        way = partial(self._by_descent, softest=1.0) if self.problem.supported else self._by_pseudo_time
        for kick in range(KICKS):
            step = mode.copy()
            step.scale(self.perturbation * 4.0**kick)
            y.waxpy(self.problem.free_share(saddle, step), step, saddle)
            self.contact.state = state.copy()
            outcome = self._attempt(way, y, wanted)
            if outcome.converged or outcome.gone:
                break
        return outcome

    def _by_descent(
        self, y: PETSc.Vec, wanted: float, softest: float = SOFTEST, updates: int = UPDATES
    ) -> Outcome:
        """Contact starts soft, so that its front can move over many vertices at once, and hardens update by update. Not
        between layers of the shell: what is soft lets them collapse, and then no step is free."""
        contact, problem = self.contact, self.problem
        softest = 1.0 if contact.itself else softest
        contact.freeze(problem.positions(y), problem.load_factor)
        rough, self.newton.descend, contact.softness = ROUGHEST * wanted, True, softest
        try:
            for _ in range(updates):
                if not self._run(self.newton, y, max(wanted, rough), DESCENT):
                    return Outcome(False, "descent", self._missed(y))
                contact.adopt(problem.positions(y), problem.load_factor)
                contact.softness = min(HARDENING * contact.softness, 1.0)
                settled = self.snes.getIterationNumber() <= 2 or contact.softness == 1.0
                if settled and self._finished(y, wanted):
                    return Outcome(True, "descent")
                rough *= 0.1
        finally:
            contact.softness = 1.0
        return Outcome(
            False, "descent", f"{updates} updates of the reactions did not converge; {self._missed(y)}"
        )

    def _finished(self, y: PETSc.Vec, wanted: float) -> bool:
        """Whether the updated reactions are those of an equilibrium, or near enough for the semismooth method."""
        return self._norm(y) <= wanted or self._attempt(self._directly, y, wanted).converged

    def _by_pseudo_time(self, y: PETSc.Vec, wanted: float) -> Outcome:
        problem, self._settles = self.problem, not self.contact.itself
        mass, slow = problem.mass(), slow_rate(problem)
        loads, began = max(problem.load_norm(y), wanted / 1e-8), self.contact.state.copy()
        rate, tried, pull, origin = FIRST_RATE * slow, np.inf, np.inf, y.copy()
        try:
            for _ in range(PSEUDO_STEPS):
                home, before = y.copy(), self.iterations
                problem.anchor = Anchor(home, rate, mass)
                done = self._pseudo_step(y, wanted, ROUGH * loads, 0.5 * pull)
                if not done:
                    rate *= 4.0
                    if rate > LAST_RATE * slow:
                        return Outcome(
                            False, "pseudo-time", f"no step of pseudo-time converges; {self._missed(y)}"
                        )
                    continue
                if problem.largest_motion(difference(y, origin)) > GONE:
                    return Outcome(False, "pseudo-time", self._slides(difference(y, home)), gone=True)
                if done == UNFINISHED:
                    continue
                pull, spent = problem.norm(problem.anchor.pull(y)), self.iterations - before
                rate *= 0.3 if spent <= 6 else 0.5 if spent <= 12 else 0.7
                if pull < min(NEAR * loads, 0.3 * tried):
                    tried, problem.anchor = pull, None
                    self._begin(y)
                    if self._attempt(self._directly, y, wanted).converged:
                        if problem.supported:
                            self._recall(y, wanted, began)
                        return Outcome(True, "pseudo-time")
        finally:
            problem.anchor = None
        return Outcome(False, "pseudo-time", f"{PSEUDO_STEPS} steps of pseudo-time did not settle")

    def _recall(self, y: PETSc.Vec, wanted: float, began: State) -> None:
        """An equilibrium whose slip is that of the whole load step, begun in that state, where there is one near: that
        of pseudo-time is measured from its own last step."""
        found, state = self.contact.state.copy(), self.contact.state
        state.reference, state.factor, state.layers = began.reference, began.factor, began.layers
        if not self._attempt(self._directly, y, wanted).converged:
            self.contact.state = found

    def _pseudo_step(self, y: PETSc.Vec, wanted: float, rough: float, pull: float) -> int:
        """DONE, UNFINISHED or (0) failed: by the semismooth method, which waits longer and longer after it has failed,
        else by descent until the reactions have settled. Where supports move the shell friction must remember: the laws
        hold in every step. Else, once such a descent has failed, a part of their mismatch is left to the next step, as
        rough as the last step's pull (N) allows; between layers at once, which take long to settle."""
        self._begin(y)
        reduced = REDUCED * self._norm(y)
        tolerance = max(wanted, min(rough, reduced))
        exact = self.problem.supported and not self.contact.itself
        self._wait -= 1
        if self._wait < 0:
            if self._attempt(self._directly, y, tolerance).converged:
                self._patience = 0
                return DONE
            self._wait = self._patience = min(max(2 * self._patience, 1), PATIENCE)
        if exact or self._settles:
            descent = partial(self._by_descent, softest=1.0, updates=FEW)
            self._settles = self._attempt(descent, y, tolerance).converged
            if self._settles or exact:
                return DONE if self._settles else 0
        return self._lagged_descent(y, max(wanted, pull if np.isfinite(pull) else reduced))

    def _lagged_descent(self, y: PETSc.Vec, tolerance: float) -> int:
        """One descent and one update of the reactions. Where there are none yet there is no friction either: such a
        step must not go far. What snaps takes many iterations: unfinished, it goes on from where it is."""
        contact, problem, home = self.contact, self.problem, y.copy()
        fresh = problem.everywhere(not any(normal.any() for normal in contact.state.normal))
        contact.freeze(problem.positions(y), problem.load_factor)
        self.newton.descend = True
        done = self._run(self.newton, y, tolerance, SHORT)
        far = fresh and problem.largest_motion(difference(y, home)) > FAR
        if far or not (done or self.snes.reason == PETSc.SNES.ConvergedReason.DIVERGED_MAX_IT):
            home.copy(y)
            return 0
        if done:
            contact.adopt(problem.positions(y), problem.load_factor)
        return DONE if done else UNFINISHED

    # ---- stability ----

    def stability_matrix(self, y: PETSc.Vec) -> PETSc.Mat:
        """The exact tangent with sticking vertices held and slipping ones held along the normal."""
        matrix = self.snes.getJacobian()[0]
        linear = self.contact.linearise(self.problem.positions(y), self.problem.load_factor)
        self.problem.tangent(y, matrix, "exact", linear.held())
        return matrix

    def stable(self, y: PETSc.Vec) -> bool:
        """Whether the tangent has no negative eigenvalue where contact lets the shell move."""
        pc, matrix = self.snes.ksp.pc, self.stability_matrix(y)
        renew(pc, matrix)
        pc.setOperators(matrix)
        pc.setUp()
        return negative_pivots(pc) == 0

    def leave(self, y: PETSc.Vec, wanted: float) -> bool:
        """Whether a stable equilibrium was found from the saddle y, where y then is."""
        self.saddle = y.copy(), self.contact.state.copy()
        return self._attempt(self._off_saddle, y, wanted).converged

    # ---- help ----

    def _norm(self, y: PETSc.Vec) -> float:
        """Norm of residual and mismatch (N)."""
        return float(np.hypot(*self.semismooth.norms(y, y.duplicate())))

    def _carried_through(self, y: PETSc.Vec) -> bool:
        """Whether supports alone, moved from where the load step began, push layers of the shell through each other."""
        if not (self.contact.itself and self.problem.moves):
            return False
        state, target = self.contact.state, self.problem.load_factor
        self.problem.load_factor = state.factor
        began = self.problem.positions(y)
        self.problem.load_factor = target
        if not self.problem.everywhere(np.array_equal(began, state.reference)):
            return False  # the step is on its way
        return self.contact.free_share(began, self.problem.positions(y)) < 1.0

    def _at_saddle(self) -> bool:
        return self.saddle is not None

    def _begin(self, y: PETSc.Vec) -> None:
        self.contact.begin(self.problem.positions(y), self.problem.load_factor)

    def _run(self, method: Semismooth | Newton, y: PETSc.Vec, tolerance: float, most: int) -> bool:
        snes = self.snes
        snes.setPythonContext(method)
        snes.setTolerances(rtol=0.0, atol=tolerance, stol=0.0, max_it=most)
        snes.setFromOptions()
        snes.solve(None, y)
        self.iterations += snes.getIterationNumber()
        return snes.getConvergedReason() > 0

    def _missed(self, y: PETSc.Vec) -> str:
        """By how much the last solve, which ended at y, missed its tolerance; and round-off, where it is to blame."""
        names = {v: k for k, v in vars(PETSc.SNES.ConvergedReason).items() if isinstance(v, int)}
        norm, asked = self.snes.getFunctionNorm(), self.snes.getTolerances()[1]
        noise = max(round_off(self.problem, y))
        blame = f"; round-off is {noise:.1e} N" if norm < ROUND_OFF * noise else ""
        return (
            f"norm {norm:.3e} N misses {asked:.3e} N ({names[self.snes.getConvergedReason()].lower()}){blame}"
        )

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
