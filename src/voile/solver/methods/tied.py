"""Contacts tied by stiff springs, then the semismooth method.

A shell disturbed beside an equilibrium lets go of its contacts first, if the laws decide far from balance. Here every
active contact stays closed and sticks, preloaded with its reaction, while a descent settles the shell around it.
"""

from dataclasses import dataclass, replace

from petsc4py import PETSc

from voile.problem.contact import contact_of
from voile.problem.problem import Problem
from voile.problem.tied import TiedContact
from voile.solver.methods.descent import Descent
from voile.solver.methods.method import Outcome
from voile.solver.methods.semismooth import Semismooth


@dataclass
class Options:
    """iterations of the descent. settled: its tolerance over the load step's, for what comes after is sharp; nearly:
    the same where round-off of the stiff springs stops it before."""

    iterations: int = 300
    settled: float = 1e2
    nearly: float = 1e4


class Tied:
    """Descent with tied contacts, then `semismooth`."""

    name = "tied contacts"

    def __init__(self, descent: Descent, semismooth: Semismooth, options: Options | None = None):
        self.descent, self.semismooth, self.options = descent, semismooth, options or Options()

    def solve(self, problem: Problem, y: PETSc.Vec, tolerance: float) -> Outcome:
        """See Method."""
        options, tied = self.options, TiedContact(contact_of(problem), problem.positions(y), problem.time)
        if problem.everywhere(not tied.active):
            return Outcome(False, self.name, "")
        settled = self.descent.run(
            problem.with_terms(tied), y, options.settled * tolerance, options.iterations
        )
        nonlinear = self.descent.nonlinear
        if not settled and not nonlinear.norm <= options.nearly * tolerance:
            return nonlinear.missed(self.name, y)
        return replace(self.semismooth.solve(problem, y, tolerance), method=self.name)
