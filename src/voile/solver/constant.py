"""Constant matrices of a shell's unknowns that do not couple axes: factored once, solved with for all axes at once.

On one rank by CHOLMOD, one factor for axes with the same unknowns; on several by MUMPS.
"""

import numpy as np
import scipy.sparse as sp
from petsc4py import PETSc

from voile import _projective
from voile.arrays import Ints, Reals
from voile.problem.problem import Problem
from voile.solver.linear import Counts, LinearSolver, factored


class ConstantMatrices:
    """Factors positive definite matrices of a problem's unknowns, the blocks of one, and counts so on one rank.
    `groups`: (axes, size) own unknowns of axes along which the same vertices move; the matrices couple each axis of a
    group alike."""

    def __init__(self, problem: Problem, matrices: list[PETSc.Mat], counts: Counts):
        self.counts, self.groups = counts, _alike(problem)
        self._several: list[LinearSolver] = []
        self._factors: list[list[_projective.Cholesky]] = []
        if problem.comm.size > 1:
            self._several = [factored(matrix, counts, "") for matrix in matrices]
            self._b, self._x = problem.create_vector(), problem.create_vector()
            return
        with counts.factorising():
            self._factors = [[_factor(matrix, rows[0]) for rows in self.groups] for matrix in matrices]

    def solve(self, which: int, right: list[Reals]) -> None:
        """Right-hand sides (at most axes, size) of each group become the solutions, by one of the matrices."""
        if not self._several:
            with self.counts.solving():
                for factor, sides in zip(self._factors[which], right, strict=True):
                    factor.solve(sides)
            return
        self._b.set(0.0)
        for rows, sides in zip(self.groups, right, strict=True):
            self._b.array[rows[: len(sides)]] = sides
        self._several[which].solve(self._b, self._x)
        for rows, sides in zip(self.groups, right, strict=True):
            sides[:] = self._x.array_r[rows[: len(sides)]]


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


def _factor(matrix: PETSc.Mat, rows: Ints) -> _projective.Cholesky:
    """Of the block of some unknowns of a matrix."""
    start, column, value = matrix.getValuesCSR()
    part = sp.csr_matrix((value, column, start), shape=matrix.getSize())[rows][:, rows]
    part.eliminate_zeros()
    part.sort_indices()
    return _projective.Cholesky(part.indptr.astype(np.int32), part.indices.astype(np.int32), part.data)
