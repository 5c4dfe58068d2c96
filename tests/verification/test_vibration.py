"""Natural frequencies from time signals, beside those of plate theory."""

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.append(str(Path(__file__).parents[1] / "dynamics"))
from moving import cloth, move
from test_problem import sheet

from voile.solver.stepping.schemes import SchemeOptions

LEISSA = (3.492, 8.525, 21.43)  # cantilever square plate, nu = 0.3
YOUNG, POISSON, THICKNESS, DENSITY = 1e9, 0.3, 0.01, 1000.0
UNIT = np.sqrt(YOUNG * THICKNESS**2 / (12.0 * (1.0 - POISSON**2) * DENSITY))  # rad/s for lambda^2 = 1


def frequencies(signal: np.ndarray, step: float, order: int = 10) -> np.ndarray:
    """Those (rad/s) in a sum of at most `order` exponentials, ascending: matrix pencil (Hua & Sarkar 1990)."""
    rows = np.lib.stride_tricks.sliding_window_view(signal, len(signal) // 2 + 1)
    basis = np.linalg.svd(rows, full_matrices=False)[2][:order]
    shift = np.linalg.lstsq(basis[:, :-1].T, basis[:, 1:].T, rcond=None)[0]
    found = np.sort(np.log(np.linalg.eigvals(shift)).imag) / step
    return found[found > 0.0]


def cantilever(cells: int) -> np.ndarray:
    """lambda^2 of the first two modes that are alike at both free corners, the first of those that are opposite."""
    points, triangles = sheet(cells, cells, 1.0, 1.0)
    x, y = points[:, 0], points[:, 1]
    period = 2.0 * np.pi / (LEISSA[2] * UNIT)
    kick = np.zeros_like(points)
    kick[:, 2] = 1e-4 * (x**2 * (2.0 * y) - 3.0 * x**3)  # m/s, excites all three
    fabric = {"young": YOUNG, "poisson": POISSON, "thickness": THICKNESS, "density": DENSITY}
    shell = cloth(points, triangles, np.flatnonzero(x < 1e-9), gravity=np.zeros(3), **fabric)
    run = move(
        shell,
        "generalized-alpha",
        period / 40.0,
        12.0 * period,
        velocity=kick,
        tolerance=1e-6,
        asked=SchemeOptions(spectral_radius=0.9),
    )
    assert run.path.converged
    corner = [np.flatnonzero((x > 1.0 - 1e-9) & (np.abs(y - side) < 1e-9))[0] for side in (0.0, 1.0)]
    z = np.array([positions[corner, 2] for positions in run.positions])[::2]
    alike, opposite = (frequencies(s, period / 20.0) for s in (z.sum(axis=1), z[:, 0] - z[:, 1]))
    return np.array([alike[0], opposite[0], alike[1]]) / UNIT


@pytest.mark.slow
def test_a_cantilever_plate_sings_its_modes():
    coarse, fine = cantilever(12), cantilever(24)
    found = fine + (fine - coarse) / 3.0  # lumped masses: second order in the mesh
    np.testing.assert_allclose(fine, LEISSA, rtol=0.03)
    np.testing.assert_allclose(found, LEISSA, rtol=0.01)
