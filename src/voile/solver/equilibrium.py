"""Which methods find the equilibria of a problem, in which order.

Without contact: mixed Newton steps follow a branch; descent is the last resort. With contact and friction: the
semismooth method and, for what a disturbance left out of balance, tied contacts; the augmented Lagrangian where
supports hold the shell along every axis, and implicit steps in pseudo-time.
"""

import math
from dataclasses import replace

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from voile.problem.contact import contact_of
from voile.problem.imperfection import perturb
from voile.problem.problem import Problem
from voile.solver.balance import unbalanced
from voile.solver.cascade import Cascade, attempt
from voile.solver.linear import Counts
from voile.solver.methods.augmented_lagrangian import AugmentedLagrangian
from voile.solver.methods.augmented_lagrangian import Options as LagrangianOptions
from voile.solver.methods.complementarity import OPTION, Complementarity
from voile.solver.methods.descent import Descent
from voile.solver.methods.descent import Options as DescentOptions
from voile.solver.methods.method import Method, Outcome, Workspace
from voile.solver.methods.mixed_newton import MixedNewton
from voile.solver.methods.mixed_newton import Options as MixedOptions
from voile.solver.methods.off_saddle import OffSaddle
from voile.solver.methods.pseudo_transient import PseudoTransient, WatchedTransient
from voile.solver.methods.semismooth import Semismooth, law_norms
from voile.solver.methods.steps import Sharpened
from voile.solver.methods.tied import Tied
from voile.solver.multigrid import with_levels
from voile.solver.nested import Nested, Promising, pays
from voile.solver.path import StaticsOptions

# Patience of descents in pseudo-time: drapes of 32 x 32 cells took 343 factorisations with 2, 279 with 8.
ROUGH_PATIENCE = 8
# Of descents on coarse levels, which are starts. One of a pleated dress, with hinges near 180 degrees, gained 0.1 % in
# 20 steps, and in 3,900 more no use to the fine level.
CREEP = 1e-3


class Solver:
    """Finds equilibria of a problem at any time."""

    def __init__(
        self,
        problem: Problem,
        options: StaticsOptions,
        counts: Counts | None = None,
        descent: DescentOptions | None = None,
    ):
        self.problem, self.work = problem, Workspace(problem, counts)
        self.work.watch = options.watch
        self.work.symmetric = with_levels(problem, self.work.symmetric)
        self.perturbation = options.perturbation * problem.thickness()
        self.descent = Descent(self.work, descent)
        self.off_saddle: OffSaddle | None = None
        self.nests = options.nested and pays(problem)
        self.nested: Nested | None = None
        if problem.contact:
            self._for_contact(problem, options)
        else:
            mixed = MixedNewton(self.work, MixedOptions(iterations=10) if self.nests else None)
            minimum: Method = Sharpened(Minimum(self.descent, self.perturbation), self.descent)
            self.first: Method = Sharpened(mixed, mixed) if options.first == "newton" else minimum
            first, nested = self._nested(self.first, minimum, options)
            self.near = Cascade([first])
            self.rest = self.all = Cascade([*nested, minimum])
            # Where a level does not start from the next coarser one, neither will the finer ones.
            self.level: Method = Cascade(nested or [minimum])

    def _for_contact(self, problem: Problem, options: StaticsOptions) -> None:
        work, descent, off = self.work, self.descent, self.perturbation
        self.semismooth = Semismooth(work)
        first: Method = self.semismooth
        if PETSc.Options().hasName(OPTION):
            first = Complementarity(work, self.semismooth)
        self.first = first
        tied = Tied(descent, self.semismooth)
        rough = Descent(work, DescentOptions(patience=ROUGH_PATIENCE), "transient_")
        transient = PseudoTransient(work, rough, self.semismooth, off)
        self.watched = WatchedTransient(work, rough, self.semismooth, off)
        stiff = AugmentedLagrangian(descent, self.semismooth, off, LagrangianOptions(softest=1.0))
        self.off_saddle = OffSaddle(work, stiff, transient, off)
        contact = contact_of(problem)
        near: list[Method] = [tied, first]
        later: list[Method] = [transient]
        if problem.held:  # or else it is made again in such steps
            later = [self.watched, transient]
        fine = later[0]
        if problem.supported:  # what nothing holds has no least potential
            later = [AugmentedLagrangian(descent, self.semismooth, off), *later]
        if options.first == "newton":
            first, nested = self._nested(first, fine, options)
            near = [first, *nested, tied]
            if problem.moves or contact.moves:
                # A cut costs another equilibrium, and nothing is off balance.
                near, later = [first, *later], [tied]
        self.near, self.rest = Cascade(near, self.off_saddle), Cascade(later)
        self.level = self.all = Cascade([*near, *later], self.off_saddle)

    def _nested(self, first: Method, fine: Method, options: StaticsOptions) -> tuple[Method, list[Method]]:
        """The first method, and nested iteration around another, where that pays."""
        if not self.nests:
            return first, []
        coarse = replace(options, watch=None)  # of the problem's own unknowns
        brief = DescentOptions(creep=CREEP)
        self.nested = Nested(self.problem, fine, lambda level: Solver(level, coarse, self.work.counts, brief))
        return Promising(first, self.nested), [self.nested]

    def promises(self, problem: Problem, y: PETSc.Vec, tolerance: float) -> bool:
        """Whether the first method converges on the coarsest level of the problem, from y; y moves."""
        if self.nested:
            return self.nested.promises(problem, y, tolerance)
        found = attempt(self.first, problem, y, tolerance)
        return found.converged or found.saddle is not None

    def solve(self, problem: Problem, y: PETSc.Vec, wanted: float, by: Method) -> Outcome:
        """y and what contact remembers end at the equilibrium with a norm under `wanted` (N), or where they were.
        by: `near`, the methods that follow a branch; `rest`, the others; `all`; or `watched`, steps that do not lead
        through obstacles."""
        if not math.isfinite(wanted):
            return Outcome(False, "", "the loads are not finite")
        if not problem.contact:
            return attempt(by, problem, y, wanted)
        if _carried_through(problem, y):
            reason = "supports carry layers of the shell through each other in one load step"
            return Outcome(False, "", reason)
        force = problem.create_vector()
        problem.residual(y, force)
        if not math.isfinite(force.norm()):
            return Outcome(False, "", "supports strain the shell beyond what its model can in one load step")
        if sliding := unbalanced(problem, y, wanted):
            return Outcome(False, "", sliding, gone=True)
        outcome = attempt(by, problem, y, wanted)
        if outcome.converged and not math.isfinite(outcome.norm):
            outcome = replace(outcome, norm=math.hypot(*law_norms(problem, y, y.duplicate(), wanted)))
        return outcome

    def leave_saddle(self, problem: Problem, y: PETSc.Vec, wanted: float) -> bool:
        """Whether a stable equilibrium was found from the saddle y, where y then is."""
        assert self.off_saddle
        return attempt(self.off_saddle, problem, y, wanted).converged


def _carried_through(problem: Problem, y: PETSc.Vec) -> bool:
    """Whether supports alone, moved from where the load step began, push layers of the shell through each other."""
    contact = problem.contact
    if not (contact and contact.itself and problem.moves):
        return False
    began = problem.at(contact.history.time).positions(y)
    if not problem.everywhere(np.array_equal(began, contact.history.reference)):
        return False  # the step is on its way
    share = contact.free_share(began, problem.positions(y))
    return bool(problem.comm.allreduce(share, op=MPI.MIN) < 1.0)


class Minimum:
    """Descent from a start moved off symmetry (perturbation, m)."""

    def __init__(self, descent: Descent, perturbation: float):
        self.descent, self.perturbation = descent, perturbation

    def solve(self, problem: Problem, y: PETSc.Vec, tolerance: float) -> Outcome:
        """See Method."""
        perturb(problem, y, self.perturbation)
        return self.descent.solve(problem, y, tolerance)
