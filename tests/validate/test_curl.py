"""The hanging rod that `voile validate bend-twist` stands on, beside closed forms."""

import numpy as np
import pytest
from scipy.optimize import brentq

from voile.errors import NotConverged
from voile.validate.references import curl

N = 400
MIDDLE = (np.arange(N) + 0.5) / N
HARD, TORSION = 0.7, 1.3


def held(*places: tuple[int, int]) -> np.ndarray:
    mask = np.zeros((N + 1, 2), bool)
    mask[tuple(zip(*places, strict=True))] = True
    return mask


def test_a_heavy_cantilever_on_edge_buckles_at_its_published_weight():
    """12.85376 sqrt(EI GJ) / L^3, from a zero of J_-1/6 (Timoshenko & Gere 1961); level, rigid in its plane."""
    clamp, level = held((0, 0), (0, 1)), np.full(N + 1, 0.5 * np.pi)

    def softest(weight):
        arm = 1.0 - MIDDLE
        return curl.softest(level, -0.5 * weight * arm**2, weight * arm, HARD, TORSION, clamp)

    assert brentq(softest, 5.0, 20.0) == pytest.approx(12.85376 * np.sqrt(HARD * TORSION), rel=3e-5)


def test_a_curved_bar_buckles_at_its_published_moment():
    """End moments, ends that turn but do not twist, sin(pi s) and cos(pi s) (Timoshenko & Gere 1961, 7.6)."""
    curvature, ends = 1.2, held((0, 1), (-1, 1))
    sum_, difference = (HARD + TORSION) * curvature / 2.0, (HARD - TORSION) * curvature / 2.0
    exact = sum_ - np.hypot(difference, np.pi * np.sqrt(HARD * TORSION))

    def softest(moment):
        angle = curvature * np.linspace(0.0, 1.0, N + 1)
        return curl.softest(angle, np.full(N, moment), np.zeros(N), HARD, TORSION, ends)

    assert brentq(softest, 1.5 * exact, 0.5 * exact) == pytest.approx(exact, rel=1e-4)


def test_a_planar_curl_without_weight_is_a_circle_and_long_ones_differ_by_their_length_alone():
    angle, curvature = curl.planar(0.0, 3.0)(MIDDLE)
    assert angle == pytest.approx(3.0 * MIDDLE, abs=1e-7) and curvature == pytest.approx(3.0, abs=1e-7)
    # What twists is near the free end, whose length is (B / w)^(1/3): isotropic, nu = 0.5.
    light, heavy = (curl.critical(weight, 1.0, 2.0 / 3.0) / np.cbrt(weight) for weight in (1e3, 2e3))
    assert heavy == pytest.approx(light, rel=1e-3) and 1.60 < heavy < 1.62


def test_a_rod_stiff_against_twist_stays_in_its_plane():
    with pytest.raises(NotConverged, match="stays in its plane"):
        curl.critical(50.0, 400.0, 2.0)
