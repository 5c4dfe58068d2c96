"""Constant matrices of a shell's unknowns that do not couple axes: factored once, solved with for all axes at once.

On one rank by CHOLMOD, one factor for axes with the same unknowns; on several by MUMPS.
"""

import numpy as np
import scipy.sparse as sp
from petsc4py import PETSc

from voile import _projective
from voile.arrays import Ints
from voile.problem.problem import Problem
from voile.solver.linear import Counts, LinearSolver, factored

SAME = 1e-14  # of the largest entry: axes' matrices differ by round-off alone


class ConstantMatrices:
    """Factors positive definite matrices of a problem's unknowns, the blocks of one, and counts so on one rank."""

    def __init__(self, problem: Problem, matrices: list[PETSc.Mat], counts: Counts):
        self.counts = counts
        self._several: list[LinearSolver] = []
        self._groups: list[list[tuple[Ints, _projective.Cholesky]]] = []
        if problem.comm.size > 1:
            self._several = [factored(matrix, counts, "") for matrix in matrices]
            return
        with counts.factorising():
            self._groups = [_split(problem, matrix) for matrix in matrices]

    def solve(self, which: int, b: PETSc.Vec, x: PETSc.Vec) -> None:
        """x = A^-1 b, A one of the matrices."""
        if self._several:
            self._several[which].solve(b, x)
            return
        with self.counts.solving():
            for rows, factor in self._groups[which]:
                right = b.array_r[rows]
                factor.solve(right)
                x.array[rows] = right


def _split(problem: Problem, matrix: PETSc.Mat) -> list[tuple[Ints, _projective.Cholesky]]:
    """Factors of groups of axes (their unknowns (axes, size))."""
    start, column, value = matrix.getValuesCSR()
    whole = sp.csr_matrix((value, column, start), shape=matrix.getSize())
    unknowns = [np.flatnonzero(problem.layout.axis == axis) for axis in range(3)]
    kept: list[tuple[list[Ints], sp.csr_matrix]] = []
    for rows in filter(len, unknowns):
        part = whole[rows][:, rows]
        part.eliminate_zeros()
        part.sort_indices()
        for group, first in kept:
            if _same(first, part):
                group.append(rows)
                break
        else:
            kept.append(([rows], part))
    return [
        (
            np.stack(group),
            _projective.Cholesky(part.indptr.astype(np.int32), part.indices.astype(np.int32), part.data),
        )
        for group, part in kept
    ]


def _same(a: sp.csr_matrix, b: sp.csr_matrix) -> bool:
    if (
        a.shape != b.shape
        or not np.array_equal(a.indptr, b.indptr)
        or not np.array_equal(a.indices, b.indices)
    ):
        return False
    return bool(np.abs(a.data - b.data).max() <= SAME * np.abs(a.data).max())
