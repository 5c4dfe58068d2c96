"""Degrees of freedom as an affine function of the unknowns: dof = C unknown + closure + supports(t)."""

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import spsolve

from voile.arrays import Flags, Reals
from voile.contact.motion import Motion
from voile.problem.held import Supports
from voile.problem.local_axes import inverse, principal
from voile.problem.shell import Shell


@dataclass
class Constraints:
    """Degrees of freedom: 3*vertex + axis, then edges.

    matrix C (dofs, dofs): unit rows for unknowns, combinations of unknowns for what is sewn to them, empty rows for
    supports; where supports hold along local axes, the unknowns are displacements along the free ones. free (dofs,)
    marks the unknowns, direction (dofs, 3) is where each leads, none for directors. closure (dofs,) is the displacement
    that closes the seams of the start shape and the director angles of its clamps.
    """

    matrix: sp.csr_matrix
    free: Flags
    direction: Reals
    closure: Reals
    supports: Supports

    @property
    def fixed(self) -> Flags:
        """(dofs,) marks those that supports hold alone."""
        found: Flags = np.diff(self.matrix.indptr) == 0
        return found


def build_constraints(shell: Shell, directors: bool) -> Constraints:
    """Constraints of a shell; what a supported vertex is sewn to is supported with it."""
    n, edges = len(shell.points), len(shell.topology.edges)
    sewing, base = shell.sewing()
    joined = sewing.astype(bool).astype(float)
    held_base = (joined.T @ shell.held.reshape(n, 9)).reshape(-1, 3, 3)
    axes, fixed_base = principal(held_base)
    closure = np.zeros(3 * n)
    if len(shell.slave):
        stays = (held_base != 0.0).any(axis=2)  # along the global axes
        closure = (_closing(shell, sewing, stays) if shell.closing is None else shell.closing).ravel()
    column = (3 * base[:, None] + np.arange(3)).ravel()
    place = sp.csr_matrix(
        (np.ones(len(column)), (np.arange(len(column)), column)), shape=(len(column), 3 * n)
    )
    turn = _blocks(axes.transpose(0, 2, 1) * ~fixed_base[:, None, :])
    vertices = (sp.kron(sewing, sp.identity(3), format="csr") @ turn @ place).tocsr()
    director_free = np.full(edges, directors)
    director_free[shell.clamped_edges] = False
    matrix = sp.block_diag([vertices, sp.diags(director_free.astype(float))], format="csr")
    matrix.eliminate_zeros()
    matrix.sort_indices()
    free = np.zeros(3 * n + edges, dtype=bool)
    free[column] = ~fixed_base.ravel()
    free[3 * n :] = director_free
    direction = np.zeros((3 * n + edges, 3))
    direction[column] = axes.reshape(-1, 3)
    closure = np.concatenate([closure, np.zeros(edges)])
    return Constraints(matrix, free, direction, closure, _supports(shell, sewing))


def _supports(shell: Shell, sewing: sp.csr_matrix) -> Supports:
    """Those that move, with what is sewn to them: where several meet, it moves as their mean."""
    displaced = np.flatnonzero((shell.motion * shell.fixed.any(axis=1)[:, None]).any(axis=1))
    moving = np.unique(np.concatenate([displaced, *(vertices for vertices, _ in shell.moves)]))
    held = shell.held
    share = (sewing.T @ held.reshape(-1, 9)).reshape(-1, 3, 3)
    along = sp.kron(sewing, sp.identity(3), format="csr")
    mean = _blocks(inverse(share)) @ along.T @ _blocks(held)
    carry = (along @ mean).tocsc()[:, (3 * moving[:, None] + np.arange(3)).ravel()].tocoo()
    size = (3 * len(shell.points) + len(shell.topology.edges), 3 * len(moving))
    motions = [(np.searchsorted(moving, vertices), motion) for vertices, motion in shell.moves]
    if len(displaced):
        along_path = Motion(displacement=shell.motion[displaced])
        motions.append((np.searchsorted(moving, displaced), along_path))
    return Supports(
        shell.points[moving], motions, sp.csr_matrix((carry.data, (carry.row, carry.col)), shape=size)
    )


def _blocks(blocks: Reals) -> sp.csr_matrix:
    """(3n, 3n) block diagonal of (n, 3, 3)."""
    n = len(blocks)
    matrix = sp.bsr_matrix((blocks, np.arange(n), np.arange(n + 1)), shape=(3 * n, 3 * n)).tocsr()
    matrix.eliminate_zeros()
    return matrix


def _closing(shell: Shell, sewing: sp.csr_matrix, fixed_base: Flags) -> Reals:
    """(n, 3) displacement that closes the seams of the start shape: among all that do, the one of least
    sum over edges of |u_i - u_j|^2 (uniform weights keep thin triangles from turning over)."""
    i, j = shell.topology.edges.T
    n = len(shell.points)
    adjacency = sp.csr_matrix((np.ones(len(i)), (i, j)), shape=(n, n))
    adjacency = adjacency + adjacency.T
    laplacian = sp.diags(np.asarray(adjacency.sum(axis=1)).ravel()) - adjacency
    system = (sewing.T @ laplacian @ sewing).tocsc()
    right = sewing.T @ (laplacian @ shell.points)
    home = np.zeros(right.shape)
    for axis in range(3):
        free = ~fixed_base[:, axis]
        start = _means(sewing, shell.points[:, axis])
        held = np.where(free, 0.0, start)
        load = right[:, axis] - system @ held
        # A piece without supports keeps its place through a faint pull towards where it starts.
        pull = 1e-9 * sp.identity(int(free.sum()), format="csc")
        home[:, axis] = held
        home[free, axis] = spsolve(system[free][:, free] + pull, load[free] + 1e-9 * start[free])
    found: Reals = sewing @ home - shell.points
    return found


def _means(sewing: sp.csr_matrix, x: Reals) -> Reals:
    """Mean of x over the vertices joined to each base vertex."""
    joined = sewing.copy()
    joined.data = (joined.data == 1.0).astype(float)
    found: Reals = (joined.T @ x) / np.asarray(joined.sum(axis=0)).ravel()
    return found
