"""Flat panels as design variables: derivatives, and skirts whose panels are known."""

from dataclasses import replace

import numpy as np
import pytest
from inverse_shells import held_edges, nearest_to, shell
from mpi4py import MPI

from voile.inverse.flatten import flatten
from voile.inverse.panels import split
from voile.inverse.solve import InverseOptions, solve_panels
from voile.inverse.target import Target
from voile.problem.problem import Problem
from voile.problem.rest import PanelRest
from voile.solver.path import StaticsOptions, require
from voile.solver.statics import solve_statics
from voile.tasks.patterns import cut_apart, first_copies


def cone_skirt(around=24, down=8, pieces=1, **more):
    """A frustum hanging from its waist, as shell with its flat panels as rest shape: one, cut at the back, or gores."""
    angle = 2 * np.pi * np.arange(around) / around
    radius = np.linspace(0.12, 0.24, down + 1)
    points = np.array([[r * np.cos(a), r * np.sin(a), -1.5 * (r - 0.12)] for r in radius for a in angle])
    k, j = np.meshgrid(np.arange(down), np.arange(around), indexing="ij")
    a, b = k * around + j, k * around + (j + 1) % around
    c, d = b + around, a + around
    triangles = np.concatenate(
        [np.stack([a, c, b], -1).reshape(-1, 3), np.stack([a, d, c], -1).reshape(-1, 3)]
    )
    fixed = np.repeat(points[:, 2:] > -0.03, 3, axis=1)
    whole = shell(points, triangles.astype(np.int32), fixed, **more)
    part = (np.tile(np.arange(len(triangles) // 2) % around, 2) * pieces) // around
    groups = (part, tuple(f"gore{k}" for k in range(pieces))) if pieces > 1 else None
    flat = flatten(split(whole.triangles, whole.points, groups, cut_open=True))
    whole.rest_points = np.column_stack([flat.coordinates, np.zeros(len(flat.coordinates))])
    whole.rest_triangles = flat.panels.corners.astype(np.int32)
    whole.flat = True
    return whole, flat


def cone_target(comm, bending="average"):
    """A cone skirt under its weight as target, and its flat panel (p, 2) m on every rank."""
    whole, flat = cone_skirt(12, 4, bending=bending, young=1e7)
    mine = whole if comm.rank == 0 else None
    target = Target(Problem(mine, comm), mine, [], 0.0, 1e-3)
    target.load(1.0)
    return target, flat.coordinates


@pytest.mark.parametrize("bending", ["average", "tan"])
def test_gradient_by_panel_coordinates(bending):
    target, flat = cone_target(MPI.COMM_SELF, bending)
    panels = PanelRest(target.problem, flat)
    z, direction = panels.create(), panels.create()
    index = np.arange(z.getSize())
    z.array[:], direction.array[:] = 1e-4 * np.sin(index), 1e-4 * np.cos(1.7 * index)
    objective = nearest_to(target, panels, panels.create(), target.problem.create_vector(), 0.1, 1e-10)
    gradient = z.duplicate()
    value = objective.evaluate(z, gradient)
    slope, left = gradient.dot(direction), []
    for h in (1e-1, 1e-2):
        there = z.copy()
        there.axpy(h, direction)
        left.append(abs(objective.evaluate(there, there.duplicate()) - value - h * slope))
    np.testing.assert_allclose(np.log10(left[0] / left[1]), 2.0, atol=0.2)
    assert left[1] < 0.02 * abs(1e-2 * slope)


def test_cone_skirt_drapes_back_from_its_flat_panel():
    """A cone is developable: its panel is exact, and optimised panels drape nearer to the target than exact ones."""
    whole, flat = cone_skirt(young=1e7)
    assert np.abs(flat.stretches - 1.0).max() < 1e-8
    result, coordinates = solve_panels(
        Problem(whole, MPI.COMM_SELF), whole, flat, [], 0.0, InverseOptions(iterations=10)
    )
    assert result.converged, result.reason
    assert result.adjoint is not None
    height = np.ptp(whole.points[:, 2])
    sag = result.simulation.sag * result.target.problem.size()
    assert sag < 0.01 * height
    assert result.simulation.sag < 0.7 * result.adjoint.steps[0].sag
    assert coordinates.shape == flat.coordinates.shape


def test_metric_is_the_mean_square_of_the_strain():
    """Of a pattern stretched by 1 % one way and sheared: e11^2 + 2 e12^2, and a little of the displacements."""
    whole, flat = cone_skirt(young=1e7)
    problem = Problem(whole, MPI.COMM_SELF)
    panels = PanelRest(problem, flat.coordinates)
    z, out = panels.create(), panels.create()
    moved = flat.coordinates @ np.array([[0.01, 0.004], [0.004, 0.0]])
    z.array[:] = moved.ravel()
    panels.metric().mult(z, out)
    still = 0.1 * np.mean((moved**2).sum(axis=1)) / problem.size() ** 2
    np.testing.assert_allclose(z.dot(out), 0.01**2 + 2.0 * 0.004**2 + still, rtol=1e-12)


@pytest.mark.parametrize(
    "bending, clamp", [("average", False), ("tan", False), ("sin", False), ("theta", False), ("tan", True)]
)
@pytest.mark.parametrize("pieces", [1, 3])
def test_sewn_panels_that_bend_at_seams_are_the_uncut_surface(bending, clamp, pieces):
    """The same equilibrium of a cone skirt as one surface and as panels, cut apart and sewn; free seams sag more."""
    whole, flat = cone_skirt(12, 4, pieces=pieces, bending=bending, young=1e6)
    if clamp:
        whole.clamped_edges = held_edges(whole)
    sewn = cut_apart(replace(whole, seam_bending=True), flat)
    free = cut_apart(whole, flat)
    assert len(sewn.topology.edges) == len(whole.topology.edges) < len(free.topology.edges)
    ends = []
    for each in (whole, sewn, free):
        problem = Problem(each, MPI.COMM_SELF)
        path = require(solve_statics(problem, StaticsOptions(tolerance=1e-11)))
        ends.append((problem.positions(path.state), path.steps[-1].energies))
    first = first_copies(flat)
    np.testing.assert_allclose(ends[1][0][first], ends[0][0], atol=1e-9)
    for name, energy in ends[0][1].items():
        assert ends[1][1][name] == pytest.approx(energy, rel=1e-7, abs=1e-12)
    assert np.abs(ends[2][0][first] - ends[0][0]).max() > 1e-4


def test_only_edges_that_two_panels_share_bend_at_seams():
    """Not where the rest shape has its panels apart in space, nor where three layers are sewn along one edge."""
    whole, flat = cone_skirt(12, 4, pieces=3)
    free, sewn = (cut_apart(replace(whole, seam_bending=bends), flat) for bends in (False, True))
    assert len(sewn.topology.edges) == len(free.topology.edges) - 3 * 4  # three seams of four edges
    apart = replace(free, flat=False, seam_bending=True)
    assert len(apart.topology.edges) == len(free.topology.edges)
    strip, corners = (
        np.array([[0, 0, 0], [0, 1, 0], [1, 0, 0], [-1, 0, 0], [0, 0, 1]], float),
        [[0, 2, 1], [5, 6, 3]],
    )
    three = shell(
        np.concatenate([strip, strip[:2], strip[:2]]),
        np.array([*corners, [7, 8, 4]], dtype=np.int32),
        np.zeros((9, 3), dtype=bool),
        slave=np.array([5, 6, 7, 8], dtype=np.int32),
        first=np.array([0, 1, 0, 1], dtype=np.int32),
        second=np.array([0, 1, 0, 1], dtype=np.int32),
        weight=np.zeros(4),
        seam_bending=True,
    )
    assert len(three.topology.edges) == 9
