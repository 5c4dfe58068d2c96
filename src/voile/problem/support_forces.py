"""What supports and clamps exert on a shell, and its sums over each [[fix]]."""

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from petsc4py import PETSc

from voile.arrays import Ints, Reals
from voile.mesh.stitches import Stitches, sewing_matrix
from voile.problem.partition import gathered
from voile.problem.problem import Problem
from voile.problem.shell import Shell

ROUND_OFF = 1e-12  # of a weight of C


@dataclass(frozen=True)
class Held:
    """What a [[fix]] holds: vertices (k,) along `axes` (indices), and with `clamp` the edges between them."""

    name: str
    vertices: Ints
    axes: tuple[int, ...]
    clamp: bool


def support_forces(problem: Problem, y: PETSc.Vec) -> Reals:
    """(local vertices, 3) forces (N) that supports exert on the shell, complete for this rank's own: what balances
    elastic forces, loads and contact along degrees of freedom that follow no unknown. Inertia is left out."""
    at, count = problem.point(y), problem.layout.vertices
    forces = problem.inner_forces(at)[:count]
    if problem.contact:
        forces += problem.contact.force(at.positions, problem.time, frozen=False).ravel()
    held = 1.0 - np.asarray(problem.part.matrix[:count].sum(axis=1)).ravel()
    held[np.abs(held) < ROUND_OFF] = 0.0
    return -(held * forces).reshape(-1, 3)


def clamp_moments(problem: Problem, y: PETSc.Vec) -> tuple[Ints, Reals]:
    """(k, 2) vertices in the input's order and (k, 3) moments (N m) on the shell of the clamps of the half edges whose
    triangles count on this rank: about the edge, what keeps its half hinge angle."""
    part, at = problem.part, problem.point(y)
    half = part.half_edge_clamp[:, 0].astype(np.int64)
    half = half[part.weight[half // 3] > 0.0]
    slope = problem.kernel.stresses(at.u, at.phi)[:, 5:].ravel()[half]  # dW/dalpha
    ends = np.column_stack([part.corners[half // 3, (half + turn) % 3] for turn in (1, 2)])
    along = at.positions[ends[:, 1]] - at.positions[ends[:, 0]]
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    return part.vertex[ends], slope[:, None] * along


def support_table(
    problem: Problem, y: PETSc.Vec, shell: Shell | None, holds: list[Held] | None
) -> list[dict] | None:
    """On rank 0 (which has shell and holds) per [[fix]] its name, force (N) on the shell and moment (N m) about the
    centroid of its vertices as they are now. What several hold along an axis counts with the first; what is sewn to a
    held vertex counts with that."""
    forces, x = gathered(problem, support_forces(problem, y)), gathered(problem, problem.positions(y))
    pieces = problem.comm.gather(clamp_moments(problem, y))
    if pieces is None or shell is None or holds is None:
        return None
    ends, moments = (np.concatenate(parts) for parts in zip(*pieces, strict=True))
    joined = _joined(shell)
    left, loose = np.ones((len(x), 3), dtype=bool), np.ones(len(ends), dtype=bool)
    table = []
    for hold in holds:
        inside = np.zeros(len(x), dtype=bool)
        inside[hold.vertices] = True
        mine = np.zeros((len(x), 3), dtype=bool)
        mine[:, hold.axes] = (joined @ (joined.T @ inside))[:, None]
        mine &= left
        left &= ~mine
        force, centre = np.where(mine, forces, 0.0), x[inside].mean(axis=0)
        moment = np.cross(x - centre, force).sum(axis=0)
        if hold.clamp:
            own = loose & inside[ends].all(axis=1)
            loose &= ~own
            moment += moments[own].sum(axis=0)
        table.append({"name": hold.name, "force": force.sum(axis=0), "moment": moment, "about": centre})
    return table


def _joined(shell: Shell) -> sp.csr_matrix:
    """(n, base vertices) whether a vertex follows a base vertex of its seams; the identity without."""
    n = len(shell.points)
    if not len(shell.slave):
        return sp.identity(n, dtype=bool, format="csr")
    return sewing_matrix(Stitches(shell.slave, shell.first, shell.second, shell.weight), n)[0].astype(bool)
