"""What a path in time is: its options, its steps and its outcome."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from petsc4py import PETSc

from voile.arrays import Flags
from voile.problem.damping import Air, Damping
from voile.problem.support_forces import Supporting
from voile.solver.linear import Counts
from voile.solver.stepping.books import Books
from voile.solver.stepping.schemes import Kinematics, Scheme


@dataclass
class TimeOptions:
    """scheme; time_step and duration (s); tolerance: of each step's residual over the loads; air: that drags on the
    shell; damping: Rayleigh's; accuracy: local error of a step in sizes of the shell, 0: all steps are as long as
    time_step; stop_at_rest (m/s): ends the path once nothing is faster, 0: never; advice: what helps where energy comes
    from nowhere."""

    scheme: Scheme
    time_step: float
    duration: float
    tolerance: float = 1e-6
    air: Air | None = None
    damping: Damping = Damping()
    accuracy: float = 0.0
    stop_at_rest: float = 0.0
    advice: str = "shorter steps"


@dataclass
class TimeStep:
    """One step: its end `time` and length (s), iterations, norms of forces out of balance and of what contact's laws
    miss (N), the tolerance of both together (N), potential energies (J), contact's figures, method, and the largest
    speed (m/s) of a vertex at its end."""

    time: float
    length: float
    iterations: int
    balance_residual: float
    law_residual: float
    tolerance: float
    energies: dict[str, float]
    contact: dict[str, Any] | None
    method: str
    speed: float

    @property
    def residual(self) -> float:
        """Of balance and laws together (N)."""
        return float(np.hypot(self.balance_residual, self.law_residual))


@dataclass
class TimePath:
    """The outcome: `state` (unknowns), kinematics and books of the last good step, also when `converged` is False; what
    supports exerted in it; how many steps missed their tolerance clearly (`short`), by how many times at most. For the
    next step: its length (s), the largest force without loads so far (N), which vertices (n,) something pushed."""

    state: PETSc.Vec
    kinematics: Kinematics
    books: Books
    time: float = 0.0
    converged: bool = False
    reason: str = ""
    last: TimeStep | None = None
    supporting: Supporting | None = None
    methods: list[str] = field(default_factory=list)
    counts: Counts = field(default_factory=Counts)
    attempts: int = 0
    short: int = 0
    worst: float = 0.0
    length: float = 0.0
    largest: float = 0.0
    pushed: Flags = field(default_factory=lambda: np.zeros(0, dtype=bool))
    seconds: dict[str, float] = field(default_factory=dict)

    @property
    def figures(self) -> dict[str, Any]:
        """What summaries tell of it as of a load path: nothing, tasks tell theirs."""
        return {}

    @property
    def count(self) -> int:
        """Steps done."""
        return len(self.methods)

    @property
    def newton_iterations(self) -> int:
        """Those of all methods, failed attempts included."""
        return self.counts.iterations


OnStep = Callable[[TimeStep, TimePath], None]
