"""Layers in contact, by Newton's method: they meet by more pairs than they need."""

import numpy as np
from moving import cloth
from mpi4py import MPI
from test_problem import sheet

import voile
from voile.contact.obstacles import Sphere
from voile.problem.contact import shell_layers, with_obstacles
from voile.problem.problem import Problem
from voile.solver.path_in_time import TimeOptions
from voile.solver.stepping.newton_step import NewtonStep
from voile.solver.stepping.restart import packed, unpacked
from voile.solver.stepping.schemes import ImplicitEuler
from voile.solver.stepping.time_path import Stepper, start_path


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


def test_layers_go_on_to_the_last_digit():
    """Before, matrices had room for other pairs after a restart, and searches had learnt from former steps: runs that
    went on ended 1e-9 m from those that were not stopped."""
    lower, triangles = sheet(6, 6, 0.2, 0.2)
    lower -= lower.mean(axis=0)
    points = np.concatenate([lower, 0.8 * lower + [0.011, 0.007, 0.002]])
    shell = cloth(
        points, np.vstack([triangles, triangles + len(lower)]), young=1e5, model="koiter/average/stvk"
    )
    ball = Sphere(center=np.array([0.0, 0.0, -0.083]), radius=0.08, friction=0.3)
    layers = shell_layers(shell, 5e-4, 0.3)

    def follow(found=None):
        """What is saved after each step, from a start or a set that was."""
        problem = with_obstacles(Problem(shell, MPI.COMM_SELF), [ball], 5e-4, layers).at(0.0)
        path = unpacked(problem, found) if found else start_path(problem, np.zeros_like(points))
        stepper = Stepper(problem, TimeOptions(ImplicitEuler(), 4e-3, 0.08), NewtonStep(problem), path)
        saved = []
        stepper.follow(lambda step, path: saved.append(packed(problem, path)))
        return saved

    whole = follow()
    for step in (9, 15):
        rest = follow(whole[step])
        assert len(rest) == len(whole) - step - 1
        for name in ("positions", "velocity", "contact.normal.1", "contact.friction.1", "counts"):
            np.testing.assert_array_equal(rest[-1][name], whole[-1][name], err_msg=name)
