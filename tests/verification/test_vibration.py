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
SUPPORTED = (2.0 * np.pi**2, 5.0 * np.pi**2, 8.0 * np.pi**2)  # simply supported square plate
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


def strongest(signal: np.ndarray, step: float) -> float:
    """The frequency (rad/s) with the largest amplitude: a mesh that is not symmetric mixes all modes a little."""
    found = frequencies(signal, step, 6)
    t = step * np.arange(len(signal))[:, None]
    waves = np.linalg.lstsq(np.hstack([np.cos(found * t), np.sin(found * t)]), signal, rcond=None)[0]
    return float(found[np.argmax(np.hypot(*waves.reshape(2, -1)))])


def supported(cells: int) -> np.ndarray:
    """lambda^2 of three modes of a simply supported square plate: alike along both diagonals, opposite along one, and
    opposite along both sides."""
    points, triangles = sheet(cells, cells, 1.0, 1.0)
    x, y = points[:, 0], points[:, 1]
    rim = (np.minimum(x, y) < 1e-9) | (np.maximum(x, y) > 1.0 - 1e-9)
    fixed = np.broadcast_to(rim[:, None], points.shape).copy()
    period = 2.0 * np.pi / (SUPPORTED[2] * UNIT)
    kick = np.zeros_like(points)
    modes = [np.sin(m * np.pi * x) * np.sin(n * np.pi * y) for m, n in ((1, 1), (1, 2), (2, 2))]
    kick[:, 2] = 1e-4 * (modes[0] + modes[1] + modes[2])  # m/s
    fabric = {"young": YOUNG, "poisson": POISSON, "thickness": THICKNESS, "density": DENSITY}
    shell = cloth(points, triangles, fixed=fixed, gravity=np.zeros(3), **fabric)
    scheme = SchemeOptions(spectral_radius=0.9)
    run = move(shell, "generalized-alpha", period / 40.0, 8.0 * period, kick, tolerance=1e-6, asked=scheme)
    assert run.path.converged
    spots = [(0.25, 0.25), (0.75, 0.25), (0.25, 0.75), (0.75, 0.75)]
    at = [int(np.argmin((x - a) ** 2 + (y - b) ** 2)) for a, b in spots]
    z = np.array([positions[at, 2] for positions in run.positions])[::2]
    signals = z @ np.array([[1, 1, 1, 1], [1, 1, -1, -1], [1, -1, -1, 1]]).T  # (1,1), (1,2), (2,2)
    return np.array([strongest(signal, period / 20.0) for signal in signals.T]) / UNIT


def test_a_simply_supported_plate_sings_its_modes():
    """lambda^2 = pi^2 (m^2 + n^2), Navier's plate."""
    coarse, fine = supported(8), supported(16)
    found = fine + (fine - coarse) / 3.0
    np.testing.assert_allclose(fine, SUPPORTED, rtol=0.05)
    np.testing.assert_allclose(found, SUPPORTED, rtol=0.01)
