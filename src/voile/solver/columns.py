"""Linear algebra on many columns at once: a factor or a matrix is read once for all of them.

Columns are arrays (own rows, p) of vectors on the problem's unknowns.
"""

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from voile.arrays import Reals

TRANSPOSED = 9  # MUMPS' ICNTL: 0 solves with the transposed matrix, 1 with the matrix
SCALED = 1e-10  # eigenvalues of scaled products, over the largest: columns nearer to dependent count as such


def dense(columns: Reals, comm: MPI.Comm) -> PETSc.Mat:
    """A dense matrix of columns, to be destroyed rather than left to Python."""
    matrix = PETSc.Mat().createDense(
        ((len(columns), PETSc.DECIDE), (PETSc.DECIDE, columns.shape[1])), comm=comm
    )
    matrix.setUp()
    matrix.getDenseArray()[:] = columns
    matrix.assemble()
    return matrix


def times(matrix: PETSc.Mat, columns: Reals) -> Reals:
    """matrix @ columns."""
    given = dense(columns, matrix.comm)
    product = matrix.matMult(given)
    out: Reals = product.getDenseArray().copy()
    for each in (given, product):
        each.destroy()
    return out


def products(left: Reals, right: Reals, comm: MPI.Comm) -> Reals:
    """left^T right over all ranks."""
    found: Reals = comm.allreduce(left.T @ right)
    return found


def orthonormal(gram: Reals) -> Reals:
    """(p, q) combinations of p vectors with these products that are orthonormal, dependent ones left out."""
    size = np.sqrt(np.maximum(np.diag(gram), 0.0))
    scale = np.divide(1.0, size, out=np.zeros_like(size), where=size > 0.0)
    theta, q = np.linalg.eigh(gram * scale * scale[:, None])
    kept = theta > SCALED * theta[-1]
    found: Reals = scale[:, None] * q[:, kept] / np.sqrt(theta[kept])
    return found


def solutions(pc: PETSc.PC, columns: Reals, transposed: bool = False) -> Reals:
    """Solutions with the matrix that a PC has factored, or with its transpose."""
    factor, out = pc.getFactorMatrix(), np.empty_like(columns)
    if pc.getFactorSolverType() == "mumps":
        given, found = dense(columns, pc.comm), dense(columns, pc.comm)
        factor.setMumpsIcntl(TRANSPOSED, 0 if transposed else 1)
        factor.matSolve(given, found)
        factor.setMumpsIcntl(TRANSPOSED, 1)
        out[:] = found.getDenseArray()
        for each in (given, found):
            each.destroy()
        return out
    right, left = factor.createVecs()
    for k, column in enumerate(columns.T):
        right.array[:] = column
        (factor.solveTranspose if transposed else factor.solve)(right, left)
        out[:, k] = left.array_r
    return out
