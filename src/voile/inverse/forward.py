"""The forward problem of an optimisation: equilibria under the full load, one after the other."""

from dataclasses import replace

from petsc4py import PETSc

from voile.problem.problem import Problem
from voile.solver.equilibrium import Solver
from voile.solver.linear import Counts
from voile.solver.path import StaticsOptions, tolerance
from voile.solver.statics import solve_statics

PATIENCE = 200  # Newton iterations of one equilibrium


class Forward:
    """Equilibria under the full load from nearby ones, with one solver for all."""

    def __init__(self, problem: Problem, accuracy: float, counts: Counts):
        """accuracy: residual over the loads' norm; counts: of the run."""
        self.problem, self.options = problem.at(1.0), StaticsOptions(tolerance=accuracy)
        self.solver, self.counts, self.solves = Solver(problem, self.options, counts), counts, 0

    def solve(self, y: PETSc.Vec) -> bool:
        """y moves to an equilibrium that descent reaches from it; False where it does not. It depends on the start and
        the problem alone, not on what was solved before: a search that goes on finds the same."""
        problem = self.problem
        self.solves += 1
        self.solver.descent.iteration.forget()
        wanted = tolerance(problem, y, self.options)
        if problem.contact:
            found = self.solver.solve(problem, y, wanted, self.solver.all).converged
            problem.reset_origin(y)
            return found
        return self.solver.descent.run(problem, y, wanted, PATIENCE)

    def search(self, y: PETSc.Vec) -> bool:
        """y moves to the equilibrium that statics find from it by all means; False where they do not."""
        path = solve_statics(self.problem, replace(self.options, load_steps=1), start=y, counts=self.counts)
        self.problem.reset_origin(path.state)
        path.state.copy(y)
        return path.converged
