"""Constant matrices of a shell's unknowns that do not couple axes: factored once, solved with for all axes at once.

Each rank has the whole factor, one for axes with the same unknowns, and solves for all: a solve takes less than the
messages of a shared one (on two ranks 500 times, at 289 vertices).
"""

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from petsc4py import PETSc

from voile import _projective
from voile.arrays import Ints, Reals
from voile.problem.problem import Problem
from voile.solver.linear import Counts


@dataclass
class Group:
    """Axes along which the same vertices move: rows (axes, size) of this rank's unknowns, everywhere (axes, whole) the
    numbers of all ranks', of which those of this rank stand at `here`."""

    rows: Ints
    everywhere: Ints
    here: slice


class ConstantMatrices:
    """Factors positive definite matrices of a problem's unknowns, the blocks of one. `groups`: (axes, size) own
    unknowns of axes along which the same vertices move; the matrices couple each axis of a group alike."""

    def __init__(self, problem: Problem, matrices: list[PETSc.Mat], counts: Counts):
        self.counts, self.comm = counts, problem.comm
        self._groups = [_everywhere(problem, rows) for rows in _alike(problem)]
        with counts.factorising():
            self._factors = [self._factored(matrix) for matrix in matrices]

    @property
    def groups(self) -> list[Ints]:
        return [group.rows for group in self._groups]

    def solve(self, which: int, right: list[Reals]) -> None:
        """Right-hand sides (at most axes, size) of each group become the solutions, by one of the matrices."""
        with self.counts.solving():
            for group, factor, sides in zip(self._groups, self._factors[which], right, strict=True):
                if self.comm.size == 1:  # messages to itself take as long as a third of the solve
                    factor.solve(sides)
                    continue
                whole = np.concatenate(self.comm.allgather(sides), axis=1)
                factor.solve(whole)
                sides[:] = whole[:, group.here]

    def _factored(self, matrix: PETSc.Mat) -> list[_projective.Cholesky]:
        """Of the block of each group's first axis."""
        rows = PETSc.IS().createStride(matrix.getSize()[0], step=1, comm=PETSc.COMM_SELF)
        (whole,) = matrix.createSubMatrices(rows, rows)
        start, column, value = whole.getValuesCSR()
        sparse = sp.csr_matrix((value, column, start), shape=whole.getSize())
        return [_factor(sparse, group.everywhere[0]) for group in self._groups]


def _everywhere(problem: Problem, rows: Ints) -> Group:
    counts = problem.comm.allgather(rows.shape[1])
    before = sum(counts[: problem.comm.rank])
    everywhere = np.concatenate(problem.comm.allgather(problem.part.first_global + rows), axis=1)
    return Group(rows, everywhere, slice(before, before + rows.shape[1]))


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
    """Of the block of some unknowns of a matrix."""
    part = matrix[rows][:, rows]
    part = 0.5 * (part + part.T).tocsr()  # where round-off leaves zeros on one side only
    part.eliminate_zeros()
    part.sort_indices()
    return _projective.Cholesky(part.indptr.astype(np.int32), part.indices.astype(np.int32), part.data)
