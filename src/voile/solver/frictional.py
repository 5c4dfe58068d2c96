"""One equilibrium with contact and dry friction: three ways to it, each tried where the one before fails.

1. The semismooth Newton method, from where the shell is.
2. Descent: the augmented Lagrangian with frozen reactions is a potential, minimised by the descent method of statics;
   then the reactions are updated (a Tresca fixed point), and the semismooth method tried again.
3. Pseudo-time (see pseudo_time), whose steps the first two find.
"""

from dataclasses import replace
from functools import partial

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from voile.contact.kept import Kept
from voile.errors import InputError
from voile.problem.anchor import difference
from voile.problem.discrete import Problem
from voile.problem.imperfection import disturb
from voile.problem.scales import round_off, slow_rate
from voile.solver.complementarity import OPTION, Complementarity
from voile.solver.newton import Newton, negative_pivots, renew
from voile.solver.pseudo_time import PseudoTime
from voile.solver.semismooth import MOST, Semismooth
from voile.solver.stability import smallest_eigenpair
from voile.solver.ways import KICKS, NEUTRAL, Base, Outcome, Place, Way

UPDATES = 15  # of the reactions
ROUGHEST = 30.0  # first tolerance of the descents over the last
SOFTEST, HARDENING = (
    1e-4,
    30.0,
)  # contact's stiffness in the first descent, over the shell's; factor per update
DESCENT = 300  # iterations of one
SETTLED, NEARLY = (
    1e2,
    1e4,
)  # tolerances, of the balance with all contacts kept; where round-off stops it before
SHARP = 1e-13  # sizes of the shell: gaps and slips that make up the tolerance
SAMPLED, MOST_SAMPLES = 0.01, 200  # sizes of the shell between places at which a way is looked at; how many
ROUND_OFF = 10.0  # times round-off a norm may be due to it


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
        self.problem, self.contact, self.snes, self.newton = problem, problem.contact, snes, newton
        self.semismooth, self.base = Semismooth(problem, self.contact), Base(problem, self.contact)
        self.pseudo_time = PseudoTime(self)
        self.iterations = 0

    @property
    def seconds(self) -> float:
        return self.semismooth.seconds + self.newton.seconds

    def solve(self, y: PETSc.Vec, wanted: float, ways: int = 3, only: Way | None = None) -> Outcome:
        """y and the contact's state end at the equilibrium with a norm under `wanted` (N), or where they were. only: a
        way in place of those that are tried one after the other."""
        self.iterations = 0
        self.contact.sharp = wanted / (SHARP * self.problem.size())
        if self._carried_through(y):
            return Outcome(
                False, "", "supports carry layers of the shell through each other in one load step"
            )
        if only:
            return self.attempt(only, y, wanted)
        outcome = Outcome(False, "")
        first = self._by_complementarity if PETSc.Options().hasName(OPTION) else self.directly
        later: list[Way] = [self.pseudo_time.run]
        if self.problem.supported:  # what nothing holds has no least potential
            later.insert(0, self.by_descent)
        near = [first, self._keeping] if self.fast else [self._keeping, first]
        for way in [*near, *later][: ways + 1]:
            outcome = self.attempt(way, y, wanted)
            if outcome.saddle and way is first:
                outcome = self.attempt(partial(self._off_saddle, outcome.saddle), y, wanted)
            if outcome.converged or outcome.gone:
                break
        return outcome

    def attempt(self, way: Way, y: PETSc.Vec, wanted: float) -> Outcome:
        """One way; puts y and the reactions back where it fails."""
        start = self.base.here(y)
        outcome = way(y, wanted)
        if not outcome.converged:
            self.base.put(y, start)
        return outcome

    # ---- the ways ----

    def directly(self, y: PETSc.Vec, wanted: float) -> Outcome:
        done = self.run(self.semismooth, y, wanted, MOST)
        if done and self.semismooth.negative:
            reason = "the semismooth Newton method ended at a saddle"
            return Outcome(False, "semismooth", reason, saddle=self.base.here(y))
        return Outcome(done, "semismooth", "" if done else self.missed(y))

    def _keeping(self, y: PETSc.Vec, wanted: float) -> Outcome:
        """The semismooth method once the shell has settled around contacts that stay as they were: where it alone is
        disturbed, far from balance, the laws would first let go of them."""
        contact, problem = self.contact, self.problem
        kept = Kept(contact, problem.positions(y), problem.load_factor)
        if problem.everywhere(not kept.bears):
            return Outcome(False, "kept contacts", "nothing bears")
        self.newton.descend, contact.kept = True, kept
        try:
            settled = self.run(self.newton, y, SETTLED * wanted, DESCENT)
        finally:
            contact.kept = None
        if not settled and not self.snes.getFunctionNorm() <= NEARLY * wanted:
            return Outcome(False, "kept contacts", self.missed(y))
        return replace(self.directly(y, wanted), way="kept contacts")

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
        done = self.directly(y, wanted)
        return replace(done, way=snes.getType())

    def _off_saddle(self, saddle: Place, y: PETSc.Vec, wanted: float) -> Outcome:
        """Leaves a saddle along its softest mode, further and further."""
        if not self.problem.supported:  # what nothing holds has no least potential
            self.base.put(y, saddle)
            return self.attempt(self.pseudo_time.run, y, wanted)
        outcome = Outcome(False, "descent", "no way off the saddle")
        for kick in range(KICKS):
            if self.kick(y, saddle, kick) <= NEUTRAL * slow_rate(self.problem):
                return Outcome(True, "semismooth")
            outcome = self.attempt(partial(self.by_descent, softest=1.0), y, wanted)
            if outcome.converged:
                break
        return outcome

    def kick(self, y: PETSc.Vec, saddle: Place, kick: int) -> float:
        """Puts y off a saddle along its softest mode, further with every kick; the rate (1/s^2) at which that grows.
        Where it is NEUTRAL, as of a spin about a single contact, the saddle is none, and y stays there."""
        self.base.put(y, saddle)
        slow = slow_rate(self.problem)
        value, mode = smallest_eigenpair(self.problem, self.stability_matrix(y), slow)
        if value < -NEUTRAL * slow:
            mode.scale(self._reach(kick))
            y.axpy(self.problem.free_share(y, mode), mode)
        return -value

    def disturb(self, y: PETSc.Vec) -> None:
        """Moves the start of a descent off symmetry; not between layers, which take long to settle again."""
        if not self.contact.itself:
            disturb(self.problem, y, self.perturbation)

    def beside(self, y: PETSc.Vec, saddle: Place, kick: int) -> bool:
        """Whether y is already further from a saddle than that kick would put it."""
        moved = self.problem.largest_motion(difference(y, self.base.unknowns(saddle)))
        return moved * self.problem.size() > self._reach(kick)

    def _reach(self, kick: int) -> float:
        return self.perturbation * 4.0**kick

    def by_descent(
        self,
        y: PETSc.Vec,
        wanted: float,
        softest: float = SOFTEST,
        updates: int = UPDATES,
        rough: float = 0.0,
    ) -> Outcome:
        """Contact starts soft, so that its front can move over many vertices at once, and hardens update by update. Not
        between layers of the shell: what is soft lets them collapse, and then no step is free. rough (N): what
        the first descent need only come near to, `wanted` by default; the next ones' tolerances are ever smaller."""
        contact, problem = self.contact, self.problem
        softest = 1.0 if contact.itself else softest
        contact.freeze(problem.positions(y), problem.load_factor)
        rough, self.newton.descend, contact.softness = ROUGHEST * (rough or wanted), True, softest
        self.disturb(y)
        try:
            for _ in range(updates):
                if not self.run(self.newton, y, max(wanted, rough), DESCENT):
                    return Outcome(False, "descent", self.missed(y))
                contact.adopt(problem.positions(y), problem.load_factor)
                contact.softness = min(HARDENING * contact.softness, 1.0)
                settled = self.snes.getIterationNumber() <= 2 or contact.softness == 1.0
                if settled and self._finished(y, wanted):
                    return Outcome(True, "descent")
                rough *= 0.1
        finally:
            contact.softness = 1.0
        return Outcome(
            False, "descent", f"{updates} updates of the reactions did not converge; {self.missed(y)}"
        )

    def _finished(self, y: PETSc.Vec, wanted: float) -> bool:
        """Whether the updated reactions are those of an equilibrium, or near enough for the semismooth method."""
        return self.norm(y) <= wanted or self.attempt(self.directly, y, wanted).converged

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
        return self.attempt(partial(self._off_saddle, self.base.here(y)), y, wanted).converged

    # ---- obstacles on the way ----

    def passes(self, before: np.ndarray, began: float, after: np.ndarray) -> bool:
        """Whether the straight way from positions `before` (n, 3), at the load factor `began`, to those `after`, at
        the present one, leads a vertex through an obstacle."""
        problem = self.problem
        farthest = float(np.linalg.norm(after - before, axis=1).max(initial=0.0))
        farthest = problem.comm.allreduce(farthest, op=MPI.MAX) / problem.size()
        shares = np.linspace(0.0, 1.0, min(int(farthest / SAMPLED), MOST_SAMPLES) + 1)[1:-1]
        inside = self.contact.inside_on_the_way(
            before, began, after, problem.load_factor, shares, problem.size()
        )
        return not problem.everywhere(not inside.any())

    # ---- help ----

    def norm(self, y: PETSc.Vec) -> float:
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

    def begin(self, y: PETSc.Vec) -> None:
        self.contact.begin(self.problem.positions(y), self.problem.load_factor)

    def run(self, method: Semismooth | Newton, y: PETSc.Vec, tolerance: float, most: int) -> bool:
        snes = self.snes
        snes.setPythonContext(method)
        snes.setTolerances(rtol=0.0, atol=tolerance, stol=0.0, max_it=most)
        snes.setFromOptions()
        snes.solve(None, y)
        self.iterations += snes.getIterationNumber()
        return snes.getConvergedReason() > 0

    def missed(self, y: PETSc.Vec) -> str:
        """By how much the last solve, which ended at y, missed its tolerance; and round-off, where it is to blame."""
        names = {v: k for k, v in vars(PETSc.SNES.ConvergedReason).items() if isinstance(v, int)}
        norm, asked = self.snes.getFunctionNorm(), self.snes.getTolerances()[1]
        noise = max(round_off(self.problem, y))
        blame = f"; round-off is {noise:.1e} N" if norm < ROUND_OFF * noise else ""
        return (
            f"norm {norm:.3e} N misses {asked:.3e} N ({names[self.snes.getConvergedReason()].lower()}){blame}"
        )
