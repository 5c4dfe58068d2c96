"""Middles of a curved mesh's edges on a smooth surface through its vertices, for refinement.

An edge becomes a cubic curve (Hermite's) whose directions at the ends are the edge's own in the tangent planes there;
along the border, those of the border. Tangent planes are of quadrics fitted to a vertex, its neighbours and theirs
(Cazals & Pouget 2005, degree 2): right to h^2, middles to h^3 or better. Flat meshes stay flat, straight borders
straight, sharp edges and corners sharp.
"""

import numpy as np
from scipy.sparse import csr_matrix, diags

from voile.arrays import Flags, Ints, Reals, area_vectors, row_sums, units
from voile.mesh.topology import build_topology

SHARP = 0.5  # cosine: turns of 60 degrees and more, from a triangle or border edge to the next, are edges and corners
ROUND_OFF = 1e-12  # of the fits' matrices, so that those of few neighbours have an answer


def smooth_middles(points: Reals, triangles: Ints) -> Reals:
    """(e, 3) in the order of the topology's edges."""
    topology = build_topology(triangles)
    a, b = points[topology.edges[:, 0]], points[topology.edges[:, 1]]
    facing = area_vectors(points, triangles)
    sharp = _sharp(units(facing), topology.across, triangles, len(points))
    normals = _normals(points, triangles, facing, topology.edges, sharp)
    lean = np.einsum("eki,ei->ek", normals[topology.edges], b - a)
    lean[sharp[topology.edges].any(axis=1)] = 0.0
    bend = lean[:, 1:] * normals[topology.edges[:, 1]] - lean[:, :1] * normals[topology.edges[:, 0]]
    border = topology.boundary_edges
    bend[border] = _along_border(points, topology.edges[border])
    found: Reals = 0.5 * (a + b) + 0.125 * bend
    return found


def _sharp(facing: Reals, across: Ints, triangles: Ints, count: int) -> Flags:
    """(n,) vertices at the ends of sharp edges."""
    triangle, corner = np.nonzero(across >= 0)
    beyond = across[triangle, corner] // 3
    at = np.einsum("hi,hi->h", facing[triangle], facing[beyond]) < SHARP
    found = np.zeros(count, dtype=bool)
    for step in (1, 2):
        found[triangles[triangle[at], (corner[at] + step) % 3]] = True
    return found


def _normals(points: Reals, triangles: Ints, facing: Reals, edges: Ints, sharp: Flags) -> Reals:
    """(n, 3) unit normals of quadrics through the vertices; fits do not reach past sharp vertices."""
    n = len(points)
    first = np.zeros((n, 3))
    for corner in triangles.T:
        np.add.at(first, corner, facing)
    first = units(first)
    ones = np.ones(2 * len(edges))
    near = csr_matrix((ones, (edges.ravel("F"), edges[:, ::-1].ravel("F"))), shape=(n, n))
    reached = (near + near @ diags((~sharp).astype(float)) @ near).tocoo()
    i, j = reached.row[reached.row != reached.col], reached.col[reached.row != reached.col]
    aside = units(np.cross(first, np.eye(3)[np.abs(first).argmin(axis=1)]))
    frame = np.stack([aside, np.cross(first, aside), first], axis=1)
    size = np.sqrt(np.bincount(edges.ravel(), np.repeat(_lengths(points, edges) ** 2, 2), n))
    local = np.einsum("pki,pi->pk", frame[i], points[j] - points[i]) / size[i, None]
    u, v, height = local.T
    terms = np.stack([u, v, u * u, u * v, v * v], axis=1) / np.linalg.norm(local, axis=1)[:, None]
    right = terms * (height / np.linalg.norm(local, axis=1))[:, None]
    squares = row_sums(i, (terms[:, :, None] * terms[:, None, :]).reshape(-1, 25), n).reshape(n, 5, 5)
    slopes = np.linalg.solve(squares + ROUND_OFF * np.eye(5), row_sums(i, right, n)[:, :, None])[:, :2, 0]
    return units(first - slopes[:, :1] * frame[:, 0] - slopes[:, 1:] * frame[:, 1])


def _lengths(points: Reals, edges: Ints) -> Reals:
    found: Reals = np.linalg.norm(points[edges[:, 1]] - points[edges[:, 0]], axis=1)
    return found


def _along_border(points: Reals, edges: Ints) -> Reals:
    """(b, 3) lengths times the differences of directions at the ends of border edges (b, 2): those of parabolas through
    the vertex and its two neighbours; at corners, of the parabola that starts there."""
    lengths = _lengths(points, edges)
    along = (points[edges[:, 1]] - points[edges[:, 0]]) / lengths[:, None]
    ends, edge = edges.ravel(), np.repeat(np.arange(len(edges)), 2)
    outward = along[edge] * np.tile([1.0, -1.0], len(edges))[:, None]  # from the vertex along the edge
    order = np.argsort(ends, kind="stable")
    _, start, count = np.unique(ends[order], return_index=True, return_counts=True)
    direction = np.full(
        (2 * len(edges), 3), np.nan
    )  # at both ends of every edge, from its first to its second
    one, two = order[start[count == 2]], order[start[count == 2] + 1]
    smooth = np.einsum("vi,vi->v", outward[one], outward[two]) < -SHARP
    one, two = one[smooth], two[smooth]
    mine, other = lengths[edge[one], None], lengths[edge[two], None]
    through = (outward[one] * other - outward[two] * mine) / (
        mine + other
    )  # from the second edge to the first
    direction[one] = through * np.where(one % 2 == 0, 1.0, -1.0)[:, None]
    direction[two] = through * np.where(two % 2 == 0, -1.0, 1.0)[:, None]
    begins, stops = direction[0::2], direction[1::2]
    begins = np.where(np.isnan(begins), 2.0 * along - stops, begins)
    stops = np.where(np.isnan(stops), 2.0 * along - begins, stops)
    found: Reals = np.nan_to_num(begins - stops) * lengths[:, None]
    return found
