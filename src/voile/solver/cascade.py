"""Methods tried one after the other: each from where the last one began, and the outcome says who found it."""

from collections.abc import Sequence
from dataclasses import dataclass

from petsc4py import PETSc

from voile.problem.problem import Problem
from voile.solver.methods.method import Method, Outcome


def attempt(method: Method, problem: Problem, y: PETSc.Vec, tolerance: float) -> Outcome:
    """One method; puts y and what contact remembers back where it fails."""
    start = problem.save(y)
    outcome = method.solve(problem, y, tolerance)
    if not outcome.converged:
        problem.restore(y, start)
    return outcome


@dataclass
class Cascade:
    """A method itself: ends with the first of its methods that converges or finds that there is no equilibrium.
    off_saddle: tried from an unstable one where the first method ends there."""

    methods: Sequence[Method]
    off_saddle: Method | None = None

    def solve(self, problem: Problem, y: PETSc.Vec, tolerance: float) -> Outcome:
        """See Method."""
        outcome = Outcome(False, "")
        for method in self.methods:
            found = attempt(method, problem, y, tolerance)
            if not found.converged and not found.reason:
                continue  # nothing that it could try: what failed before tells more
            outcome = found
            if outcome.saddle and self.off_saddle and method is self.methods[0]:
                outcome = self._leave(problem, y, tolerance, outcome)
            if outcome.converged or outcome.gone:
                break
        return outcome

    def _leave(self, problem: Problem, y: PETSc.Vec, tolerance: float, found: Outcome) -> Outcome:
        assert self.off_saddle and found.saddle
        start = problem.save(y)
        problem.restore(y, found.saddle)
        outcome = self.off_saddle.solve(problem, y, tolerance)
        if not outcome.converged:
            problem.restore(y, start)
        return outcome
