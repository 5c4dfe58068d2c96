"""The tangent's matrix: a fixed pattern into which kernels write in place, and which contacts of a shell with itself
extend when they couple vertices that no triangle does."""

from collections.abc import Iterable

import numpy as np
import scipy.sparse as sp
from mpi4py import MPI
from petsc4py import PETSc

from voile import _kernels, _petsc
from voile.arrays import Ints, Reals
from voile.launch import threads
from voile.problem.partition import Part

Blocks = Iterable[tuple[Ints, Reals]]
# (indices (p,) of local vertices or (p, s) of vertices in the input, (p, 3s, 3s) N/m)


class Assembly:
    """Writes blocks of triangles and of vertices to AIJ matrices. `scatter` takes those of triangles."""

    def __init__(self, part: Part, directors: bool, comm: MPI.Comm):
        self.part, self.directors, self.comm = part, directors, comm
        self.unknown = np.concatenate([part.first_global + np.arange(part.owned), part.ghost_global])
        self.unknowns = int(comm.allreduce(part.owned))
        self.scatter: _kernels.Scatter
        # ascending codes of the pairs of vertices that contacts couple
        self.coupled: Ints = np.zeros(0, dtype=np.int64)
        self._places: int | None = None  # how many were coupled when `scatter`, which keeps places, was made
        self._combination: sp.csr_matrix | None = None
        self._bound = None

    def create(self, kernel: _kernels.Elastic) -> PETSc.Mat:
        """A matrix with the tangent's pattern."""
        size = (self.part.owned, self.unknowns)
        matrix = PETSc.Mat().create(comm=self.comm)
        matrix.setSizes((size, size))
        matrix.setType(PETSc.Mat.Type.AIJ)
        self._allocate(matrix, kernel)
        matrix.setOption(PETSc.Mat.Option.SYMMETRIC, True)
        matrix.setOption(PETSc.Mat.Option.NEW_NONZERO_LOCATION_ERR, True)
        return matrix

    def _allocate(self, matrix: PETSc.Mat, kernel: _kernels.Elastic) -> None:
        if self._places != len(self.coupled):
            self.scatter, self._places = self._make_scatter(kernel), len(self.coupled)
        matrix.setPreallocationCSR(self._find_pattern())
        matrix.setAttr("coupled", len(self.coupled))
        self._bind(matrix)

    def _make_scatter(self, kernel: _kernels.Elastic) -> _kernels.Scatter:
        part = self.part
        return _kernels.Scatter(
            kernel,
            self.directors,
            part.owned,
            part.matrix.indptr.astype(np.int32),
            part.matrix.indices.astype(np.int32),
            part.matrix.data,
            threads(),
        )

    def _find_pattern(self) -> tuple[Ints, Ints]:
        """Row starts and columns of this rank's entries. Matrices are few and it is as large as a third of one: it is
        not kept."""
        start, column = self.scatter.pattern(self.unknown.astype(np.int64))
        column = self.unknown.astype(np.int32)[column]
        if len(self.coupled):
            start, column = self._widened(start, column)
        return start.astype(np.int32), column.astype(np.int32, copy=False)

    def prepare(
        self, matrix: PETSc.Mat, kernel: _kernels.Elastic, blocks: Blocks, likely: Ints | None = None
    ) -> None:
        """Makes room in the matrix for blocks that are to be added. Its pattern grows if it must, and then for contacts
        over vertices that are likely to come, too (c, s); its attribute `coupled` counts them."""
        needed = [self._codes(vertex) for vertex, _ in blocks if vertex.ndim == 2]
        if not np.isin(np.concatenate([*needed, self.coupled[:0]]), self.coupled).all():
            near = [] if likely is None else [self._codes(likely)]
            self.coupled = np.unique(np.concatenate([*needed, *near, self.coupled]))
            self._allocate(matrix, kernel)
        elif matrix.getAttr("coupled") != len(self.coupled):
            self._allocate(matrix, kernel)
        elif matrix.handle != self._bound:
            self._bind(matrix)

    def _bind(self, matrix: PETSc.Mat) -> None:
        none = np.zeros(0, dtype=np.int32)
        inside, outside, columns = _petsc.aij_arrays(matrix.handle)
        if outside is None:
            self.scatter.bind(*inside, none, none, np.zeros(0), none)
        else:
            ghost = np.searchsorted(columns, self.part.ghost_global).astype(np.int32)
            self.scatter.bind(*inside, *outside, ghost)
        self._bound = matrix.handle

    def add(self, matrix: PETSc.Mat, blocks: Blocks) -> None:
        """Adds blocks of vertices to the values written."""
        for vertex, block in blocks:
            if vertex.ndim == 1:
                self.scatter.add_vertices(vertex.astype(np.int32), np.ascontiguousarray(block))
                continue
            own, everything = self._maps()
            values = (own @ _over_dofs(vertex, block, everything.shape[0]) @ everything).tocsr()
            matrix.setValuesCSR(
                values.indptr.astype(np.int32), values.indices.astype(np.int32), values.data, addv=True
            )

    # ---- pairs of vertices that only contacts couple ----

    def _codes(self, vertex: Ints) -> Ints:
        """Ascending codes of all pairs among the vertices (p, s) of each contact."""
        first, second = np.triu_indices(vertex.shape[1], 1)
        pair = np.sort(np.stack([vertex[:, first], vertex[:, second]]).reshape(2, -1), axis=0).astype(
            np.int64
        )
        found: Ints = np.unique(pair[0] * (1 << 32) + pair[1])
        return found

    def _widened(self, start: Ints, column: Ints) -> tuple[Ints, Ints]:
        """A pattern of this rank's rows with the entries of coupled vertices."""
        own, everything = self._maps()
        i, j = self.coupled >> 32, self.coupled & 0xFFFFFFFF
        ones = np.ones((len(i), 6, 6))
        coupling = abs(own) @ _over_dofs(np.column_stack([i, j]), ones, everything.shape[0]) @ abs(everything)
        pattern = sp.csr_matrix((np.ones(len(column)), column, start), shape=coupling.shape) + coupling
        pattern.sort_indices()
        return pattern.indptr, pattern.indices

    def _maps(self) -> tuple[sp.csr_matrix, sp.csr_matrix]:
        """(own unknowns, dofs) and (dofs, all unknowns): C of the displacements of all vertices, its columns by global
        number; transposed, those of this rank's unknowns."""
        if self._combination is None:
            part = self.part
            rows = (3 * part.owned_vertices[:, None] + np.arange(3)).ravel()
            mine = part.matrix[rows].tocoo()
            dof = (3 * part.vertex[part.owned_vertices][:, None] + np.arange(3)).ravel()
            pieces = self.comm.allgather((dof[mine.row], self.unknown[mine.col], mine.data))
            row, col, value = (np.concatenate(piece) for piece in zip(*pieces, strict=True))
            count = self.comm.allreduce(len(rows))
            self._combination = sp.csr_matrix((value, (row, col)), shape=(count, self.unknowns))
            begin = part.first_global
            self._own = self._combination[:, begin : begin + part.owned].T.tocsr()
        return self._own, self._combination


def _over_dofs(vertex: Ints, block: Reals, count: int) -> sp.csr_matrix:
    """Sum of blocks (p, 3s, 3s) over the dofs of vertices (p, s), `count` dofs in all."""
    dof = (3 * vertex[:, :, None] + np.arange(3)).reshape(len(vertex), 3 * vertex.shape[1])
    row, col = np.broadcast_arrays(dof[:, :, None], dof[:, None, :])
    return sp.csr_matrix((block.ravel(), (row.ravel(), col.ravel())), shape=(count, count))
