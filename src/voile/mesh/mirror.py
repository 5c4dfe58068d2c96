"""A surface made symmetric: one half of it and that half's mirror image, joined on the plane between them."""

from dataclasses import replace

import igl
import numpy as np
from scipy.spatial import cKDTree

from voile.arrays import Flags, Ints, Reals, border_sides, triangle_areas, triangle_sides
from voile.errors import InputError
from voile.mesh.raw import RawMesh

PLACES = 5  # the plane is found again with the partners that it gave
SNAP = 0.3  # of a vertex's shortest edge: nearer to a cut it is moved there, so that no sliver is cut off
ON = 1e-9  # of the size: what ends there, as half a garment, is joined to its image
MIDDLE = 0.3  # a group with at least so much of its area on either side lies across the plane


def plane_of(raw: RawMesh, axis: int) -> float:
    """Where the plane of symmetry across an axis (0 to 2) is: amid the surface, as most of its vertices have it."""
    x = raw.points[np.unique(raw.triangles)]
    tree, place = cKDTree(x), 0.5 * (x[:, axis].min() + x[:, axis].max())
    for _ in range(PLACES):
        image = x.copy()
        image[:, axis] = 2 * place - image[:, axis]
        place = float(np.median(0.5 * (x[:, axis] + x[tree.query(image)[1], axis])))
    return float(place)


def mirror(raw: RawMesh, axis: int, place: float, side: int) -> tuple[RawMesh, dict[str, float]]:
    """The half of a mesh where side * (x[axis] - place) > 0 with its mirror image; and figures: the largest distance
    (`apart`) and its mean square (`rms`) from the other half's vertices to what now stands there.

    Triangles across the plane are cut, vertices beside the cut moved to it. Groups go to those on the other side, and
    lie across the plane where they did. Stitches are mirrored, those to the other half sew vertices to their images.
    Texture coordinates are dropped.
    Raises InputError where nothing is on that side.
    """
    d = side * (raw.points[:, axis] - place)
    beside = (np.abs(d) < SNAP * _shortest(raw)) & _crossed(raw.triangles, d)
    d[beside | (np.abs(d) < ON * np.ptp(raw.points[raw.triangles], axis=(0, 1)).max(initial=0.0))] = 0.0
    points = raw.points.copy()
    points[:, axis] = place + side * d
    made, triangles, parent = _cut(points, raw.triangles, d)
    made[len(points) :, axis] = place
    if not len(triangles):
        raise InputError(
            f"{raw.source}: nothing lies on that side of {'xyz'[axis]} = {place:g}; choose another"
        )
    group, twin, names, keep = _groups(raw, triangles, parent, axis, place, side)
    triangles = triangles[keep]
    on = np.append(d == 0.0, np.ones(len(made) - len(points), dtype=bool))
    on &= _ends_at(triangles, on)  # legs that touch the plane have vertices of their own there
    image, n = np.where(on, np.arange(len(made)), np.arange(len(made)) + len(made)), len(made)
    flipped = made.copy()
    flipped[:, axis] = 2 * place - flipped[:, axis]
    everything = np.concatenate([made, flipped])
    faces = np.concatenate([triangles, image[triangles][:, ::-1]])
    used = np.zeros(2 * n, dtype=bool)
    used[faces] = True
    new = np.cumsum(used) - 1
    sewn = weight = None
    if raw.stitch_vertices is not None and raw.stitch_weight is not None:
        held = used[raw.stitch_vertices]
        whole = held.all(axis=1)
        # what was sewn to the other half is sewn to its own image
        ends = raw.stitch_vertices[held & ~whole[:, None]]
        ends = np.unique(ends[image[ends] != ends])
        across = np.column_stack([image[ends], ends, ends])
        both = [raw.stitch_vertices[whole], image[raw.stitch_vertices[whole]], across]
        sewn = new[np.concatenate(both)]
        weight = np.concatenate([np.tile(raw.stitch_weight[whole], 2), np.zeros(len(across))])
    result = replace(
        raw, points=everything[used], triangles=new[faces], group=np.concatenate([group, twin]), group_names=names,
        texture=None, texture_triangles=None, stitch_vertices=sewn, stitch_weight=weight,
        point_lines=None, triangle_lines=None, stitch_lines=None, vertex_groups={},
    )  # fmt: skip
    other = raw.points[np.unique(raw.triangles)]
    other = other[side * (other[:, axis] - place) < 0]
    if not len(other):
        return result, {"apart": 0.0, "rms": 0.0}
    size, corner = np.ptp(raw.points[raw.triangles], axis=(0, 1)).max(), result.points[0]
    here, there = (
        (other - corner) / size,
        (result.points - corner) / size,
    )  # squares of any size are numbers then
    square = igl.point_mesh_squared_distance(here, there, result.triangles.astype(np.int64))[0]
    return result, {"apart": float(size * np.sqrt(square.max())), "rms": float(size * np.sqrt(square.mean()))}


def _shortest(raw: RawMesh) -> Reals:
    """(n,) length of the shortest edge at each vertex, 0 without any."""
    found = np.full(len(raw.points), np.inf)
    for k in range(3):
        ends = raw.triangles[:, [k, (k + 1) % 3]]
        length = np.linalg.norm(raw.points[ends[:, 0]] - raw.points[ends[:, 1]], axis=1)
        for end in ends.T:
            np.minimum.at(found, end, length)
    return np.where(np.isfinite(found), found, 0.0)


def _crossed(triangles: Ints, d: Reals) -> Flags:
    """(n,) marks vertices with a neighbour beyond the plane."""
    edges = triangle_sides(triangles)
    found = np.zeros(len(d), dtype=bool)
    found[edges[d[edges[:, 0]] * d[edges[:, 1]] < 0]] = True
    return found


def _ends_at(triangles: Ints, on: Flags) -> Flags:
    """(n,) marks the vertices of border edges whose ends are both on the plane."""
    found, sides = np.zeros(len(on), dtype=bool), border_sides(triangles)
    found[sides[on[sides].all(axis=1)]] = True
    return found


def _cut(points: Reals, triangles: Ints, d: Reals) -> tuple[Reals, Ints, Ints]:
    """Points and those where edges meet the plane; the triangles where d (n,) is above 0, and what each was part of."""
    signs = np.sign(d[triangles])
    keep = (signs >= 0).all(axis=1) & (signs > 0).any(axis=1)
    faces, parent = triangles[keep].tolist(), np.flatnonzero(keep).tolist()
    between: dict[tuple[int, int], int] = {}
    added: list[Reals] = []

    def crossing(a: int, b: int) -> int:
        key = (min(a, b), max(a, b))
        if key not in between:
            between[key] = len(points) + len(added)
            added.append((d[a] * points[b] - d[b] * points[a]) / (d[a] - d[b]))
        return between[key]

    for t in np.flatnonzero((signs > 0).any(axis=1) & (signs < 0).any(axis=1)).tolist():
        ring: list[int] = []
        corners = triangles[t].tolist()
        for a, b in zip(corners, [*corners[1:], corners[0]], strict=True):
            if d[a] >= 0:
                ring.append(a)
            if d[a] * d[b] < 0:
                ring.append(crossing(a, b))
        made = (
            [ring] if len(ring) == 3 else _halved(ring, np.concatenate([points, np.reshape(added, (-1, 3))]))
        )
        faces += made
        parent += [t] * len(made)
    everything = np.concatenate([points, np.reshape(added, (-1, 3))])
    return everything, np.array(faces, dtype=np.int64).reshape(-1, 3), np.array(parent, dtype=np.int64)


def _halved(ring: list[int], points: Reals) -> list[list[int]]:
    """A quadrilateral as two triangles, along its shorter diagonal."""
    a, b, c, d = ring
    first = np.linalg.norm(points[a] - points[c]) <= np.linalg.norm(points[b] - points[d])
    return [[a, b, c], [a, c, d]] if first else [[b, c, d], [b, d, a]]


def _components(triangles: Ints) -> Ints:
    """(n,) number of the piece that each vertex belongs to."""
    return np.asarray(igl.vertex_components(np.ascontiguousarray(triangles, dtype=np.int64))).ravel()


def _groups(
    raw: RawMesh,
    triangles: Ints,
    parent: Ints,
    axis: int,
    place: float,
    side: int,
) -> tuple[Ints, Ints, tuple[str, ...], Flags]:
    """Groups of the half's triangles and of their mirror images: the group that lies there, or a new one; and the
    triangles that stay. What reaches over the plane from the other half goes to its partner, or where it is a piece of
    its own goes."""
    corners = raw.points[raw.triangles]
    area = triangle_areas(raw.points, raw.triangles)
    middle, count = corners.mean(axis=1), len(raw.group_names)
    here = side * (middle[:, axis] - place) > 0
    share = np.bincount(raw.group, area * here, count) / np.maximum(
        np.bincount(raw.group, area, count), 1e-300
    )
    image = middle.copy()
    image[:, axis] = 2 * place - image[:, axis]
    opposite = raw.group[cKDTree(middle).query(image)[1]]
    partner, names = np.arange(count), list(raw.group_names)
    for g in range(count):
        if not MIDDLE <= share[g] <= 1 - MIDDLE and (raw.group == g).any():
            votes = np.bincount(opposite[raw.group == g], area[raw.group == g], count)
            votes[(share > 0.5) == (share[g] > 0.5)] = 0.0  # of those on the other side
            partner[g] = int(votes.argmax()) if votes.any() else -1
    for g in np.flatnonzero(partner < 0):
        partner[g] = len(names)
        names.append(f"{names[g]} mirrored")
    group = raw.group[parent].astype(np.int64)
    beyond = share[group] < MIDDLE
    piece = np.unique(_components(triangles)[triangles[:, 0]], return_inverse=True)[1].ravel()
    keep = np.bincount(piece, ~beyond)[piece] > 0
    keep |= not keep.any()
    group = np.where(beyond, partner[group], group)[keep]
    twin = np.append(partner, np.zeros(len(names) - count, dtype=np.int64))
    for g, h in enumerate(partner):
        if h >= count:
            twin[h] = g
    used, index = np.unique(np.concatenate([group, twin[group]]), return_inverse=True)
    index = index.ravel().astype(np.int32)
    return index[: len(group)], index[len(group) :], tuple(names[g] for g in used), keep
