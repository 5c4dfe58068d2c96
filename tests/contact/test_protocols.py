"""Contact against closed forms: lifted strip, incline, drapes, and the end of Newton's method."""

import itertools

import numpy as np
import protocols
import pytest

from voile.contact.obstacles import Motion, Sphere
from voile.problem.contact import with_obstacles
from voile.problem.problem import Problem
from voile.solver.path import StaticsOptions
from voile.solver.statics import solve_statics


@pytest.mark.parametrize("cells", [80, pytest.param(1280, marks=pytest.mark.slow)])
def test_lifted_strip(cells):
    """The closed form of the free boundary, and the laws to round-off."""
    strip = protocols.lifted_strip(cells)
    assert strip.path.converged and strip.path.stable
    assert strip.force == pytest.approx(strip.exact_force, rel=0.01)
    assert strip.length == pytest.approx(strip.exact_length, rel=0.01)
    assert abs(strip.first - strip.exact_length) < strip.size
    expected = strip.points[:, 0] > strip.first - 1e-9
    assert np.array_equal(strip.touching, expected)  # the expected vertices, no other
    reaction, gap = strip.fields["reaction"][:, 2], strip.fields["gap"]
    assert np.abs(reaction * gap).max() < 1e-15 * strip.exact_force
    assert gap.min() > -1e-15


@pytest.mark.parametrize("angle", [5.0, 30.0, 60.0])
@pytest.mark.parametrize("cells", [24, pytest.param(96, marks=pytest.mark.slow)])
@pytest.mark.parametrize("thickness", [1e-3, 5e-2], ids=["cloth", "block"])
def test_incline(angle, cells, thickness):
    """Sticks while tan(angle) < mu without drift; slides down the slope beyond."""
    path, problem, start, down = protocols.incline(angle, cells, thickness, 1.001)
    assert path.converged and path.steps[-1].contact["slip"] == 0
    moved = problem.positions(path.state) - start
    assert np.abs(moved.mean(axis=0)).max() < 1e-12 and path.steps[-1].contact["max_penetration"] < 1e-15
    path = protocols.incline(angle, cells, thickness, 0.999)[0]
    assert not path.converged and "slides" in path.reason
    way = [float(x) for x in path.reason.split("along (")[1].split(")")[0].split(",")]
    assert np.dot(way, down) > 0.999


@pytest.mark.parametrize("name", ["sphere", "box"])
def test_drape(name):
    """Contact carries the weight, nothing is inside."""
    path, problem, weight = protocols.drape(name, 14)
    assert path.converged and path.stable
    report = path.steps[-1].contact
    assert np.abs(report["obstacles"][0]["force"] - weight * protocols.UP).max() < 1e-8 * weight
    assert report["max_penetration"] < 1e-10 * problem.size()
    assert report["friction_error"] < 1e-7 and report["active"] > 5


def test_quadratic_convergence():
    """The last norms of the semismooth method on a strip pressed by a moving ball."""
    points, triangles = protocols.plate(1.0, 0.2, 0.05)
    ends = (points[:, 0] < 1e-9) | (points[:, 0] > 1 - 1e-9)
    supports = protocols.held(points, (ends, np.zeros(3)))
    shell = protocols.shell_of(points, triangles, young=1e8, thickness=5e-3, density=300.0, **supports)
    press = Motion(displacement=np.array([0.002, 0.001, 0.02]))
    ball = Sphere(name="ball", friction=0.2, motion=press, center=np.array([0.45, 0.1, -0.31]), radius=0.3)
    problem = Problem(shell)
    problem = with_obstacles(problem, [ball], 0.0)
    norms: list[float] = []

    def monitor(_factor, iteration, norm):
        if iteration == 0:
            norms.clear()
        norms.append(norm)

    problem.monitor = monitor
    path = solve_statics(problem, StaticsOptions(load_steps=2, stability=False))
    assert path.converged and path.steps[-1].contact["slip"] > 0
    print([f"{norm:.1e}" for norm in norms])
    falls = [b / a for a, b in itertools.pairwise(norms)]
    assert falls[-1] < 1e-3 and norms[-1] < 1e-8 * norms[0]
