"""Schemes of second order on stiff cloth that moves far: the elastic force's mean over the step keeps the energy."""

import numpy as np
import pytest
from moving import cloth, move
from mpi4py import MPI
from scipy.integrate import solve_ivp
from test_problem import sheet

from voile.problem.damping import Air, Damping
from voile.problem.mean import mean_nodes
from voile.problem.problem import Problem
from voile.solver.stepping.forces import StepForces
from voile.solver.stepping.schemes import SCHEMES, SchemeOptions
from voile.solver.stepping.time_path import start_kinematics

POINTS, TRIANGLES = sheet(6, 5, 0.5, 0.4)
LEFT = np.flatnonzero(POINTS[:, 0] < 1e-9)


@pytest.mark.parametrize("share", [1.0, 0.9, 0.3])
def test_two_places_are_exact_for_cubics(share):
    nodes = mean_nodes(share)
    assert all(0.0 < s <= 1.0 and weight > 0.0 for s, weight in nodes)
    for power in range(4):
        exact = share / (power + 1.0) + 1.0 - share
        assert sum(weight * s**power for s, weight in nodes) == pytest.approx(exact, rel=1e-13)


@pytest.mark.parametrize(("scheme", "theta"), [("generalized-alpha", 1.0), ("moreau-jean", 0.5)])
def test_the_forces_of_a_step_have_a_potential(scheme, theta):
    """With damping and wind, at a shape far from the start: gradient and Hessian."""
    shell = cloth(POINTS, TRIANGLES, LEFT)
    problem, rng = Problem(shell, MPI.COMM_SELF).at(0.0), np.random.default_rng(3)
    y = problem.create_vector()
    k = start_kinematics(problem, y, rng.normal(size=POINTS.shape))
    h = 2e-3
    chosen = SCHEMES[scheme](SchemeOptions(theta=theta))
    given = Damping(0.5, 1e-3), Air(np.array([0.0, 1.0, 2.0]), 0.5)
    forces = StepForces(problem.at(h), chosen, h, problem.point(y), k, *given)
    step = forces.balance(chosen.predict(k, h))
    y.array[:] = 1e-2 * rng.normal(size=len(y.array_r))
    way, f = y.duplicate(), [y.duplicate(), y.duplicate()]
    way.array[:] = rng.normal(size=len(y.array_r))
    matrix, along, e = step.create_matrix(), y.duplicate(), 1e-7
    step.tangent(y, matrix)
    matrix.mult(way, along)
    energy = []
    for side, residual in zip((e, -e), f, strict=True):
        there = y.copy()
        there.axpy(side, way)
        step.residual(there, residual)
        energy.append(step.energy(there))
    change = (f[0] - f[1]) / (2.0 * e)
    assert (change - along).norm() < 1e-6 * along.norm()
    step.residual(y, f[0])
    assert (energy[0] - energy[1]) / (2.0 * e) == pytest.approx(f[0].dot(way), rel=1e-6)


@pytest.mark.parametrize(
    ("scheme", "theta", "model"),
    [
        ("generalized-alpha", 1.0, "koiter/tan/stvk"),
        ("moreau-jean", 0.5, "koiter/tan/stvk"),
        ("moreau-jean", 0.5, "koiter/average/stvk"),
    ],
)
def test_stiff_cloth_that_moves_far_gains_no_energy(scheme, theta, model):
    """500 x 400 mm at 100 MPa in steps of 5 ms, some fifty times what its waves need."""
    swing = 0.5 * np.column_stack([-POINTS[:, 1], POINTS[:, 0], 0.0 * POINTS[:, 0]])
    shell = cloth(POINTS, TRIANGLES, LEFT, young=1e8, model=model)
    run = move(shell, scheme, 5e-3, 0.3, swing, tolerance=1e-6, asked=SchemeOptions(theta=theta))
    books, mass = run.path.books, run.problem.vertex_mass()
    at_start = books.kinetic(start_kinematics(run.problem, run.problem.create_vector(), swing))
    kinetic = np.array([0.5 * mass @ (v**2).sum(axis=1) for v in run.velocities])
    total = kinetic + np.array([sum(step.energies.values()) for step in run.steps])
    largest = kinetic.max()
    assert run.path.converged and largest > 2.0 * at_start
    if scheme == "moreau-jean":
        assert np.abs(total - at_start).max() < 1e-3 * largest
    assert total.max() < at_start + 0.02 * largest


def test_elastic_supports_and_ties_keep_the_energy_too():
    """A sheet that swings on a stiff tie: the length of a bar is no polynomial, and steps turn it by a tenth."""
    count = len(POINTS)
    springs = np.zeros((count, 3))
    springs[LEFT] = 50.0  # N/m
    bars = np.array([[0, count - 1, 40.0, 0.5]])  # ends, N/m, m
    shell = cloth(POINTS, TRIANGLES, springs=springs, bars=bars)
    run = move(shell, "moreau-jean", 1e-2, 0.3, 0.0, asked=SchemeOptions(theta=0.5))
    totals, largest = run.path.books.totals, run.path.books.most
    assert run.path.converged and max(step.energies["springs"] for step in run.steps) > 1e-2 * largest
    assert abs(totals["scheme_dissipated"]) < 2e-3 * largest
    assert abs(run.path.books.error) < 1e-8 * largest


@pytest.mark.parametrize("scheme", ["generalized-alpha", "moreau-jean"])
def test_forces_at_both_ends_strain_no_stiff_strip_that_swings(scheme):
    """A pendulum of 20 steps: its angle a obeys I a'' = S g cos a; means of the force let its end drop 28 % short."""
    points, triangles = sheet(6, 1, 0.3, 0.05)
    shell = cloth(points, triangles, young=1e9, model="koiter/average/stvk")
    shell.fixed[points[:, 0] < 1e-9] = True
    mass = Problem(shell, MPI.COMM_SELF).vertex_mass()
    ratio = 9.81 * (mass @ points[:, 0]) / (mass @ points[:, 0] ** 2)
    way = solve_ivp(lambda t, y: [y[1], ratio * np.cos(y[0])], (0.0, 0.2), [0.0, 0.0], rtol=1e-9, atol=1e-12)
    exact, tip = -0.3 * np.sin(way.y[0, -1]), int(np.argmax(points[:, 0]))
    asked = SchemeOptions(theta=0.5, keeps="nothing")
    errors = []
    for h in (1e-2, 5e-3):
        run = move(shell, scheme, h, 0.2, asked=asked)
        errors.append(abs(run.end[tip, 2] / exact - 1.0))
        assert run.path.converged and abs(run.path.books.error) < 1e-10 * run.path.books.most
    assert errors[0] < 5e-3 and errors[1] < 0.35 * errors[0]
