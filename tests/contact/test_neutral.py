"""Rings between frictionless plates: nothing says where they stand, and without loads only strain presses them."""

import numpy as np
import pytest

import voile

RADIUS = 0.1


def ring(around=48, across=4, width=0.05, outline=None):
    """A tube about y, its outline (around, 2) by default a circle's."""
    angle = 2.0 * np.pi * np.arange(around) / around
    x, z = (RADIUS * np.array([np.cos(angle), np.sin(angle)])) if outline is None else outline.T
    points = [np.column_stack([x, np.full(around, width * j / across), z]) for j in range(across + 1)]
    triangles = []
    for j in range(across):
        for i in range(around):
            a, b = j * around + i, j * around + (i + 1) % around
            triangles += [(a, a + around, b), (b, a + around, b + around)]
    return np.concatenate(points), np.array(triangles)


def oval(around=48):
    """The outline of an ellipse, long along z, with the circle's circumference, in equal parts."""
    angle = np.linspace(0.0, 2.0 * np.pi, 100_001)
    curve = np.column_stack([0.7 * np.sin(angle), 1.25 * np.cos(angle)])
    length = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(curve, axis=0), axis=1)))
    at = np.interp(np.arange(around) / around * length[-1], length, angle)
    parts = np.column_stack([0.7 * np.sin(at), 1.25 * np.cos(at)])[::-1]
    whole = np.linalg.norm(np.roll(parts, -1, axis=0) - parts, axis=1).sum()
    return parts * (RADIUS * 2.0 * around * np.sin(np.pi / around) / whole)


def between_plates(closer, **shell):
    """Frictionless, two radii apart, the upper one of which comes closer (m)."""
    plates = [
        {"shape": "plane", "point": [0, 0, -RADIUS], "normal": [0, 0, 1]},
        {"shape": "plane", "point": [0, 0, RADIUS], "normal": [0, 0, -1]},
    ]
    if closer:
        plates[1]["move"] = {"displacement": [0, 0, -closer]}
    material = {"young": 1e8, "poisson": 0.3, "density": 1000.0}
    return voile.load(
        {
            "shell": {"mesh": ring(), **material, **shell},
            "loads": {"gravity": [0, 0, 0]},
            "obstacle": plates,
            "contact": {"offset": 0.0},
        }
    )


@pytest.mark.parametrize("thickness", [1e-3, 5e-3])
def test_a_squeezed_ring_stands_somewhere(thickness):
    """Round-off gave it ways off saddles that were none, until it had "slid" by its size."""
    result = voile.run(between_plates(0.03, thickness=thickness))
    lower, upper = result.summary["contact"]["obstacles"]
    assert (
        result.summary["stable"] and lower["force"][2] == pytest.approx(-upper["force"][2], rel=1e-8) != 0.0
    )
    assert np.ptp(result.positions[:, 2]) == pytest.approx(2.0 * RADIUS - 0.03, rel=1e-6)
    assert any("neutral" in note for note in result.summary["notes"]) or (
        result.summary["smallest_eigenvalue"] is None
    )


@pytest.mark.parametrize(
    "rest", [ring(outline=oval()), tuple(1.1 * part if k == 0 else part for k, part in enumerate(ring()))]
)
def test_a_strained_shell_needs_no_loads(rest):
    """It presses on the plates, or rolls until it fits between them."""
    result = voile.run(between_plates(0.0, thickness=1e-3, rest=rest))
    assert result.summary["stable"] and result.summary["energy"]["bending"] > 0.0
    assert np.abs(result.positions[:, 2]).max() < RADIUS + 1e-6
    lower, upper = result.summary["contact"]["obstacles"]
    assert lower["force"][2] == pytest.approx(-upper["force"][2], abs=1e-7)


def test_a_shell_at_rest_still_needs_supports():
    with pytest.raises(voile.InputError, match="free to move rigidly"):
        voile.run(between_plates(0.0, thickness=1e-3))
