"""Projective Dynamics without contact: its fixed point is the step that Newton's method finds."""

import numpy as np
import pytest
from marching import ALWAYS, March
from test_problem import make_shell, sewn_panels, sheet

from voile.problem.problem import Problem
from voile.solver.methods.local_global import LocalGlobal, Options
from voile.solver.methods.method import Workspace
from voile.solver.methods.mixed_newton import MixedNewton

H, STEPS = 0.01, 3


def both(shell, velocity=0.0, iterations=3000):
    """Marches of local-global and Newton over STEPS steps."""
    ours, newton = Problem(shell), Problem(shell)
    method = LocalGlobal(ours, Options(iterations=iterations))
    marches = (
        March(ours, velocity, H, 1e-11).run(method.solve, STEPS),
        March(newton, velocity, H, 1e-11).run(MixedNewton(Workspace(newton)).solve, STEPS),
    )
    assert all(march.outcome.reason == "" for march in marches)
    return marches


def swung(points):
    """m/s, across a sheet."""
    return np.column_stack([0.0 * points[:, :2], 2.0 * points[:, 0] * np.sin(6.0 * points[:, 1])])


def shell_of(points, triangles, poisson=0.3, thickness=1e-3, **given):
    one = np.ones(len(triangles))
    given = {"young": 1e5 * one, "poisson": poisson * one, "thickness": thickness * one} | given
    return make_shell(points, triangles, "projective//", load_laws=ALWAYS, **given)


@pytest.mark.parametrize(
    ("poisson", "thickness", "curved", "axes"),
    [
        (0.0, 1e-3, 0.0, "xyz"),
        (0.3, 1e-3, 0.1, "xyz"),
        (-0.3, 1e-3, 0.0, "xyz"),
        (0.3, 0.03, 0.1, "xyz"),
        (0.3, 1e-3, 0.0, "xz"),
    ],
)
def test_a_step_is_newtons(poisson, thickness, curved, axes):
    points, triangles = sheet(12, 6)
    points[:, 2] = curved * np.sin(3.0 * points[:, 0])
    fixed = (points[:, :1] < 1e-9) & np.isin(["x", "y", "z"], list(axes))
    clamp = {} if axes == "xyz" else {"fixed": fixed}
    ours, newton = both(shell_of(points, triangles, poisson, thickness, **clamp), swung(points))
    moved = np.abs(newton.x - points).max()
    assert moved > 0.02
    assert np.abs(ours.x - newton.x).max() < 1e-8 * moved


def test_a_step_is_newtons_where_supports_move():
    points, triangles = sheet(8, 4)
    shell = shell_of(points, triangles)
    shell.motion[shell.fixed[:, 0]] = [0.0, 0.5, 1.0]  # at time 1
    ours, newton = both(shell)
    assert (
        np.abs(newton.x[points[:, 0] < 1e-9] - points[points[:, 0] < 1e-9] - [0.0, 0.015, 0.03]).max() < 1e-12
    )
    assert np.abs(ours.x - newton.x).max() < 1e-9


def test_a_step_is_newtons_where_panels_are_sewn():
    shell = sewn_panels()
    shell.model, shell.load_laws = "projective//", ALWAYS
    shell.clamped_edges = np.zeros(0, dtype=np.int32)
    ours, newton = both(shell, iterations=20000)
    assert np.abs(ours.x - newton.x).max() < 1e-8


def test_it_stops_after_its_iterations_and_says_so():
    points, triangles = sheet(12, 6)
    problem = Problem(shell_of(points, triangles))
    method = LocalGlobal(problem, Options(iterations=7))
    march = March(problem, swung(points), H, 1e-12).run(method.solve, 2)
    assert method.counts.iterations == 14 and method.counts.factorisations == 1
    assert march.outcome.reason.startswith("7 iterations, norm ")
    assert len(method.norms) == 8
    assert method.norms[-1] == (march.outcome.norm, 0.0) and march.outcome.norm > 1e-12 * march.scale


def test_acceleration_takes_half_the_iterations():
    points, triangles = sheet(12, 6)
    counts = []
    for depth in (0, 5):
        problem = Problem(shell_of(points, triangles))
        method = LocalGlobal(problem, Options(iterations=5000, depth=depth))
        March(problem, swung(points), H, 1e-6).run(method.solve, STEPS)
        counts.append(method.counts.iterations)
    assert counts[1] < 0.5 * counts[0]


def test_motions_along_the_normals_take_few_iterations():
    """With A alone a step takes 78: it resists them as it resists stretching."""
    points, triangles = sheet(12, 6)
    problem = Problem(shell_of(points, triangles))
    method = LocalGlobal(problem, Options(iterations=5000))
    March(problem, swung(points), H, 1e-6).run(method.solve, STEPS)
    assert method.counts.iterations < 30 * STEPS


def test_forces_are_split_where_stretching_outweighs_inertia():
    """The second solve is for stiff cloth alone, whatever its mesh."""
    problem = Problem(shell_of(*sheet(12, 6)))
    method = LocalGlobal(problem)
    splits = [method.matrices(problem, step**-2)[1] is not None for step in (H, 0.05 * H)]
    assert splits == [True, False]


def test_iterations_without_acceleration_lower_the_potential():
    """Projections only help, so no step is too long."""
    points, triangles = sheet(12, 6)
    problem = Problem(shell_of(points, triangles, young=1e6 * np.ones(len(triangles))))
    potentials = []
    march = March(problem, 5.0 * swung(points), 0.03)

    def solve(step, y, tolerance):
        for _ in range(15):
            outcome = LocalGlobal(step, Options(iterations=1, depth=0)).solve(step, y, tolerance)
            potentials.append(step.energy(y))
        return outcome

    march.step(solve)
    assert (np.diff(potentials) < 0.0).all()
