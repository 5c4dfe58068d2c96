"""What contacts of Projective Dynamics take the shell's resistance for in their sweeps."""

import numpy as np
import scipy.sparse as sp
from petsc4py import PETSc

from voile import _projective
from voile.arrays import Ints, Reals
from voile.problem.contact import contact_of
from voile.problem.problem import Problem


class Resistance:
    """A constant `matrix` for the unknowns that this rank's contacts move: its own and its ghosts', all where layers
    are in play, for contacts are then those of all ranks. What is sewn with weights counts with the unknown of its
    largest. `stiffness`: for `_projective.LocalContacts`."""

    def __init__(self, problem: Problem, matrix: PETSc.Mat):
        used, unknown = _used(problem)
        rows = PETSc.IS().createGeneral(used.astype(np.int32), comm=PETSc.COMM_SELF)
        self._near = PETSc.Vec().createSeq(len(used), comm=PETSc.COMM_SELF)
        self._scatter = PETSc.Scatter().create(problem.create_vector(), rows, self._near, None)
        (part,) = matrix.createSubMatrices(rows, rows)
        start, column, value = part.getValuesCSR()
        sparse = sp.csr_matrix((value, column, start), shape=part.getSize())
        sparse.eliminate_zeros()  # axes are not coupled
        self.stiffness = _projective.Stiffness(
            sparse.indptr.astype(np.int32),
            sparse.indices.astype(np.int32),
            sparse.data,
            sparse.diagonal(),
            unknown.astype(np.int32),
        )

    def gather(self, force: PETSc.Vec) -> Reals:
        """(unknowns here,) of a vector's, a copy."""
        self._scatter.scatter(force, self._near, PETSc.InsertMode.INSERT, PETSc.ScatterMode.FORWARD)
        found: Reals = self._near.array.copy()
        return found


def _used(problem: Problem) -> tuple[Reals, Ints]:
    """Global numbers of the unknowns, ascending, and each vertex's and axis's place among them, -1 without any."""
    part, contact = problem.part, contact_of(problem)
    known = np.concatenate([part.first_global + np.arange(part.owned), part.ghost_global])
    moved = part.matrix[: problem.layout.vertices].tocoo()
    order = np.argsort(moved.data, kind="stable")
    number = np.full(moved.shape[0], -1.0)
    number[moved.row[order]] = known[moved.col[order]]
    number = number.reshape(-1, 3)
    everywhere = contact.itself.gather(number) if contact.itself else number
    used = np.unique(everywhere[everywhere >= 0.0])
    return used, np.where(everywhere >= 0.0, np.searchsorted(used, everywhere), -1)
