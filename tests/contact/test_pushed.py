"""Shells that nothing but obstacles hold, which move: a ring between two plates, a strip on rods."""

import numpy as np
import pytest
from scipy.integrate import solve_bvp
from test_problem import sheet

import voile

RADIUS, THICKNESS, WIDTH, YOUNG, FACETS = 0.1, 1e-3, 0.02, 1e8, 48


def ring():
    angle = 2.0 * np.pi * np.arange(FACETS) / FACETS
    points = [[RADIUS * np.cos(a), RADIUS * np.sin(a), z] for a in angle for z in (0.0, 0.5 * WIDTH, WIDTH)]
    triangles = []
    for i in range(FACETS):
        j = (i + 1) % FACETS
        for k in range(2):
            a, b, c, d = 3 * i + k, 3 * i + k + 1, 3 * j + k, 3 * j + k + 1
            triangles += [(a, c, d), (a, d, b)] if (i + k) % 2 else [(a, c, b), (b, c, d)]
    return np.array(points), np.array(triangles)


def elastica(squeezed):
    """Force (N) that takes a ring, whose part on the plates is straight, so many diameters together."""
    half = RADIUS * (1.0 - squeezed)
    s = np.linspace(0.0, 1.0, 80)

    def along(_, y, p):
        angle, curvature, _ = y
        return p[1] * np.array([curvature, p[0] * np.cos(angle), np.sin(angle)])

    def ends(a, b, _):
        return np.array([a[0], a[1], a[2], b[0] - 0.5 * np.pi, b[2] - half])

    free = np.pi * RADIUS / 2.0 * (1.4 * (1.0 - squeezed))
    guess = np.array([s * np.pi / 2.0, np.full_like(s, np.pi / 2.0 / free), half * s])
    found = solve_bvp(along, ends, s, guess, p=[2.0 / RADIUS**2, free], tol=1e-8, max_nodes=20000)
    assert found.success
    return 2.0 * found.p[0] * YOUNG * THICKNESS**3 / 12.0 * WIDTH


def test_plates_that_move_far_in_a_step_squeeze_a_free_ring():
    """Load steps that do not succeed are cut although no support holds the ring (it ended in the first one)."""
    squeezed = 0.7  # 0.8 % off with twice the facets
    way = squeezed * RADIUS
    plates = [
        {
            "shape": "plane",
            "point": [0.0, side * RADIUS, 0.0],
            "normal": [0.0, -side, 0.0],
            "move": {"displacement": [0.0, -side * way, 0.0]},
            "friction": 0.5,
        }
        for side in (-1.0, 1.0)
    ]
    scene = {
        "shell": {"mesh": ring(), "young": YOUNG, "poisson": 0.0, "thickness": THICKNESS, "density": 1.0},
        "loads": {"gravity": [0.0, 0.0, 0.0]},
        "contact": {"offset": 0.0},
        "obstacle": plates,
        "statics": {"load_steps": 10},
    }
    summary = voile.run(scene).summary
    below, above = (plate["force"][1] for plate in summary["contact"]["obstacles"])
    assert below == pytest.approx(elastica(squeezed), rel=0.04)
    assert above == pytest.approx(-below, rel=1e-6)


def test_rods_that_move_far_in_a_step_do_not_push_a_free_strip_through_others():
    """A strip on two rods, a third pushes its middle down by 3 mm a step (it ended flat below them, converged)."""
    points, triangles = sheet(80, 2, 0.4, 0.02)
    points = points - [0.2, 0.01, 0.0]
    rods = [
        {
            "shape": "cylinder",
            "axis": [0.0, 1.0, 0.0],
            "radius": 0.005,
            "friction": 0.2,
            "center": [x, 0.0, z],
        }
        for x, z in ((-0.15, -0.0055), (0.15, -0.0055), (0.0, 0.0055))
    ]
    rods[2]["move"] = {"displacement": [0.0, 0.0, -0.015]}
    scene = {
        "shell": {
            "mesh": (points, triangles),
            "young": 2e8,
            "poisson": 0.0,
            "thickness": 1e-3,
            "density": 1.0,
        },
        "loads": {"gravity": [0.0, 0.0, 0.0]},
        "obstacle": rods,
        "statics": {"load_steps": 5},
    }
    result = voile.run(scene)
    left, right, pushed = (rod["force"][2] for rod in result.summary["contact"]["obstacles"])
    assert left > 0.0 and right > 0.0 and pushed == pytest.approx(-left - right, rel=1e-6)
    assert (result.positions[np.abs(points[:, 0]) > 0.16, 2] > 0.0).all()
