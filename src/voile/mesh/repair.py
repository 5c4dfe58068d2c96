"""Meshes that voile refuses or that would not hold, mended: see `repair`. What is mended is counted and told."""

from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import igl
import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from voile.arrays import Flags, Ints
from voile.errors import InputError
from voile.mesh.checks import LARGEST, flat_triangles
from voile.mesh.holes import LONGEST, border_loops, fill
from voile.mesh.raw import RawMesh

UNITS = {"m": 1.0, "cm": 0.01, "mm": 0.001, "inch": 0.0254}  # metres
USUAL = (0.15, 3.0)  # m: size of a garment or a body; of another, a mesh may be in another unit
WELD = 1e-6  # of the size: vertices of borders so close are one
SCRAP = (
    0.01  # of the triangles: a smaller part that hangs by two vertices is dropped, a larger one comes apart
)
ROUNDS = 50  # of collapses and flips: each round leaves fewer triangles without area


@dataclass(frozen=True)
class RepairOptions:
    """weld: distance (of the size) below which border vertices are one, 0 none; fill_holes: border loops of so many
    edges at most are closed; drop_pieces: pieces of fewer triangles are dropped; unit: of the file, None as it is;
    keep_flaps: parts that hang by two vertices stay."""

    weld: float = WELD
    fill_holes: int = 0
    drop_pieces: int = 0
    unit: str | None = None
    keep_flaps: bool = False


@dataclass
class Repair:
    """A mended mesh; what was changed, each with how often; what was left, a line each."""

    mesh: RawMesh
    changed: dict[str, int] = field(default_factory=dict)
    left: list[str] = field(default_factory=list)

    def count(self, what: str, often: int) -> None:
        if often:
            self.changed[what] = self.changed.get(what, 0) + int(often)

    def keep(self, what: str, triangles: Ints | Flags) -> None:
        """Drops the triangles (m,) that are False. Raises InputError where none is left."""
        self.count(what, np.count_nonzero(~triangles))
        m = self.mesh
        if not triangles.any():
            raise InputError(
                f"{m.source}: no triangle is left to repair ({what}); a surface mesh of triangles is needed"
            )
        texture = None if m.texture_triangles is None else m.texture_triangles[triangles]
        self.mesh = replace(
            m, triangles=m.triangles[triangles], group=m.group[triangles], texture_triangles=texture
        )

    def merge(self, into: Ints) -> None:
        """Every vertex becomes the one that it is merged `into` (n,)."""
        m = self.mesh
        sewn = None if m.stitch_vertices is None else into[m.stitch_vertices]
        named = {name: np.unique(into[v]) for name, v in m.vertex_groups.items()}
        self.mesh = replace(m, triangles=into[m.triangles], stitch_vertices=sewn, vertex_groups=named)


def repair(raw: RawMesh, options: RepairOptions) -> Repair:
    """The mesh without what the reader refuses or the solver cannot hold; groups, texture, stitches stay.

    In turn: triangles of vertices that are missing or not finite go; the unit becomes metres; border vertices at one
    place become one; triangles without area are collapsed or flipped away; of equal triangles one stays; small parts
    that hang by two vertices go; orientations agree; edges of three and more triangles and vertices of several fans
    come apart (the former stay sewn by stitches), as one-sided surfaces do; holes are closed; unused vertices go.
    Raises InputError where no triangle is left.
    """
    work = Repair(replace(raw, point_lines=None, triangle_lines=None, stitch_lines=None))
    work.count("faces of more than three corners split into triangles", raw.polygons)
    _drop_invalid(work)
    _convert(work, options.unit)
    _drop_doubles(work)  # whose edges would not count as border
    _weld(work, options.weld)
    _without_area(work)
    _drop_doubles(work)
    if not options.keep_flaps:
        _drop_flaps(work)
    _orient(work)
    _come_apart(work)
    _drop_pieces(work, options.drop_pieces)
    _fill(work, options.fill_holes)
    _compact(work)
    return work


def _drop_invalid(work: Repair) -> None:
    m = work.mesh
    here = ((m.triangles >= 0) & (m.triangles < len(m.points))).all(axis=1)
    work.keep("triangles of missing vertices dropped", here)
    m = work.mesh
    finite = np.isfinite(m.points).all(axis=1) & (np.abs(m.points) <= LARGEST).all(axis=1)
    work.keep("triangles of vertices that are no finite numbers dropped", finite[m.triangles].all(axis=1))
    work.mesh = replace(work.mesh, points=np.where(finite[:, None], m.points, 0.0))
    if m.texture is not None and not np.isfinite(m.texture).all():
        work.count("texture coordinates dropped, some are no finite numbers", len(m.texture))
        work.mesh = replace(work.mesh, texture=None, texture_triangles=None)
    if m.stitch_vertices is not None and m.stitch_weight is not None:
        good = (m.stitch_weight >= 0) & (m.stitch_weight <= 1) & finite[m.stitch_vertices].all(axis=1)
        _keep_stitches(work, "stitches that cannot be sewn dropped", good)


def _keep_stitches(work: Repair, what: str, good: Flags) -> None:
    m = work.mesh
    if m.stitch_vertices is None or m.stitch_weight is None:
        return
    work.count(what, np.count_nonzero(~good))
    work.mesh = replace(m, stitch_vertices=m.stitch_vertices[good], stitch_weight=m.stitch_weight[good])


def size_of(mesh: RawMesh) -> float:
    """Largest extent of what its triangles use, m."""
    return float(np.ptp(mesh.points[np.unique(mesh.triangles)], axis=0).max())


def _convert(work: Repair, unit: str | None) -> None:
    m, size = work.mesh, size_of(work.mesh)
    if unit is None:
        fitting = [name for name, metre in UNITS.items() if USUAL[0] <= metre * size <= USUAL[1]]
        if not m.in_metres and not USUAL[0] <= size <= USUAL[1]:
            ways = ", ".join(f"--unit {name} ({UNITS[name] * size:.3g} m)" for name in fitting)
            work.left.append(
                f"in metres the mesh is {size:.3g} m large" + (f"; or give {ways}" if ways else "")
            )
        return
    factor = 1.0 if m.in_metres else UNITS[unit]
    texture = None if m.texture is None else factor * m.texture
    work.mesh = replace(m, points=factor * m.points, texture=texture, in_metres=True)
    work.count(f"vertices turned from {unit} into metres", len(m.points) if factor != 1.0 else 0)


def _drop_doubles(work: Repair) -> None:
    ordered = np.sort(work.mesh.triangles, axis=1)
    first = np.zeros(len(ordered), dtype=bool)
    first[np.unique(ordered, axis=0, return_index=True)[1]] = True
    work.keep("triangles given twice dropped", first)


def _half_edges(triangles: Ints) -> tuple[Ints, Ints]:
    """Edges (e, 2), smaller vertex first, and the one (3m,) of each half edge from corner i to i + 1."""
    sides = np.sort(triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    edges, of = np.unique(sides, axis=0, return_inverse=True)
    return edges, of.ravel()


def _weld(work: Repair, distance: float) -> None:
    """Border vertices at one place become one; those that stitches name stay apart, as sewing says."""
    m = work.mesh
    edges, of = _half_edges(m.triangles)
    border = np.unique(edges[np.bincount(of) == 1])
    if m.stitch_vertices is not None:
        border = np.setdiff1d(border, m.stitch_vertices)
    if not distance or not len(border):
        return
    pairs = cKDTree(m.points[border]).query_pairs(distance * size_of(m), output_type="ndarray")
    into = _joined(border[pairs], len(m.points))
    work.count(
        "vertices at the place of others joined to them", np.count_nonzero(into != np.arange(len(into)))
    )
    work.merge(into)


def _joined(pairs: Ints, count: int) -> Ints:
    """(n,) the smallest vertex that each is joined to by pairs (p, 2)."""
    graph = sparse.coo_matrix((np.ones(len(pairs)), tuple(pairs.T)), shape=(count, count))
    label = connected_components(graph, directed=False)[1]
    found: Ints = np.unique(label, return_index=True)[1][label]
    return found


def _without_area(work: Repair) -> None:
    """Triangles whose corners are at one place collapse; of those with one corner on the edge of the other two, edge
    and neighbour are turned so that none is left."""
    for _ in range(ROUNDS):
        t = work.mesh.triangles
        work.keep("triangles without area collapsed", (t != np.roll(t, 1, axis=1)).all(axis=1))
        t, x = work.mesh.triangles, work.mesh.points
        flat = flat_triangles(x, t)
        if not len(flat):
            return
        sides = np.linalg.norm(x[t[flat]] - x[np.roll(t[flat], -1, axis=1)], axis=2)
        short = sides.min(axis=1) <= WELD * sides.max(axis=1)
        if short.any():
            at, corner = flat[short], sides[short].argmin(axis=1)
            work.merge(_joined(np.column_stack([t[at, corner], t[at, (corner + 1) % 3]]), len(x)))
        else:
            _flip_caps(work, flat, sides.argmax(axis=1))
    work.left.append(f"{len(flat)} triangles still have no area")


def _flip_caps(work: Repair, flat: Ints, longest: Ints) -> None:
    """Flips the edges at `longest` corners of flat triangles with neighbours that have an area; those without go."""
    m = work.mesh
    t = m.triangles.copy()
    texture = None if m.texture_triangles is None else m.texture_triangles.copy()
    _, of = _half_edges(t)
    order = np.argsort(of, kind="stable")
    begin = np.searchsorted(of[order], np.arange(of.max() + 2))
    busy, keep = np.zeros(len(t), dtype=bool), np.ones(len(t), dtype=bool)
    is_flat = np.zeros(len(t), dtype=bool)
    is_flat[flat] = True
    for cap, corner in zip(flat.tolist(), longest.tolist(), strict=True):
        edge = of[3 * cap + corner]
        others = [h for h in order[begin[edge] : begin[edge + 1]].tolist() if h // 3 != cap]
        if len(others) != 1:
            keep[cap] = False
            continue
        other, side = divmod(others[0], 3)
        if busy[cap] or busy[other] or is_flat[other]:
            continue  # in a later round
        busy[[cap, other]] = True
        for corners in (t, texture):
            if corners is not None:
                apex, near = corners[cap, (corner + 2) % 3], corners[other].copy()
                corners[other] = near
                corners[other, (side + 1) % 3] = apex
                corners[cap] = near
                corners[cap, side] = apex
        m.group[cap] = m.group[other]
        work.count("triangles without area turned into their neighbours", 1)
    work.mesh = replace(m, triangles=t, texture_triangles=texture)
    work.keep("triangles without area dropped", keep)


def _patches(triangles: Ints) -> Ints:
    """(m,) the patch of each triangle: connected over edges of two triangles."""
    return np.asarray(igl.bfs_orient(np.ascontiguousarray(triangles, dtype=np.int64))[1]).ravel()


def _drop_flaps(work: Repair) -> None:
    """Patches that share one or two vertices with others, and stitches, are free to turn: small ones go."""
    dropped = 0
    while True:
        m = work.mesh
        flaps = list(_flaps(m))
        if not flaps:
            break
        keep, touched = np.ones(len(m.triangles), dtype=bool), set[int]()
        for joints, members in sorted(flaps, key=lambda flap: (len(flap[1]), -flap[1][0])):
            if not touched.intersection(joints):
                touched.update(joints)
                keep[members] = False
                dropped += 1
        work.keep("triangles of flaps, parts that hang by a vertex or two, dropped", keep)
    work.count("flaps dropped", dropped)


def _flaps(m: RawMesh) -> Iterator[tuple[list[int], Ints]]:
    """The vertices by which each flap hangs, and its triangles."""
    patch = _patches(m.triangles)
    member = sparse.csr_matrix(
        (np.ones(m.triangles.size), (np.repeat(patch, 3), m.triangles.ravel())),
        shape=(patch.max() + 1, len(m.points)),
    ).astype(bool)
    joint = np.asarray(member.sum(axis=0)).ravel() > 1
    if m.stitch_vertices is not None:
        joint[m.stitch_vertices] = True
    small = np.bincount(patch) <= max(SCRAP * len(patch), 1)
    for k in np.flatnonzero(small):
        vertices = member[k].indices
        joints = vertices[joint[vertices]]
        if 1 <= len(joints) <= 2:
            yield joints.tolist(), np.flatnonzero(patch == k)


def _orient(work: Repair) -> None:
    """Neighbours over edges of two triangles run the same way; in each patch the fewer triangles are flipped."""
    m = work.mesh
    turned, patch = igl.bfs_orient(np.ascontiguousarray(m.triangles, dtype=np.int64))
    start = np.argmax(turned == m.triangles[:, :1], axis=1)  # where its first corner went
    flip = turned[np.arange(len(turned)), (start + 1) % 3] != m.triangles[:, 1]
    patch = np.asarray(patch).ravel()
    most = np.bincount(patch, weights=flip) > 0.5 * np.bincount(patch)
    flip ^= most[patch]
    work.count("triangles flipped for a consistent orientation", np.count_nonzero(flip))
    swap = [0, 2, 1]
    texture = m.texture_triangles
    if texture is not None:
        texture = np.where(flip[:, None], texture[:, swap], texture)
    triangles = np.where(flip[:, None], m.triangles[:, swap], m.triangles)
    work.mesh = replace(m, triangles=triangles, texture_triangles=texture)


def _come_apart(work: Repair) -> None:
    """Copies of vertices where more than two triangles share an edge, several fans a vertex, or a surface has one side;
    the first kind, and cuts of one-sided surfaces, stay sewn."""
    m = work.mesh
    edges, of = _half_edges(m.triangles)
    crowded = np.unique(edges[np.bincount(of) > 2])
    split, origin = igl.split_nonmanifold(np.ascontiguousarray(m.triangles, dtype=np.int64))
    first = np.zeros(len(m.points), dtype=np.int64)
    first[origin[::-1]] = np.arange(len(origin))[::-1]  # of several copies the first
    copies = np.setdiff1d(np.arange(len(origin)), first[np.unique(origin)])
    work.count("edges of three and more triangles come apart", np.count_nonzero(np.bincount(of) > 2))
    sewn = copies[np.isin(origin[copies], crowded) | np.isin(origin[copies], _clashing(m.triangles))]
    work.count("vertices of several fans come apart", len(copies) - len(sewn))
    work.count("stitches added where surfaces came apart", len(sewn))
    used = np.isin(np.arange(len(m.points)), origin)
    stitches, weights = (
        [np.column_stack([sewn, first[origin[sewn]], first[origin[sewn]]])],
        [np.zeros(len(sewn))],
    )
    if m.stitch_vertices is not None and m.stitch_weight is not None:
        _keep_stitches(
            work, "stitches of vertices without a triangle dropped", used[m.stitch_vertices].all(axis=1)
        )
        old = work.mesh
        assert old.stitch_vertices is not None and old.stitch_weight is not None
        stitches.insert(0, first[old.stitch_vertices])
        weights.insert(0, old.stitch_weight)
    sewing, weight = np.concatenate(stitches), np.concatenate(weights)
    work.count("vertices without a triangle dropped", np.count_nonzero(~used))
    work.mesh = replace(
        m, points=m.points[origin], triangles=np.asarray(split),
        stitch_vertices=sewing if len(sewing) else None, stitch_weight=weight if len(sewing) else None,
        vertex_groups={name: first[v[used[v]]] for name, v in m.vertex_groups.items()},
    )  # fmt: skip


def _clashing(triangles: Ints) -> Ints:
    """Vertices of edges whose two triangles run the same way: where a one-sided surface must be cut."""
    start, end = triangles.ravel(), np.roll(triangles, -1, axis=1).ravel()
    directed, count = np.unique(np.column_stack([start, end]), axis=0, return_counts=True)
    found: Ints = np.unique(directed[count > 1])
    return found


def _drop_pieces(work: Repair, least: int) -> None:
    patch = _patches(work.mesh.triangles)
    large = np.bincount(patch) >= least
    work.count(f"pieces of fewer than {least} triangles dropped", np.count_nonzero(~large))
    work.keep(f"triangles of pieces of fewer than {least} triangles dropped", large[patch])


def _fill(work: Repair, most: int) -> None:
    """Closes border loops of at most `most` edges; the new triangles take group and texture from their borders."""
    m = work.mesh
    loops, closed = border_loops(m.points, m.triangles), list[Ints]()
    holes: dict[int, int] = defaultdict(int)
    for loop in loops[::-1]:  # the shortest first
        known = np.concatenate([m.triangles, *closed])
        made = fill(m.points, known, loop) if len(loop) <= min(most, LONGEST) else None
        if made is None:
            holes[len(loop)] += 1
        else:
            closed.append(made)
    work.count("holes filled", len(closed))
    if holes:
        sizes = ", ".join(f"{often} of {edges} edges" for edges, often in sorted(holes.items())[:6])
        more = ", ..." if len(holes) > 6 else ""
        work.left.append(f"{sum(holes.values())} border loops are open: {sizes}{more} (--fill-holes N closes those "
                         "of N edges and fewer)")  # fmt: skip
    if not closed:
        return
    new = np.concatenate(closed)
    work.count("triangles added in holes", len(new))
    corner = np.zeros(len(m.points), dtype=np.int64)
    corner[m.triangles.ravel()] = np.arange(m.triangles.size)
    texture = m.texture_triangles
    if texture is not None:
        texture = np.concatenate([texture, texture.ravel()[corner[new]]])
    group = np.concatenate([m.group, m.group[corner[new[:, 0]] // 3]])
    work.mesh = replace(
        m, triangles=np.concatenate([m.triangles, new]), group=group, texture_triangles=texture
    )


def _compact(work: Repair) -> None:
    """Drops the vertices that no triangle uses any more, and names of groups that are empty."""
    m = work.mesh
    used = np.zeros(len(m.points), dtype=bool)
    used[m.triangles] = True
    if m.stitch_vertices is not None:
        _keep_stitches(
            work, "stitches of vertices without a triangle dropped", used[m.stitch_vertices].all(axis=1)
        )
        m = work.mesh
    new = np.cumsum(used) - 1
    names, group = np.unique(m.group, return_inverse=True)
    work.mesh = replace(
        m, points=m.points[used], triangles=new[m.triangles], group=group.ravel(),
        group_names=tuple(m.group_names[k] for k in names),
        stitch_vertices=None if m.stitch_vertices is None else new[m.stitch_vertices],
        vertex_groups={name: new[v[used[v]]] for name, v in m.vertex_groups.items() if used[v].any()},
    )  # fmt: skip
