"""Frictionless contact as a mixed complementarity problem for PETSc's SNESVI.

    R(y) - G(y)^T r = 0,    0 <= r  perpendicular to  g(y) >= 0

Unknowns y and a reaction r for each candidate, a pair of vertex and obstacle nearer than REACH. Chosen by the option
-contact_snes_type (vinewtonrsls, vinewtonssls); options of that prefix go to it.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import scipy.sparse as sp
from mpi4py import MPI
from petsc4py import PETSc

from voile.arrays import Ints, Reals
from voile.contact.contact import Contact
from voile.errors import InputError
from voile.problem.contact import contact_of
from voile.problem.lifetime import until_the_end
from voile.problem.problem import Problem
from voile.solver.linear import set_defaults, use_lu
from voile.solver.methods.method import Outcome, Workspace
from voile.solver.methods.semismooth import Semismooth

REACH = 0.1  # of the shell's size
OPTION = "contact_snes_type"
# Whole steps: backtracking on the residual's norm gets stuck, as that rises where the active set has to change.
# Work space in per cent: pivoting wants more than the estimate.
DEFAULTS = {"contact_snes_linesearch_type": "basic", "contact_mat_mumps_icntl_14": "200"}


class Complementarity:
    """SNESVI, then a step of the semismooth method for the inertia."""

    name = "complementarity"

    def __init__(self, work: Workspace, semismooth: Semismooth):
        self.work, self.semismooth = work, semismooth

    def solve(self, problem: Problem, y: PETSc.Vec, tolerance: float) -> Outcome:
        """See Method. Raises InputError where something rubs, or layers of the shell touch."""
        contact = contact_of(problem)
        if contact.itself or any(friction > 0.0 for _, friction in contact.frictions):
            raise InputError(
                f"-{OPTION}: SNESVI solves frictionless contact with obstacles; allowed: friction = 0 on all, "
                "contact.self_contact = false"
            )
        snes = Inequality(problem, contact, self.work.matrix, y).solve(tolerance)
        self.work.counts.iterations += snes.getIterationNumber()
        if snes.getConvergedReason() <= 0:
            return Outcome(False, snes.getType(), f"{snes.getType()} did not converge")
        return replace(self.semismooth.solve(problem, y, tolerance), method=snes.getType())


class Inequality:
    """One solve's candidates, vectors and matrices. Gaps enter as forces, times the shell's own stiffness."""

    def __init__(self, problem: Problem, contact: Contact, tangent: PETSc.Mat, y: PETSc.Vec):
        self.problem, self.contact, self.tangent, self.y = problem, contact, tangent, y
        x = problem.positions(y)
        own = problem.own & contact.movable
        gaps = [contact.gap(k, x, problem.time) for k in range(len(contact.obstacles))]
        self.pairs = [np.flatnonzero(own & (gap < REACH * problem.size())) for gap in gaps]
        count = sum(len(v) for v in self.pairs)
        self.count, self.split = count, y.getLocalSize()
        self.unknowns = PETSc.Vec().createMPI((self.split + count, None), comm=problem.comm)

    def solve(self, wanted: float) -> PETSc.SNES:
        """Solves from the present unknowns and reactions; leaves both at the last iterate."""
        z = self.unknowns
        state = self.contact.history
        z.array[: self.split] = self.y.array_r
        z.array[self.split :] = np.concatenate([state.normal[k][v] for k, v in enumerate(self.pairs)])
        low, high = z.duplicate(), z.duplicate()
        low.set(-np.inf)
        low.array[self.split :] = 0.0
        high.set(np.inf)
        snes = until_the_end(PETSc.SNES().create(comm=self.problem.comm))
        snes.setOptionsPrefix("contact_")
        snes.setType("vinewtonrsls")
        snes.setFunction(self._residual, z.duplicate())
        snes.setVariableBounds(low, high)
        matrix = self._jacobian_at(z)
        snes.setJacobian(self._jacobian, matrix)
        snes.setTolerances(rtol=0.0, atol=wanted, stol=0.0, max_it=200)
        snes.ksp.setType(PETSc.KSP.Type.PREONLY)
        use_lu(snes.ksp.pc)
        set_defaults(DEFAULTS)
        snes.setFromOptions()
        snes.solve(None, z)
        self._take(z)
        return snes

    def _take(self, z: PETSc.Vec) -> None:
        """Unknowns and reactions of z become the present ones, on all ranks that see a candidate's vertex."""
        problem, state = self.problem, self.contact.history
        self.y.array[:] = z.array_r[: self.split]
        state.friction = [np.zeros_like(a) for a in state.friction]
        place = np.full(
            int(problem.comm.allreduce(int(problem.part.vertex.max(initial=-1)), op=MPI.MAX)) + 1, -1
        )
        place[problem.part.vertex] = np.arange(len(problem.part.vertex))
        at = self.split
        for k, v in enumerate(self.pairs):
            mine = (problem.part.vertex[v], z.array_r[at : at + len(v)])
            at += len(v)
            state.normal[k] = np.zeros_like(state.normal[k])
            for vertex, reaction in problem.comm.allgather(mine):
                here = place[vertex]
                state.normal[k][here[here >= 0]] = reaction[here >= 0]

    def _residual(self, _snes: PETSc.SNES, z: PETSc.Vec, f: PETSc.Vec) -> None:
        self._take(z)
        problem, contact = self.problem, self.contact
        x, part = problem.positions(self.y), self.y.duplicate()
        forces = np.zeros_like(x)
        gaps = []
        for k, obstacle in enumerate(contact.obstacles):
            pressed = np.flatnonzero(contact.history.normal[k])
            _, gradient, _ = obstacle.gap_derivatives(x[pressed], problem.time)
            forces[pressed] += contact.history.normal[k][pressed, None] * gradient
            gaps.append(contact.gap(k, x, problem.time, self.pairs[k]))
        problem.residual(self.y, part, forces)
        f.array[: self.split] = part.array_r
        f.array[self.split :] = contact.stiffness * np.concatenate(gaps)

    def _jacobian(self, _snes: PETSc.SNES, z: PETSc.Vec, _matrix: PETSc.Mat, matrix: PETSc.Mat) -> None:
        fresh = self._jacobian_at(z)
        fresh.copy(matrix, structure=PETSc.Mat.Structure.DIFFERENT_NONZERO_PATTERN)

    def _jacobian_at(self, z: PETSc.Vec) -> PETSc.Mat:
        self._take(z)
        problem, contact = self.problem, self.contact
        x, factor = problem.positions(self.y), problem.time
        curved, rows = [], []
        for k, obstacle in enumerate(contact.obstacles):
            pressed = np.flatnonzero(contact.history.normal[k])
            _, _, curvature = obstacle.gap_derivatives(x[pressed], factor)
            curved.append((pressed, -contact.history.normal[k][pressed, None, None] * curvature))
            rows.append((self.pairs[k], obstacle.gap_derivatives(x[self.pairs[k]], factor)[1]))
        problem.tangent(self.y, self.tangent, "exact", curved)
        gap_rows = self._gap_rows(rows)
        push = PETSc.Mat()
        gap_rows.transpose(push)
        push.scale(-1.0 / contact.stiffness)
        blocks = [[self.tangent, push], [gap_rows, self._diagonal()]]
        return PETSc.Mat().createNest(blocks, comm=problem.comm).convert("aij")

    def _diagonal(self) -> PETSc.Mat:
        """Stored zeros for the reactions, on which vinewtonssls writes."""
        begin = sum(self.problem.comm.allgather(self.count)[: self.problem.comm.rank])
        rows, columns = np.arange(self.count + 1), begin + np.arange(self.count)
        matrix = PETSc.Mat().createAIJ(
            ((self.count, None), (self.count, None)),
            csr=(rows.astype(np.int32), columns.astype(np.int32), np.zeros(self.count)),
            comm=self.problem.comm,
        )
        matrix.assemble()
        return matrix

    def _gap_rows(self, rows: Sequence[tuple[Ints, Reals]]) -> PETSc.Mat:
        """Derivative of the scaled gaps by the unknowns y."""
        part, contact = self.problem.part, self.contact
        count = self.count
        vertex = np.concatenate([v for v, _ in rows])
        slope = contact.stiffness * np.concatenate([g for _, g in rows])
        dofs = 3 * vertex[:, None] + np.arange(3)
        select = sp.csr_matrix(
            (slope.ravel(), (np.repeat(np.arange(count), 3), dofs.ravel())),
            shape=(count, part.matrix.shape[0]),
        )
        local = (select @ part.matrix).tocsr()
        unknown = np.concatenate([part.first_global + np.arange(part.owned), part.ghost_global])
        matrix = PETSc.Mat().createAIJ(
            ((count, None), (part.owned, self.problem.unknowns)),
            csr=(local.indptr.astype(np.int32), unknown[local.indices].astype(np.int32), local.data),
            comm=self.problem.comm,
        )
        matrix.assemble()
        return matrix
