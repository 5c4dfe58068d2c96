"""Newton's method for a step in time, from its predicted positions.

Inertia makes a step's equations well-conditioned: without contact mixed Newton steps solve it, with contact and
friction the semismooth method. Where steps are long and those fail, a minimum of the step's potential is looked for.
"""

from dataclasses import dataclass

import numpy as np
from petsc4py import PETSc

from voile.contact.natural_map import LAYERS
from voile.contact.pairs import PENALTY
from voile.problem.damping import Wind
from voile.problem.problem import Problem
from voile.solver.cascade import Cascade
from voile.solver.linear import Counts
from voile.solver.methods.augmented_lagrangian import AugmentedLagrangian
from voile.solver.methods.augmented_lagrangian import Options as LagrangianOptions
from voile.solver.methods.descent import Descent
from voile.solver.methods.method import InertialWorkspace, Method, Outcome
from voile.solver.methods.mixed_newton import MixedNewton
from voile.solver.methods.semismooth import Semismooth, law_norms
from voile.solver.methods.steps import Sharpened


@dataclass
class Options:
    """sharp: of the tolerance, at which a guess is the step's end. With layers: stiffest, of contact in descents, as
    stiff as the equations. Pairs that meet in almost the same place, of a strip that folds along its cells, differ by a
    fiftieth of a weight. Updates as soft as the first one left three quarters of what the laws missed there, and no
    step was short enough."""

    sharp: float = 0.01
    stiffest: float = PENALTY / LAYERS


@dataclass
class Iterated:
    """A method whose systems are tried by iteration first."""

    method: Method
    work: InertialWorkspace

    def solve(self, problem: Problem, y: PETSc.Vec, tolerance: float) -> Outcome:
        """See Method."""
        drags = any(isinstance(term, Wind) for term in problem.terms)  # flutter grows from noise
        rough = problem.conservative and not problem.contact and not drags
        self.work.iterate(True, tolerance if rough else 0.0)
        try:
            return self.method.solve(problem, y, tolerance)
        finally:
            self.work.iterate(False)


class NewtonStep:
    """A method for the problems of steps, which have an inertia term."""

    def __init__(self, problem: Problem, options: Options | None = None):
        self.work, self.options = InertialWorkspace(problem), options or Options()
        self.descent = descent = Descent(self.work)
        methods: list[Method]
        if problem.contact:
            layers = problem.contact.itself is not None
            semismooth = Semismooth(self.work)
            stiffest = self.options.stiffest if layers else 1.0
            held = LagrangianOptions(softest=1.0, stiffest=stiffest)
            stiff = AugmentedLagrangian(descent, semismooth, 0.0, held)
            methods = [Iterated(semismooth, self.work), Iterated(stiff, self.work)]
        else:
            mixed = MixedNewton(self.work)
            methods = [
                Iterated(Sharpened(mixed, mixed), self.work),
                Iterated(Sharpened(descent, descent), self.work),
            ]
        self.cascade = Cascade(methods)

    @property
    def counts(self) -> Counts:
        """Of its linear algebra."""
        return self.work.counts

    def solve(self, problem: Problem, y: PETSc.Vec, tolerance: float) -> Outcome:
        """See Method. In free flight a guess that is far better than the tolerance is taken as it is. What bears never
        is: its stick is to be exact. Nothing is left from former steps, or a run that goes on would end elsewhere."""
        self.descent.iteration.forget()
        self.work.symmetric.forget()
        contact = problem.contact
        if contact and problem.everywhere(not any(normal.any() for normal in contact.history.normal)):
            norm = float(np.hypot(*law_norms(problem, y, y.duplicate(), tolerance)))
            if norm <= self.options.sharp * tolerance:
                return Outcome(True, "prediction", norm=norm)
        factored = self.counts.factorisations
        outcome = self.cascade.solve(problem, y, tolerance)
        if outcome.converged and not problem.contact and self.counts.factorisations > factored:
            self._polish(problem, y)
        return outcome

    def sharpen(self, problem: Problem, y: PETSc.Vec, tolerance: float) -> None:
        """One more iteration, mostly, from the solution y to a tolerance (N); y stays where that fails. With contact
        there is always one, and one is to round-off."""
        held, sharper = problem.save(y), tolerance if problem.contact else self.options.sharp * tolerance
        if not self.cascade.solve(problem, y, sharper).converged:
            problem.restore(y, held)

    def _polish(self, problem: Problem, y: PETSc.Vec) -> None:
        """One more correction with the last factor, which costs little and lets the books close."""
        residual, step = problem.create_vector(), y.duplicate()
        problem.residual(y, residual)
        norm = residual.norm()
        self.work.symmetric.solve(residual, step)
        y.axpy(-1.0, step)
        problem.residual(y, residual)
        if not residual.norm() < norm:
            y.axpy(1.0, step)
