"""Natural frequencies and buckling loads against closed forms and methods that share nothing with the program: rates of
order 2 and absolute bounds at stated meshes."""

import numpy as np
import pytest
import vibrating
from mpi4py import MPI
from scipy.special import jn_zeros
from vibrating import THICKNESS, UNIT, YOUNG, factors, modes, omegas

from voile.contact.obstacles import Plane
from voile.problem.contact import contact_fields, with_obstacles
from voile.problem.problem import Problem
from voile.solver.linear import Counts
from voile.solver.modes import vibrations
from voile.solver.path import StaticsOptions, require
from voile.solver.statics import solve_statics

# Leissa 1973, Barton 1951 (beam functions, upper bounds): up to 1 % above converged values.
LEISSA = {
    "cantilever": [3.492, 8.525, 21.43, 27.33, 31.11, 54.44],
    "free": [13.49, 19.79, 24.43, 35.02, 35.02],
}
DISC = np.array([3.19622, 4.61090, 4.61090, 5.90568, 5.90568, 6.30644, 7.14353, 7.14353]) ** 2  # Leissa 1969
BEAM = np.sqrt(YOUNG * THICKNESS**2 / 12.0 / vibrating.DENSITY)


def check(found: list, reference, bound: float, rate: float = 1.85) -> None:
    """Relative errors at the finest mesh, the order that the last two show, the second of half the size, and what they
    extrapolate to: stiffness or mass 1 % off would show there."""
    coarse, fine = (np.asarray(f) / reference - 1.0 for f in found[-2:])
    assert np.abs(fine).max() < bound, fine
    assert np.log2(np.abs(coarse / fine)).min() > rate, (coarse, fine)
    assert np.abs(fine + (fine - coarse) / 3.0).max() < 0.001, (coarse, fine)


@pytest.mark.parametrize("held", ["cantilever", "free"])
def test_square_plate(held):
    rigid = 6 if held == "free" else 0
    count = len(LEISSA[held])
    reference = vibrating.ritz(held, rigid // 2 + count)[rigid // 2 :]
    found = [omegas(vibrating.plate(n, held)[0], rigid + count) / UNIT for n in (24, 48)]
    assert all((f[:rigid] == 0.0).all() for f in found)
    check([f[rigid:] for f in found], reference, 0.005)
    np.testing.assert_allclose(found[-1][rigid:], LEISSA[held], rtol=0.013)


def test_the_quoted_plates_are_upper_bounds():
    """Ritz's method, an upper bound itself, comes out below them."""
    for held, quoted in LEISSA.items():
        skip = 3 if held == "free" else 0  # out of plane
        ritz = vibrating.ritz(held, skip + len(quoted))[skip:]
        assert (ritz < quoted).all()
        np.testing.assert_allclose(ritz, quoted, rtol=0.011)


def test_simply_supported_plate():
    reference = np.pi**2 * np.array([2, 5, 5, 8, 10, 10])
    found = [omegas(vibrating.plate(n, "supported")[0], 6) / UNIT for n in (32, 64)]
    check(found, reference, 0.005)


def test_clamped_disc():
    check([omegas(vibrating.clamped_disc(size), 8) / UNIT for size in (0.05, 0.025)], DISC, 0.006)


@pytest.mark.parametrize(
    ("held", "reference"),
    [
        ("pinned", (np.pi * np.arange(1, 4)) ** 2),
        ("clamped-free", [3.51602, 22.0345, 61.6972]),
        ("clamped", [22.3733, 61.6728, 120.9034]),
    ],
)
def test_beams(held, reference):
    check([omegas(vibrating.beam(n, held), 3) / BEAM for n in (40, 80)], reference, 0.004)


def test_hanging_chain():
    """The strip swings as a chain; it also turns about its length, which is left out here."""
    reference, found = jn_zeros(0, 3) / 2.0 * np.sqrt(9.81), []
    for n in (20, 40, 80):
        shell = vibrating.hanging_chain(n)
        m, order = modes(shell, 8), np.lexsort((shell.points[:, 1], shell.points[:, 2]))
        sides = [shape[order, 0].reshape(n + 1, 2) for shape in m.shapes]
        swings = [s[:, 0] @ s[:, 1] > 0.0 for s in sides]
        found.append(2.0 * np.pi * m.frequencies[swings][:3])
    check(found, reference, 0.004)


def test_stretched_membrane():
    strain = 1e-5
    reference = np.pi * np.sqrt(strain * YOUNG / vibrating.DENSITY * np.array([2, 5, 5, 8]))
    check([omegas(vibrating.stretched(n, strain), 4) for n in (24, 48)], reference, 0.002)


def test_membrane_under_pressure():
    reference = vibrating.arc_omegas(0.8, 4, 1e-6 * YOUNG * 1e-3, vibrating.DENSITY * 1e-3)
    check([omegas(vibrating.blown_arc(n), 4) for n in (40, 80)], reference, 0.003)


# ---- contact ----


@pytest.mark.parametrize(("friction", "held"), [(0.0, [2]), (100.0, [0, 1, 2])])
def test_contacts_hold_what_sticks_and_let_slide_what_slips(friction, held):
    """A cantilever whose tip lies on a plane has the modes of one whose tip supports hold there. It pulls at the tip as
    it sinks: only much friction holds that."""
    shell = vibrating.resting_strip()
    problem = Problem(shell, MPI.COMM_SELF)
    plane = Plane(point=np.array([0.0, 0.0, -0.05]), normal=np.array([0.0, 0.0, 1.0]), friction=friction)
    on_plane = with_obstacles(problem, [plane], 0.0)
    y = require(solve_statics(on_plane, StaticsOptions(load_steps=20))).state
    state = contact_fields(on_plane, y)["contact"]
    touching = state == (1 if friction else 2)
    assert touching.any() and not (state == (2 if friction else 1)).any()
    found = vibrations(on_plane, y, 4, Counts())
    tip = vibrating.held_at(shell, problem, y, touching, held)
    np.testing.assert_allclose(2.0 * np.pi * found.frequencies, omegas(tip, 4), rtol=1e-4)


# ---- buckling ----


@pytest.mark.parametrize(
    ("length", "cells"), [(1.0, 52), pytest.param(1.5, 40, marks=pytest.mark.slow), (2.0, 40)]
)
def test_pushed_plate(length, cells):
    ratio = np.array([i / length + length / i for i in (1, 2, 3)])
    reference = np.pi**2 * vibrating.BENDING * np.sort(ratio**2)[:2]
    check([factors(vibrating.pushed_plate(n, length), 2) for n in (cells // 2, cells)], reference, 0.005)


def test_supports_that_move_push_alike():
    pushed = vibrating.pushed_plate(16, 1.0)
    np.testing.assert_allclose(factors(vibrating.moved_plate(16), 4), factors(pushed, 4), rtol=1e-6)


def test_pushed_cylinder():
    """Donnell's equations neglect a share of the order of the waves' number around, some per cent here."""
    found = factors(vibrating.pushed_cylinder(120, 20, 1.0, 0.02), 4)
    np.testing.assert_allclose(found, vibrating.donnell(1.0, 0.02), rtol=0.02)


@pytest.mark.parametrize("poisson", [0.0, 0.3])
def test_lateral_buckling_under_own_weight(poisson):
    """Narrow strips: 12.85376 sqrt(2 / (1 + nu)); the plate's correction falls with its width."""
    slender = 12.85376 * np.sqrt(2.0 / (1.0 + poisson))
    found = [vibrating.own_weight(b, 50.0, round(4 / b), 4, poisson) for b in (0.05, 0.025)]
    assert abs(found[-1] / slender - 1.0) < 0.015
    assert abs((2.0 * found[-1] - found[-2]) / slender - 1.0) < 0.002


def test_lateral_buckling_under_a_tip_load():
    found = [vibrating.tip_load(b, 50.0, round(4 / b), 4) for b in (0.05, 0.025)]
    assert abs(found[-1] / 4.013 - 1.0) < 0.01
    assert abs((2.0 * found[-1] - found[-2]) / 4.013 - 1.0) < 0.002
