"""Strips against the elastica, the catenary and the lateral buckling load: absolute bounds, observed rates."""

import numpy as np
import pytest
from mpi4py import MPI
from shapes import (
    CANTILEVER,
    END_SHEAR,
    LATERAL,
    buckling_load,
    buckling_refined,
    cantilever_refined,
    cantilever_row,
    catenary_refined,
    hanging_strip,
    heavy_strip,
    roll_refined,
    rolled_strip,
    shear_refined,
    shear_rows,
    standing_strip,
    tip_of,
)
from shells import rates, solve

from voile.problem.problem import Problem
from voile.validate.references.elastica import cantilever as elastica

SIZES = [4.0, 2.0, 1.0]


def test_the_stored_elasticas_solve_their_equations():
    for gamma, ratio in CANTILEVER.items():
        found = elastica(gamma, heavy=True)
        assert abs(found.drop / found.reach / ratio - 1.0) < 1e-7, gamma
    for alpha, (shortening, deflection) in END_SHEAR.items():
        found = elastica(alpha, heavy=False)
        assert abs(1.0 - found.reach - shortening) < 1e-8 and abs(found.drop - deflection) < 1e-8, alpha


@pytest.mark.parametrize("gamma", CANTILEVER)
def test_heavy_cantilever(gamma):
    assert cantilever_row(gamma).error < (0.001 if gamma <= 200 else 0.002)


def test_heavy_cantilever_converges():
    rows = cantilever_refined()
    assert rows[-1].error < 2e-4
    assert min(rates(rows, SIZES)) > 1.9


@pytest.mark.parametrize("bending", ["sin", "theta"])
def test_heavy_cantilever_of_other_variants(bending):
    x = tip_of(*heavy_strip(10.0, 80, 4, bending))
    assert abs(-x[2] / x[0] / CANTILEVER[10.0] - 1.0) < 5e-4


@pytest.mark.parametrize("alpha", END_SHEAR)
def test_end_shear(alpha):
    for found in shear_rows(alpha):
        assert found.error < 0.001, found


def test_end_shear_converges():
    rows = shear_refined()
    assert rows[-1].error < 5e-5
    assert min(rates(rows, SIZES)) > 1.9


@pytest.mark.parametrize("turns, bound, rate", [(0.5, 6e-4, 1.9), (1.0, 2e-3, 1.9), (1.5, 4e-3, 1.8)])
def test_roll_up(turns, bound, rate):
    """A positive moment rolls towards the normal: half a turn ends above the clamp, a whole one at it."""
    rows = roll_refined(turns)
    assert rows[-1].error < bound
    assert min(rates(rows, SIZES)) > rate


def test_the_tangent_of_end_moments_is_the_derivative_of_their_forces():
    shell, _ = rolled_strip(1.0, 4, 2)
    shell.young[:] = 1e-3  # leaves the moments alone
    problem = Problem(shell, MPI.COMM_SELF)
    problem = problem.at(0.7)
    rng = np.random.default_rng(0)
    y, along, symmetric, skew = (problem.create_vector() for _ in range(4))
    y.array, along.array = 0.02 * rng.standard_normal((2, y.size))
    tangent = problem.create_matrix()
    problem.tangent(y, tangent)
    tangent.mult(along, symmetric)
    problem.add_skew(along, skew)
    assert skew.norm() > 0.1 * symmetric.norm()

    def residual(h: float) -> np.ndarray:
        f = problem.create_vector()
        problem.residual(y + h * along, f)
        return f.array

    left = [np.linalg.norm(residual(h) - residual(0.0) - h * (symmetric + skew).array) for h in (0.02, 0.01)]
    assert np.log2(left[0] / left[1]) > 1.9


def test_the_rolled_strip_is_stable_and_not_stretched():
    shell, _ = rolled_strip(1.0, 40, 2)
    solution = solve(shell)
    assert solution.path.stable
    bending = 0.5 * (2.0 * np.pi) ** 2 * 1e6 * 1e-6 / 12.0 * 0.05  # B b / (2 R^2) L
    energies = solution.path.steps[-1].energies
    assert abs(energies["bending"] / bending - 1.0) < 0.02
    assert energies["stretching"] < 0.01 * bending


def test_hanging_strip_is_a_catenary():
    rows = catenary_refined()
    assert rows[-1].error < 5e-4
    assert min(rates(rows, SIZES)) > 1.9


def test_hanging_strip_follows_the_whole_catenary():
    span = 0.8
    shell, _ = hanging_strip(80, span)
    solution = solve(shell, 1)
    assert solution.path.stable
    x = shell.points + solution.u
    a = np.linspace(0.2, 1.0, 100001)
    a = a[np.argmin(np.abs(2 * a * np.sinh(span / 2 / a) - 1.0))]
    curve = a * (np.cosh((x[:, 0] - span / 2) / a) - np.cosh(span / 2 / a))
    assert np.abs(x[:, 2] - curve).max() < 2e-4


def test_lateral_buckling_load():
    """The excess over the beam's load is the clamp's hold on warping: it falls with b/L."""
    rows = buckling_refined()
    assert rows[-1].error < 0.015
    assert min(rates(rows, SIZES)) > 0.9
    limit = 2.0 * rows[-1].computed - rows[-2].computed
    assert abs(limit / LATERAL - 1.0) < 0.002


@pytest.mark.parametrize("height, nx, thin, load", [(0.1, 20, 20.0, 1.2), (0.05, 40, 50.0, 1.5)])
def test_a_strip_past_its_buckling_load_ends_bent_and_stable(height, nx, thin, load):
    critical = buckling_load(height, nx, 2)
    straight = solve(standing_strip(0.9 * critical, height, nx, 2, thin)[0], 1)
    assert straight.path.stable and np.abs(straight.u[:, 2]).max() < 1e-15
    buckled = solve(standing_strip(load * critical, height, nx, 2, thin)[0], 1)
    assert buckled.path.stable and np.abs(buckled.u[:, 2]).max() > 0.05
