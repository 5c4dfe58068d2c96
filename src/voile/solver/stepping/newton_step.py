"""Newton's method for a step in time, from its predicted positions.

Inertia makes a step's equations well-conditioned: without contact mixed Newton steps solve it, with contact and
friction the semismooth method. Where steps are long and those fail, a minimum of the step's potential is looked for.
"""

from petsc4py import PETSc

from voile.problem.problem import Problem
from voile.solver.cascade import Cascade
from voile.solver.linear import Counts
from voile.solver.methods.augmented_lagrangian import AugmentedLagrangian
from voile.solver.methods.augmented_lagrangian import Options as LagrangianOptions
from voile.solver.methods.descent import Descent
from voile.solver.methods.method import Method, Outcome, Workspace
from voile.solver.methods.mixed_newton import MixedNewton
from voile.solver.methods.semismooth import Semismooth
from voile.solver.methods.steps import Sharpened


class NewtonStep:
    """A method for the problems of steps, which have an inertia term."""

    def __init__(self, problem: Problem):
        self.work = Workspace(problem)
        descent, methods = Descent(self.work), list[Method]()
        if problem.contact:
            semismooth = Semismooth(self.work)
            firm = AugmentedLagrangian(descent, semismooth, 0.0, LagrangianOptions(softest=1.0))
            methods = [semismooth, firm]
        else:
            mixed = MixedNewton(self.work)
            methods = [Sharpened(mixed, mixed), Sharpened(descent, descent)]
        self.cascade = Cascade(methods)

    @property
    def counts(self) -> Counts:
        """Of its linear algebra."""
        return self.work.counts

    def solve(self, problem: Problem, y: PETSc.Vec, tolerance: float) -> Outcome:
        """See Method."""
        return self.cascade.solve(problem, y, tolerance)
