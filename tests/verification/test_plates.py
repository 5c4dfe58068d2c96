"""Plates against closed forms: absolute bounds at stated meshes, observed rates, the limit of small slopes."""

import numpy as np
import pytest
from shapes import (
    field_energy_refined,
    long_plate_refined,
    long_plate_sag,
    plate_refined,
    small_slopes,
    small_slopes_energy,
    square_plate,
)
from shells import rates, solve

SIZES = [4.0, 2.0, 1.0]


@pytest.mark.parametrize("clamped, bound", [(False, 0.002), (True, 0.006)])
def test_square_plate(clamped, bound):
    rows = plate_refined(clamped)
    assert rows[-1].error < bound
    assert min(rates(rows, SIZES)) > 1.9


@pytest.mark.parametrize("diagonals", ["alternating", "right"])
def test_square_plate_on_other_diagonals(diagonals):
    shell, centre, scale = square_plate(32, False, diagonals)
    assert abs(-solve(shell, 1).u[centre, 2] / (0.00406235 * scale) - 1.0) < 0.004


@pytest.mark.slow
@pytest.mark.parametrize("clamped", [False, True])
def test_square_plate_on_fine_meshes(clamped):
    rows = plate_refined(clamped, meshes=(32, 64, 128))
    assert rows[-1].error < (0.0002 if not clamped else 0.001)
    assert min(rates(rows, SIZES)) > 1.9


def test_the_long_plates_reference_has_the_linear_limit():
    assert abs(long_plate_sag(1.0) * 384.0 - 1.0) < 1e-4  # q l^4 / (384 D)


def test_long_plate_bends_and_stretches():
    rows = long_plate_refined()
    assert rows[-1].error < 0.001
    assert min(rates(rows, SIZES)) > 1.9


def test_koiter_reduces_to_foppl_von_karman():
    """Sag over thickness at a fixed load q / (D h) departs from its limit as the square of the slopes."""
    rows = small_slopes()
    assert rows[-1].error < 0.001
    assert min(rates(rows, SIZES)) > 1.8


def test_koiters_energy_reduces_to_foppl_von_karmans():
    rows = small_slopes_energy()
    assert rows[-1].error < 0.002
    assert min(rates(rows, SIZES)) > 1.8


def test_the_limit_of_koiters_energy_is_foppl_von_karmans():
    rows = field_energy_refined()
    assert rows[-1].error < 0.001
    assert min(rates(rows, SIZES)) > 1.7
    assert np.isfinite(rows[-1].computed)
