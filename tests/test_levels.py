"""Coarse levels of a shell: what they keep, how good their triangles are, what carries shapes back."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from test_problem import make_shell, sewn_panels, sheet

from voile.mesh import Stitches, boundary_loops, read_mesh, read_rest, sewing_matrix
from voile.mesh.checks import flat_triangles
from voile.mesh.topology import build_topology
from voile.problem.discrete import Problem
from voile.problem.levels import Prolongation, coarsen
from voile.problem.shell import Shell, seam_gaps, triangle_areas


def angles(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """(m,) smallest angle of each triangle in degrees."""
    x = points[triangles]
    one, two = np.roll(x, -1, axis=1) - x, np.roll(x, 1, axis=1) - x
    cosine = (one * two).sum(axis=2) / (np.linalg.norm(one, axis=2) * np.linalg.norm(two, axis=2))
    return np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)).min(axis=1))


def loops(shell: Shell) -> int:
    topology = build_topology(shell.triangles)
    return len(boundary_loops(shell.triangles, topology, shell.points))


def pieces(shell: Shell) -> int:
    t = shell.triangles
    pair = np.concatenate([t[:, :2], t[:, 1:]])
    graph = coo_matrix((np.ones(len(pair)), pair.T), shape=(len(shell.points),) * 2)
    return connected_components(graph, directed=False)[0]


def euler(shell: Shell) -> int:
    return len(shell.points) - len(build_topology(shell.triangles).edges) + len(shell.triangles)


def turned(points: np.ndarray) -> np.ndarray:
    """The points moved rigidly."""
    axis = np.array([2.0, -1.0, 2.0]) / 3.0
    cross = np.cross(np.eye(3), axis)
    rotation = np.eye(3) + np.sin(2.1) * cross + (1.0 - np.cos(2.1)) * cross @ cross
    return points @ rotation + np.array([0.3, -4.0, 1.0])


def started(shell: Shell) -> np.ndarray:
    return shell.points if shell.closing is None else shell.points + shell.closing


def mass(shell: Shell) -> float:
    return shell.density * shell.thickness @ triangle_areas(shell.rest_points, shell.rest_triangles)


def check(fine: Shell, coarse: Shell, up: Prolongation) -> None:
    """What holds of every level."""
    # a subset of the vertices, a surface of the same kind
    assert (np.diff(up.kept) > 0).all()
    np.testing.assert_array_equal(coarse.points, fine.points[up.kept])
    np.testing.assert_array_equal(up.restrict(fine.points), coarse.points)
    there = {tuple(x) for x in fine.rest_points}
    assert all(tuple(x) in there for x in coarse.rest_points)
    ordered = np.sort(coarse.triangles, axis=1)
    assert len(np.unique(ordered, axis=0)) == len(ordered)
    half = coarse.triangles[:, [1, 2, 2, 0, 0, 1]].reshape(-1, 2)
    assert len(np.unique(half, axis=0)) == len(half), "an edge of three triangles, or one turned over"
    loose = [
        len(s.points) - len(np.unique(s.triangles)) for s in (fine, coarse)
    ]  # all theirs vanish when sewn
    assert loose[0] == loose[1]
    assert len(flat_triangles(coarse.points, coarse.triangles)) == 0
    assert len(flat_triangles(coarse.rest_points, coarse.rest_triangles)) == 0
    assert (euler(coarse), loops(coarse), pieces(coarse)) == (euler(fine), loops(fine), pieces(fine))
    # supports and loads
    for values in ("fixed", "motion"):
        np.testing.assert_array_equal(getattr(coarse, values), getattr(fine, values)[up.kept])
    kinds = [np.unique(np.hstack([s.fixed, s.motion]), axis=0) for s in (fine, coarse)]
    np.testing.assert_array_equal(*kinds)
    assert mass(coarse) == pytest.approx(mass(fine), rel=1e-12)
    if fine.force is not None:
        np.testing.assert_allclose(coarse.force.sum(axis=0), fine.force.sum(axis=0), rtol=1e-12, atol=1e-15)
    # the start shape, rigid motions, linear fields
    size = np.ptp(fine.points, axis=0).max()
    np.testing.assert_allclose(up.weights.sum(axis=1), 1.0, rtol=1e-12)
    start = started(fine)
    np.testing.assert_allclose(up.positions(start[up.kept]), start, atol=1e-12 * size)
    np.testing.assert_allclose(up.positions(turned(start[up.kept])), turned(start), atol=1e-11 * size)
    bent = coarse.points + 0.1 * size * np.sin(3.0 * coarse.points[:, [1, 2, 0]] / size)
    np.testing.assert_array_equal(up.positions(bent)[up.kept], bent)
    if len(coarse.slave):
        stitches = Stitches(coarse.slave, coarse.first, coarse.second, coarse.weight)
        matrix, base = sewing_matrix(stitches, len(coarse.points))  # nothing hangs on itself or twice
        anywhere = matrix @ np.random.default_rng(0).random((len(base), 3))
        assert len(flat_triangles(anywhere, coarse.triangles)) == 0, "a triangle vanishes when sewn"


def levels(shell: Shell, count: int = 2, ratio: float = 0.25) -> list[Shell]:
    """The shell and its next levels, checked."""
    found = [shell]
    for _ in range(count):
        level = coarsen(found[-1], ratio)
        assert level is not None
        check(found[-1], *level)
        found.append(level[0])
    return found


def test_plate():
    points, triangles = sheet(32, 16)
    shell = make_shell(points, triangles)
    for level, target in zip(levels(shell)[1:], (141, 36), strict=True):
        assert abs(len(level.points) - target) <= 2
        corners = {(x, y) for x in (0.0, 1.0) for y in (0.0, 0.5)}
        assert corners <= {(x, y) for x, y, _ in level.points}
        assert triangle_areas(level.points, level.triangles).sum() == pytest.approx(0.5, rel=1e-12)
        assert angles(level.points, level.triangles).min() > 18.0
        edge = level.points[level.topology.edges]
        length = np.linalg.norm(edge[:, 1] - edge[:, 0], axis=1)
        assert length.max() < 2.2 * length.mean()
        # the clamped side: as long as it was, held and clamped all along
        clamps = level.points[level.topology.edges[level.clamped_edges]]
        assert (
            np.abs(clamps[:, 1, 1] - clamps[:, 0, 1]).sum() == pytest.approx(0.5)
            and not clamps[:, :, 0].any()
        )
        Problem(level)


def real(shared, name: str, scale: float, up: int, flat: bool = False) -> Shell:
    """A garment held at the top 3 % of its height."""
    surface = read_mesh(shared / "meshes" / name, scale)
    rest = read_rest("flat" if flat else None, surface, shared)
    height = surface.points[:, up]
    top = height > height.max() - 0.03 * np.ptp(height)
    seams = surface.stitches
    given = {} if seams is None else {k: getattr(seams, k) for k in ("slave", "first", "second", "weight")}
    return make_shell(
        surface.points,
        surface.triangles,
        rest_points=rest.points,
        rest_triangles=rest.triangles,
        flat=rest.flat,
        fixed=np.repeat(top[:, None], 3, axis=1),
        **given,
    )


GARMENTS = {
    "skirt7271.obj": (1.0, 1, False),
    "dress-v17k-f34k.obj": (0.02, 1, False),
    "pleated-dress-panels.obj": (1.0, 2, True),
}


@pytest.mark.parametrize("name", GARMENTS)
def test_garments(shared, name):
    shell = real(shared, name, *GARMENTS[name])
    for level, ratio in zip(levels(shell)[1:], (4, 16), strict=True):
        assert abs(len(level.points) * ratio / len(shell.points) - 1.0) < 0.01
        for points, triangles in ((level.points, level.triangles), (level.rest_points, level.rest_triangles)):
            smallest = angles(points, triangles)
            assert np.percentile(smallest, 1) > 12.0 and np.percentile(smallest, 50) > 37.0
            area = triangle_areas(points, triangles).sum()
            before = (shell.rest_points, shell.rest_triangles)
            assert area == pytest.approx(triangle_areas(*before).sum(), rel=0.06)


def test_panels_that_are_sewn():
    for level in levels(sewn_panels(), 1, 0.5)[1:]:
        assert 1 <= len(level.slave) < 7
        assert seam_gaps(level).max() == pytest.approx(0.04)


def test_no_level_where_nothing_may_go():
    points, triangles = sheet(1, 1)
    assert coarsen(make_shell(points, triangles)) is None
    fixed = make_shell(*sheet(8, 8))
    assert coarsen(replace(fixed, moment=np.ones(fixed.triangles.size))) is None
