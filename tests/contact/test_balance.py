"""Loads that no reactions of planes can balance: found before anything is solved, and only where that is certain."""

from dataclasses import replace

import numpy as np
import protocols
import pytest

from voile.contact.obstacles import Motion, Plane, Sphere
from voile.problem.contact import with_obstacles
from voile.problem.problem import Problem
from voile.solver.balance import unbalanced, unresisted
from voile.solver.path import StaticsOptions, tolerance
from voile.solver.statics import solve_statics


def problem_of(*obstacles, **more) -> Problem:
    points, triangles = protocols.plate(0.5, 0.5, 0.1)
    shell = protocols.shell_of(points, triangles, young=1e6, thickness=1e-3, density=300.0, **more)
    return with_obstacles(Problem(shell), list(obstacles), 0.0)


def plane(angle: float, friction: float, turn: float = 0.0) -> Plane:
    """A slope of `angle` (rad) down along x, after a turn about the vertical."""
    normal = np.array([np.sin(angle) * np.cos(turn), np.sin(angle) * np.sin(turn), np.cos(angle)])
    return Plane(name="slope", friction=friction, point=np.zeros(3), normal=normal)


def why(problem: Problem) -> str:
    y = problem.create_vector()
    return unbalanced(problem, y, tolerance(problem, y, StaticsOptions()))


@pytest.mark.parametrize("angle", [1.0, 30.0, 80.0])
def test_a_slope_holds_up_to_its_friction(angle):
    a = np.radians(angle)
    for share in (1.0 - 1e-4, 0.9, 0.0):
        reason = why(problem_of(plane(a, share * np.tan(a))))
        way = [float(x) for x in reason.split("along (")[1].split(")")[0].split(",")]
        assert np.allclose(way, [np.cos(a), 0.0, -np.sin(a)], atol=6e-4)
    for share in (1.0 - 1e-12, 1.0, 1.0 + 1e-12, 2.0):
        assert not why(problem_of(plane(a, share * np.tan(a))))


def test_a_ceiling_bears_nothing():
    reason = why(problem_of(plane(np.pi, 1.0)))
    assert "(0.000, 0.000, -1.000)" in reason


def groove(lean: float, friction: float, slope: float) -> Problem:
    """Two planes that lean towards each other, with gravity turned along their groove by `slope` (rad)."""
    down = 9.81 * np.array([0.0, np.sin(slope), -np.cos(slope)])
    return problem_of(plane(lean, friction), plane(-lean, friction), gravity=down)


@pytest.mark.parametrize("friction", [0.1, 0.4])
def test_a_groove_holds_as_far_as_wedging_can(friction):
    """The cones of two planes that lean by b reach up to tan(slope) = mu / (cos b sqrt(1 - mu^2 tan(b)^2))."""
    lean = np.radians(40.0)
    limit = friction / (np.cos(lean) * np.sqrt(1.0 - (friction * np.tan(lean)) ** 2))
    reason = why(groove(lean, friction, np.arctan(1.001 * limit)))
    way = [abs(float(x)) for x in reason.split("along (")[1].split(")")[0].split(",")]
    assert np.allclose(way, [0.0, 1.0, 0.0], atol=6e-4)
    assert not why(groove(lean, friction, np.arctan(0.999 * limit)))


def test_nothing_is_said_where_it_is_not_certain():
    slope = plane(0.5, 0.1)
    ball = Sphere(name="ball", friction=0.0, center=np.array([0.0, 0.0, -9.0]), radius=1.0)
    points, _ = protocols.plate(0.5, 0.5, 0.1)
    held = np.zeros(points.shape, dtype=bool)
    held[0] = True
    assert why(problem_of(slope))
    assert not why(problem_of(slope, ball))
    assert not why(problem_of(slope, fixed=held))
    assert not why(problem_of(slope, pressure=1.0))
    assert not why(problem_of(slope, gravity=np.zeros(3)))


def test_the_same_with_dead_forces():
    """A force along the slope holds the sheet without friction; the same force the other way does not."""
    slope, a = plane(0.5, 0.0), 0.5
    points, _ = protocols.plate(0.5, 0.5, 0.1)
    weight = 300.0 * 1e-3 * 0.25 * 9.81
    force = np.zeros(points.shape)
    force[0] = -weight * np.sin(a) * np.array([np.cos(a), 0.0, -np.sin(a)])
    assert not why(problem_of(slope, force=force))
    assert why(problem_of(slope, force=-force))
    assert why(problem_of(slope, force=0.999 * force))


def test_what_is_left_is_least():
    """Reactions at random leave no less; what is left works on no reaction, and only the loads work on it."""
    rng = np.random.default_rng(3)
    some = 0
    for count in (1, 2, 3) * 20:
        normals = rng.normal(size=(count, 3))
        normals[:, 2] += 2.0
        normals /= np.linalg.norm(normals, axis=1)[:, None]
        frictions, load = rng.uniform(0.0, 0.5, count), rng.normal(size=3) - [0.0, 0.0, 1.0]
        left, _ = unresisted(load, normals, frictions)
        size = np.linalg.norm(left)
        some += size > 0.0
        sideways = rng.normal(size=(5000, count, 3))
        sideways -= np.einsum("nki,ki->nk", sideways, normals)[:, :, None] * normals
        sideways *= rng.uniform(0.0, 1.0, (5000, count, 1)) / np.linalg.norm(sideways, axis=2, keepdims=True)
        cones = normals + frictions[:, None] * sideways
        sums = np.einsum("nk,nki->ni", rng.exponential(size=(5000, count)), cones)
        assert np.linalg.norm(load + sums, axis=1).min() >= size - 1e-12
        assert (cones @ left).min() >= -1e-12 and abs(left @ load - size**2) < 1e-10
    assert 20 < some < 60
    left, bearing = unresisted(np.array([-3.0, -4.0, 1.0]), np.eye(3), np.zeros(3))
    assert np.allclose(left, [0.0, 0.0, 1.0], atol=1e-14) and np.array_equal(bearing, np.eye(3)[:2])


def test_a_slide_takes_no_factorisation_and_a_stick_as_before():
    slides = problem_of(plane(0.5, 0.999 * np.tan(0.5)))
    path = solve_statics(slides, StaticsOptions())
    assert (
        not path.converged and path.reason.startswith("the shell slides") and path.counts.factorisations == 0
    )
    sticks = problem_of(plane(0.5, 1.001 * np.tan(0.5)))
    path = solve_statics(sticks, StaticsOptions())
    assert path.converged and path.stable


def test_a_plane_that_tips_over():
    """The load step in which the slope becomes too steep ends the path."""
    tips = replace(plane(0.0, 0.3), motion=Motion(rotation=np.array([0.0, 0.6, 0.0])))
    path = solve_statics(problem_of(tips), StaticsOptions(load_steps=10))
    assert not path.converged and "no reactions" in path.reason
    held = 0.6 * path.steps[-1].factor
    assert np.tan(held) <= 0.3 < np.tan(held + 0.06 + 1e-9)
