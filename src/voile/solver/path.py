"""What a load path is: its options, its steps and its outcome."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, ClassVar, Literal

from petsc4py import PETSc

from voile.arrays import Array
from voile.errors import NotConverged
from voile.problem.problem import Problem
from voile.problem.scales import force_floor
from voile.problem.state import State
from voile.solver.linear import Counts

LIMIT_POINT, BIFURCATION = "limit point", "bifurcation"  # methods of steps that are one
STEPS = 10  # of the load, where supports or moving obstacles lead the shell


@dataclass
class StaticsOptions:
    """load_steps: first step is 1/load_steps, None: see the function `load_steps`; max_steps: attempts in all;
    perturbation off unstable branches in thicknesses; tolerance: residual over the load's norm; stability: test the end
    state, eigenvalue: with its smallest eigenvalue; first: the method to begin with, newton near an equilibrium,
    descent from a start that strains the shell far beyond one, where full steps are of no use; nested: coarser levels
    of the mesh first, where that pays (see solver.nested); load_factors: prescribed ends of load steps, ascending, the
    last one 1; watch: told of descents' iterates (unknowns), it may raise to end the path."""

    load_steps: int | None = None
    max_steps: int = 1000
    perturbation: float = 1.0
    tolerance: float = 1e-8
    stability: bool = True
    eigenvalue: bool = False
    first: Literal["newton", "descent"] = "newton"
    nested: bool = False
    load_factors: tuple[float, ...] = ()
    watch: Callable[[PETSc.Vec], None] | None = None


@dataclass
class LoadStep:
    """One converged equilibrium of the path; negative: eigenvalues of its tangent; contact: its figures (see
    problem.contact); method: which found it; reason why it is one; displacement (m) along the load, where the path
    is followed along its arc."""

    factor: float
    iterations: int
    residual: float
    tolerance: float
    energies: dict[str, float]
    negative: int | None = None
    contact: dict[str, Any] | None = None
    method: str = "newton"
    reason: str = "residual below tolerance"
    displacement: float | None = None


@dataclass(frozen=True)
class Jump:
    """A load step that left its branch: how much it moved the shell, in sizes, and how many times that what the step
    before let expect."""

    start: float
    end: float
    moved: float
    times: float


@dataclass
class Path:
    """The outcome: `state` is the last converged one (unknowns), also when `converged` is False. blurred: where
    the next step ended and its state, if only round-off may have kept it from the tolerance."""

    state: PETSc.Vec
    converged: bool = False
    reason: str = ""
    steps: list[LoadStep] = field(default_factory=list)
    counts: Counts = field(default_factory=Counts)
    attempts: int = 0
    jumps: list[Jump] = field(default_factory=list)
    stable: bool | None = None
    smallest_eigenvalue: float | None = None
    seconds: dict[str, float] = field(default_factory=dict)
    blurred: tuple[LoadStep, State] | None = None
    supporting: ClassVar[None] = None  # what supports exert at rest

    @property
    def time(self) -> float:
        """The load factor at its end."""
        return self.last.factor if self.last else 0.0

    @property
    def figures(self) -> dict[str, Any]:
        """What summaries tell of load paths only."""
        value = self.smallest_eigenvalue
        return {
            "load_factor": self.time,
            "stable": self.stable,
            "smallest_eigenvalue": None if value is None or math.isnan(value) else value,
        }

    @property
    def last(self) -> LoadStep | None:
        """Its last step."""
        return self.steps[-1] if self.steps else None

    @property
    def count(self) -> int:
        """Steps done."""
        return len(self.steps)

    @property
    def methods(self) -> list[str]:
        """Which found each step."""
        return [step.method for step in self.steps]

    def found_by(self, *methods: str) -> list[LoadStep]:
        """The steps that these methods found."""
        return [step for step in self.steps if step.method in methods]

    @property
    def newton_iterations(self) -> int:
        """Those of all methods, failed attempts included."""
        return self.counts.iterations


Progress = Callable[[LoadStep, PETSc.Vec], None]
Arrays = dict[str, Array]
Pause = Callable[[Callable[[], Arrays]], None]  # told where a path may go on from this rank's arrays


def require(path: Path) -> Path:
    """The path itself, or NotConverged with the reason."""
    if not path.converged:
        raise NotConverged(f"statics did not converge: {path.reason}")
    return path


def load_steps(problem: Problem, options: StaticsOptions) -> int:
    """Those of the options; else 10, or 1 for a shell with obstacles where nothing moves: partial loads would lead it
    through drapes that it never hangs in."""
    contact = problem.contact
    falls = contact is not None and not (problem.moves or contact.moves)
    return options.load_steps or (1 if falls else STEPS)


def tolerance(problem: Problem, y: PETSc.Vec, options: StaticsOptions) -> float:
    """What the residual's norm must fall to (N): a fraction of the loads' norm; without loads of the supports'
    reactions, but not below the round-off of an unloaded shell."""
    loads = problem.load_norm(y)
    if loads > 0.0:
        return options.tolerance * loads
    return max(options.tolerance * problem.reaction_norm(y), force_floor(problem))
