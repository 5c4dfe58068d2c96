"""What contacts of Projective Dynamics take the shell's resistance for in their sweeps."""

import numpy as np
import scipy.sparse as sp
from petsc4py import PETSc

from voile import _projective
from voile.arrays import Ints, Reals
from voile.problem.contact import contact_of
from voile.problem.problem import Problem


class Resistance:
    """A constant `matrix` for what this rank's contacts move: its own unknowns and its ghosts', all where layers are in
    play, for contacts are then those of all ranks. It holds alike for the three components of a vertex with unknowns.
    What is sewn with weights counts with the unknown of its largest. `stiffness`: for `_projective.LocalContacts`."""

    def __init__(self, problem: Problem, matrix: PETSc.Mat):
        used, unknown = _used(problem)
        rows = PETSc.IS().createGeneral(used.astype(np.int32), comm=PETSc.COMM_SELF)
        self._near = PETSc.Vec().createSeq(len(used), comm=PETSc.COMM_SELF)
        self._scatter = PETSc.Scatter().create(problem.create_vector(), rows, self._near, None)
        bases, axes = problem.create_vector(), problem.create_vector()  # of the unknowns
        bases.array[:] = problem.part.vertex[problem.part.place]
        axes.array[:] = problem.layout.axis
        vertices, node = np.unique(self.gather(bases), return_inverse=True)
        slot = 4 * node + self.gather(axes).astype(int)
        (part,) = matrix.createSubMatrices(rows, rows)
        start, column, value = part.getValuesCSR()
        sparse = sp.csr_matrix((value, column, start), shape=part.getSize())
        sparse.eliminate_zeros()  # axes are not coupled
        sparse = sparse.tocoo()
        place, first = np.unique(len(vertices) * node[sparse.row] + node[sparse.col], return_index=True)
        row, column = np.divmod(place, len(vertices))
        nodes = sp.csr_matrix((sparse.data[first], (row, column)), shape=2 * (len(vertices),))
        soft, free = np.zeros((len(vertices), 4)), np.zeros((len(unknown), 4))
        soft.ravel()[slot] = 1.0 / nodes.diagonal()[node]
        free[:, :3] = unknown >= 0
        moves = np.where(unknown >= 0, node[unknown], -1).max(axis=1)
        self.stiffness = _projective.Stiffness(
            nodes.indptr.astype(np.int32),
            nodes.indices.astype(np.int32),
            nodes.data,
            nodes.diagonal(),
            soft,
            free,
            slot.astype(np.int32),
            moves.astype(np.int32),
        )

    def gather(self, force: PETSc.Vec) -> Reals:
        """(unknowns here,) of a vector's, for now."""
        self._scatter.scatter(force, self._near, PETSc.InsertMode.INSERT, PETSc.ScatterMode.FORWARD)
        found: Reals = self._near.array_r
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
