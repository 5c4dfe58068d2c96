"""Whether a descent leads the shell through an obstacle: soft contact lets it through, or it went around."""

from petsc4py import PETSc

from voile.problem.contact import contact_of, leads_through
from voile.problem.problem import Problem

LOOKS = 4  # iterations from look to look: one costs about a residual, and few descents go astray


class Astray:
    """Tells of iterates that lie deeper than `depth` (sizes of the shell) in an obstacle somewhere on the straight way
    since the start of the load step."""

    def __init__(self, problem: Problem, depth: float):
        self.problem, self.depth, self.calls = problem, depth, 0

    def __call__(self, y: PETSc.Vec) -> bool:
        self.calls += 1
        if self.calls % LOOKS:
            return False
        problem, began = self.problem, contact_of(self.problem).history
        return leads_through(problem, began.reference, began.time, problem.positions(y), self.depth)
