"""From an unstable equilibrium to a stable one: along its softest mode, further and further."""

from petsc4py import PETSc

from voile.problem.problem import Problem
from voile.problem.scales import slow_rate
from voile.solver.cascade import attempt
from voile.solver.methods.method import Method, Outcome, Workspace
from voile.solver.methods.pseudo_transient import PseudoTransient
from voile.solver.stability import KICKS, NEUTRAL, kick


class OffSaddle:
    """minimise: finds a minimum beside the saddle, where supports hold the shell along every axis; transient: where
    they do not, for what nothing holds has no least potential. perturbation (m): of the first attempt."""

    name = "off a saddle"

    def __init__(self, work: Workspace, minimise: Method, transient: PseudoTransient, perturbation: float):
        self.work, self.minimise, self.transient = work, minimise, transient
        self.perturbation = perturbation

    def solve(self, problem: Problem, y: PETSc.Vec, tolerance: float) -> Outcome:
        """See Method; y starts at the saddle."""
        if not problem.supported:
            return self.transient.leave(problem, y, tolerance)
        saddle = problem.save(y)
        outcome = Outcome(False, self.name, "no way off the saddle")
        for further in range(KICKS):
            growth = kick(self.work, problem, y, saddle, self.perturbation, further)
            if growth <= NEUTRAL * slow_rate(problem):
                return Outcome(True, "semismooth")
            outcome = attempt(self.minimise, problem, y, tolerance)
            if outcome.converged:
                break
        return outcome
