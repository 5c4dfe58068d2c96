"""A surface as panels, discs that can be laid flat: along groups, along given seams, or by one automatic cut."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components, dijkstra

from voile.arrays import Array, Flags, Ints, Reals
from voile.errors import InputError
from voile.mesh import Stitches, boundary_loops, build_topology

BACK = (0.0, 0.0, -1.0)  # where an automatic cut goes among paths of like length: the middle of the back
FRONT_COSTS = 0.5  # relative extra length of an edge at the very front
Groups = tuple[Ints, tuple[str, ...]]


@dataclass(frozen=True)
class Seam:
    """Two runs of boundary that are sewn together, both in the same direction along the seam.

    panels: the panel of either side, the same one twice in a dart or a cut back on itself; sides: the panel
    vertices (k,) of either run; at: for each vertex of a run where it is along the seam, from 0 to 1.
    """

    panels: tuple[int, int]
    sides: tuple[Ints, Ints]
    at: tuple[Reals, Reals]


@dataclass(frozen=True)
class Panels:
    """A surface cut into P discs, each with its own copies of the vertices along its seams.

    points (n, 3) in metres and triangles (m, 3) of the surface; panel (m,) of each triangle, from 0; names (P);
    corners (m, 3): triangles in panel vertices, of which there are p; vertex (p,): their surface vertices;
    vertex_panel (p,), increasing; outlines: panel vertices (b,) around each panel, counter-clockwise seen
    from the side of the surface's normals; seams: what is sewn together; stitches: what joins panel vertices
    beside their being copies of one surface vertex, if anything does.
    """

    points: Reals
    triangles: Ints
    panel: Ints
    names: tuple[str, ...]
    corners: Ints
    vertex: Ints
    vertex_panel: Ints
    outlines: tuple[Ints, ...]
    seams: tuple[Seam, ...]
    stitches: Stitches | None = None


def split(
    triangles: Ints,
    points: Reals,
    groups: Groups | None = None,
    seams: Ints | None = None,
    cut_open: bool | None = None,
    back: Sequence[float] = BACK,
    middle: Flags | None = None,
) -> Panels:
    """Cut the surface `triangles` (m, 3), `points` (n, 3) in metres, into discs.

    groups: index (m,) and names, a panel for each connected piece of a group; seams: (k, 2) vertex pairs of the
    edges to cut, beside those between groups. cut_open: whether a piece that is no disc is cut along shortest
    paths between its boundary loops, at the side `back` where several are alike; by default only where there are
    neither groups nor seams. middle: (n,) vertices along which it is cut where it can be, as those of the plane of
    symmetry.
    Raises InputError for an edge of more than two triangles or clashing orientations, a seam edge that is not
    inside the surface, and a panel that is no disc.
    """
    triangles, points = np.asarray(triangles, dtype=np.int64), np.asarray(points, dtype=float)
    _check_manifold(triangles)
    topology = build_topology(triangles)
    cut = np.zeros(len(topology.edges), dtype=bool)
    half = np.flatnonzero(topology.across.ravel() >= 0)
    edge, other = topology.triangle_edges.ravel()[half], topology.across.ravel()[half]
    if groups is not None:
        cut[edge[groups[0][half // 3] != groups[0][other // 3]]] = True
    if seams is not None:
        cut[_edges_at(topology.edges, np.asarray(seams), np.bincount(edge, minlength=len(cut)) > 0)] = True
    if cut_open if cut_open is not None else groups is None and seams is None:
        middle = np.zeros(len(points), dtype=bool) if middle is None else middle
        cut = _cut_to_discs(triangles, points, cut, np.asarray(back, dtype=float), middle)
    group = np.zeros(len(triangles), dtype=np.int64) if groups is None else np.asarray(groups[0])
    corners, vertex, panel = _pieces(triangles, cut, group)
    names = _names(panel, groups)
    _check_discs(corners, panel, names, topology.edges[cut])
    vertex_panel = np.empty(len(vertex), dtype=np.int64)
    vertex_panel[corners] = panel[:, None]
    walk = _Walk(triangles, corners, panel)
    outlines = tuple(walk.starts(loop) for loop in walk.loops)
    return Panels(
        points,
        triangles,
        panel,
        names,
        corners,
        vertex,
        vertex_panel,
        outlines,
        tuple(walk.seams(points, vertex)),
    )


def _check_manifold(triangles: Ints) -> None:
    start, end = triangles[:, [1, 2, 0]].ravel(), triangles[:, [2, 0, 1]].ravel()
    key = start * (triangles.max(initial=0) + 1) + end
    order = np.argsort(key, kind="stable")
    twice = np.flatnonzero(np.diff(key[order]) == 0)
    if len(twice):
        one, other = order[twice[0]], order[twice[0] + 1]
        raise InputError(
            f"panels: triangles {one // 3} and {other // 3} run the same way along the edge of vertices "
            f"{start[one]} and {end[one]}; a surface of one orientation, at most two triangles to an edge, is needed"
        )


def _edges_at(edges: Ints, pairs: Ints, inside: Flags) -> Ints:
    """Indices in `edges` (e, 2) of vertex pairs (k, 2); InputError unless all are edges inside the surface."""
    place = {(int(i), int(j)): k for k, (i, j) in enumerate(edges)}
    found = np.array([place.get((min(i, j), max(i, j)), -1) for i, j in pairs.tolist()], dtype=np.int64)
    wrong = np.flatnonzero((found < 0) | ~inside[found])
    if len(wrong):
        i, j = pairs[wrong[0]]
        what = "no edge of the surface" if found[wrong[0]] < 0 else "an edge of its border"
        raise InputError(f"seams: vertices {i} and {j} are {what}; seams run along edges inside it")
    return found


def _pieces(triangles: Ints, cut: Flags, group: Array) -> tuple[Ints, Ints, Ints]:
    """Triangles (m, 3) in vertices that are separate across the `cut` edges; their surface vertices, ordered by
    piece; the piece (m,) of each triangle, numbered by group (m,), then as they appear."""
    topology = build_topology(triangles)
    keep = np.flatnonzero((topology.across.ravel() >= 0) & ~cut[topology.triangle_edges.ravel()])
    t, i = keep // 3, keep % 3
    s, j = topology.across.ravel()[keep] // 3, topology.across.ravel()[keep] % 3
    m = len(triangles)
    one = np.concatenate([3 * t + (i + 1) % 3, 3 * t + (i + 2) % 3])
    other = np.concatenate([3 * s + (j + 2) % 3, 3 * s + (j + 1) % 3])
    _, copy = connected_components(_graph(one, other, 3 * m), directed=False)
    _, label = connected_components(_graph(t, s, m), directed=False)
    _, first, label = np.unique(label, return_index=True, return_inverse=True)
    panel = np.argsort(np.lexsort((first, group[first])))[label]
    _, corner = np.unique(copy, return_index=True)
    vertex, piece = triangles.ravel()[corner], panel[corner // 3]
    order = np.lexsort((vertex, piece))
    rank = np.argsort(order)
    return rank[copy].reshape(m, 3), vertex[order], panel


def _graph(one: Ints, other: Ints, count: int) -> sparse.csr_matrix:
    return sparse.csr_matrix((np.ones(len(one), dtype=np.int8), (one, other)), shape=(count, count))


def _names(panel: Ints, groups: Groups | None) -> tuple[str, ...]:
    """A name for each panel: its group's, numbered where the group has several, else panel-1, panel-2."""
    _, first = np.unique(panel, return_index=True)
    if groups is None:
        return tuple(f"panel-{k + 1}" for k in range(len(first)))
    group = groups[0][first]
    several = np.bincount(group) > 1
    count = np.array([np.sum(group[: k + 1] == g) for k, g in enumerate(group)])
    return tuple(
        f"{groups[1][g]}-{k}" if several[g] else groups[1][g] for g, k in zip(group, count, strict=True)
    )


def _euler(corners: Ints, panel: Ints) -> Ints:
    """Euler characteristic of each piece: 1 for a disc, 2 less two for each handle and one for each border."""
    topology = build_topology(corners)
    of_vertex = np.empty(corners.max() + 1, dtype=np.int64)
    of_vertex[corners] = panel[:, None]
    return np.bincount(of_vertex) - np.bincount(of_vertex[topology.edges[:, 0]]) + np.bincount(panel)


def _check_discs(corners: Ints, panel: Ints, names: tuple[str, ...], cuts: Ints) -> None:
    wrong = np.flatnonzero(_euler(corners, panel) != 1)
    if not len(wrong):
        return
    piece = corners[panel == wrong[0]]
    loops = len(boundary_loops(piece, build_topology(piece), np.zeros((piece.max() + 1, 3))))
    handles = (2 - int(_euler(corners, panel)[wrong[0]]) - loops) // 2
    ends = np.flatnonzero(np.bincount(cuts.ravel(), minlength=1) == 1)
    open_ends = f"; seams end at the vertices {', '.join(map(str, ends[:8]))}" if len(ends) else ""
    raise InputError(
        f"panel {names[wrong[0]]!r} is no disc, it has {loops} borders and {handles} handles{open_ends}; a panel to be "
        "laid flat has one border: give seams that close, or let it be cut open"
    )


def _cut_to_discs(triangles: Ints, points: Reals, cut: Flags, back: Reals, middle: Flags) -> Flags:
    """Cut edges (e,) more, until every piece is a disc: between boundary loops first, then handles."""
    topology = build_topology(triangles)
    inside = np.ones(len(cut), dtype=bool)
    inside[topology.boundary_edges] = False
    while True:
        corners, vertex, panel = _pieces(triangles, cut, np.zeros(len(triangles)))
        wrong = np.flatnonzero(_euler(corners, panel) != 1)
        if not len(wrong):
            return cut
        piece = corners[panel == wrong[0]]
        loops = boundary_loops(piece, build_topology(piece), points[vertex])
        if len(loops) > 1:
            paths = [_shortest(piece, points[vertex], loops, back, middle[vertex])]
        else:
            paths = _handles(piece, points[vertex], back, middle[vertex])
        pairs = np.concatenate([np.column_stack([path[:-1], path[1:]]) for path in paths])
        surface = np.sort(vertex[pairs], axis=1)
        place = np.searchsorted(_key(topology.edges, len(points)), _key(surface, len(points)))
        cut = cut.copy()
        cut[place[inside[place]]] = True


def _key(edges: Ints, count: int) -> Ints:
    return edges[:, 0].astype(np.int64) * count + edges[:, 1]


def _weighted_edges(piece: Ints, points: Reals, back: Reals, middle: Flags) -> tuple[Ints, Reals]:
    """Edges (e, 2) of a piece and their lengths, up to FRONT_COSTS longer the farther they are from the back; beside
    the middle, where there is one, so long that no way along it is longer."""
    edges = build_topology(piece).edges.astype(np.int64)
    forward = -(points[edges].mean(axis=1) @ back)
    share = (forward - forward.min()) / max(np.ptp(forward), np.finfo(float).tiny)
    length = np.linalg.norm(np.diff(points[edges], axis=1)[:, 0], axis=1)
    beside = np.where(middle[edges].all(axis=1), 1.0, len(edges)) if middle.any() else 1.0
    return edges, length * (1 + FRONT_COSTS * share) * beside


def _shortest(piece: Ints, points: Reals, loops: list[Ints], back: Reals, middle: Flags) -> Ints:
    """The shortest path through the inside of a piece from one of its boundary loops to another."""
    edges, weight = _weighted_edges(piece, points, back, middle)
    count = len(points)
    loop_of = np.full(count, -1)
    for k, loop in enumerate(loops):
        loop_of[loop] = k
    border = loop_of >= 0
    best: tuple[float, Ints] = (np.inf, np.empty(0, dtype=np.int64))
    for k, loop in enumerate(loops[:-1]):
        # paths start on this loop and end where they meet another: no edge leaves the other loops
        leave = np.concatenate([edges, edges[:, ::-1]])
        use = ~border[leave[:, 0]] | (loop_of[leave[:, 0]] == k)
        use &= loop_of[leave[:, 1]] != k
        graph = sparse.csr_matrix(
            (np.tile(weight, 2)[use], (leave[use, 0], leave[use, 1])), shape=(count, count)
        )
        distance, before, _ = dijkstra(graph, indices=loop, min_only=True, return_predecessors=True)
        reach = np.where(border & (loop_of != k), distance, np.inf)
        end = int(reach.argmin())
        if reach[end] < best[0]:
            best = (reach[end], _trace(before, end))
    return best[1]


def _trace(before: Ints, end: int) -> Ints:
    path = [end]
    while before[path[-1]] >= 0:
        path.append(int(before[path[-1]]))
    return np.array(path)


def _handles(piece: Ints, points: Reals, back: Reals, middle: Flags) -> list[Ints]:
    """Paths that open a piece of at most one border: the cut graph of its handles, or a slit in a closed sphere."""
    import igl

    used, local = np.unique(piece, return_inverse=True)
    paths = [used[path] for path in igl.cut_to_disk(local.reshape(-1, 3).astype(np.int64))]
    if paths:
        return paths
    edges, weight = _weighted_edges(piece, points, back, middle)
    graph = sparse.csr_matrix((weight, (edges[:, 0], edges[:, 1])), shape=(len(points),) * 2)
    start = int(used[(points[used] - points[used].mean(axis=0)).dot(back).argmax()])
    for _ in range(2):  # from the farthest vertex to the one farthest from it
        distance, before = dijkstra(graph, directed=False, indices=start, return_predecessors=True)
        start = int(used[distance[used].argmax()])
    return [_trace(before, start)]


class _Walk:
    """The borders of cut pieces as loops of half edges 3 * triangle + corner, in the order of the panels."""

    def __init__(self, triangles: Ints, corners: Ints, panel: Ints):
        self.corners, self.panel = corners, panel
        across = build_topology(corners).across.ravel()
        half = np.flatnonzero(across < 0)
        begins = dict(zip(self.starts(half).tolist(), half.tolist(), strict=True))  # one fan to each vertex
        self.next = {int(h): begins[int(end)] for h, end in zip(half, self.ends(half), strict=True)}
        glued = build_topology(triangles).across.ravel()[half]
        self.partner = {int(h): int(g) for h, g in zip(half, glued, strict=True) if g >= 0}
        self.loops = sorted(self._loops(), key=lambda loop: (panel[loop[0] // 3], loop[0]))

    def starts(self, half: Ints) -> Ints:
        found: Ints = self.corners[half // 3, (half + 1 - half // 3 * 3) % 3]
        return found

    def ends(self, half: Ints) -> Ints:
        found: Ints = self.corners[half // 3, (half + 2 - half // 3 * 3) % 3]
        return found

    def _loops(self) -> Iterator[Ints]:
        left = dict.fromkeys(self.next)
        while left:
            h, loop = next(iter(left)), []
            while h in left:
                del left[h]
                loop.append(h)
                h = self.next[h]
            yield np.array(loop)

    def _goes_on(self, h: int, g: int) -> bool:
        """Whether the seam of half edge h goes on in the next one, g: the other side follows and is no turning tip."""
        if h not in self.partner or g not in self.partner:
            return False
        return self.next[self.partner[g]] == self.partner[h] and g != self.partner[h]

    def seams(self, points: Reals, vertex: Ints) -> Iterator[Seam]:
        """Every seam once, from the side met first; of a closed one the first half edge of its loop is the start."""
        done: set[int] = set()
        for loop in self.loops:
            breaks = [k for k in range(len(loop)) if not self._goes_on(int(loop[k - 1]), int(loop[k]))]
            for begin, end in zip(breaks or [0], [*breaks[1:], (breaks or [0])[0] + len(loop)], strict=True):
                run = [int(loop[k % len(loop)]) for k in range(begin, end)]
                if run[0] not in self.partner or run[0] in done:
                    continue
                twins = np.array([self.partner[h] for h in run])
                done.update(run, twins.tolist())
                half = np.array(run)
                first = np.append(self.starts(half), self.ends(half[-1]))
                second = np.append(self.ends(twins), self.starts(twins[-1]))
                length = np.linalg.norm(np.diff(points[vertex[first]], axis=0), axis=1)
                at = np.append(0.0, np.cumsum(length)) / length.sum()
                sides = (int(self.panel[half[0] // 3]), int(self.panel[twins[0] // 3]))
                yield Seam(sides, (first, second), (at, at))
