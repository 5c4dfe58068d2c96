"""Edges, hinges and boundary loops of an oriented triangle mesh.

Conventions, shared with the kernels (src/cpp/geometry.hpp): corner `i` of a triangle is opposite its edge `i`,
which runs from corner i+1 to corner i+2 (modulo 3), so the triangle lies on the edge's left.
"""

from dataclasses import dataclass

import numpy as np

from voile.arrays import Ints, Reals


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
