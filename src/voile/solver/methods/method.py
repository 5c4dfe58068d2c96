"""What all methods share: their interface, their workspace, their SNES."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from petsc4py import PETSc

from voile.problem.lifetime import until_the_end
from voile.problem.problem import Problem
from voile.problem.scales import round_off
from voile.problem.state import State
from voile.solver.iterative import Iterative
from voile.solver.linear import DEFAULTS, Counts, LinearSolver, hand_on, set_defaults, symmetric, unsymmetric

LINEAR = 1e-10  # GMRES' tolerance; preconditioned by the symmetric part's factor it takes 3 to 5 iterations
BLAMED = 10.0  # times round-off that a norm may be due to it
_REASON = PETSc.SNES.ConvergedReason  # newer and older petsc4py call it differently
NOT_FINITE = getattr(_REASON, "DIVERGED_FUNCTION_NANORINF", None) or _REASON.DIVERGED_FNORM_NAN
REASONS = {value: name.lower() for name, value in vars(_REASON).items() if isinstance(value, int)}


@dataclass
class Outcome:
    """How an equilibrium was found (`method`), or the reason why not. gone: there is none, the shell slides away;
    saddle: an unstable one found instead; blurred: an iterate that only round-off may keep from the tolerance; norm: of
    the residual and of what the laws miss at the end (N), and negative: eigenvalues of the tangent there, where the
    method knows them; watched: no step on the way led through an obstacle."""

    converged: bool
    method: str
    reason: str = ""
    gone: bool = False
    saddle: State | None = None
    blurred: State | None = None
    norm: float = math.inf
    negative: int | None = None
    watched: bool = False


class Method(Protocol):
    """Finds an equilibrium of a problem at its load factor from the unknowns y, which move there."""

    def solve(self, problem: Problem, y: PETSc.Vec, tolerance: float) -> Outcome:
        """tolerance: of the residual's norm (N)."""
        ...


class Workspace:
    """What the methods of a run share: the tangent's matrix with its linear solvers, the counts, and who watches
    descents' iterates.

    `symmetric` is LL^T or LDL^T of the tangent, without prefix in PETSc's options; `unsymmetric` LU, prefix friction_.
    """

    def __init__(self, problem: Problem, counts: Counts | None = None):
        self.comm, self.monitor = problem.comm, problem.monitor
        self.watch: Callable[[PETSc.Vec], None] | None = None
        self.matrix, self.counts = problem.create_matrix(), counts or Counts()
        set_defaults(DEFAULTS)
        kind = PETSc.KSP.Type.PREONLY if problem.conservative else PETSc.KSP.Type.GMRES
        direct = symmetric(problem.comm, kind, LINEAR, self.counts)
        self.symmetric = self._eased(direct, "step_", problem.conservative)
        self._unsymmetric: LinearSolver | None = None

    @property
    def unsymmetric(self) -> LinearSolver:
        """LU, made when it is first wanted."""
        if self._unsymmetric is None:
            self._unsymmetric = self._make_unsymmetric()
        return self._unsymmetric

    def _make_unsymmetric(self) -> LinearSolver:
        direct = unsymmetric(self.comm, "friction_", self.counts)
        return self._eased(direct, "step_friction_", False)

    def _eased(self, direct: LinearSolver, prefix: str, symmetric: bool) -> LinearSolver:
        """What solves the systems of a direct solver."""
        return direct

    @property
    def rough(self) -> bool:
        """Whether Newton steps may be, and with the last factor."""
        return False

    def careful(self) -> None:
        """Ends that Newton steps are rough."""


class InertialWorkspace(Workspace):
    """Of steps in time, whose systems inertia makes easy: they can be iterated first, prefixes step_ and
    step_friction_."""

    def __init__(self, problem: Problem, counts: Counts | None = None):
        self._iterative: list[Iterative] = []  # the symmetric one first
        super().__init__(problem, counts)
        self._unsymmetric = self._make_unsymmetric()

    def _eased(self, direct: LinearSolver, prefix: str, symmetric: bool) -> LinearSolver:
        self._iterative.append(Iterative(direct, self.counts, prefix, symmetric))
        return self._iterative[-1]

    @property
    def rough(self) -> bool:
        return self._iterative[0].wanted > 0.0

    def careful(self) -> None:
        self._iterative[0].wanted = 0.0

    def iterate(self, tries: bool, wanted: float = 0.0) -> None:
        """Whether systems are tried by iteration from here on, for a step of the tolerance `wanted` (N): those
        without contact or drag, whose Newton steps may then be rough."""
        for solver in self._iterative:
            solver.tries, solver.wanted = tries, wanted


class Iteration(Protocol):
    """What a SNES of type python calls."""

    def solve(self, snes: PETSc.SNES, b: PETSc.Vec | None, y: PETSc.Vec) -> None: ...


class Nonlinear:
    """A SNES with an option prefix around an iteration of our own.

    Options without prefix hold for all methods: they are handed on to the prefix where it has none of its own.
    """

    def __init__(self, work: Workspace, prefix: str, iteration: Iteration):
        self.work = work
        self._problem: Problem | None = None
        self.asked = 0.0  # the last run's tolerance (N)
        snes = self.snes = until_the_end(PETSc.SNES().create(comm=work.comm))
        snes.setOptionsPrefix(prefix)
        hand_on(prefix)
        # Where the potential falls, the residual may rise as it likes.
        set_defaults({f"{prefix}snes_divergence_tolerance": "-3"})
        snes.setType(PETSc.SNES.Type.PYTHON)
        snes.setPythonContext(iteration)
        snes.setKSP(work.symmetric.indefinite.ksp)
        if work.monitor:
            snes.setMonitor(self._report)

    def run(self, problem: Problem, y: PETSc.Vec, tolerance: float, most: int) -> bool:
        """Iterates on the problem from y; whether the residual's norm came under the tolerance (N)."""
        snes, self._problem = self.snes, problem
        snes.setFunction(lambda _, z, f: problem.residual(z, f), problem.create_vector())
        snes.setJacobian(lambda _, z, j, p: problem.tangent(z, p), self.work.matrix)
        snes.setTolerances(rtol=0.0, atol=tolerance, stol=0.0, max_it=most)
        snes.setFromOptions()
        self.work.symmetric.aim(tolerance)
        try:
            snes.solve(None, y)
        except PETSc.Error as error:  # newer petsc4py wraps what an iteration raises
            raise error.__cause__ or error from None
        self.work.counts.iterations += snes.getIterationNumber()
        self.asked = tolerance
        # options may end an iteration earlier than the scene asks, but that is no equilibrium
        return snes.getConvergedReason() > 0 and self.norm <= tolerance

    @property
    def problem(self) -> Problem:
        """That of the last run."""
        assert self._problem is not None
        return self._problem

    @property
    def norm(self) -> float:
        """The residual's at the end of the last run (N)."""
        return float(self.snes.getFunctionNorm())

    @property
    def iterations(self) -> int:
        """Those of the last run."""
        return int(self.snes.getIterationNumber())

    def missed(self, method: str, y: PETSc.Vec) -> Outcome:
        """By how much the last run, which ended at y, missed its tolerance; and round-off, where it is to blame."""
        asked, why = self.asked, REASONS.get(self.snes.getConvergedReason(), "?")
        noise = max(round_off(self.problem, y))
        blame, blurred = "", None
        if self.norm < BLAMED * noise:
            blurred = self.problem.save(y)
            times = max(noise, self.norm) / asked
            blame = f"; round-off is {noise:.1e} N: a tolerance (statics.tolerance) {times:.0e} times as large is met"
        relative, given, short, _ = self.snes.getTolerances()
        early = f"; the option -snes_atol {given:g} is above it" if given > asked else ""
        for name, value in (("rtol", relative), ("stol", short)):  # 0 where no option says otherwise
            early += f"; the option -snes_{name} {value:g} may have ended it" if value else ""
        reason = f"norm {self.norm:.3e} N misses {asked:.3e} N ({why}){early}{blame}"
        if self.norm <= asked:  # a saddle, which no method takes
            reason = f"norm {self.norm:.3e} N meets {asked:.3e} N where the tangent is not positive definite"
        return Outcome(False, method, reason, blurred=blurred, norm=self.norm)

    def _report(self, _snes: PETSc.SNES, iteration: int, norm: float) -> None:
        assert self.work.monitor is not None
        self.work.monitor(self.problem.time, iteration, norm)
