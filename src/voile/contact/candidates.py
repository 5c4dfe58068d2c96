"""Layers of a shell that may touch: a vertex with a triangle, an edge with an edge, two thicknesses of cloth apart.

No step may carry one layer through another (`free_share`, ipctk's continuous collision detection), so the distance
needs no sign: each layer stays on the side where it started. Which pairs come near is found by `_kernels.Proximity`,
in arrays, for the search is made at nearly every step: ipctk's makes an object of each of 80,000 pairs of boxes that
meet, where 5,000 pairs of a dress are near.
"""

from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np

from voile import _kernels
from voile.arrays import Flags, Ints, Reals, diagonal, triangle_sides
from voile.contact.closest import Closest, closest_of_edges, closest_to_triangle
from voile.contact.directions import lengths
from voile.errors import InputError

BAND = 1.0  # thicknesses beyond contact within which pairs are kept: they stay valid for half of it of motion
# Steps of IPC's search on a way, which then ends where it is: 10 ms. A vertex that lies in a triangle's plane to
# round-off takes any number; one that slides by 3 cm at a distance of 1e-6 m takes 50,000.
LONGEST = 100_000
SAME = 1e-9  # thicknesses: layers nearer than this are in the same place
ACROSS = ((0, 1), (0, 2), (0, 3)), ((0, 2), (0, 3), (1, 2), (1, 3))  # a stencil's two sides: faces, edges


@dataclass(frozen=True)
class Candidates:
    """Pairs that may touch near the positions home (n, 3): vertex (c, 4), the first `faces` of them a vertex and a
    triangle, then edges and edges; code (c,) ascending, what a pair is known by; min_distance (c,) m, that it
    keeps."""

    code: Ints
    vertex: Ints
    faces: int
    home: Reals
    min_distance: Reals


@dataclass
class Layers:
    """All n vertices of a shell as layers that keep `thickness` (m) between their mid-surfaces.

    points (n, 3) m; triangles (m, 3); edges (e, 2); excluded (b, 2): vertices too near along the cloth to touch, or
    `caught` at the start where a seam gapes (how many); seams (k, 2): those of them that only a seam joins, further
    along it: a pair with one of these may touch, but for those of codes barred (l,); friction: Coulomb's coefficient;
    known (k,): codes of pairs, ascending, that keep another distance `min_distance` (k,) m apart; keeps: what starts
    nearer than the thickness does not come apart to it, for a motion is not to throw it; least (n,): the distances (m)
    that pairs of a vertex keep then.
    """

    points: Reals
    triangles: Ints
    edges: Ints
    excluded: Ints
    thickness: float
    friction: float
    caught: int = 0
    known: Ints = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    min_distance: Reals = field(default_factory=lambda: np.zeros(0))
    keeps: bool = False
    seams: Ints = field(default_factory=lambda: np.zeros((0, 2), dtype=np.int64))
    barred: Ints = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    least: Reals | None = None

    def __post_init__(self) -> None:
        import ipctk

        ipctk.set_num_threads(1)
        ipctk.set_logger_level(ipctk.LoggerLevel.error)  # it warns of small gaps, as touching layers have
        self.triangles = np.ascontiguousarray(self.triangles, dtype=np.int32)
        self.edges = np.ascontiguousarray(self.edges, dtype=np.int32)
        excluded, joined = self._pair_code(*self.excluded.T), self._pair_code(*self.seams.T)
        self._excluded, self._joined = np.setdiff1d(excluded, joined), np.intersect1d(excluded, joined)
        self._wary = np.isin(np.arange(len(self.points)), self.excluded)  # vertices of those pairs
        self._split = len(self.triangles) * len(self.points)  # codes from here on are of edges
        self._mesh = ipctk.CollisionMesh(self.points, self.edges, self.triangles)
        points = np.ascontiguousarray(self.points, dtype=float)
        self._proximity = _kernels.Proximity(points, self.triangles, self.edges)

    def __reduce__(self) -> tuple[Any, ...]:  # neither is sent to other ranks
        return Layers, tuple(getattr(self, f.name) for f in fields(self))

    def find(self, x: Reals, kept: Ints | None = None, further: float | None = None) -> Candidates:
        """Candidates at positions x (n, 3), up to `further` (m) from touching, with `known` ones and those of the codes
        kept (k,) in any case."""
        reach = self.thickness + (BAND * self.thickness if further is None else further)
        kept = self.known if kept is None else np.union1d(kept, self.known)
        return self._named(np.union1d(self._near(x, x, reach), kept), x)

    def started(self, x: Reals) -> "Layers":
        """The layers of a shell that starts at positions x (n, 3). It is vertices that keep what they start with, not
        pairs: those that slide on, to other triangles, would be thrown off these."""
        if not self.keeps:
            return self
        here, least = self.find(x), np.full(len(x), self.thickness)
        c = closest(here, x)
        at = c.weight != 0.0
        np.minimum.at(least, here.vertex[at], np.repeat(c.distance, at.sum(axis=1)))
        return replace(self, least=least)

    def joined(self, distance: float) -> Ints:
        """(l,) codes of the pairs with vertices that a seam joins, nearer at the start than distance (m)."""
        found = self.find(self.points, further=distance - self.thickness)
        parts = zip((found.vertex[: found.faces], found.vertex[found.faces :]), ACROSS, strict=True)
        across = [self._across(vertex, sides, self._joined) for vertex, sides in parts]
        return found.code[np.concatenate(across) > 0]

    def nearer(self, distance: float) -> Ints:
        """(b, 2) pairs of vertices across from each other in the pairs of the start nearer than distance (m)."""
        if distance <= 0.0:
            return np.zeros((0, 2), dtype=np.int64)
        found = self.find(self.points)
        near = closest(found, self.points).distance < distance
        parts = zip((slice(found.faces), slice(found.faces, None)), ACROSS, strict=True)
        values: Ints = np.concatenate(
            [found.vertex[part][near[part]][:, side] for part, sides in parts for side in sides]
        ).astype(np.int64)
        return values

    def _named(self, code: Ints, x: Reals) -> Candidates:
        vertex, least = self._vertices(code), np.full(len(code), self.thickness)
        if self.least is not None:
            least = self.least[vertex].min(axis=1)
        least[np.isin(code, self.known)] = self.min_distance[np.isin(self.known, code)]
        return Candidates(code, vertex, self._faces(code), x.copy(), least)

    def valid(self, candidates: Candidates, x: Reals) -> bool:
        """Whether no other pairs than the candidates can touch at positions x (n, 3)."""
        if len(candidates.home) != len(x):
            return False
        return bool(np.linalg.norm(x - candidates.home, axis=1).max() < 0.5 * BAND * self.thickness)

    def free_share(self, x: Reals, moved: Reals, candidates: Candidates) -> float:
        """Share of the way from x to `moved` (n, 3) that carries no layer through another, at most 1, and no vertex
        further than the shell is large: over ways of many sizes, as of a safe step near a mechanism, IPC's search does
        not come back."""
        import ipctk

        reach = diagonal(x) / max(float(lengths(moved - x).max()), 1e-300)
        if reach < 1.0:
            reach *= 0.999  # or round-off may leave the rest too long again
            return reach * self.free_share(x, x + reach * (moved - x), candidates)
        known = self.valid(candidates, x) and self.valid(candidates, moved)
        code = candidates.code if known else self._near(x, moved, 0.0)
        face, edge = np.split(code, [self._faces(code)])
        swept, search = ipctk.Candidates(), ipctk.AdditiveCCD(LONGEST)
        n, e = len(self.points), len(self.edges)
        swept.fv_candidates = [ipctk.FaceVertexCandidate(*divmod(c, n)) for c in face.tolist()]
        swept.ee_candidates = [ipctk.EdgeEdgeCandidate(*divmod(c, e)) for c in (edge - self._split).tolist()]
        return float(swept.compute_collision_free_stepsize(self._mesh, x, moved, 0.0, search))

    def check_start(self, x: Reals) -> None:
        """Raises InputError where layers at x (n, 3) are in the same place, or (but for what is excluded) through each
        other."""
        here = self.find(x)
        distance = closest(here, x).distance
        if len(distance) and distance.min() <= SAME * self.thickness:
            vertex = here.vertex[np.argmin(distance), 0]
            place = ", ".join(f"{c:.4g}" for c in x[vertex])
            raise InputError(
                f"contact.self_contact: layers of the shell start in the same place at vertex {vertex} ({place}); "
                "move them apart, or sew them"
            )
        crossing = self._crossing(x)
        if len(crossing):
            place = ", ".join(f"{c:.4g}" for c in x[crossing[0]])
            raise InputError(
                f"contact.self_contact: the shell starts passing through itself near {len(crossing)} vertices, first "
                f"{crossing[0]} ({place}); move its layers apart"
            )

    def _crossing(self, x: Reals) -> Ints:
        """Vertices of edges that pass through a triangle, away from what is excluded."""
        import ipctk

        apart = self.triangles[~np.isin(self.triangles, self.excluded).any(axis=1)]
        sides = np.unique(triangle_sides(apart), axis=0)
        boxes = ipctk.LBVH()
        boxes.build(x, sides, apart, 0.0)
        found = [(c.edge_id, c.face_id) for c in boxes.detect_edge_face_candidates()]
        edge, face = np.array(found, dtype=np.int64).reshape(-1, 2).T
        joined = (sides[edge][:, :, None] == apart[face][:, None]).any(axis=(1, 2))
        stencil = np.column_stack([sides[edge], apart[face]])[~joined]
        through = [ipctk.is_edge_intersecting_triangle(*x[row]) for row in stencil]
        values: Ints = np.unique(stencil[np.array(through, dtype=bool)][:, :2])
        return values

    def check_held(self, x: Reals, free: Flags) -> None:
        """Raises InputError where what is not free (n,) keeps layers at x (n, 3) nearer than they may come."""
        here = self.find(x)
        c = closest(here, x)
        held = ~((c.weight != 0.0) & free[here.vertex]).any(axis=1)
        near = np.where(held, c.distance, np.inf)
        if (near < (1.0 - SAME) * here.min_distance).any():
            vertex = here.vertex[np.argmin(near), 0]
            raise InputError(
                f"contact.self_contact: supports hold layers of the shell {near.min():.4g} m apart at vertex {vertex}, "
                f"nearer than twice the offset, {self.thickness:.4g} m; lower contact.offset or hold them further apart"
            )

    def _near(self, x: Reals, moved: Reals, reach: float) -> Ints:
        """(c,) codes, ascending, of the pairs that may come within `reach` (m) on straight ways from x to moved (n, 3),
        but for excluded ones."""
        start, end = (np.ascontiguousarray(p, dtype=float) for p in (x, moved))
        face, edge = self._proximity.pairs(start, end, reach)
        return np.concatenate([code[self._open(code)] for code in (face, self._split + edge)])

    def _open(self, code: Ints) -> Flags:
        """(c,) marks those of codes, all of faces or all of edges, that are not excluded. Two vertices of the one side
        joined to the other, or one between two, lie along the seam: both triangulations have chords of it there."""
        vertex, sides = self._vertices(code), ACROSS[0 if self._faces(code) else 1]
        near, joined = (self._across(vertex, sides, pairs) for pairs in (self._excluded, self._joined))
        found: Flags = (near == 0) & (joined < 2) & ~np.isin(code, self.barred)
        return found

    def _across(self, vertex: Ints, sides: tuple[tuple[int, int], ...], pairs: Ints) -> Ints:
        """(c,) how many pairs of vertices across from each other in stencils (c, 4) are among pairs (b,), by code."""
        count = np.zeros(len(vertex), dtype=np.int64)
        for i, j in sides:
            one, two = vertex[:, i], vertex[:, j]
            rows = np.flatnonzero(self._wary[one] & self._wary[two])
            count[rows] += np.isin(self._pair_code(one[rows], two[rows]), pairs)
        return count

    def _pair_code(self, i: Ints, j: Ints) -> Ints:
        found: Ints = np.minimum(i, j).astype(np.int64) * len(self.points) + np.maximum(i, j)
        return found

    def _faces(self, code: Ints) -> int:
        return int(np.count_nonzero(code < self._split))

    def _vertices(self, code: Ints) -> Ints:
        """(c, 4) of candidates by codes, those of faces first."""
        n, e, split = len(self.points), len(self.edges), self._faces(code)
        face, edge = code[:split], code[split:] - self._split
        first = np.column_stack([face % n, self.triangles[face // n]])
        return np.concatenate([first, np.column_stack([self.edges[edge // e], self.edges[edge % e]])])


def closest(candidates: Candidates, x: Reals) -> Closest:
    """Of all candidates, at positions x (n, 3) of all vertices."""
    split, corner = candidates.faces, x[candidates.vertex]
    parts = closest_to_triangle(corner[:split]), closest_of_edges(corner[split:])
    return Closest(
        np.concatenate([part.weight for part in parts]),
        np.concatenate([part.along for part in parts]),
        np.concatenate([part.distance for part in parts]),
    )


def near_along(edges: Ints, length: Reals, n: int, limit: float) -> Ints:
    """(b, 2) pairs of n vertices joined by a path of edges (e, 2) of lengths (e,) m no longer than limit (m)."""
    short = length <= limit
    link = np.concatenate([edges[short], edges[short][:, ::-1]]).astype(np.int64)
    link, cost = _shortest(link, np.tile(length[short], 2), n)
    start = np.searchsorted(link[:, 0], np.arange(n + 1))
    pair, reach, count = link, cost, -1
    while count != len(pair):  # one edge more at a time
        count = len(pair)
        fan = start[pair[:, 1] + 1] - start[pair[:, 1]]
        first = np.repeat(start[pair[:, 1]] - (np.cumsum(fan) - fan), fan) + np.arange(fan.sum())
        longer = np.repeat(reach, fan) + cost[first]
        fits = longer <= limit
        on = np.column_stack([np.repeat(pair[:, 0], fan), link[first, 1]])[fits]
        pair, reach = _shortest(np.concatenate([pair, on]), np.concatenate([reach, longer[fits]]), n)
    return pair[pair[:, 0] < pair[:, 1]]


def _shortest(pair: Ints, cost: Reals, n: int) -> tuple[Ints, Reals]:
    """Each pair once, ascending, with its least cost; no vertex with itself."""
    order = np.lexsort((cost, pair[:, 0] * n + pair[:, 1]))
    order = order[pair[order, 0] != pair[order, 1]]
    code = pair[order, 0] * n + pair[order, 1]
    once = order[np.concatenate([[True], code[1:] != code[:-1]])[: len(code)]]
    return pair[once], cost[once]
