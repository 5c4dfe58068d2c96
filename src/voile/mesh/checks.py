"""What a mesh must satisfy before anything is computed on it, and what is repaired.

Messages count vertices and triangles from 0 in the file's order; triangles after polygons were split.
"""

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from voile.arrays import Flags, Ints, Reals
from voile.errors import InputError
from voile.mesh.raw import LARGEST, SMALLEST, RawMesh
from voile.mesh.stitches import Stitches, circular, sewing_matrix

# Altitude over longest edge of a triangle without area: the determinant of its metric keeps no digit there.
FLATNESS = 1e-8


def check_coordinates(raw: RawMesh) -> None:
    """Raise InputError unless there are triangles, their indices exist and all coordinates are finite."""
    if len(raw.triangles) == 0:
        raise InputError(f"{raw.source}: no triangles; a surface mesh of triangles (or polygons) is needed")
    outside = np.flatnonzero(((raw.triangles < 0) | (raw.triangles >= len(raw.points))).any(axis=1))
    if len(outside):
        raise InputError(
            f"{raw.source}: {raw.triangle(outside[0])} has a vertex out of range, "
            f"the file has {len(raw.points)} vertices"
        )
    bad = np.flatnonzero(~np.isfinite(raw.points).all(axis=1))
    if len(bad):
        raise InputError(f"{raw.source}: {raw.vertex(bad[0])} is {raw.points[bad[0]].tolist()}, not finite")
    beyond = np.flatnonzero((np.abs(raw.points) > LARGEST).any(axis=1))
    if len(beyond):
        raise InputError(
            f"{raw.source}: {raw.vertex(beyond[0])} is {raw.points[beyond[0]].tolist()} m; allowed: at most {LARGEST:g}"
        )
    if raw.texture is not None and not np.isfinite(raw.texture).all():
        bad = np.flatnonzero(~np.isfinite(raw.texture).all(axis=1))
        raise InputError(
            f"{raw.source}: texture coordinate {bad[0]} is {raw.texture[bad[0]].tolist()}, not finite"
        )


def check_triangles(raw: RawMesh) -> None:
    """Raise InputError at a repeated vertex, a triangle given twice, or one without area."""
    tri = raw.triangles
    repeated = np.flatnonzero((tri == np.roll(tri, 1, axis=1)).any(axis=1))
    if len(repeated):
        raise InputError(
            f"{raw.source}: {raw.triangle(repeated[0])} repeats a vertex; three different ones are needed"
        )
    tiny = np.flatnonzero(np.ptp(raw.points[tri], axis=1).max(axis=1, initial=0.0) < SMALLEST)
    if len(tiny):
        raise InputError(
            f"{raw.source}: {raw.triangle(tiny[0])} is smaller than {SMALLEST:g} m; larger ones are needed"
        )
    ordered = np.sort(tri, axis=1)
    order = np.lexsort(ordered.T)
    twice = np.flatnonzero((ordered[order[1:]] == ordered[order[:-1]]).all(axis=1))
    if len(twice):
        one, other = sorted(order[twice[0] : twice[0] + 2])
        raise InputError(
            f"{raw.source}: {raw.triangle(one)} and {raw.triangle(other)} are the same; keep one"
        )
    flat = flat_triangles(raw.points, tri)
    if len(flat):
        raise InputError(f"{raw.source}: {raw.triangle(flat[0])} has no area; its vertices lie on a line")


def flat_triangles(points: Reals, triangles: Ints) -> Ints:
    """Indices of the triangles whose area vanishes against their longest edge."""
    a, b, c = (points[triangles[:, i]] for i in range(3))
    longest = np.maximum(np.maximum(_norm(b - a), _norm(c - b)), _norm(a - c))
    safe = np.where(longest > 0, longest, 1.0)[:, None]  # unit size first: squares of tiny sizes underflow
    twice_area = _norm(np.cross((b - a) / safe, (c - a) / safe))
    return np.flatnonzero((twice_area <= FLATNESS) | (longest == 0))


def _norm(vectors: Reals) -> Reals:
    found: Reals = np.linalg.norm(vectors, axis=1)
    return found


def orient(raw: RawMesh) -> Flags:
    """(m,) True for the triangles to flip so that neighbours agree; all False if they do already.

    In each component the fewer triangles are flipped (on a tie the first one stays).
    Raises InputError at an edge of more than two triangles and for a surface that has no orientation.
    """
    tri = raw.triangles
    start, end = tri.ravel(), np.roll(tri, -1, axis=1).ravel()
    key = np.minimum(start, end) * len(raw.points) + np.maximum(start, end)
    order = np.argsort(key, kind="stable")
    same = key[order[1:]] == key[order[:-1]]
    crowded = np.flatnonzero(same[1:] & same[:-1])
    if len(crowded):
        half = order[crowded[0]]
        around = ", ".join(str(h // 3) for h in order[key[order] == key[half]])
        raise InputError(
            f"{raw.source}: the edge of vertices {start[half]} and {end[half]} belongs to "
            f"the triangles {around}; at most two may share an edge (shell.joints = true sews sheets together there)"
        )
    one, other = order[:-1][same], order[1:][same]
    clash = start[one] == start[other]
    flip = np.zeros(len(tri), dtype=bool)
    return _flips(raw, one // 3, other // 3, clash) if clash.any() else flip


def _flips(raw: RawMesh, one: Ints, other: Ints, clash: Flags) -> Flags:
    """Triangles to flip, from the pairs of neighbours and whether they clash.

    Two copies of each triangle, as given (t) and flipped (t + m): a clash ties unlike copies, agreement
    like ones.
    The surface is orientable just if no triangle is tied to its own flipped copy.
    """
    m = len(raw.triangles)
    swapped = np.where(clash, other + m, other), np.where(clash, other, other + m)
    rows, columns = np.concatenate([one, one + m]), np.concatenate(swapped)
    graph = sparse.coo_matrix((np.ones(len(rows), dtype=np.int8), (rows, columns)), shape=(2 * m, 2 * m))
    _, label = connected_components(graph, directed=False)
    moebius = np.flatnonzero(label[:m] == label[m:])
    if len(moebius):
        raise InputError(
            f"{raw.source}: the surface around {raw.triangle(moebius[0])} has one side only "
            "(a Moebius band); an orientable surface is needed"
        )
    sheet = np.minimum(label[:m], label[m:])
    given = label[:m] == sheet
    _, first, sheet = np.unique(sheet, return_index=True, return_inverse=True)
    size, alike = np.bincount(sheet), np.bincount(sheet, weights=given)
    keep_given = (2 * alike > size) | ((2 * alike == size) & given[first])
    found: Flags = given != keep_given[sheet]
    return found


def sew(raw: RawMesh, used: Flags) -> Flags:
    """(m,) False for the triangles that vanish once sewn, as where real seams join neighbours.

    `used` (n,): vertices of triangles. Raises InputError where a stitch ties another vertex, has a weight
    outside [0, 1], cannot be sewn (see sewing_matrix), or where a vertex would be left without a triangle.
    """
    if raw.stitch_vertices is None or raw.stitch_weight is None:
        return np.ones(len(raw.triangles), dtype=bool)
    bad = np.flatnonzero(~((raw.stitch_weight >= 0) & (raw.stitch_weight <= 1)))
    if len(bad):
        weight = raw.stitch_weight[bad[0]]
        raise InputError(f"{raw.source}: {raw.stitch(bad[0])} has weight {weight}, allowed: 0 to 1")
    loose = np.argwhere(~used[raw.stitch_vertices])
    if len(loose):
        record, column = loose[0]
        vertex = raw.vertex(raw.stitch_vertices[record, column])
        raise InputError(f"{raw.source}: {raw.stitch(record)} ties {vertex}, which belongs to no triangle")
    slave, first, second = raw.stitch_vertices.T
    weight = raw.stitch_weight
    itself = np.flatnonzero(((slave == first) & (weight < 1)) | ((slave == second) & (weight > 0)))
    if len(itself):
        raise InputError(
            f"{raw.source}: {raw.stitch(itself[0])} ties {raw.vertex(slave[itself[0]])} to itself; another is needed"
        )
    try:
        matrix, free = sewing_matrix(
            Stitches(slave, first, second, raw.stitch_weight), len(raw.points), raw.stitch
        )
    except InputError as error:
        raise InputError(f"{raw.source}: {error}") from None
    rounds = circular(Stitches(slave, first, second, weight), len(raw.points))
    if rounds:
        raw.notes = (*raw.notes, f"{rounds} stitches join vertices in a circle: some say what others say")
    # in arbitrary positions of the free vertices only those triangles are flat that the seams make so
    keep = np.ones(len(raw.triangles), dtype=bool)
    keep[flat_triangles(matrix @ np.random.default_rng(0).random((len(free), 3)), raw.triangles)] = False
    held = np.zeros(len(free), dtype=bool)
    held[matrix[np.unique(raw.triangles[keep])].indices] = True
    alone = np.flatnonzero(~held & used[free])
    if len(alone):
        vertex = raw.vertex(free[alone[0]])
        raise InputError(
            f"{raw.source}: all triangles of {vertex} vanish when sewn; correct the stitches there"
        )
    return keep
