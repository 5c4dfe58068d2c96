"""Degrees of freedom as an affine function of the unknowns: dof = C unknown + gap + load factor * lift."""

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from voile.mesh.stitches import Stitches, sewing_matrix
from voile.problem.shell import Shell


@dataclass
class Constraints:
    """Degrees of freedom: 3*vertex + axis, then edges.

    matrix C (dofs, dofs): unit rows for unknowns, combinations of unknowns for what is sewn to them, empty rows for
    supports. free (dofs,) marks the unknowns, fixed (dofs,) the supports. gap (dofs,) is the displacement that closes
    the seams of the start shape, lift (dofs,) the supports' at load factor 1, carried along the seams.
    """

    matrix: sp.csr_matrix
    free: np.ndarray
    fixed: np.ndarray
    gap: np.ndarray
    lift: np.ndarray


def build_constraints(shell: Shell, directors: bool) -> Constraints:
    """Constraints of a shell; what a supported vertex is sewn to is supported with it."""
    n, edges = len(shell.points), len(shell.topology.edges)
    sewing, base = _sewing(shell)
    touches = sewing.astype(bool).astype(float)
    fixed_base = (touches.T @ shell.fixed.astype(float)) > 0.0
    share = sewing.T @ shell.fixed.astype(float)
    motion = (sewing.T @ (shell.motion * shell.fixed)) / np.where(share > 0.0, share, 1.0) * fixed_base
    home = _home(sewing, base, shell.points, fixed_base)
    gap = (sewing @ home - shell.points).ravel() if len(shell.slave) else np.zeros(3 * n)
    column = (3 * base[:, None] + np.arange(3)).ravel()
    place = sp.csr_matrix((np.ones(len(column)), (np.arange(len(column)), column)), shape=(len(column), 3 * n))
    keep = sp.diags((~fixed_base).ravel().astype(float))
    vertices = (sp.kron(sewing, sp.identity(3), format="csr") @ keep @ place).tocsr()
    director_free = np.full(edges, directors)
    director_free[shell.clamped_edges] = False
    matrix = sp.block_diag([vertices, sp.diags(director_free.astype(float))], format="csr")
    matrix.eliminate_zeros()
    matrix.sort_indices()
    free = np.zeros(3 * n + edges, dtype=bool)
    free[column] = ~fixed_base.ravel()
    free[3 * n :] = director_free
    fixed = np.concatenate([np.diff(vertices.indptr) == 0, ~director_free])
    none = np.zeros(edges)
    return Constraints(
        matrix, free, fixed, np.concatenate([gap, none]), np.concatenate([(sewing @ motion).ravel(), none])
    )


def _sewing(shell: Shell) -> tuple[sp.csr_matrix, np.ndarray]:
    """x = P x[base] for the seams; the identity without."""
    n = len(shell.points)
    if not len(shell.slave):
        return sp.identity(n, format="csr"), np.arange(n)
    return sewing_matrix(Stitches(shell.slave, shell.first, shell.second, shell.weight), n)


def _home(sewing: sp.csr_matrix, base: np.ndarray, points: np.ndarray, fixed_base: np.ndarray) -> np.ndarray:
    """Where the base vertices start: vertices joined to one meet half way, unless supported."""
    joined = sewing.copy()
    joined.data = (joined.data == 1.0).astype(float)
    mean = (joined.T @ points) / np.asarray(joined.sum(axis=0)).T
    return np.where(fixed_base, points[base], mean)
