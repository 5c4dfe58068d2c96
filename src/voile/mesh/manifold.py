"""From triangles to surfaces, as steps of `repair`: parts that hang by a vertex or two, orientations, edges of three
and more triangles, vertices of several fans, surfaces with one side."""

from collections.abc import Iterator
from dataclasses import replace

import igl
import numpy as np
from scipy import sparse

from voile.arrays import Ints
from voile.mesh.mending import Repair, half_edges, keep_stitches
from voile.mesh.raw import RawMesh

SCRAP = (
    0.01  # of the triangles: a smaller part that hangs by two vertices is dropped, a larger one comes apart
)


def patches(triangles: Ints) -> Ints:
    """(m,) the patch of each triangle: connected over edges of two triangles."""
    return np.asarray(igl.bfs_orient(np.ascontiguousarray(triangles, dtype=np.int64))[1]).ravel()


def drop_flaps(work: Repair) -> None:
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
    patch = patches(m.triangles)
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


def orient(work: Repair) -> None:
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


def come_apart(work: Repair) -> None:
    """Copies of vertices where more than two triangles share an edge, several fans a vertex, or a surface has one side;
    the first kind, and cuts of one-sided surfaces, stay sewn."""
    m = work.mesh
    edges, of = half_edges(m.triangles)
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
        keep_stitches(
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
