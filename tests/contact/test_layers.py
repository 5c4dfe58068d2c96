"""Which layers of a shell can touch: seams, and the barrier that keeps layers apart on the way to an equilibrium."""

from dataclasses import replace

import numpy as np
from mpi4py import MPI
from protocols import plate, shell_of
from test_self_contact import pressed_sheets

from voile.contact.candidates import Layers
from voile.contact.pairs import barrier
from voile.problem.contact import shell_layers, with_obstacles
from voile.problem.load import History
from voile.problem.loads import LOADS
from voile.problem.problem import Problem
from voile.solver.methods.local_global import LocalGlobal, Options
from voile.solver.path_in_time import TimeOptions
from voile.solver.stepping.newton_step import NewtonStep
from voile.solver.stepping.schemes import ImplicitEuler
from voile.solver.stepping.time_path import Stepper, start_path

CELL, OFFSET = 0.01, 5e-4


def sewn_panels(share: float, apart: float = 0.0):
    """Two panels of 20 by 2 cells side by side, the second `apart` (m) above the first, its edge sewn to the first's
    with each vertex at `share` of an edge; a small patch lies across the seam at half that height."""
    points, triangles = plate(20 * CELL, 2 * CELL, CELL)
    patch, corners = plate(2 * CELL, CELL, CELL)
    width = np.ptp(points[:, 1])
    near, far = (
        np.flatnonzero(np.isclose(points[:, 1], y)) for y in (points[:, 1].max(), points[:, 1].min())
    )
    near, far = (side[np.argsort(points[side, 0])] for side in (near, far))
    moved = points + np.array([share * CELL, width, apart])
    patch = patch - patch.min(axis=0) + np.array([0.1, points[:, 1].max() - 0.4 * CELL, 0.5 * apart or CELL])
    n = len(points)
    return shell_of(
        np.concatenate([points, moved, patch]),
        np.concatenate([triangles, triangles + n, corners + 2 * n]),
        young=1e6,
        thickness=2 * OFFSET,
        density=300.0,
        slave=n + far[:-1],
        first=near[:-1],
        second=near[1:],
        weight=np.full(len(far) - 1, share),
    ), 2 * n


def test_a_seam_does_not_join_its_far_ends():
    """Only what lies on the same few edges cannot touch, not all along a seam."""
    for share in (0.0, 0.3):
        shell, _ = sewn_panels(share)
        excluded = shell_layers(shell, OFFSET, 0.0).excluded
        length = np.linalg.norm(shell.points[excluded[:, 0]] - shell.points[excluded[:, 1]], axis=1)
        pairs = {tuple(pair) for pair in np.sort(excluded, axis=1).tolist()}
        assert all(tuple(sorted(pair)) in pairs for pair in zip(shell.slave, shell.first, strict=True))
        assert length.max() < 2.1 * CELL


def folded(cells: int = 8, angle: float = 0.3):
    """Two panels two cells wide, folded onto each other by a seam along x: the upper one, at `angle` to the horizontal
    and one cell shorter, is sewn half a cell off the lower one's vertices. The first of its vertices."""
    (lower, below), (upper, above) = (plate(k * CELL, 2 * CELL, CELL) for k in (cells, cells - 1))
    lower, upper = lower - lower.min(axis=0), upper - upper.min(axis=0) + [0.5 * CELL, 0.0, 0.0]
    (first, sewn), n = (np.flatnonzero(p[:, 1] < 1e-9) for p in (lower, upper)), len(lower)
    first, sewn = first[np.argsort(lower[first, 0])], sewn[np.argsort(upper[sewn, 0])]
    points = np.concatenate([lower, upper])
    points[:, 2] = points[:, 1] * np.sin(angle) * np.where(np.arange(len(points)) < n, -1.0, 1.0)
    points[:, 1] *= np.cos(angle)
    return shell_of(
        points,
        np.concatenate([below, above[:, ::-1] + n]),
        young=1e4,
        thickness=2 * OFFSET,
        density=300.0,
        slave=n + sewn,
        first=first[:-1],
        second=first[1:],
        weight=np.full(len(sewn), 0.5),
        gravity=np.zeros(3),
        load_laws=dict.fromkeys(LOADS, History()),
    ), n


def through(layers: Layers, x: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
    """Edges that pass through the inside of triangles at positions x (n, 3)."""
    found = []
    for edge in layers.edges:
        for triangle in layers.triangles[~np.isin(layers.triangles, edge).any(axis=1)]:
            (a, b), corner = x[edge], x[triangle]
            normal = np.cross(corner[1] - corner[0], corner[2] - corner[0])
            here, there = normal @ (a - corner[0]), normal @ (b - corner[0])
            if here * there < 0.0:
                place = a + here / (here - there) * (b - a)
                sides = np.roll(corner, -1, axis=0) - corner
                shares = np.cross(sides, place - corner) @ normal / (normal @ normal)
                if shares.min() > 1e-4:
                    found.append((edge, triangle))
    return found


def seam_pairs(layers: Layers, edge: np.ndarray, triangle: np.ndarray) -> int:
    """How many vertices of the one a seam joins to the other's."""
    joined = {tuple(pair) for pair in np.sort(layers.seams, axis=1).tolist()}
    return sum(tuple(sorted((i, j))) in joined for i in edge.tolist() for j in triangle.tolist())


def crumpled(speed: float, step: float, local_global: int = 0):
    """Two folded panels whose inner vertices start upwards and downwards in turn (m/s), in steps (s) of Newton or of so
    many iterations of local-global: layers, and the shapes (n, 3) of every step."""
    shell, n = folded()
    shell.model = "projective//" if local_global else shell.model
    layers, x = shell_layers(shell, OFFSET, 0.0), shell.points
    assert not len(layers.barred) and not through(layers, x)
    inner, upper = np.isclose(x[:, 1], np.cos(0.3) * CELL), np.arange(len(x)) >= n
    back = (x[:, 0] / CELL + 0.1).astype(int) % 3 == np.where(upper, 1, 0)
    velocity = np.zeros_like(x)
    velocity[:, 2] = speed * inner * np.where(upper, -1.0, 1.0) * np.where(back, -1.0, 1.0)
    problem = with_obstacles(Problem(shell, MPI.COMM_SELF), [], OFFSET, layers).at(0.0)
    path = start_path(problem, velocity[problem.part.vertex])
    shapes, place = [], np.argsort(problem.part.vertex)
    solver = LocalGlobal(problem, Options(local_global)) if local_global else NewtonStep(problem)
    Stepper(problem, TimeOptions(ImplicitEuler(), step, 0.02, 1e-6), solver, path).follow(
        lambda step, path: shapes.append(path.kinematics.positions[place])
    )
    return layers, shapes


def test_layers_beside_a_seam_keep_apart_in_motion():
    """Crumpled, two panels pass through each other only where the chords of the two sides of their seam differ: an edge
    and a triangle that have three vertices on it."""
    layers, shapes = crumpled(1.0, 1e-3)
    assert len(shapes) == 20
    crossing = [pair for shape in shapes[4::5] for pair in through(layers, shape)]
    assert all(seam_pairs(layers, *pair) > 1 for pair in crossing)


def test_no_step_of_local_global_ends_with_layers_through_each_other():
    """A cell long, and stopped after five iterations."""
    layers, shapes = crumpled(5.0, 2e-3, 5)
    crossing = [pair for shape in shapes for pair in through(layers, shape)]
    assert shapes and all(seam_pairs(layers, *pair) > 1 for pair in crossing)


def test_what_leaves_a_seam_may_touch_what_lies_along_it_not():
    """Of the pairs with vertices that the seam joins only those with one such pair count, unless they start near."""
    shell, _ = folded()
    layers, x = shell_layers(shell, OFFSET, 0.0), shell.points
    found = layers.find(x, further=CELL)
    sides = np.array([[0, 0, 0, 1], [0, 0, 1, 1]])[(np.arange(len(found.code)) >= found.faces).astype(int)]
    sides[: found.faces] = [0, 1, 1, 1]
    counts = [
        seam_pairs(layers, vertex[side == 0], vertex[side == 1])
        for vertex, side in zip(found.vertex, sides, strict=True)
    ]
    assert set(counts) == {0, 1}
    open_seams = replace(layers, seams=np.zeros((0, 2), dtype=int)).find(x, further=CELL)
    assert len(np.setdiff1d(open_seams.code, found.code)) == 0 and len(open_seams.code) < len(found.code)
    near = layers.joined(4.0 * OFFSET)
    assert len(near) and not np.isin(near, replace(layers, barred=near).find(x, further=CELL).code).any()


def test_what_a_sliver_parts_cannot_touch():
    """A vertex on the other side of a triangle less than a thickness high is near, but not in another layer."""
    points, triangles = plate(6 * CELL, 6 * CELL, CELL)
    inner = np.flatnonzero((np.abs(points[:, :2] - 3 * CELL) < 1.5 * CELL).all(axis=1))
    above = inner[np.isclose(points[inner, 1], points[inner, 1].min())]
    points[above, :2] += [0.5 * CELL, CELL - 0.8 * OFFSET]  # a row of cells is squeezed
    shell = shell_of(points, triangles, young=1e6, thickness=2 * OFFSET, density=300.0)
    layers = shell_layers(shell, OFFSET, 0.0)
    everything = replace(layers, excluded=np.zeros((0, 2), dtype=int))
    assert len(everything.nearer(2.0 * OFFSET)) and not len(layers.nearer(2.0 * OFFSET))


def test_layers_caught_in_a_gaping_seam_cannot_touch():
    """What starts nearer than the seams gape may be on the wrong side of a seam when that closes."""
    gape = 0.4 * OFFSET
    shell, patch = sewn_panels(0.3, gape)
    layers = shell_layers(shell, OFFSET, 0.0)
    assert layers.caught > 0 and len(layers.nearer(0.99 * gape)) == 0
    caught = (layers.excluded >= patch).sum(axis=1) == 1  # with one of the panels
    assert caught.any()
    everything = replace(layers, excluded=np.zeros((0, 2), dtype=int))
    assert len(everything.nearer(0.99 * gape))
    shell, patch = sewn_panels(0.3)
    assert shell_layers(shell, OFFSET, 0.0).caught == 0
    assert not ((shell_layers(shell, OFFSET, 0.0).excluded >= patch).sum(axis=1) == 1).any()


def test_the_barrier_is_none_where_layers_do_not_meet():
    potential, push, stiff = barrier(np.array([1e-3, 0.0, -1e-6, -OFFSET, -0.999 * 2 * OFFSET]), 2 * OFFSET)
    assert not np.any([potential[:2], push[:2], stiff[:2]])
    assert push[2] < 1e-8 and stiff[2] < 1e-2  # to third order
    assert push[3] > 0.5 * OFFSET and push[4] > 100.0 * push[3]
    gap = np.array([-0.3, -0.7, -0.95]) * 2 * OFFSET
    step = 1e-5 * OFFSET
    ahead, back = barrier(gap + step, 2 * OFFSET), barrier(gap - step, 2 * OFFSET)
    here = barrier(gap, 2 * OFFSET)
    assert np.allclose((ahead - back)[0] / (2 * step), -here[1], rtol=1e-7)
    assert np.allclose((ahead - back)[1] / (2 * step), -here[2], rtol=1e-7)


def test_round_off_of_gaps_counts_for_less_in_norms():
    """Layers' mismatch of the laws grows with rho where their gaps are off, and norms take that of obstacles."""
    contact, x = pressed_sheets(0.0)
    firm = contact.missed(contact.pairs(x, 1.0))
    pairs = contact.measured_pairs(x, 1.0)
    assert pairs[0].rho == contact.stiffness
    assert contact.missed(pairs) < 1e-2 * firm
    assert contact.missed(contact.pairs(x, 1.0)) == firm
