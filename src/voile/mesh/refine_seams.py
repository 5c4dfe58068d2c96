"""Seams of a refined mesh: stitches of the midpoints.

The middle of an edge whose two ends are sewn is sewn half way between where they are, along the edges on the seam's
other side. Vertices that are joined by stitches count as one point, named by the smallest (mesh.stitches.join).
"""

from dataclasses import dataclass
from heapq import heappop, heappush
from itertools import pairwise

import numpy as np

from voile.arrays import Ints, Reals
from voile.mesh.stitches import Stitches, join
from voile.mesh.topology import Topology

LONGER = 2.0  # than its edge: a way on the seam's other side that still is the same seam; cloth eased in needs less
STRAIGHT = 1.05  # the same of an edge inside a panel, which seams may run along, but not around a corner
# how much longer than it is an edge inside a panel counts beside one on the border: seams keep to it
ACROSS = 4.0
SAME = 1e-9  # of an edge: as near to a vertex as this is at the vertex (sewing_matrix tells no nearer apart)


@dataclass(frozen=True)
class _Spot:
    """The point (1 - weight) first + weight second of an edge."""

    first: int
    second: int
    weight: float


class _Seams:
    """The coarser mesh's points that are joined, its hanging ones, and its edges between points."""

    def __init__(self, stitches: Stitches, points: Reals, topology: Topology):
        n = len(points)
        self.label, self.hangs = join(stitches, n)
        slave, first, second = (
            self.label[part[self.hangs]] for part in (stitches.slave, stitches.first, stitches.second)
        )
        self.spots = {
            int(s): _Spot(int(a), int(b), float(w))
            for s, a, b, w in zip(slave, first, second, stitches.weight[self.hangs], strict=True)
        }
        self.count = n
        self.ends = self.label[topology.edges]
        self.border = np.zeros(len(topology.edges), dtype=bool)
        self.border[topology.boundary_edges] = True
        self.length = np.linalg.norm(np.diff(points[topology.edges], axis=1)[:, 0], axis=1)
        self.masters, self.joined = self._same()
        self.edge = {(int(a), int(b)): int(e) for e in self.masters for a, b in [np.sort(self.ends[e])]}
        self.around = self._around()

    def _same(self) -> tuple[Ints, Ints]:
        """Edges of which one stands for all between the same two points, and (k, 2) those to sew to such a one: all on
        the border, and one inside a panel if it is the only one there."""
        low, high = np.sort(self.ends, axis=1).T.astype(np.int64)
        order = np.lexsort([~self.border, low * self.count + high])  # the border's first
        key = (low * self.count + high)[order]
        first = np.ones(len(key), dtype=bool)
        first[1:] = key[1:] != key[:-1]
        master = order[first][np.cumsum(first) - 1]
        inside = np.bincount(master, weights=~self.border[order], minlength=len(key))[master]
        sewn = ~first & self.border[master] & (self.border[order] | (inside == 1))
        return order[first], np.column_stack([order, master])[sewn]

    def _around(self) -> dict[int, list[tuple[int, float]]]:
        """Point -> its neighbours that do not hang, with how far they are."""
        found: dict[int, list[tuple[int, float]]] = {}
        involved = np.isin(
            self.label, np.unique([[s.first, s.second] for s in self.spots.values()]).astype(int)
        )
        near = self.masters[involved[self.ends[self.masters]].any(axis=1)]
        for e in near.tolist():
            a, b = self.ends[e].tolist()
            if a not in self.spots and b not in self.spots:
                far = float(self.length[e]) * (1.0 if self.border[e] else ACROSS)
                found.setdefault(a, []).append((b, far))
                found.setdefault(b, []).append((a, far))
        return found

    def far(self, a: int, b: int) -> float:
        """Length between two points with an edge; 0 without."""
        e = self.edge.get((min(a, b), max(a, b)))
        return 0.0 if e is None else float(self.length[e])

    def leave(self, point: int) -> list[tuple[int, float]]:
        """Points at the ends of the edge where a point is, and how far."""
        spot = self.spots.get(point)
        if spot is None:
            return [(point, 0.0)]
        far = self.far(spot.first, spot.second)
        return [(spot.first, spot.weight * far), (spot.second, (1.0 - spot.weight) * far)]

    def way(self, start: int, end: int, limit: float) -> list[int]:
        """Points on the shortest way, of at most `limit`, from a point to another that passes whole edges; empty
        without one (Dijkstra's method)."""
        goals = dict(self.leave(end))
        queue = [(far, [point]) for point, far in self.leave(start)]
        queue.sort()
        best: tuple[float, list[int]] = (limit, [])
        seen: set[int] = set()
        while queue and queue[0][0] <= best[0]:
            far, path = heappop(queue)
            if path[-1] in seen:
                continue
            seen.add(path[-1])
            if path[-1] in goals and far + goals[path[-1]] <= best[0]:
                best = far + goals[path[-1]], path
            for point, further in self.around.get(path[-1], ()):
                heappush(queue, (far + further, [*path, point]))
        return best[1]

    def middle(self, e: int) -> _Spot | None:
        """Where the middle of an edge is on the seam's other side; None where that is not sewn along it."""
        start, end = self.ends[e].tolist()
        one, other = self.spots.get(start), self.spots.get(end)
        spot = one or other
        if spot is None:
            return None
        pair = spot.first, spot.second
        begin, stop = self._along(pair, start), self._along(pair, end)
        if begin is not None and stop is not None:
            return _Spot(*pair, 0.5 * (begin + stop))
        length = float(self.length[e])
        path = self.way(start, end, (LONGER if self.border[e] else STRAIGHT) * length)
        if not path:
            return None
        return self._half_way(one, path, other)

    def _along(self, pair: tuple[int, int], point: int) -> float | None:
        """How far along the edge between two points another is, from 0 to 1; None off it."""
        spot = self.spots.get(point)
        if spot and (spot.first, spot.second) == pair:
            return spot.weight
        if spot and (spot.second, spot.first) == pair:
            return 1.0 - spot.weight
        return float(pair.index(point)) if point in pair else None

    def _half_way(self, one: _Spot | None, path: list[int], other: _Spot | None) -> _Spot:
        """The spot half way from one, or the path's first point, over the path to the other, or its last."""
        pieces = [(a, b, 0.0, 1.0) for a, b in pairwise(path)]
        if one:
            whole = (one.first, one.second, one.weight)
            a, b, t = whole if one.second == path[0] else (one.second, one.first, 1.0 - one.weight)
            pieces.insert(0, (a, b, t, 1.0))
        if other:
            whole = (other.first, other.second, other.weight)
            a, b, t = whole if other.first == path[-1] else (other.second, other.first, 1.0 - other.weight)
            pieces.append((a, b, 0.0, t))
        far = np.array([(stop - begin) * self.far(a, b) for a, b, begin, stop in pieces])
        passed = np.cumsum(far)
        k = int(np.searchsorted(passed, 0.5 * passed[-1]))
        a, b, begin, stop = pieces[k]
        share = (0.5 * passed[-1] - (passed[k] - far[k])) / far[k]
        return _Spot(a, b, begin + share * (stop - begin))


def refine_stitches(stitches: Stitches, points: Reals, topology: Topology) -> Stitches:
    """Stitches of the mesh whose vertices are `points` (n, 3), then the middles of the edges: the given ones, those on
    an edge now on a half of it, and those of the middles."""
    seams = _Seams(stitches, points, topology)
    n = seams.count
    rows: list[tuple[int, int, int, float]] = []

    def sew(slave: int, first: int, second: int, weight: float) -> None:
        """On the half of the edge between two vertices, if there is one."""
        a, b = sorted((int(seams.label[first]), int(seams.label[second])))
        e = seams.edge.get((a, b))
        if e is None:
            rows.append((slave, first, second, weight))
        else:
            end, share = (first, 1.0 - 2.0 * weight) if weight <= 0.5 else (second, 2.0 * weight - 1.0)
            rows.append((slave, n + e, end, next((w for w in (0.0, 1.0) if abs(share - w) < SAME), share)))

    hangs = np.zeros(len(stitches), dtype=bool)
    hangs[seams.hangs] = True
    for k, row in enumerate(
        zip(stitches.slave, stitches.first, stitches.second, stitches.weight, strict=True)
    ):
        slave, first, second, weight = (part.item() for part in row)
        if hangs[k]:
            sew(slave, first, second, weight)
        else:
            rows.append((slave, first, second, weight))
    rows += [(n + e, n + master, n + master, 0.0) for e, master in seams.joined.tolist()]
    touched = np.isin(seams.ends, list(seams.spots)).any(axis=1)
    for e in seams.masters[touched[seams.masters]].tolist():
        spot = seams.middle(e)
        if spot:
            sew(n + e, spot.first, spot.second, spot.weight)
    slave, first, second = np.array([row[:3] for row in rows], dtype=np.int32).T.copy()
    return Stitches(slave, first, second, np.array([row[3] for row in rows]))
