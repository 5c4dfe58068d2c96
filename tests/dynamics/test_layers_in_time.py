"""Layers in contact, by Newton's method: they meet by more pairs than they need."""

import numpy as np
from test_problem import sheet

import voile


def moved(mesh, obstacle, step, duration, velocity=(0.0, 0.0, 0.0)):
    """The summary of a run of cloth that falls with a velocity (m/s)."""
    fabric = {"young": 1e5, "poisson": 0.3, "thickness": 1e-3, "density": 300.0, "bending": "average"}
    scene = {
        "scene": {"task": "dynamics"},
        "shell": {"mesh": mesh, "velocity": list(velocity), **fabric},
        "loads": {"gravity": [0.0, 0.0, -9.81]},
        "obstacle": [obstacle],
        "contact": {"self_contact": True, "self_friction": 0.3},
        "dynamics": {"time_step": step, "duration": duration},
    }
    return voile.run(scene).summary


def test_a_strip_that_folds_along_its_cells():
    """Pairs that meet in almost the same place share its load only if contact in descents hardens: before, steps of any
    length failed."""
    flat, triangles = sheet(40, 5, 0.3, 0.0375)
    x = flat[:, 0] - flat[:, 0].min()
    upright = np.column_stack([0.01 * np.sin(2 * np.pi * x / 0.3) + 0.05 * x, flat[:, 1], x + 0.003])
    floor = {"shape": "plane", "point": [0.0, 0.0, 0.0], "normal": [0.0, 0.0, 1.0], "friction": 0.4}
    done = moved((upright, triangles), floor, 0.003, 0.075, (0.0, 0.0, -0.5))
    assert done["converged"] and done["newton_iterations"] < 35 * done["steps"]


def test_two_layers_that_fall_on_a_turning_ball():
    """Steps start where their layers' gaps are none, and attempts that layers cut end: 454 iterations for 563."""
    lower, triangles = sheet(7, 7, 0.2, 0.2)
    lower -= lower.mean(axis=0)
    upper = 0.8 * lower + np.array([0.01, 0.0, 0.002])
    mesh = np.vstack([lower, upper]), np.vstack([triangles, triangles + len(lower)])
    center = [0.0, 0.0, -0.083]
    ball = {"shape": "sphere", "center": center, "radius": 0.08, "friction": 0.3}
    ball["move"] = {"angular_velocity": [0.0, 0.0, 3.0], "center": center}
    done = moved(mesh, ball, 0.004, 0.1)
    assert done["converged"] and done["steps"] == 25 and done["newton_iterations"] < 20 * done["steps"]
