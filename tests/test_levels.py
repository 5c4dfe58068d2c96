"""Coarse levels of a shell: what they keep, how good their triangles are, what carries shapes back."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import Delaunay
from scipy.spatial.transform import Rotation
from test_problem import make_shell, sewn_panels, sheet

from voile.arrays import triangle_areas
from voile.mesh import Stitches, boundary_loops, read_mesh, read_rest, sewing_matrix
from voile.mesh.checks import flat_triangles
from voile.mesh.topology import build_topology, inside_out
from voile.problem.levels import Prolongation, coarsen
from voile.problem.problem import Problem
from voile.problem.shell import Shell


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


def patch(seed: int) -> Shell:
    """An irregular curved sheet with a hole, of two fabrics, some of it held; a flat rest shape for odd seeds, for
    every third one cut into two pieces that lie apart."""
    rng = np.random.default_rng(seed)
    flat = rng.random((600, 2)) * [1.0, rng.uniform(0.4, 1.0)]
    triangles = Delaunay(flat).simplices.astype(np.int32)
    side = flat[triangles] - flat[np.roll(triangles, 1, axis=1)]
    area = np.cross(side[:, 1], side[:, 2])
    triangles[area < 0.0] = triangles[area < 0.0][:, [0, 2, 1]]
    middle = flat[triangles].mean(axis=1)
    solid = np.abs(area) > 0.05 * (side**2).sum(axis=2).max(axis=1)
    triangles = triangles[solid & (np.linalg.norm(middle - [0.6, 0.2], axis=1) > 0.1)]
    used, triangles = np.unique(triangles, return_inverse=True)
    flat, triangles = flat[used], triangles.reshape(-1, 3).astype(np.int32)
    points = np.column_stack([flat, 0.2 * np.sin(4.0 * flat[:, 0])])
    rest = np.column_stack([flat, np.zeros(len(flat))]) if seed % 2 else points
    middle = flat[triangles].mean(axis=1)
    corners = triangles
    if seed % 3 == 0:
        corners = np.where(middle[:, 1:] < 0.2, triangles, triangles + len(flat)).astype(np.int32)
        rest = np.vstack([rest, rest + np.array([0.0, 3.0, 0.0])])
    fixed, motion = np.zeros((len(flat), 3), dtype=bool), np.zeros((len(flat), 3))
    fixed[flat[:, 0] < 0.2] = True
    moved = (flat[:, 0] > 0.8) & (flat[:, 1] > 0.2)
    fixed[moved, 2], motion[moved, 2] = True, 0.1
    fixed[np.argmin(np.linalg.norm(flat - [0.5, 0.4], axis=1))] = True  # a single one
    shell = make_shell(
        points,
        triangles,
        rest_points=rest,
        rest_triangles=corners,
        young=np.where(middle[:, 0] < 0.5, 1e6, 2e6),
        fixed=fixed,
        motion=motion,
        force=rng.normal(size=points.shape),
    )
    shell.clamped_edges = np.flatnonzero(shell.fixed[shell.topology.edges].all(axis=(1, 2)))
    return shell


@pytest.mark.parametrize("seed", range(6))
def test_irregular_meshes(seed):
    fine = patch(seed)
    for level in levels(fine)[1:]:
        for young in (1e6, 2e6):
            area = [
                triangle_areas(s.rest_points, s.rest_triangles)[s.young == young].sum() for s in (fine, level)
            ]
            assert area[1] == pytest.approx(area[0], rel=0.06)
        held = []  # area clamped all around, of the start shape; its border is stepped
        for shell in (fine, level):
            clamped = np.zeros(len(shell.topology.edges), dtype=bool)
            clamped[shell.clamped_edges] = True
            assert shell.fixed[shell.topology.edges[clamped]].all()
            solid = clamped[shell.topology.triangle_edges].all(axis=1)
            held.append(triangle_areas(shell.points, shell.triangles)[solid].sum())
        assert held[1] == pytest.approx(held[0], rel=0.15) and held[0] > 0.0
        Problem(level)


def test_a_smooth_shape_comes_back_smooth():
    # a strip rolled up: the surface between the coarse vertices is curved, not faceted
    points, triangles = sheet(64, 24)
    shell = make_shell(points, triangles)
    level = coarsen(shell)
    assert level is not None
    up = level[1]

    def rolled(x):
        return np.column_stack([0.3 * np.sin(x[:, 0] / 0.3), x[:, 1], 0.3 * (1.0 - np.cos(x[:, 0] / 0.3))])

    exact, coarse = rolled(points), rolled(points[up.kept])
    off = np.linalg.norm(up.positions(coarse) - exact, axis=1)
    faceted = np.linalg.norm(up.interpolate(coarse) - exact, axis=1)
    assert np.sqrt((off**2).mean()) < 0.2 * np.sqrt((faceted**2).mean())
    assert off.max() < 0.3 * faceted.max()


def test_supports_take_what_they_hold():
    points, triangles = sheet(16, 16)
    shell = make_shell(points, triangles)
    shell.motion = 0.2 * shell.fixed * points[:, [1, 1, 1]] ** 2  # one support, though no two move alike
    level = coarsen(shell)
    assert level is not None and 3 <= level[0].fixed.all(axis=1).sum() < 0.7 * shell.fixed.all(axis=1).sum()
    at = level[1].positions(level[0].points + level[0].motion, load_factor=0.5)
    np.testing.assert_array_equal(at[shell.fixed], (points + 0.5 * shell.motion)[shell.fixed])


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


@pytest.mark.parametrize("bending", [False, True])
def test_panels_that_are_sewn(bending):
    # three panels in a row, one seam of unlike and one of like resolution
    left, triangles = sheet(48, 24)
    right, more = sheet(72, 36)
    apart = np.array([1.04, 0.0, 0.0])
    points = np.concatenate([left, right + apart, right + 2.0 * apart])
    begin = [0, len(left), len(left) + len(right)]
    triangles = np.concatenate([triangles, more + begin[1], more + begin[2]]).astype(np.int32)
    rim = [48 * 25 + np.arange(25), begin[1] + np.arange(37)]
    rim += [begin[1] + 72 * 37 + np.arange(37), begin[2] + np.arange(37)]
    at = np.arange(37) / 1.5
    first = np.minimum(at.astype(int), 23)
    shell = make_shell(
        points,
        triangles,
        slave=np.concatenate([rim[1], rim[3]]).astype(np.int32),
        first=np.concatenate([rim[0][first], rim[2]]).astype(np.int32),
        second=np.concatenate([rim[0][first + 1], rim[2]]).astype(np.int32),
        weight=np.concatenate([at - first, np.zeros(37)]),
        seam_bending=bending,
    )
    shell.closing = np.array([-0.02, 0.0, 0.0]) * (points[:, :1] // 1.02)
    shell.closing[rim[1], 0] = -0.04
    shell.closing[rim[3], 0] = points[rim[2], 0] + shell.closing[rim[2], 0] - points[rim[3], 0]
    for level, left in zip(levels(shell)[1:], (0.8, 0.4), strict=True):
        ends = np.column_stack([level.slave, level.first, level.second])
        x = started(level)
        seam = (1.0 - level.weight)[:, None] * x[ends[:, 1]] + level.weight[:, None] * x[ends[:, 2]]
        np.testing.assert_allclose(x[ends[:, 0]], seam, atol=1e-12)  # closed, and sewn at the right places
        rest = level.rest_points
        along = (1.0 - level.weight) * rest[ends[:, 1], 1] + level.weight * rest[ends[:, 2], 1]
        np.testing.assert_allclose(rest[ends[:, 0], 1], along, atol=1e-12)
        for sides in ((1.0, 1.04), (2.04, 2.08)):  # both sides of a seam are coarser
            count = [np.isclose(p[:, :1], sides).sum() for p in (shell.points, level.points)]
            assert count[1] < left * count[0]
        Problem(level)
    assert len(levels(sewn_panels(), 1, 0.5)[1].slave) < 7


def test_no_level_where_nothing_may_go():
    points, triangles = sheet(1, 1)
    assert coarsen(make_shell(points, triangles)) is None
    fixed = make_shell(*sheet(8, 8))
    assert coarsen(replace(fixed, moment=np.ones(fixed.triangles.size))) is None


def crumpled(points: np.ndarray, seed: int) -> np.ndarray:
    """Folded by 150 degrees within 2 cm along each of three lines at random, one after the other."""
    random, x = np.random.default_rng(seed), points.copy()
    for _ in range(3):
        line = random.uniform(0.0, 2.0 * np.pi)
        across = np.array([np.cos(line), np.sin(line), 0.0])
        middle = np.array([0.5, 0.5, 0.0]) + 0.2 * random.normal(size=3) * [1.0, 1.0, 0.0]
        angle = np.radians(150.0) * np.clip((x - middle) @ across / 0.02, 0.0, 1.0)
        turn = Rotation.from_rotvec(angle[:, None] * np.cross([0.0, 0.0, 1.0], across))
        x = middle + turn.apply(x - middle)
    return x


def test_few_vertices_turn_inside_out_beside_sharp_folds_of_a_level(monkeypatch):
    """Least bending alone loops there, and hinges that passed 180 degrees stay so."""
    points, triangles = sheet(24, 24)
    coarse, up = coarsen(make_shell(points, triangles), 0.25)
    shapes = [crumpled(coarse.points, seed) for seed in range(12)]

    def turned() -> list[int]:
        return [int(inside_out(up.positions(shape), triangles).sum()) for shape in shapes]

    righted = turned()
    monkeypatch.setattr(Prolongation, "_righted", lambda _, fine, start: fine)
    loose = turned()
    assert sum(loose) > 15 and sum(righted) < 0.6 * sum(loose)
    assert all(np.less_equal(righted, loose)) and righted.count(0) > loose.count(0)
