"""Degrees of freedom as an affine function of the unknowns: dof = C unknown + lift (supports, seams, clamps)."""

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from voile.errors import InputError
from voile.problem.shell import Shell


@dataclass
class Constraints:
    """Which degrees of freedom (3*vertex + axis, then edges) are unknowns and how the others follow.

    matrix C (dofs, dofs): rows of unknowns are unit rows, rows of seam slaves combine unknowns, rows of supports are
    empty. seam (dofs, dofs) carries prescribed values (columns: supported dofs) to the slaves that follow them.
    free (dofs,) marks the unknowns. gap (dofs,) is the constant displacement that closes the seams of the start shape.
    """

    matrix: sp.csr_matrix
    seam: sp.csr_matrix
    free: np.ndarray
    fixed: np.ndarray
    gap: np.ndarray


def build_constraints(shell: Shell, directors: bool) -> Constraints:
    """Constraints of a shell; raises InputError where seams and supports contradict each other."""
    n, edges = len(shell.points), len(shell.topology.edges)
    size = 3 * n + edges
    fixed = np.zeros(size, dtype=bool)
    fixed[: 3 * n] = _spread_supports(shell).ravel()
    fixed[3 * n :] = not directors
    fixed[3 * n + shell.clamped_edges] = True
    slave = np.zeros(size, dtype=bool)
    slave[: 3 * n].reshape(n, 3)[shell.slave] = True
    slave &= ~fixed
    follow = _seam_matrix(shell, size, slave)
    free = ~fixed & ~slave
    total = sp.identity(size, format="csr")
    power = follow
    for _ in range(len(shell.slave) + 1):  # chains of seams: (1 - S)^-1 = 1 + S + S^2 + ... (S is nilpotent)
        if power.nnz == 0:
            break
        total = total + power
        power = (power @ follow).tocsr()
        power.eliminate_zeros()
    else:
        raise InputError("stitches: a seam follows itself around a cycle")
    x = shell.points.ravel()
    gap = np.zeros(size)
    rows = follow[: 3 * n, : 3 * n]
    own = np.where(slave[: 3 * n], rows @ x - x, 0.0)
    gap[: 3 * n] = (total[: 3 * n, : 3 * n] @ own) * slave[: 3 * n]
    keep = sp.diags(free.astype(float))
    held = sp.diags(fixed.astype(float))
    matrix = (total @ keep).tocsr()
    seam = (total @ held).tocsr()
    for m in (matrix, seam):
        m.eliminate_zeros()
        m.sort_indices()
    return Constraints(matrix, seam, free, fixed, gap)


def _spread_supports(shell: Shell) -> np.ndarray:
    """(n, 3) supported axes; what a supported slave is sewn to is supported with it."""
    fixed = shell.fixed.copy()
    for _ in range(len(shell.slave)):
        wanted = fixed[shell.slave]
        before = fixed.sum()
        for master, share in ((shell.first, 1.0 - shell.weight), (shell.second, shell.weight)):
            used = share != 0.0
            np.logical_or.at(fixed, master[used], wanted[used])
        if fixed.sum() == before:
            break
    return fixed


def _seam_matrix(shell: Shell, size: int, slave: np.ndarray) -> sp.csr_matrix:
    """S with x_slave = S x; zero rows elsewhere."""
    axes = np.arange(3)
    row = (3 * shell.slave[:, None] + axes).ravel()
    entries = []
    for master, share in ((shell.first, 1.0 - shell.weight), (shell.second, shell.weight)):
        entries.append((row, (3 * master[:, None] + axes).ravel(), np.repeat(share, 3)))
    row, column, value = (np.concatenate(part) for part in zip(*entries, strict=True))
    keep = slave[row] & (value != 0.0)
    return sp.csr_matrix((value[keep], (row[keep], column[keep])), shape=(size, size))
