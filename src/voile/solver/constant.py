"""Constant matrices of a shell's unknowns that do not couple axes: factored once, solved with for all axes at once.

Each rank has the whole factor, one for axes with the same unknowns, and solves for all: a solve takes less than the
messages of a shared one (on two ranks 500 times, at 289 vertices).
"""

import numpy as np
import scipy.sparse as sp
from petsc4py import PETSc

from voile import _projective
from voile.arrays import Ints, Reals
from voile.problem.problem import Problem
from voile.solver.linear import Counts


class ConstantMatrices:
    """Factors positive definite matrices of a problem's unknowns, the blocks of one. `groups`: (axes, size) own
    unknowns of axes along which the same vertices move; the matrices couple each axis of a group alike. The first
    matrix is for all axes, others are for the first of each group."""

    def __init__(self, problem: Problem, matrices: list[PETSc.Mat], counts: Counts):
        self.counts, self.comm = counts, problem.comm
        self.groups, part = _alike(problem), problem.part
        self._here = slice(part.first_global, part.first_global + part.owned)
        everywhere = [
            np.concatenate(problem.comm.allgather(part.first_global + rows), axis=1) for rows in self.groups
        ]
        with counts.factorising():
            self._factors = [
                _factored(matrix, [rows[: None if k == 0 else 1] for rows in everywhere])
                for k, matrix in enumerate(matrices)
            ]

    def solve(self, which: int, right: Reals, out: Reals) -> None:
        """Writes what one of the matrices makes of a right-hand side, both of this rank's own unknowns, to `out`."""
        with self.counts.solving():
            alone = self.comm.size == 1  # messages to itself take as long as a third of the solve
            sides = right if alone else np.concatenate(self.comm.allgather(right))
            whole = out if alone else np.zeros_like(sides)
            for factor in self._factors[which]:
                factor.solve(sides, whole)
            if not alone:
                out[:] = whole[self._here]


def _factored(matrix: PETSc.Mat, groups: list[Ints]) -> list[_projective.Cholesky]:
    """Of the block of each group's first axis, for right-hand sides along all; groups (axes, size): of all ranks."""
    rows = PETSc.IS().createStride(matrix.getSize()[0], step=1, comm=PETSc.COMM_SELF)
    (whole,) = matrix.createSubMatrices(rows, rows)
    start, column, value = whole.getValuesCSR()
    sparse = sp.csr_matrix((value, column, start), shape=whole.getSize())
    return [_factor(sparse, group) for group in groups]


def _alike(problem: Problem) -> list[Ints]:
    """The groups of axes, the same on all ranks."""
    place, groups = problem.part.place, list[list[Ints]]()
    for axis in range(3):
        rows = np.flatnonzero(problem.layout.axis == axis)
        for group in groups:
            if problem.everywhere(np.array_equal(place[group[0]], place[rows])):
                group.append(rows)
                break
        else:
            groups.append([rows])
    return [np.stack(group) for group in groups if not problem.everywhere(not len(group[0]))]


def _factor(matrix: sp.csr_matrix, rows: Ints) -> _projective.Cholesky:
    """Of the block of some unknowns of a matrix, those along the first of the axes (axes, size)."""
    part = matrix[rows[0]][:, rows[0]]
    part = 0.5 * (part + part.T).tocsr()  # where round-off leaves zeros on one side only
    part.eliminate_zeros()
    part.sort_indices()
    return _projective.Cholesky(
        part.indptr.astype(np.int32), part.indices.astype(np.int32), part.data, rows.astype(np.int32)
    )
