"""Levels below a problem's unknowns, for multigrid: what interpolates displacements of coarse meshes on finer ones.

Bending is of fourth order, so interpolation that is linear in every triangle is of no use: its kinks cost more bending
than the field that it stands for. A fine vertex takes its displacement from the coarse vertices around it by moving
least squares instead (Lancaster & Salkauskas 1981), which reproduce quadratic fields.
"""

from dataclasses import dataclass, replace

import numpy as np
import scipy.sparse as sp
from petsc4py import PETSc

from voile.arrays import Ints, Reals, units
from voile.mesh.topology import build_topology
from voile.problem.constraints import build_constraints
from voile.problem.levels import coarsen
from voile.problem.partition import number_unknowns
from voile.problem.problem import Problem
from voile.problem.prolongation import Prolongation, start_shape
from voile.problem.shell import Shell

NEAR = 1e-3  # squared edges: a coarse vertex so near outweighs all others
RIDGE = 1e-10  # of the squares' sum: decides where coarse vertices lie on a line
FAINT = 1e-12  # an entry of the interpolation that is round-off
BATCH = 50_000  # vertices at a time, some 200 MiB


@dataclass
class _Level:
    """A mesh on rank 0: its shell, the unknowns' displacements (unknowns, 3 vertices), those of directors empty, and
    where each rank's begin (ranks + 1,)."""

    shell: Shell
    along: sp.csr_matrix
    begin: Ints


def transfers(problem: Problem, smallest: int) -> list[PETSc.Mat]:
    """Interpolations to each level's unknowns from the next coarser one's, displacements only, the finest first. The
    coarsest has at most `smallest`, or no coarser mesh. Collective: rank 0 finds them."""
    comm, found, count = problem.comm, [], problem.unknowns
    level = _finest(problem)
    while count > smallest:
        made = None if level is None else _below(level, comm.size)
        rows: list[tuple[sp.csr_matrix, int] | None] = [None] * comm.size
        if level and made:
            coarse, matrix = made
            pairs = zip(level.begin[:-1], level.begin[1:], strict=True)
            widths = np.diff(coarse.begin)
            rows = [(matrix[a:b], int(width)) for (a, b), width in zip(pairs, widths, strict=True)]
            level = coarse
        here = comm.scatter(rows)
        if here is None:
            break
        own, width = here
        count = own.shape[1]
        interpolation = PETSc.Mat().createAIJ(
            ((own.shape[0], None), (width, count)),
            csr=(own.indptr.astype(np.int32), own.indices.astype(np.int32), own.data),
            comm=comm,
        )
        found.append(interpolation)
    return found


def _finest(problem: Problem) -> _Level | None:
    """That of the problem itself."""
    part, still = problem.part, ~problem.layout.turns
    vertex = np.where(still, part.vertex[np.where(still, part.place, 0)], -1)
    pieces = problem.comm.gather((vertex, part.direction[: part.owned]))
    if pieces is None or problem.shell is None:
        return None
    vertex, direction = (np.concatenate(arrays) for arrays in zip(*pieces, strict=True))
    begin = np.cumsum([0, *(len(piece[0]) for piece in pieces)])
    shell = replace(problem.shell, moment=None, topology=problem.shell.topology)
    return _Level(shell, _along(vertex, direction, len(shell.points)), begin)


def _along(vertex: Ints, direction: Reals, count: int) -> sp.csr_matrix:
    """(unknowns, 3 count) unit rows of unknowns at vertices along directions; empty where the vertex is -1."""
    row = np.flatnonzero(vertex >= 0)
    column = 3 * vertex[row][:, None] + np.arange(3)
    values = (direction[row].ravel(), (np.repeat(row, 3), column.ravel()))
    return sp.csr_matrix(values, shape=(len(vertex), 3 * count))


def _below(fine: _Level, ranks: int) -> tuple[_Level, sp.csr_matrix] | None:
    """The next coarser level and the interpolation from its unknowns to the fine one's; None where there is none."""
    made = coarsen(fine.shell)
    if made is None:
        return None
    shell, prolongation = made
    count = 3 * len(shell.points)
    constraints = build_constraints(shell, directors=False)
    numbering = number_unknowns(shell, constraints, ranks)
    spread = constraints.matrix[:count, :][:, numbering.dof]
    weights = smooth_weights(fine.shell, prolongation)
    matrix = (fine.along @ sp.kron(weights, sp.identity(3), format="csr") @ spread).tocsr()
    matrix.data[np.abs(matrix.data) < FAINT] = 0.0
    matrix.eliminate_zeros()
    matrix.sort_indices()
    along = _along(numbering.dof // 3, constraints.direction[numbering.dof], len(shell.points))
    return _Level(shell, along, numbering.range_start), matrix


def smooth_weights(fine: Shell, made: Prolongation) -> sp.csr_matrix:
    """(nf, nc) weights of the coarse vertices around each fine one, on the start shape; kept vertices are themselves.

    Around: its coarse triangle's corners and their neighbours. Weights fall with the fourth power of the distance.
    """
    nf, nc = len(made.corners), len(made.kept)
    triangle, home = np.unique(np.sort(made.corners, axis=1), axis=0, return_inverse=True)
    around = _around(made, triangle)
    loose = np.setdiff1d(np.arange(nf), made.kept)
    shape = start_shape(fine)
    rows, columns, values = [made.kept], [np.arange(nc)], [np.ones(nc)]
    for few in np.array_split(loose, len(loose) // BATCH + 1):
        which = home.ravel()[few]
        size = np.diff(around.indptr)[which]
        present = np.arange(size.max(initial=0)) < size[:, None]
        near = np.zeros(present.shape, dtype=np.int64)
        near[present] = around[which].indices
        weight = _least_squares(
            shape[few], shape[made.kept][near], present, shape[made.kept[triangle[which]]]
        )
        rows.append(np.repeat(few, size))
        columns.append(near[present])
        values.append(weight[present])
    entries = np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))
    return sp.csr_matrix(entries, shape=(nf, nc))


def _around(made: Prolongation, triangle: Ints) -> sp.csr_matrix:
    """(t, nc) pattern of the corners (t, 3) of coarse triangles and their neighbours."""
    nc = len(made.kept)
    i, j = build_topology(made.triangles).edges.T
    edges = sp.csr_matrix((np.ones(len(i)), (i, j)), shape=(nc, nc))
    start = np.arange(0, triangle.size + 1, 3)
    corners = sp.csr_matrix((np.ones(triangle.size), triangle.ravel(), start), shape=(len(triangle), nc))
    return (corners @ (edges + edges.T + sp.identity(nc))).tocsr()


def _least_squares(x: Reals, around: Reals, present: Reals, corners: Reals) -> Reals:
    """(p, s) weights that reproduce quadratic fields at x (p, 3) from points (p, s, 3), those that are present, in the
    plane of corners (p, 3, 3)."""
    one, two = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    size = np.maximum(np.sqrt((one**2 + two**2).sum(axis=1) / 2.0), 1e-300)[:, None]
    along = units(one)
    across = units(two - np.einsum("ni,ni->n", two, along)[:, None] * along)
    away = around - x[:, None]
    s, t = (np.einsum("psi,pi->ps", away, axis) / size for axis in (along, across))
    share = present / ((away**2).sum(axis=2) / size**2 + NEAR) ** 2
    terms = np.stack([np.ones_like(s), s, t, s * s, s * t, t * t], axis=2)
    normal = np.einsum("psi,ps,psj->pij", terms, share, terms)
    normal += RIDGE * np.trace(normal, axis1=1, axis2=2)[:, None, None] * np.eye(6)
    at_x = np.zeros((len(x), 6, 1))
    at_x[:, 0] = 1.0
    found: Reals = share * np.einsum("psi,pi->ps", terms, np.linalg.solve(normal, at_x)[:, :, 0])
    return found
