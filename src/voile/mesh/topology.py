"""Edges, hinges and boundary loops of an oriented triangle mesh.

Conventions, shared with the kernels (src/cpp/geometry.hpp): corner `i` of a triangle is opposite its edge `i`,
which runs from corner i+1 to corner i+2 (modulo 3), so the triangle lies on the edge's left.
"""

from dataclasses import dataclass

import numpy as np

from voile.arrays import Flags, Ints, Reals, units


@dataclass(frozen=True)
class Topology:
    """Edges of a mesh of m triangles and how triangles meet in them.

    edges (e, 2) vertex pairs, smaller index first, sorted lexicographically;
    triangle_edges (m, 3) edge opposite each corner; signs (m, 3) +1 where the triangle runs along the edge
    from its first to its second vertex, else -1; across (m, 3) the half edge 3*triangle + corner on the other
    side, -1 on the boundary.
    """

    edges: Ints
    triangle_edges: Ints
    signs: Ints
    across: Ints

    @property
    def boundary_edges(self) -> Ints:
        """(b,) indices of the edges with one triangle only."""
        return np.sort(self.triangle_edges[self.across < 0])


def build_topology(triangles: Ints) -> Topology:
    """Topology of an edge-manifold, consistently oriented mesh `triangles` (m, 3)."""
    tri = np.asarray(triangles, dtype=np.int64)
    start, end = tri[:, [1, 2, 0]].ravel(), tri[:, [2, 0, 1]].ravel()
    low, high = np.minimum(start, end), np.maximum(start, end)
    key = low * (int(tri.max(initial=0)) + 1) + high
    order = np.argsort(key, kind="stable")
    ordered = key[order]
    first = np.ones(len(key), dtype=bool)
    first[1:] = ordered[1:] != ordered[:-1]
    edge_of = np.empty(len(key), dtype=np.int32)
    edge_of[order] = np.cumsum(first, dtype=np.int32) - 1
    edges = np.column_stack([low[order][first], high[order][first]]).astype(np.int32)
    across = np.full(len(key), -1, dtype=np.int32)
    twin = np.flatnonzero(~first)
    across[order[twin]] = order[twin - 1]
    across[order[twin - 1]] = order[twin]
    signs = np.where(start < end, 1, -1).astype(np.int32)
    shape = tri.shape
    return Topology(edges, edge_of.reshape(shape), signs.reshape(shape), across.reshape(shape))


def boundary_loops(triangles: Ints, topology: Topology, points: Reals) -> list[Ints]:
    """Closed boundary loops as vertex indices in order, longest (in metres) first.

    At a pinch vertex (two loops touching) the walk turns into the edge that belongs to the same fan of
    triangles, so that touching loops stay separate loops.
    """
    tri = np.asarray(triangles)
    half = np.flatnonzero(topology.across.ravel() < 0)
    follower = {int(h): _next_boundary(int(h), topology.across) for h in half}
    loops, left = [], set(follower)
    for h in follower:
        if h not in left:
            continue
        walk = []
        while h in left:
            left.remove(h)
            walk.append(tri[h // 3, (h % 3 + 1) % 3])
            h = follower[h]
        loops.append(np.array(walk, dtype=np.int32))

    def length(loop: Ints) -> float:
        return float(np.linalg.norm(points[np.roll(loop, -1)] - points[loop], axis=1).sum())

    return sorted(loops, key=length, reverse=True)


def _next_boundary(half: int, across: Ints) -> int:
    """The boundary half edge that starts where `half` ends, met by turning through the fan of triangles."""
    triangle, corner = divmod(half, 3)
    while True:
        corner = (corner + 1) % 3  # the edge of this triangle that starts at the end vertex
        other = across[triangle, corner]
        if other < 0:
            return 3 * triangle + corner
        triangle, corner = divmod(int(other), 3)


def inside_out(points: Reals, triangles: Ints) -> Flags:
    """(n,) inner vertices around which an odd number of hinges has turned through 180 degrees since the sheet was flat.

    A walk once around a vertex turns by the corners about the normals and by the folds about the edges. It ends as it
    began, as a quaternion -1 where the sheet is flat: bending keeps that, a hinge that passes 180 degrees makes it 1.
    """
    across, n = build_topology(triangles).across, len(points)
    first, second = (units(points[np.roll(triangles, -k, axis=1)] - points[triangles]) for k in (1, 2))
    corner = np.arctan2(np.linalg.norm(np.cross(first, second), axis=2), (first * second).sum(axis=2))
    normal = units(np.cross(first[:, 0], second[:, 0]))[:, None]
    beyond, edge = normal[across // 3, 0], np.roll(first, -1, axis=1)
    fold = np.arctan2((np.cross(normal, beyond) * edge).sum(axis=2), (normal * beyond).sum(axis=2))
    # from corner k one leaves the triangle by the edge to corner k + 2, opposite corner k + 1
    leaves = np.roll(across, -1, axis=1).ravel()
    following = np.where(leaves < 0, -1, 3 * (leaves // 3) + (leaves + 1) % 3)
    half, other = 0.5 * corner.ravel(), 0.5 * np.roll(fold, -1, axis=1).ravel()
    steps = np.stack([trig(half) * also(other) for trig, also in _Z_THEN_X], axis=1)
    start = np.full(n, -1)
    start[triangles.ravel()] = np.arange(triangles.size)
    turn, at, walks = np.tile([1.0, 0.0, 0.0, 0.0], (n, 1)), start.copy(), start >= 0
    while walks.any():
        rows = np.flatnonzero(walks)
        turn[rows] = _product(turn[rows], steps[at[rows]])
        at[rows] = following[at[rows]]
        walks[rows] = (at[rows] >= 0) & (at[rows] != start[rows])
    found: Flags = (turn[:, 0] > 0.0) & (start >= 0) & (at >= 0)
    return found


# Components of a turn about z and then about x, of both halved angles.
_Z_THEN_X = (np.cos, np.cos), (np.cos, np.sin), (np.sin, np.sin), (np.sin, np.cos)


def _product(p: Reals, q: Reals) -> Reals:
    """(n, 4) of quaternions."""
    a, u, b, v = p[:, :1], p[:, 1:], q[:, :1], q[:, 1:]
    return np.hstack([a * b - (u * v).sum(axis=1, keepdims=True), a * v + b * u + np.cross(u, v)])
