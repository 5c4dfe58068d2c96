"""Places that ways to an equilibrium come back to, and starts that are equilibria already."""

import numpy as np
import protocols
import pytest

from voile.contact.obstacles import Box, Plane
from voile.problem.contact import with_obstacles
from voile.problem.problem import Problem
from voile.solver.methods.semismooth import Iteration
from voile.solver.stepping.control import StepControl


def test_a_place_is_the_same_from_another_base():
    points, triangles = protocols.plate(0.5, 0.5, 0.125)
    problem = Problem(protocols.shell_of(points, triangles, young=1e6, thickness=1e-3, density=300.0))
    problem = with_obstacles(
        problem, [Plane(name="floor", friction=0.3, point=np.zeros(3), normal=protocols.UP)], 0.0
    )
    contact, rng = problem.contact, np.random.default_rng(2)
    y = problem.create_vector()
    y.array[:] = rng.normal(size=len(y.array_r))
    contact.history.normal[0][:] = 1.0
    place, x = problem.save(y), problem.positions(y)
    y.array[:] += 1e-3 * rng.normal(size=len(y.array_r))
    problem.move_origin(y)
    assert y.norm() == 0.0 and np.abs(problem.positions(y) - x).max() > 1e-4
    contact.history.normal[0][:] = 2.0
    problem.restore(y, place)
    assert np.abs(problem.positions(y) - x).max() < 1e-14
    assert (contact.history.normal[0] == 1.0).all()


@pytest.mark.parametrize("step", [1e3, np.nan])
def test_what_is_in_equilibrium_stays_where_a_singular_tangent_leads_away(monkeypatch, step):
    points, triangles = protocols.plate(0.5, 0.5, 0.125)
    shell = protocols.shell_of(points, triangles, young=1e6, thickness=1e-3, density=300.0)
    floor = Plane(name="floor", friction=0.3, point=np.zeros(3), normal=protocols.UP)
    path, problem = protocols.solve(shell, floor)
    assert path.converged
    monkeypatch.setattr(Iteration, "_direction", lambda self, *args: args[-1].set(step))
    again, problem = protocols.solve(shell, floor, history=problem)
    assert again.converged and again.steps[-1].residual <= again.steps[-1].tolerance
    assert np.abs(problem.positions(again.state) - points).max() < 1e-12


def test_all_of_the_load_is_next_where_a_part_of_it_fails():
    pace = StepControl(0.1, 2)
    pace.done(20, 0.01, False)
    assert pace.target == pytest.approx(0.2)
    pace.whole()
    assert pace.target == 1.0 and pace.nominal == 1.0


@pytest.mark.parametrize("steps", [1, 10])
@pytest.mark.parametrize("friction", [0.6, 10.0])
def test_a_strip_does_not_fall_through_the_bench_that_it_lies_on(friction, steps):
    """Pinned at one end in mid-air, its other half on a box: hanging straight down it were in equilibrium, too."""
    points, triangles = protocols.plate(1.0, 0.2, 0.05)
    pinned = protocols.held(points, (points[:, 0] < 1e-9, np.zeros(3)))
    shell = protocols.shell_of(points, triangles, young=1e6, thickness=1e-3, density=300.0, **pinned)
    bench = Box(
        name="bench",
        friction=friction,
        center=np.array([3.05, 0.1, -0.1005]),
        sizes=np.array([2.5, 0.5, 0.1]),  # halves
    )
    path, problem = protocols.solve(shell, bench, steps, offset=5e-4)
    assert path.converged and path.stable
    x = problem.positions(path.state)
    assert x[:, 2].min() > -0.5  # 1 m where it hangs
    end = path.steps[-1].contact
    assert end["active"] >= 20 and end["max_penetration"] < 1e-10
    if friction > 1.0:
        assert x[points[:, 0] > 0.9, 2].min() > -1e-9  # its end stays where it lay


def test_a_shell_that_snaps_on_and_on_takes_whole_steps_until_it_is_quiet():
    pace = StepControl(0.1, 2)
    for _ in range(4):
        assert not pace.shortest
        pace.done(20, 0.01, True)
    pace.step = pace.nominal
    assert pace.shortest  # the onset of the next snap is not looked for
    pace.done(20, 0.01, False)
    assert not pace.shortest
