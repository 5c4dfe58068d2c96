"""Meshes that voile refuses or that would not hold, mended: see `repair`. What is mended is counted and told."""

from collections import defaultdict
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from voile.arrays import Ints
from voile.mesh.checks import flat_triangles
from voile.mesh.holes import LONGEST, border_loops, fill
from voile.mesh.manifold import come_apart, drop_flaps, orient, patches
from voile.mesh.mending import Repair, half_edges, joined, keep_stitches, size_of
from voile.mesh.raw import LARGEST, RawMesh

UNITS = {"m": 1.0, "cm": 0.01, "mm": 0.001, "inch": 0.0254}  # metres
USUAL = (0.15, 3.0)  # m: size of a garment or a body; of another, a mesh may be in another unit
WELD = 1e-6  # of the size: vertices of borders so close are one
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
        drop_flaps(work)
    orient(work)
    come_apart(work)
    _drop_pieces(work, options.drop_pieces)
    _tell_loose(work)
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
        keep_stitches(work, "stitches that cannot be sewn dropped", good)


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


def _weld(work: Repair, distance: float) -> None:
    """Border vertices at one place become one; those that stitches name stay apart, as sewing says."""
    m = work.mesh
    edges, of = half_edges(m.triangles)
    border = np.unique(edges[np.bincount(of) == 1])
    if m.stitch_vertices is not None:
        border = np.setdiff1d(border, m.stitch_vertices)
    if not distance or not len(border):
        return
    pairs = cKDTree(m.points[border]).query_pairs(distance * size_of(m), output_type="ndarray")
    into = joined(border[pairs], len(m.points))
    work.count(
        "vertices at the place of others joined to them", np.count_nonzero(into != np.arange(len(into)))
    )
    work.merge(into)


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
            work.merge(joined(np.column_stack([t[at, corner], t[at, (corner + 1) % 3]]), len(x)))
        else:
            _flip_caps(work, flat, sides.argmax(axis=1))
    work.left.append(f"{len(flat)} triangles still have no area")


def _flip_caps(work: Repair, flat: Ints, longest: Ints) -> None:
    """Flips the edges at `longest` corners of flat triangles with neighbours that have an area; those without go."""
    m = work.mesh
    t = m.triangles.copy()
    texture = None if m.texture_triangles is None else m.texture_triangles.copy()
    _, of = half_edges(t)
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


def _drop_pieces(work: Repair, least: int) -> None:
    patch = patches(work.mesh.triangles)
    large = np.bincount(patch) >= least
    work.count(f"pieces of fewer than {least} triangles dropped", np.count_nonzero(~large))
    work.keep(f"triangles of pieces of fewer than {least} triangles dropped", large[patch])


def _tell_loose(work: Repair) -> None:
    """Triangles that nothing joins to others, as of a scan whose corners differ in their last digits."""
    m = work.mesh
    patch, sewn = patches(m.triangles), np.zeros(len(m.points), dtype=bool)
    if m.stitch_vertices is not None:
        sewn[m.stitch_vertices] = True
    loose = m.triangles[(np.bincount(patch)[patch] == 1) & ~sewn[m.triangles].any(axis=1)]
    if not len(loose) or len(m.triangles) == 1:
        return
    others = cKDTree(m.points[np.unique(m.triangles)])
    share = float(np.median(others.query(m.points[loose.ravel()], 2)[0][:, 1])) / size_of(m)
    work.left.append(f"{len(loose)} triangles hang on no other; half of their corners "
                     f"are within {share:.1g} of the size of another's (--weld)")  # fmt: skip


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
        told = "--fill-holes N closes those of N edges and fewer"
        if any(edges <= min(most, LONGEST) for edges in holes):  # a loose triangle's border, say
            told = f"up to {most} edges: each filling has an edge or a triangle that is there already"
        work.left.append(f"{sum(holes.values())} border loops are open: {sizes}{more} ({told})")
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
        keep_stitches(
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
