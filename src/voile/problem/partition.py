"""Distribution: rank 0 cuts the mesh along a Hilbert curve and hands every rank what its own rows need.

Owner computes: a rank evaluates every triangle that contributes to one of its unknowns (one more ring around them for
the hinges), so assembly needs no communication and no rank holds more than its part; rank 0 reads the input.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
import scipy.sparse as sp
from mpi4py import MPI

from voile.arrays import Ints, Reals, triangle_areas
from voile.contact.motion import Motion
from voile.problem.clamps import clamp_laws, held_directors
from voile.problem.constraints import Constraints, build_constraints
from voile.problem.held import Supports
from voile.problem.shell import Shell, hilbert_order


@dataclass
class Part:
    """One rank's share; local numbering throughout. dofs: 3*vertex + axis, then edges.

    vertex, edge, triangle, rest_vertex: indices in the input; no edge of models without directors, whose triangle_edges
    are -1. matrix (dofs, unknowns): C, the first `owned` unknowns
    are the rank's own, the rest ghosts whose global numbers are ghost_global. weight (m,): 1 where the triangle counts
    here.
    """

    vertex: Ints
    edge: Ints
    triangle: Ints
    corners: Ints
    triangle_edges: Ints
    signs: Ints
    across: Ints
    points: Reals
    rest_points: Reals
    rest_vertex: Ints
    rest_corners: Ints
    fabric: Reals  # (4, m) thickness, young, poisson, density
    weave: Reals  # (m, 9), or (m, 0) of fabrics that are not woven
    weight: Reals
    matrix: sp.csr_matrix
    closure: Reals  # (dofs,) closes the seams of the start shape
    supports: Supports
    place: Ints  # (owned,) local vertex of an unknown, for directors vertices + local edge
    direction: Reals  # (unknowns, 3) where each leads, none for directors
    force: Reals
    mass: Reals  # (dofs,) lumped, complete where this rank has all triangles: for its own
    moment: Reals
    pressure: Reals  # (m,) Pa
    springs: Reals  # (vertices, 3) N/m, empty without
    bars: Reals  # (b, 7) all: input vertices, N/m, m, local vertices or -1 where not here, whether it counts here
    welds: Reals  # (w, 16) all: those of Shell.welds, then as for bars
    extra_mass: Reals  # (vertices,) kg
    half_edge_clamp: (
        Reals  # (k, 8): local half edge, flags conormal and at rest, vector, angle, which of `turns` or -1
    )
    turns: tuple[Motion, ...]  # of moving supports
    owned: int
    first_global: int
    ghost_global: Ints
    owned_vertices: Ints  # local indices of the vertices that this rank writes
    owned_edges: Ints

    def set_rest(self, points: Reals) -> None:
        """Another rest shape (rest vertices, 3) m; complete masses for what this rank's unknowns move."""
        self.rest_points = np.ascontiguousarray(points)
        thickness, _, _, density = self.fabric
        areas = triangle_areas(self.rest_points, self.rest_corners)
        counts = len(self.vertex), len(self.edge)
        self.mass = lumped_mass(density * areas, thickness, self.corners, self.triangle_edges, counts)
        self.mass[: 3 * counts[0]] += np.repeat(self.extra_mass, 3)


def lumped_mass(
    density_area: Reals,
    thickness: Reals,
    corners: Ints,
    edges: Ints,
    counts: tuple[int, int],
) -> Reals:
    """(dofs,) mass of vertices (kg, each axis) and rotary inertia rho h^3/12 of the directors (kg m^2).

    Per triangle density times rest area (kg/m), thickness (m), corners (m, 3), edges (m, 3), -1 for none; counts.
    """
    share = density_area * thickness / 3.0
    vertex = np.bincount(corners.ravel(), np.repeat(share, 3), counts[0])
    turns = edges.ravel() >= 0
    edge = np.bincount(edges[edges >= 0], np.repeat(share * thickness**2 / 12.0, 3)[turns], counts[1])
    return np.concatenate([np.repeat(vertex, 3), edge])


def _mass(shell: Shell) -> Reals:
    """Lumped mass of a whole shell."""
    area = triangle_areas(shell.rest_points, shell.rest_triangles)
    edges = shell.topology.triangle_edges
    counts = len(shell.points), len(shell.topology.edges)
    mass = lumped_mass(shell.density * area, shell.thickness, shell.triangles, edges, counts)
    if shell.extra_mass is not None:
        mass[: 3 * counts[0]] += np.repeat(shell.extra_mass, 3)
    return mass


@dataclass
class Numbering:
    """Global numbering of nodes and unknowns on rank 0."""

    node_owner: Ints  # vertices, then edges
    unknown: Ints  # per dof: global number, -1 where it is none
    dof: Ints  # per unknown: the degree of freedom that it is numbered by
    range_start: Ints  # (ranks + 1,)
    triangle_order: Ints


def number_unknowns(shell: Shell, constraints: Constraints, ranks: int) -> Numbering:
    """Nodes in Hilbert order, an edge right after its earlier vertex; equal numbers of unknowns per rank."""
    n, topology = len(shell.points), shell.topology
    place = np.empty(n, dtype=np.int64)
    place[hilbert_order(shell.points)] = np.arange(n)
    edge_place = place[topology.edges].min(axis=1)
    key = np.concatenate([2 * place, 2 * edge_place + 1])
    order = np.argsort(key, kind="stable")
    start = np.concatenate([3 * np.arange(n), 3 * n + np.arange(len(topology.edges))])
    size = np.concatenate([np.full(n, 3), np.ones(len(topology.edges), dtype=int)])
    free = constraints.free.astype(np.int64)
    free_before = np.concatenate([[0], np.cumsum(free)])
    count = free_before[start + size] - free_before[start]
    running = np.cumsum(count[order])
    total = int(running[-1])
    owner = np.empty(len(order), dtype=np.int32)
    # A vertex and its edges stay together: the owner is that of the vertex's place.
    share = np.minimum(((running - count[order]) * ranks) // max(total, 1), ranks - 1)
    owner[order] = share
    vertex_of_place = np.empty(n, dtype=np.int64)
    vertex_of_place[place] = np.arange(n)
    owner[n:] = owner[vertex_of_place[edge_place]]
    order = np.lexsort((np.arange(len(key)), key, owner))
    dof_order = np.repeat(start[order], size[order]) + _ramp(size[order])
    dof_order = dof_order[constraints.free[dof_order]]
    unknown = np.full(len(free), -1, dtype=np.int64)
    unknown[dof_order] = np.arange(len(dof_order))
    per_rank = np.bincount(owner, weights=count, minlength=ranks).astype(np.int64)
    triangle_order = np.argsort(place[shell.triangles].min(axis=1), kind="stable")
    range_start = np.concatenate([[0], np.cumsum(per_rank)])
    return Numbering(owner, unknown, dof_order, range_start, triangle_order)


def _ramp(sizes: Ints) -> Ints:
    """0, 1, ..., size-1 for each size in turn."""
    ends = np.cumsum(sizes)
    return np.arange(ends[-1] if len(ends) else 0) - np.repeat(ends - sizes, sizes)


def distribute(shell: Shell | None, directors: bool, comm: MPI.Comm) -> Part:
    """The part of each rank of a shell that rank 0 holds (None elsewhere). An error on rank 0 is raised on all."""
    if shell is None:
        failure = comm.bcast(None)
        if failure is not None:
            raise failure
        found: Part = comm.recv(source=0)
        return found
    try:
        constraints = build_constraints(shell, directors)
        clamps, angles = held_directors(shell, directors)
        clamps = clamp_laws(shell, clamps)
        constraints.closure[3 * len(shell.points) :] = angles
        numbering = number_unknowns(shell, constraints, comm.size)
    except Exception as failure:
        comm.bcast(failure)
        raise
    comm.bcast(None)
    for rank in range(1, comm.size):
        comm.send(cut(shell, constraints, numbering, rank, clamps, directors), dest=rank)
    return cut(shell, constraints, numbering, 0, clamps, directors)


def cut(
    shell: Shell, constraints: Constraints, numbering: Numbering, rank: int, clamps: Reals, directors: bool
) -> Part:
    """The part of one rank. clamps (k, 8) as Part.half_edge_clamp, with global half edges."""
    n, topology = len(shell.points), shell.topology
    edges = len(topology.edges)
    triangles = _needed_triangles(shell, constraints, numbering, rank)
    corners = shell.triangles[triangles]
    # with the vertices that belong to no triangle (theirs vanished in a seam): somebody must write them
    vertex = np.union1d(corners, np.flatnonzero(numbering.node_owner[:n] == rank))
    edge = np.unique(topology.triangle_edges[triangles]) if directors else np.zeros(0, dtype=np.int64)
    dofs = np.concatenate([(3 * vertex[:, None] + np.arange(3)).ravel(), 3 * n + edge])
    matrix, ghost = _combination(constraints.matrix[dofs], numbering, rank)
    vertex_local, edge_local = _numbers(vertex, n), _numbers(edge, edges)
    triangle_local = _numbers(triangles, len(shell.triangles)).astype(np.int64)
    other = topology.across[triangles]
    other_local = triangle_local[np.maximum(other, 0) // 3]
    across = np.where((other >= 0) & (other_local >= 0), 3 * other_local + other % 3, -1).astype(np.int32)
    rest_vertex, rest_corners = np.unique(shell.rest_triangles[triangles], return_inverse=True)
    force = np.zeros((n, 3)) if shell.force is None else shell.force
    moment = np.zeros((len(shell.triangles), 3)) if shell.moment is None else shell.moment.reshape(-1, 3)
    patch = shell.patch_pressure
    counted = numbering.node_owner[shell.triangles[triangles, 0]] == rank
    fabric = np.stack([a[triangles] for a in (shell.thickness, shell.young, shell.poisson, shell.density)])
    own = np.arange(*numbering.range_start[rank : rank + 2])
    return Part(
        vertex=vertex,
        edge=edge,
        triangle=triangles,
        corners=vertex_local[corners],
        triangle_edges=edge_local[topology.triangle_edges[triangles]],
        signs=np.ascontiguousarray(topology.signs[triangles]),
        across=across,
        points=shell.points[vertex],
        rest_points=shell.rest_points[rest_vertex],
        rest_vertex=rest_vertex,
        rest_corners=rest_corners.reshape(-1, 3).astype(np.int32),
        fabric=fabric,
        weave=np.zeros((len(triangles), 0)) if shell.weave is None else shell.weave[triangles],
        weight=counted.astype(float),
        matrix=matrix,
        closure=constraints.closure[dofs],
        supports=constraints.supports.of(dofs),
        place=_places(numbering.dof[own], vertex_local, edge_local, len(vertex)),
        direction=constraints.direction[numbering.dof[np.concatenate([own, ghost])]],
        force=np.concatenate([force[vertex].ravel(), np.zeros(len(edge))]),
        mass=_mass(shell)[dofs],
        moment=moment[triangles].ravel(),
        pressure=shell.pressure + (np.zeros(len(triangles)) if patch is None else patch[triangles]),
        springs=np.zeros((0, 3)) if shell.springs is None else shell.springs[vertex],
        bars=_joined(shell.bars, 2, 4, vertex_local, numbering.node_owner, rank),
        welds=_joined(shell.welds, 6, 9, vertex_local, numbering.node_owner, rank),
        extra_mass=np.zeros(len(vertex)) if shell.extra_mass is None else shell.extra_mass[vertex],
        half_edge_clamp=_clamps(clamps, triangle_local),
        turns=tuple(motion for _, motion in shell.moves),
        owned=len(own),
        first_global=int(numbering.range_start[rank]),
        ghost_global=ghost,
        owned_vertices=np.flatnonzero(numbering.node_owner[vertex] == rank),
        owned_edges=np.flatnonzero(numbering.node_owner[n + edge] == rank),
    )


def _numbers(kept: Ints, count: int) -> Ints:
    """(count,) place of each in `kept`, -1 for those that are not."""
    found: Ints = np.full(count, -1, dtype=np.int32)
    found[kept] = np.arange(len(kept))
    return found


def _combination(rows: sp.csr_matrix, numbering: Numbering, rank: int) -> tuple[sp.csr_matrix, Ints]:
    """Rows of C over a rank's unknowns, its own and then its ghosts; the ghosts' global numbers."""
    begin, end = numbering.range_start[rank], numbering.range_start[rank + 1]
    used = numbering.unknown[rows.indices]
    here = (used >= begin) & (used < end)
    ghost = np.unique(used[~here])
    local = np.where(here, used - begin, (end - begin) + np.searchsorted(ghost, used))
    shape = rows.shape[0], int(end - begin) + len(ghost)
    matrix = sp.csr_matrix((rows.data, local, rows.indptr), shape=shape)
    matrix.sort_indices()
    return matrix, ghost


def _clamps(clamps: Reals, triangle: Ints) -> Reals:
    """Those of the triangles here, by local half edges; triangle (m,): local numbers."""
    half = clamps[:, 0].astype(np.int64)
    place = triangle[half // 3]
    found: Reals = np.column_stack([3 * place + half % 3, clamps[:, 1:]])[place >= 0]
    return found


def _places(dof: Ints, vertex: Ints, edge: Ints, vertices: int) -> Ints:
    """Part.place of degrees of freedom, by the local numbers of vertices and edges."""
    director = dof - 3 * len(vertex)
    found = np.empty(len(dof), dtype=np.int64)
    found[director < 0] = vertex[dof[director < 0] // 3]
    found[director >= 0] = vertices + edge[director[director >= 0]]
    return found


def _joined(rows: Reals | None, count: int, width: int, local: Ints, owner: Ints, rank: int) -> Reals:
    """Part.bars or Part.welds of rows that begin with so many vertices."""
    if rows is None:
        return np.zeros((0, width + count + 1))
    vertices = rows[:, :count].astype(np.int64)
    here = np.where((local[vertices] >= 0).all(axis=1)[:, None], local[vertices], -1)
    return np.column_stack([rows, here, owner[vertices[:, 0]] == rank])


def _needed_triangles(shell: Shell, constraints: Constraints, numbering: Numbering, rank: int) -> Ints:
    """Triangles that contribute to an unknown of the rank and one ring for their hinges, in Hilbert order."""
    topology = shell.topology
    n = len(shell.points)
    mine = numbering.unknown[constraints.matrix.indices]
    mine = (mine >= numbering.range_start[rank]) & (mine < numbering.range_start[rank + 1])
    row = np.repeat(np.arange(constraints.matrix.shape[0]), np.diff(constraints.matrix.indptr))
    node = np.zeros(n + len(topology.edges), dtype=bool)
    touched = row[mine]
    node[np.where(touched < 3 * n, touched // 3, touched - 2 * n)] = True
    node |= numbering.node_owner == rank  # also what has no unknown is written by somebody
    for rows, count in ((shell.bars, 2), (shell.welds, 6)):  # what they join to a vertex comes with it
        if rows is not None:
            joined = rows[:, :count].astype(np.int64)
            node[joined[node[joined].any(axis=1)]] = True
    direct = node[shell.triangles].any(axis=1) | node[n + topology.triangle_edges].any(axis=1)
    ring = direct
    for _ in range(2):  # across a hinge: the vertex opposite; then the ring that those hinges need
        other = topology.across
        ring = ring | (ring[np.maximum(other, 0) // 3] & (other >= 0)).any(axis=1)
    found: Ints = numbering.triangle_order[ring[numbering.triangle_order]]
    return found


class Shared(Protocol):
    """What ranks share: a problem, or as much of one as is there."""

    comm: MPI.Comm
    part: Part


def gathered(problem: Shared, local: Reals) -> Reals | None:
    """(n, ...) values in the input's order on rank 0 of each rank's local vertices; None elsewhere."""
    own = problem.part.owned_vertices
    pieces = problem.comm.gather((problem.part.vertex[own], local[own]))
    if pieces is None:
        return None
    total = np.zeros((sum(len(index) for index, _ in pieces), *local.shape[1:]))
    for index, values in pieces:
        total[index] = values
    return total


def bounding_size(points: Reals, comm: MPI.Comm) -> float:
    """Diagonal (m) of the bounding box of all ranks' points (n, 3)."""
    outermost = np.concatenate([points, -points], axis=1).max(axis=0, initial=-np.inf)
    outermost = comm.allreduce(outermost, op=_maximum)
    return float(np.linalg.norm(outermost[:3] + outermost[3:]))


def _maximum(a: Reals, b: Reals) -> Reals:
    return np.maximum(a, b)
