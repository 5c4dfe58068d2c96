"""Augmented Lagrangian: with frozen reactions and friction bounds contact is a potential, minimised by descent; then
the reactions are updated (a Tresca fixed point; Simo & Laursen 1992) and the semismooth method tried.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from voile.problem.augmented import AugmentedContact
from voile.problem.contact import contact_of
from voile.problem.imperfection import perturb
from voile.problem.problem import Problem
from voile.solver.cascade import attempt
from voile.solver.methods.astray import Astray
from voile.solver.methods.descent import Descent
from voile.solver.methods.method import Outcome
from voile.solver.methods.semismooth import Semismooth, law_norms
from voile.solver.methods.steps import to_round_off


@dataclass
class Options:
    """updates of the reactions, and `idle` ones in a row of which the laws miss no less than after one before, by which
    they converge no more: where friction is strong each update of its bounds undoes the last. With friction 5 nine
    everyday scenes took 5,811 factorisations for 7,072, with their own 38 others as many as without. roughest: first
    tolerance of the descents over the last, a hundredth of the loads. softest: contact's stiffness in the first
    descents over the shell's, so that its front moves over many vertices at once; stiffest: that at the end. Seven
    sheets whose supports move took 13,700 factorisations from 1e-4, 8,000 from 1e-2, more from 1; others as many.
    hardening: its factor after an update of which the laws miss more than `enough` of what they missed at the one
    before, as in algorithm 17.4 of Nocedal & Wright (2006). What is as stiff at once as the shell's membrane makes
    descents of cloths creep: hundreds of steps of a thousandth. sunk: sizes of the shell by which no reaction that
    there is may sink: contact starts the stiffer. Rubber drawn over a box pressed 130 times its weight on it, and each
    load step hardened contact anew, after descents that led far off (2,567 iterations for 1,018). iterations: of all
    descents; of 129 runs on 70 everyday scenes that converged none took as many. hopeless: times the tolerance, beyond
    which the semismooth method is not tried: of 43 such tries one converged. astray: sizes of the shell, a depth in an
    obstacle on the straight way: of 15 everyday scenes all and only those came so deep that pseudo-time had to solve
    again."""

    updates: int = 15
    idle: int = 3
    roughest: float = 1e6
    softest: float = 1e-2
    stiffest: float = 1.0
    hardening: float = 10.0
    enough: float = 0.25
    sunk: float = 0.01
    iterations: int = 300
    hopeless: float = 1e10
    astray: float = 0.02


class AugmentedLagrangian:
    """perturbation (m): off symmetry, at the start of a descent."""

    name = "augmented Lagrangian"

    def __init__(
        self,
        descent: Descent,
        semismooth: Semismooth,
        perturbation: float,
        options: Options | None = None,
    ):
        self.descent, self.semismooth, self.perturbation = descent, semismooth, perturbation
        self.options = options or Options()

    def solve(self, problem: Problem, y: PETSc.Vec, tolerance: float) -> Outcome:
        """See Method."""
        contact, options = contact_of(problem), self.options
        potential = AugmentedContact(contact, self._softness(problem))
        potential.freeze(problem.point(y))
        rough = options.roughest * tolerance
        if not contact.itself:
            perturb(problem, y, self.perturbation)
        missed = least = np.inf
        updates, idle, left = 0, 0, options.iterations
        while updates < options.updates and idle < options.idle and left > 0:
            held = problem.with_terms(potential)
            astray = Astray(held, options.astray) if problem.held else None
            done = self.descent.run(held, y, max(tolerance, rough), left, astray)
            left -= self.descent.nonlinear.iterations
            if not done and not to_round_off(held, y, self.descent.nonlinear.norm, max(tolerance, rough)):
                return self.descent.nonlinear.missed(self.name, y)
            before, missed = missed, law_norms(problem, y, y.duplicate(), tolerance)[1]
            potential.update(problem.point(y))
            if (found := self._finish(problem, y, tolerance)).converged:
                return replace(found, method=self.name)
            updates, idle = updates + 1, 0 if missed < max(least, tolerance) else idle + 1
            least = min(missed, least)
            if missed > options.enough * before:
                softness = min(options.hardening * potential.softness, options.stiffest)
                potential = replace(potential, softness=softness)
            rough *= 0.1
        failed = self.descent.nonlinear.missed(self.name, y)
        reason = f"{updates} updates of the reactions did not converge; {failed.reason}"
        return replace(failed, reason=reason)

    def _softness(self, problem: Problem) -> float:
        """Contact's stiffness in the first descent. Layers of the shell would collapse, and then no step is free."""
        contact, options = contact_of(problem), self.options
        if contact.itself:
            return 1.0
        softness = problem.reduced(contact.softest(options.sunk * problem.size()), MPI.MAX)
        return max(options.softest, min(float(softness), 1.0))

    def _finish(self, problem: Problem, y: PETSc.Vec, tolerance: float) -> Outcome:
        """The equilibrium that the updated reactions are those of, or near enough for the semismooth method."""
        norm = math.hypot(*law_norms(problem, y, y.duplicate(), tolerance))
        if norm <= tolerance:
            return Outcome(True, self.name, norm=norm)
        if norm > self.options.hopeless * tolerance:
            return Outcome(False, self.name, norm=norm)
        return attempt(self.semismooth, problem, y, tolerance)
