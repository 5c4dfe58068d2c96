"""Parameters from observed equilibria: exact data, noisy data, and data that cannot tell."""

import numpy as np
import pytest
from inverse_shells import hanging_sheet
from mpi4py import MPI

from voile.errors import InputError
from voile.inverse.estimate import Estimation
from voile.problem.discrete import Problem
from voile.solver.path import StaticsOptions, require
from voile.solver.statics import solve_statics

YOUNG = 2e8


@pytest.fixture(scope="module")
def observed():
    """A sheet draped with YOUNG, and its rest shape."""
    shape = hanging_sheet(young=YOUNG)
    problem = Problem(shape, MPI.COMM_SELF)
    path = require(solve_statics(problem, StaticsOptions(tolerance=1e-12)))
    return shape.points, problem.positions(path.state)


def estimation(observed, names, noise=0.0, seed=0, **guess):
    rest, points = observed
    shape = hanging_sheet(**{"young": YOUNG, **guess})
    size = np.linalg.norm(np.ptp(points, axis=0))
    disturbance = noise * size * np.random.default_rng(seed).standard_normal(points.shape)
    shape.points = points + disturbance * ~shape.fixed
    shape.rest_points = rest
    return Estimation(Problem(shape, MPI.COMM_SELF), names)


@pytest.mark.parametrize(
    ("name", "guess", "exact"),
    [
        ("young", 10 * YOUNG, YOUNG),
        ("young", 0.3 * YOUNG, YOUNG),
        ("density", 600.0, 300.0),
        ("thickness", 2e-3, 1e-3),
    ],
)
def test_exact_drape_gives_back_each_parameter(observed, name, guess, exact):
    found = estimation(observed, (name,), **{name: guess}).solve()
    assert found.values[name] == pytest.approx(exact, rel=1e-6)
    assert found.deviations[name] < 1e-4 * exact and found.misfit < 1e-9


def test_noise_leaves_the_estimate_within_its_own_deviation(observed):
    """Over several seeds the error over the predicted deviation is that of a unit normal variable."""
    ratios = []
    for seed in range(6):
        found = estimation(observed, ("young",), noise=1e-3, seed=seed, young=2 * YOUNG).solve()
        ratios.append((found.values["young"] - YOUNG) / found.deviations["young"])
        assert found.deviations["young"] < 0.05 * YOUNG
    assert np.sqrt(np.mean(np.square(ratios))) < 2.0
    assert np.abs(ratios).max() < 3.0


def test_two_parameters_that_leave_different_traces_are_both_found(observed):
    found = estimation(observed, ("young", "thickness"), young=1.5 * YOUNG, thickness=0.9e-3).solve()
    assert found.values["young"] == pytest.approx(YOUNG, rel=1e-3)
    assert found.values["thickness"] == pytest.approx(1e-3, rel=1e-3)


def test_modulus_and_density_scale_together_and_are_refused(observed):
    with pytest.raises(InputError, match="cannot tell young and density apart"):
        estimation(observed, ("young", "density"), young=3 * YOUNG).solve()
