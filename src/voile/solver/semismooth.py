"""Semismooth Newton method for equilibrium together with Signorini's and Coulomb's laws, as a PETSc SNES.

Unknowns are displacements, director angles and the reactions of the contacts that may carry one. Per iteration: one
factorisation of the shell's tangent, to which each active contact adds a firm 3x3 block, and a few more solves with it
that turn those into the exact linearised laws, the reactions being multipliers. Without slip the matrix is symmetric
and the factorisation counts negative eigenvalues on the contacts' tangent space; with slip it is not, and LU serves.
"""

from dataclasses import dataclass, field

import numpy as np
from petsc4py import PETSc

from voile.contact.state import Contact, Linearised
from voile.problem.discrete import Problem
from voile.solver.newton import NOT_FINITE, REACH, factorisation_error, negative_pivots, renew, timed

CORRECTIONS = 3  # solves with one factorisation that turn firm stiffnesses into constraints
MOST = 60  # iterations
SINGULAR = PETSc.SNES.ConvergedReason.DIVERGED_LINEAR_SOLVE
PATIENCE = 6  # iterations without halving the norm after which it will not converge, or cycles


@dataclass
class Iteration:
    """One step of the semismooth method: norms of the equilibrium's residual and of the laws' mismatch (N)."""

    residual: float
    mismatch: float
    symmetric: bool
    changed: bool  # some pair opened, closed, stuck or slipped


@dataclass
class Semismooth:
    """Python context of a SNES for a problem with contact; its function norm is that of residual and mismatch."""

    problem: Problem
    contact: Contact
    steps: list[Iteration] = field(default_factory=list)
    seconds: float = 0.0
    negative: int | None = (
        None  # negative eigenvalues on the contacts' tangent space; None where slip hides them
    )

    _lu: PETSc.PC | None = None

    def solve(self, snes: PETSc.SNES, b: PETSc.Vec | None, y: PETSc.Vec) -> None:
        """Iterates until SNES's convergence test says so; sets its reason. The reactions are in `contact`."""
        problem, matrix = self.problem, snes.getJacobian()[0]
        f, direction, states = snes.getFunction()[0], y.duplicate(), None
        self.steps = []
        kind = "exact"
        first, best, idle, there = 0.0, np.inf, 0, None
        for it in range(MOST + 1):
            residual, mismatch = self.norms(y, f)
            norm = float(np.hypot(residual, mismatch))
            first = first or norm
            snes.setIterationNumber(it)
            snes.setFunctionNorm(norm)
            snes.logConvergenceHistory(norm, 0)
            snes.monitor(it, norm)
            idle = 0 if norm < 0.5 * best else idle + 1
            best = min(norm, best)
            reason = NOT_FINITE
            if norm <= 1e8 * first:
                reason = snes.callConvergenceTest(it, y.norm(), direction.norm() if it else 0.0, norm)
            if there and reason <= 0:  # as where the tangent is singular
                norm, reason = self._back(snes, y, there)
            if reason and (it or reason < 0):
                snes.setConvergedReason(reason)
                return
            # What holds from the start takes one step for its inertia, and to be sharper.
            there = (y.copy(), self.contact.state.copy(), norm, reason) if reason else None
            if it == MOST or idle > PATIENCE:
                break
            linear = self.contact.linearise(problem.positions(y), problem.load_factor)
            symmetric = problem.everywhere(linear.symmetric)
            problem.tangent(y, matrix, kind, linear.blocks())
            pc = self._factor(snes, matrix, symmetric)
            if pc:
                self._direction(pc, matrix, linear, y, f, direction)
            if not (pc and np.isfinite(direction.norm())):
                reason = self._back(snes, y, there)[1] if there else SINGULAR
                snes.setConvergedReason(reason)
                return
            share = min(1.0, REACH / max(problem.largest_motion(direction), 1e-300))
            direction.scale(share)
            through = problem.free_share(y, direction)
            direction.scale(through)
            share *= through
            problem.predict(y, direction)
            y.axpy(1.0, direction)
            linear.reactions(share)
            now = linear.states()
            self.steps.append(Iteration(residual, mismatch, symmetric, now != states))
            states, kind = now, "mixed"
        snes.setConvergedReason(PETSc.SNES.ConvergedReason.DIVERGED_MAX_IT)

    def _back(self, snes: PETSc.SNES, y: PETSc.Vec, there: tuple) -> tuple[float, int]:
        """y and the reactions are again those of a state that converged with this norm for this reason."""
        start, self.contact.state, norm, reason = there
        start.copy(y)
        snes.setFunctionNorm(norm)
        return norm, reason

    def norms(self, y: PETSc.Vec, f: PETSc.Vec) -> tuple[float, float]:
        """Norms of the equilibrium's residual, left in f, and of the laws' mismatch (N)."""
        problem = self.problem
        x = problem.positions(y)
        with self.contact.measured():
            problem.residual(y, f, self.contact.force(x, problem.load_factor, frozen=False))
            mismatch = problem.comm.allreduce(self.contact.mismatch(x, problem.load_factor))
        return f.norm(), float(np.sqrt(mismatch))

    def _factor(self, snes: PETSc.SNES, matrix: PETSc.Mat, symmetric: bool) -> PETSc.PC | None:
        """Cholesky or LU of the matrix; None where it fails."""
        pc = snes.ksp.pc if symmetric else self._unsymmetric()
        with timed(self):
            renew(pc, matrix)
            pc.setOperators(matrix)
            pc.setUp()
        if factorisation_error(pc):
            pc.reset()
            self.negative = None
            return None
        self.negative = negative_pivots(pc)
        return pc

    def _unsymmetric(self) -> PETSc.PC:
        if self._lu is None:
            self._lu = PETSc.PC().create(comm=self.problem.comm)
            self._lu.setOptionsPrefix("friction_")
            self._lu.setType(PETSc.PC.Type.LU)
            self._lu.setFactorSolverType("mumps")
            self._lu.setFromOptions()
        return self._lu

    def _direction(self, pc, matrix, linear: Linearised, y, f, direction) -> None:
        """The Newton step: corrects reactions and step until the firm stiffnesses carry nothing."""
        problem = self.problem
        direction.set(0.0)
        image, part = direction.duplicate(), direction.duplicate()
        for _ in range(CORRECTIONS):
            problem.residual(y, f, linear.force())
            matrix.mult(direction, image)
            f.axpy(1.0, image)
            with timed(self):
                pc.apply(f, part)
            direction.axpy(-1.0, part)
            linear.advance(problem.motion(direction))
