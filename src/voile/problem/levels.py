"""Coarse levels of a shell for nested iteration, and what carries a coarse shape to the fine mesh.

Half edges are collapsed (src/cpp/coarsen.hpp), so coarse vertices are fine ones: what vertices carry is restricted by
picking. Borders, cuts, fabrics, clamps, supports and seams keep their places.
"""

from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sp
from scipy.sparse.csgraph import connected_components

from voile import _kernels
from voile.arrays import Flags, Ints, Reals, triangle_areas
from voile.elastic.weave import warp_components, warp_directions
from voile.errors import InputError
from voile.mesh.stitches import join
from voile.mesh.topology import Topology, build_topology
from voile.problem.clamps import held_directors
from voile.problem.prolongation import Prolongation, start_shape
from voile.problem.shell import Shell

BORDER, CUT, CLAMP, FABRIC, SUPPORT = 1, 2, 4, 8, 16  # kinds of feature lines, as in coarsen.hpp
APART = 0.5  # no support stretches the surface by more; two that move apart do
WORTH = 0.7  # of the vertices: a level that keeps more is none


class _Collapsed(NamedTuple):
    """What is left of n vertices and m triangles by collapsing half edges: c triangles (c,) of the fine mesh with their
    corners (c, 3) and those at rest; of each fine vertex the coarse triangle `home` (n,) under it and its place
    `weight` (n, 3) there; edges `feature` (f, 2) of feature lines and their `kind` (f,); hanging vertices `hang` (k, 3)
    and `hang_weight` (k,), as in _Seams. All in fine numbering."""

    triangle: Ints
    corner: Ints
    rest_corner: Ints
    home: Ints
    weight: Reals
    feature: Ints
    kind: Ints
    hang: Ints
    hang_weight: Reals


def coarsen(shell: Shell, ratio: float = 0.25) -> tuple[Shell, Prolongation] | None:
    """A shell of about ratio times as many vertices and of the same mass, and its prolongation.

    None where it keeps most of them, where moments act on half edges, or where coarse triangles do not meet a plane of
    symmetry as its clamps ask.
    """
    if shell.moment is not None:
        return None
    seams, start, n = _Seams(shell), start_shape(shell), len(shell.points)
    left = _collapse(shell, seams, start, int(np.ceil(ratio * n)))
    loose = np.setdiff1d(np.arange(n), shell.triangles)
    kept = np.union1d(left.corner, loose)
    if len(kept) > WORTH * n:
        return None
    number = np.full(n, -1)
    number[kept] = np.arange(len(kept))
    corners, weight = number[left.corner[left.home]], left.weight.copy()
    corners[loose], weight[loose] = number[loose][:, None], (1.0, 0.0, 0.0)
    prolongation = Prolongation(shell, kept, number[left.corner].astype(np.int32), corners, weight)
    coarse = _picked(shell, left, number, prolongation, seams)
    coarse.density *= _mass(shell) / _mass(coarse)  # flat facets cut corners off
    if shell.closing is not None:
        coarse.closing = _closing(coarse, start[kept])
    return (coarse, prolongation) if _holds(coarse) else None


def _collapse(shell: Shell, seams: "_Seams", start: Reals, count: int) -> _Collapsed:
    """The shell at its start (n, 3) m with about `count` vertices left."""
    feature, kind = _features(shell, _clamped(shell).all(axis=1))
    return _Collapsed(
        *_kernels.coarsen(
            _ints(shell.triangles),
            _ints(shell.rest_triangles),
            _ints(_charts(shell)),
            np.ascontiguousarray(start, dtype=float),
            np.ascontiguousarray(shell.rest_points, dtype=float),
            _ints(_supports(shell)),
            _ints(seams.label),
            _ints((_fans(shell) > 1) | seams.bound(feature, kind)),
            _ints(feature),
            _ints(kind),
            _ints(seams.hang),
            seams.weight,
            count,
        )
    )


def _picked(
    shell: Shell, left: _Collapsed, number: Ints, prolongation: Prolongation, seams: "_Seams"
) -> Shell:
    """The coarse shell with what its vertices and triangles carry on the fine one. number (n,): of coarse vertices, -1
    where one is gone."""
    kept, triangles, triangle = prolongation.kept, prolongation.triangles, left.triangle
    rest_kept, rest_triangles = kept, triangles
    if not np.array_equal(left.corner, left.rest_corner):
        rest_kept, rest_triangles = np.unique(left.rest_corner, return_inverse=True)
        rest_triangles = rest_triangles.reshape(-1, 3).astype(np.int32)
    topology = build_topology(triangles)
    clamps, solid = number[left.feature[left.kind & CLAMP > 0]], _clamped(shell).all(axis=1)
    return Shell(
        points=shell.points[kept],
        triangles=triangles,
        rest_points=shell.rest_points[rest_kept],
        rest_triangles=rest_triangles,
        flat=shell.flat,
        model=shell.model,
        thickness=shell.thickness[triangle],
        young=shell.young[triangle],
        poisson=shell.poisson[triangle],
        density=shell.density[triangle],
        weave=None if shell.weave is None else _woven_on(shell, triangle, rest_kept, rest_triangles),
        fixed=shell.fixed[kept],
        motion=shell.motion[kept],
        clamped_edges=_edges(topology, clamps, solid[triangle]),
        gravity=shell.gravity,
        pressure=shell.pressure,
        patch_pressure=None if shell.patch_pressure is None else shell.patch_pressure[triangle],
        force=None if shell.force is None else prolongation.gather(shell.force),
        load_laws=shell.load_laws,
        extra_mass=None if shell.extra_mass is None else prolongation.gather(shell.extra_mass),
        topology=topology,
        seam_bending=shell.seam_bending,
        **seams.records(number, left.hang, left.hang_weight),
    )


def _woven_on(shell: Shell, triangle: Ints, kept: Ints, triangles: Ints) -> Reals:
    """(c, 9) the weave of coarse rest triangles (c, 3) of the rest vertices `kept`: that of a fine triangle (c,) each,
    with its warp."""
    assert shell.weave is not None
    warp = warp_directions(shell.rest_points, shell.rest_triangles[triangle], shell.weave[triangle])
    rows = shell.weave[triangle].copy()
    rows[:, :2] = warp_components(shell.rest_points[kept], triangles, warp)
    return rows


def _holds(shell: Shell) -> bool:
    """Whether the clamps of a coarse shell can be held."""
    top = shell.topology
    parts = (shell.triangles, top.triangle_edges, top.signs, top.across, len(top.edges), shell.points)
    try:
        held_directors(shell, _kernels.Elastic(shell.model, *parts).directors)
    except InputError:
        return False
    return True


def _ints(values: Ints | Flags) -> Ints:
    return np.ascontiguousarray(values, dtype=np.int32)


def _mass(shell: Shell) -> float:
    areas = triangle_areas(shell.rest_points, shell.rest_triangles)
    return float(shell.density * shell.thickness @ areas)


# ---- what the fine mesh keeps ----


def _clamped(shell: Shell) -> Flags:
    """(m, 3) marks clamped half edges."""
    clamped = np.zeros(len(shell.topology.edges), dtype=bool)
    clamped[shell.clamped_edges] = True
    return clamped[shell.topology.triangle_edges]


def _charts(shell: Shell) -> Ints:
    """(m,) piece of the rest shape that each triangle belongs to."""
    r, n = shell.rest_triangles, len(shell.rest_points)
    pair = np.concatenate([r[:, :2], r[:, 1:]])
    graph = sp.csr_matrix((np.ones(len(pair)), (pair[:, 0], pair[:, 1])), shape=(n, n))
    found: Ints = connected_components(graph, directed=False)[1][r[:, 0]]
    return found


def _supports(shell: Shell) -> Ints:
    """(n,) equal numbers for vertices of one support, 0 for free ones: neighbours that are held along the same axes and
    moved apart by less than APART of their distance."""
    n = len(shell.points)
    i, j = build_topology(shell.triangles).edges.T
    same = (shell.fixed[i] == shell.fixed[j]).all(axis=1)
    moved = np.linalg.norm((shell.motion * shell.fixed)[i] - (shell.motion * shell.fixed)[j], axis=1)
    same &= moved <= APART * np.linalg.norm(shell.points[i] - shell.points[j], axis=1)
    graph = sp.csr_matrix((same[same].astype(float), (i[same], j[same])), shape=(n, n))
    return np.where(shell.fixed.any(axis=1), 1 + connected_components(graph, directed=False)[1], 0)


def _fans(shell: Shell) -> Ints:
    """(n,) sheets of triangles that meet in each vertex: more than one where it alone joins them."""
    topology = build_topology(shell.triangles)
    half = np.flatnonzero(topology.across.ravel() >= 0)
    other = topology.across.ravel()[half]
    t, k, s, j = half // 3, half % 3, other // 3, other % 3
    # the half edge runs from corner k + 1 to k + 2, its twin back
    one = np.concatenate([3 * t + (k + 1) % 3, 3 * t + (k + 2) % 3])
    two = np.concatenate([3 * s + (j + 2) % 3, 3 * s + (j + 1) % 3])
    size = shell.triangles.size
    graph = sp.csr_matrix((np.ones(len(one)), (one, two)), shape=(size, size))
    fan = connected_components(graph, directed=False)[1]
    first = np.unique(fan, return_index=True)[1]
    return np.bincount(shell.triangles.ravel()[first], minlength=len(shell.points))


def _features(shell: Shell, solid: Flags) -> tuple[Ints, Ints]:
    """(f, 2) edges of the feature lines and (f,) their kinds. solid (m,): triangles clamped all around."""
    topology = build_topology(shell.triangles)
    across = topology.across.ravel()
    half = np.arange(len(across))
    start, end, opposite = (3 * (half // 3) + (half + k) % 3 for k in (1, 2, 0))
    border = across < 0
    other = np.where(border, half, across)
    rest = shell.rest_triangles.ravel()
    cut = ~border & ((rest[start] != rest[end[other]]) | (rest[end] != rest[start[other]]))
    fabric = np.column_stack([shell.thickness, shell.young, shell.poisson, shell.density])
    if shell.weave is not None:
        fabric = np.column_stack([fabric, shell.weave[:, 2:]])
    seam = (fabric[half // 3] != fabric[other // 3]).any(axis=1)
    clamp = _clamped(shell).ravel() & (border | ~(solid[half // 3] & solid[other // 3]))
    key, corner = _supports(shell), shell.triangles.ravel()
    held = (key[corner[start]] > 0) & (key[corner[start]] == key[corner[end]])
    inside = (key[corner[opposite]] == key[corner[start]]) & (
        key[corner[opposite[other]]] == key[corner[start]]
    )
    held &= border | ~inside
    bits = BORDER * border + CUT * cut + CLAMP * clamp + FABRIC * seam + SUPPORT * held
    kind = np.zeros(len(topology.edges), dtype=np.int64)
    np.bitwise_or.at(kind, topology.triangle_edges.ravel(), bits)
    on = np.flatnonzero(kind)
    return topology.edges[on], kind[on]


def _edges(topology: Topology, pairs: Ints, solid: Flags) -> Ints:
    """Indices of edges that are given by their vertices (k, 2), and of those of solid triangles (m,)."""
    n = int(topology.edges.max(initial=0)) + 1
    key = topology.edges @ np.array([n, 1])
    given = np.searchsorted(key, np.sort(pairs, axis=1) @ np.array([n, 1]))
    return np.union1d(given, topology.triangle_edges[solid]).astype(np.int32)


class _Seams:
    """Stitches of a shell as groups of vertices that are one, and vertices that hang on an edge.

    label (n,): smallest vertex that each is sewn to; hang (k, 3) slave, first and second; weight (k,).
    """

    def __init__(self, shell: Shell):
        self.label: Ints = np.arange(len(shell.points))
        stitches = shell.stitches
        row: Ints = np.zeros(0, dtype=np.int64)
        if len(stitches):
            self.label, hangs = join(stitches, len(shell.points))
            row = hangs[np.unique(self.label[stitches.slave[hangs]], return_index=True)[1]]  # one is enough
        self.hang = np.column_stack([shell.slave, shell.first, shell.second])[row]
        self.weight = np.ascontiguousarray(shell.weight[row], dtype=float)

    def bound(self, feature: Ints, kind: Ints) -> Flags:
        """(n,) marks vertices that must stay: sewn ones off the border, and ends of a seam that follow no border."""
        n = len(self.label)
        border = feature[kind & BORDER > 0]
        rim = np.zeros(n, dtype=bool)
        rim[border] = True
        sewn = np.bincount(self.label, minlength=n)[self.label] > 1
        sewn[self.hang] = True
        across = np.sort(self.hang[:, 1:], axis=1) @ np.array([n, 1])
        along = np.isin(across, np.sort(border, axis=1) @ np.array([n, 1]))
        still = sewn & ~rim
        still[self.hang[~along]] = True
        return still

    def records(self, number: Ints, hang: Ints, weight: Reals) -> dict[str, Any]:
        """Stitches of the coarse shell. number (n,): its vertices, -1 where one is gone."""
        one = np.flatnonzero((self.label != np.arange(len(self.label))) & (number >= 0))
        root = self.label[one]
        slave, first, second = (
            number[np.vstack([np.column_stack([one, root, root]), hang])].astype(np.int32).T
        )
        return {
            "slave": slave,
            "first": first,
            "second": second,
            "weight": np.concatenate([np.zeros(len(one)), weight]),
        }


def _closing(shell: Shell, closed: Reals) -> Reals:
    """(n, 3) displacement to closed (n, 3) m, with all seams closed exactly."""
    sewing, base = shell.sewing()
    found: Reals = sewing @ closed[base] - shell.points
    return found
