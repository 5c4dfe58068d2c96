"""The forward problem of an optimisation: equilibria under the full load, one after the other."""

from dataclasses import replace

from petsc4py import PETSc

from voile.problem.discrete import Problem
from voile.solver.frictional import FrictionalSolver
from voile.solver.path import StaticsOptions, tolerance
from voile.solver.statics import create_snes, solve_statics

PATIENCE = 200  # Newton iterations of one equilibrium


class Forward:
    """Equilibria under the full load from nearby ones, with one solver for all."""

    def __init__(self, problem: Problem, accuracy: float):
        """accuracy: residual over the loads' norm."""
        self.problem, self.options = problem, StaticsOptions(tolerance=accuracy)
        self.snes, self.newton = create_snes(problem, problem.create_matrix())
        self.contact = FrictionalSolver(problem, self.snes, self.newton) if problem.contact else None
        self.solves = 0

    def solve(self, y: PETSc.Vec) -> bool:
        """y moves to an equilibrium that descent reaches from it; False where it does not."""
        problem = self.problem
        self.solves += 1
        problem.load_factor = 1.0
        wanted = tolerance(problem, y, self.options)
        if self.contact:
            found = self.contact.solve(y, wanted, 2).converged
            problem.unbase(y)
            return found
        self.newton.descend = True
        self.snes.setTolerances(rtol=0.0, atol=wanted, stol=0.0, max_it=PATIENCE)
        self.snes.setFromOptions()
        self.snes.solve(None, y)
        return self.snes.getConvergedReason() > 0

    def search(self, y: PETSc.Vec) -> bool:
        """y moves to the equilibrium that statics find from it by all means; False where they do not."""
        path = solve_statics(self.problem, replace(self.options, load_steps=1), start=y)
        self.problem.load_factor = 1.0  # where statics fail they leave that of their last step
        self.problem.unbase(path.state)
        path.state.copy(y)
        return path.converged
