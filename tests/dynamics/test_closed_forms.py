"""Exact motions: layers that start too near, steps by their error, damped modes."""

import numpy as np
import pytest
import scipy.linalg
from moving import cloth, move
from mpi4py import MPI
from test_problem import sheet

from voile.contact.motion import Spell
from voile.problem.contact import shell_layers, with_obstacles
from voile.problem.damping import Damping
from voile.problem.problem import Problem
from voile.solver.path_in_time import TimeOptions
from voile.solver.stepping.newton_step import NewtonStep
from voile.solver.stepping.schemes import ImplicitEuler, SchemeOptions
from voile.solver.stepping.time_path import Stepper, start_path

G = 9.81


@pytest.mark.parametrize("apart", [*(pytest.param(a, marks=pytest.mark.slow) for a in (1.0, 0.5)), 0.2])
def test_layers_that_start_too_near_slide_as_friction_says(apart):
    """A sheet on a held one slows down by mu g and stops, at the distance (thicknesses) at which it starts, over all
    triangles that it comes to."""
    lower, triangles = sheet(8, 4, 0.4, 0.2)
    upper, corners = sheet(2, 2, 0.07, 0.07)
    n, height, mu, speed, h = len(lower), apart * 1e-3, 0.3, 0.4, 2e-3
    points = np.concatenate([lower, upper + np.array([0.113, 0.061, height])])
    shell = cloth(points, np.concatenate([triangles, corners + n]), np.arange(n))
    layers = shell_layers(shell, 5e-4, mu)
    layers.keeps = True
    problem = with_obstacles(Problem(shell, MPI.COMM_SELF), [], 5e-4, layers).at(0.0)
    velocity = np.where((np.arange(len(points)) < n)[:, None], 0.0, [speed, 0.0, 0.0])
    path, seen = start_path(problem, velocity[problem.part.vertex]), []
    moves = problem.part.vertex >= n

    def see(step, path):
        k = path.kinematics
        seen.append((step.time, k.positions[moves], k.velocity[moves]))

    Stepper(problem, TimeOptions(ImplicitEuler(), h, 0.15, 1e-9), NewtonStep(problem), path).follow(see)
    for t, x, v in seen:
        np.testing.assert_allclose(x[:, 2], height, rtol=0.0, atol=1e-12)
        exact = max(speed - mu * G * t, 0.0)
        np.testing.assert_allclose(v, np.tile([exact, 0.0, 0.0], (len(v), 1)), rtol=0.0, atol=1e-9)
    way = seen[-1][1][:, 0] - upper[problem.part.vertex[moves] - n, 0] - 0.113
    np.testing.assert_allclose(way, speed**2 / (2.0 * mu * G), rtol=0.0, atol=0.51 * speed * h)
    assert way.min() > 0.02  # of the 0.05 of a cell


def test_supports_take_along_the_layer_that_they_would_pass_in_a_step():
    """A held sheet that rises by four gaps a step meets a free one, which goes on as fast, a thickness above it."""
    lower, triangles = sheet(4, 4, 0.2, 0.2)
    upper, corners = sheet(2, 2, 0.07, 0.07)
    n, speed, end = len(lower), 20.0, 3e-3
    points = np.concatenate([lower, upper + np.array([0.063, 0.061, 0.005])])
    moves = ((np.arange(n), Spell(displacement=np.array([0.0, 0.0, speed * end]), end=end)),)
    all_triangles = np.concatenate([triangles, corners + n])
    shell = cloth(points, all_triangles, np.arange(n), gravity=np.zeros(3), moves=moves)
    problem = with_obstacles(Problem(shell, MPI.COMM_SELF), [], 5e-4, shell_layers(shell, 5e-4, 0.3)).at(0.0)
    path = start_path(problem, np.zeros_like(points))
    Stepper(problem, TimeOptions(ImplicitEuler(), 1e-3, end, 1e-9), NewtonStep(problem), path).follow()
    free = problem.part.vertex >= n
    assert path.converged and path.count < 30
    np.testing.assert_allclose(path.kinematics.positions[free, 2], speed * end + 1e-3, rtol=0.0, atol=1e-10)
    np.testing.assert_allclose(path.kinematics.velocity[free], [[0.0, 0.0, speed]] * free.sum(), atol=1e-6)


@pytest.mark.parametrize(
    ("scheme", "order"), [("implicit-euler", 1), ("bdf2", 2), ("generalized-alpha", 2), ("moreau-jean", 2)]
)
def test_errors_follow_the_accuracy_of_adaptive_steps(scheme, order):
    """Flight slowed by mass damping, v = v0 exp(-r t): as many steps as accuracy^(-1/(p + 1)), so errors of
    accuracy^(p/(p + 1)), and none above the sum of all local ones, for damping makes none larger."""
    points, triangles = sheet(2, 2)
    rate, speed, end, size = 4.0, np.array([1.0, 0.0, 0.5]), 1.0, np.hypot(*np.ptp(points, axis=0)[:2])
    shell = cloth(points, triangles, gravity=np.zeros(3))
    away, counts = [], []
    asked = SchemeOptions(theta=0.5)
    for accuracy in np.array([1e-3, 1e-4, 1e-5]) * 100.0 ** (1 - order):
        run = move(shell, scheme, 0.5, end, speed, damping=Damping(mass=rate), accuracy=accuracy, asked=asked)
        assert run.path.converged
        exact = points[run.problem.part.vertex] + speed / rate * (1.0 - np.exp(-rate * end))
        away.append(np.abs(run.end - exact).max())
        counts.append(run.path.count)
        assert away[-1] < counts[-1] * accuracy * size
    for (fine, coarse), power in ((away[::-2], order), (counts[::2], 1)):
        assert np.log10(coarse / fine) / 2.0 == pytest.approx(power / (order + 1), rel=0.15)


@pytest.mark.parametrize("zeta", [0.05, pytest.param(0.5, marks=pytest.mark.slow), 2.0])
@pytest.mark.parametrize(
    ("scheme", "theta"), [("implicit-euler", 1.0), ("generalized-alpha", 1.0), ("moreau-jean", 0.5)]
)
def test_stiffness_damping_fades_a_mode_by_half_its_frequency_squared(scheme, theta, zeta):
    """An eigenmode of the mesh: q'' + beta omega^2 q' + omega^2 q = 0, zeta = beta omega / 2; kicked, and overdamped at
    2. First order in the step."""
    points, triangles = sheet(4, 1, 0.4, 0.1)
    held = np.flatnonzero(points[:, 0] < 1e-9)
    shell = cloth(points, triangles, held, gravity=np.zeros(3), poisson=0.0, model="koiter/average/stvk")
    problem = Problem(shell, MPI.COMM_SELF)
    y, tangent = problem.create_vector(), problem.create_matrix()
    problem.tangent(y, tangent)
    stiffness, mass = (m.convert("dense").getDenseArray() for m in (tangent, problem.mass_matrix()))
    squares, modes = scipy.linalg.eigh(stiffness, mass)
    y.array[:] = modes[:, -1]  # the stiffest
    shape, omega = problem.motion(y), np.sqrt(squares[-1])
    m, beta = problem.vertex_mass(), 2.0 * zeta / omega
    kick = np.zeros_like(shape)
    kick[problem.part.vertex] = 1e-6 * shape / np.abs(shape).max()
    roots = omega * (-zeta + np.array([1.0, -1.0]) * np.sqrt(complex(zeta**2 - 1.0)))
    away = []
    for steps in (50, 100):
        end = 3.0 / omega
        asked = SchemeOptions(theta=theta, spectral_radius=0.8)
        run = move(
            shell,
            scheme,
            end / steps,
            end,
            kick,
            tolerance=1e-10,
            asked=asked,
            damping=Damping(stiffness=beta),
        )
        u = np.array(run.positions) - points[run.problem.part.vertex]
        q = np.einsum("n,kni,ni->k", m, u, shape) * np.abs(shape).max() / 1e-6
        t = np.array(run.times)
        exact = ((np.exp(roots[0] * t) - np.exp(roots[1] * t)) / (roots[0] - roots[1])).real
        away.append(np.abs(q - exact).max() / np.abs(exact).max())
    bound = 0.06 if scheme == "implicit-euler" else 0.015
    assert away[0] < bound and np.log2(away[0] / away[1]) > 0.8
