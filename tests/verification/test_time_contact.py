"""Impacts and dry friction in time against exact motions and published ones."""

import sys
from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI

sys.path.append(str(Path(__file__).parents[1] / "dynamics"))
from moving import Recorded, cloth, move
from test_problem import sheet

from voile.contact.obstacles import Plane
from voile.problem.contact import shell_layers, with_obstacles
from voile.problem.problem import Problem
from voile.solver.path_in_time import TimeOptions
from voile.solver.stepping.newton_step import NewtonStep
from voile.solver.stepping.schemes import SCHEMES, SchemeOptions
from voile.solver.stepping.time_path import Stepper, start_path

UP = np.array([0.0, 0.0, 1.0])


def bouncing_bar(scheme: str, theta: float, cells: int = 25, steps: int = 50):
    """Doyen, Ern & Piperno 2011, scaled to strains under 1e-3: a bar of length L falls along its axis through 3 waves'
    passages L/c on a rigid wall. Times (passages) at which contact begins or ends, and the energy lost over the
    first."""
    length, gravity, young = 10.0, 10.0, 9e5
    passage = length / np.sqrt(young)
    height = 0.5 * gravity * (3.0 * passage) ** 2
    points, triangles = sheet(cells, 1, length, length / cells)
    points[:, 0] += height
    shell = cloth(
        points,
        triangles,
        rest_points=points,
        young=young,
        poisson=0.0,
        thickness=1.0,
        density=1.0,
        model="koiter/average/stvk",
        gravity=np.array([-gravity, 0.0, 0.0]),
        fixed=np.tile([False, True, True], (len(points), 1)),
    )
    wall = Plane(point=np.zeros(3), normal=np.array([1.0, 0.0, 0.0]))
    asked = SchemeOptions(theta=theta)
    run = move(shell, scheme, passage / steps, 15.0 * passage, 0.0, [wall], tolerance=1e-8, asked=asked)
    assert run.path.converged
    bears = np.array([step.contact["active"] > 0 for step in run.steps])
    changes = np.array(run.times)[np.flatnonzero(np.diff(bears.astype(int))) + 1] / passage
    kinetic = run.path.books.kinetic(run.path.kinematics)
    lost = -(kinetic + sum(run.steps[-1].energies.values()))
    return changes, lost / (run.problem.vertex_mass().sum() * gravity * height)


@pytest.mark.slow
def test_a_bar_bounces_on_its_waves():
    changes, lost = bouncing_bar("moreau-jean", 0.5)
    np.testing.assert_allclose(changes[:4], [3.0, 5.0, 11.0, 13.0], atol=0.15)
    assert 0.0 < lost < 0.05
    euler = [bouncing_bar("implicit-euler", 1.0, steps=steps) for steps in (25, 50)]
    assert euler[1][0][1] == pytest.approx(5.0, abs=0.25)
    assert 0.0 < euler[1][1] < euler[0][1] < 1.0


def oscillating_pad(steps: int) -> tuple[Recorded, np.ndarray, float]:
    """A stiff sheet at the end of a soft strip, let go 4.25 times 2 mu N / k from its middle: the run, displacements
    along the strip over that length, half the period (s)."""
    cells, gravity, thickness, friction = 6, 10.0, 1e-3, 0.001
    width = 1.0 / cells
    points, triangles = sheet(cells + 1, 1, 1.0 + width, width)
    pad = points[triangles].mean(axis=1)[:, 0] > 1.0
    strip = points[:, 0] < 1.0 - 1e-9
    points[strip, 2] = 1e-5  # off the plane
    stiffness, mass = 1e5 * thickness * width, 6e3 * thickness * width**2
    fall = 2.0 * friction * mass * gravity / stiffness
    start, fixed = points.copy(), np.zeros(points.shape, dtype=bool)
    start[:, 0] += 4.25 * fall * np.minimum(points[:, 0], 1.0)
    fixed[:, 1], fixed[strip, 2], fixed[points[:, 0] < 1e-9] = True, True, True
    shell = cloth(
        start,
        triangles,
        rest_points=points,
        young=np.where(pad, 1e9, 1e5),
        density=np.where(pad, 6e3, 1e-2),
        poisson=0.0,
        thickness=thickness,
        gravity=-gravity * UP,
        fixed=fixed,
        model="koiter/average/stvk",
    )
    plane = Plane(point=np.zeros(3), normal=UP, friction=friction)
    half = np.pi * np.sqrt(mass / stiffness)
    run = move(shell, "implicit-euler", half / steps, 5.5 * half, 0.0, [plane], tolerance=1e-9)
    end = points[:, 0] > 1.0 + 1e-9
    away = np.array([(x - points)[end, 0].mean() for x in run.positions]) / fall
    return run, away, half


@pytest.mark.slow
def test_a_pad_on_a_spring_loses_the_same_in_each_swing_and_sticks():
    """Code_Aster SDND100: the amplitude falls by 2 mu N / k each half period, 4.25, -3.25, 2.25, -1.25, 0.25."""
    missed = []
    for steps in (200, 400):
        run, away, half = oscillating_pad(steps)
        assert run.path.converged
        swing = np.array(run.times) / half
        peaks = np.array([np.abs(away[np.abs(swing - k) < 0.1]).max() for k in range(5)])
        missed.append(np.abs(peaks - [4.25, 3.25, 2.25, 1.25, 0.25]).max())
        assert np.abs(run.velocities[-1]).max() < 1e-12  # off the centre
        assert abs(away[-1]) < 0.5
    assert missed[1] < 0.15 and missed[1] < 0.65 * missed[0]


@pytest.mark.slow
def test_a_house_of_cards_stands():
    """Four cards lean on each other in pairs at mu = 0.5: nothing moves for 10 s."""
    length, thickness, friction, angle = 0.09, 1e-3, 0.5, np.radians(70.0)
    offset = 0.5 * thickness
    half = length * np.cos(angle) + 1.1 * offset
    rest, stands, triangles, count = [], [], [], 0
    for foot, side in ((-half, 1.0), (half, -1.0), (0.2 - half, 1.0), (0.2 + half, -1.0)):
        flat, corners = sheet(3, 2, length, 0.06)
        along = flat[:, 0]
        stands.append(
            np.column_stack([foot + side * along * np.cos(angle), flat[:, 1], along * np.sin(angle) + offset])
        )
        rest.append(flat + np.array([0.0, 0.2 * len(rest), 0.0]))
        triangles.append((corners if side > 0.0 else corners[:, [0, 2, 1]]) + count)
        count += len(flat)
    points = np.concatenate(stands)
    shell = cloth(
        points,
        np.concatenate(triangles).astype(np.int32),
        rest_points=np.concatenate(rest),
        young=1e9,
        thickness=thickness,
        density=1000.0,
    )
    table = Plane(point=np.zeros(3), normal=UP, friction=friction)
    problem = Problem(shell, MPI.COMM_SELF)
    problem = with_obstacles(problem, [table], offset, shell_layers(shell, offset, friction)).at(0.0)
    path, solver = start_path(problem, np.zeros_like(points)), NewtonStep(problem)
    run = Recorded(path, problem, solver)
    options = TimeOptions(SCHEMES["implicit-euler"](SchemeOptions()), 0.01, 10.0)
    Stepper(problem, options, solver, path).follow(run.see)
    assert path.converged and path.count == 1000
    assert np.abs(run.end - points).max() < 2e-4  # they give a little under their weight
    settled = run.positions[50]
    assert np.abs(run.end - settled).max() < 1e-12 and np.abs(run.velocities[-1]).max() < 1e-12
    assert solver.counts.factorisations < 1.3 * path.count
