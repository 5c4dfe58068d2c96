"""A skirt of four panels with curved seams: draped from its flat panels, then found again from the drape."""

from dataclasses import replace

import numpy as np
from inverse_shells import shell
from mpi4py import MPI

from voile.inverse.flatten import flatten
from voile.inverse.panels import split
from voile.inverse.result import inverse_report
from voile.inverse.solve import InverseOptions, solve_inverse, solve_panels
from voile.problem.problem import Problem
from voile.solver.path import StaticsOptions
from voile.solver.statics import solve_statics

GORES, ACROSS, DOWN, LENGTH = 4, 6, 10, 0.4  # m


def four_gores(young):
    """The skirt on its cone before it hangs, its flat panels as rest shape; and the panel of every triangle."""
    v, u = np.meshgrid(np.linspace(0.0, 1.0, DOWN + 1), np.linspace(-1.0, 1.0, ACROSS + 1), indexing="ij")
    width = 0.15 + 0.05 * v + 0.13 * v**2  # the seams curve
    flat = np.stack([0.5 * u * width, -LENGTH * v, np.zeros_like(v)], axis=-1).reshape(-1, 3)
    corner = np.arange(len(flat)).reshape(v.shape)
    a, b, c, d = corner[:-1, :-1], corner[:-1, 1:], corner[1:, 1:], corner[1:, :-1]
    mirrored = (u[:-1, :-1] < 0.0)[..., None]
    one = np.where(mirrored, np.stack([a, d, b], -1), np.stack([a, d, c], -1))
    two = np.where(mirrored, np.stack([b, d, c], -1), np.stack([a, c, b], -1))
    panel = np.concatenate([one.reshape(-1, 3), two.reshape(-1, 3)])
    radius = GORES * width / (2.0 * np.pi)
    points, triangles, rest, rest_triangles = [], [], [], []
    column = GORES * ACROSS
    for k in range(GORES):
        turn = 2.0 * np.pi * (k + 0.5 * (u + 1.0)) / GORES
        points.append(np.stack([radius * np.cos(turn), radius * np.sin(turn), -0.9 * LENGTH * v], -1))
        place = np.add.outer(np.arange(DOWN + 1) * column, (k * ACROSS + np.arange(ACROSS + 1)) % column)
        triangles.append(place.ravel()[panel])
        rest.append(flat + np.array([0.5 * k, 0.0, 0.0]))
        rest_triangles.append(panel + k * len(flat))
    whole = np.zeros(((DOWN + 1) * column, 3))
    for k, part in enumerate(points):
        place = np.add.outer(np.arange(DOWN + 1) * column, (k * ACROSS + np.arange(ACROSS + 1)) % column)
        whole[place.ravel()] = part.reshape(-1, 3)
    fixed = np.repeat(whole[:, 2:] > -1e-9, 3, axis=1)
    made = replace(
        shell(whole, np.concatenate(triangles).astype(np.int32), fixed, young=young),
        rest_points=np.concatenate(rest),
        rest_triangles=np.concatenate(rest_triangles).astype(np.int32),
        flat=True,
    )
    return made, np.repeat(np.arange(GORES), len(panel))


def draped(young):
    """The skirt as it hangs, and its panels."""
    made, panel = four_gores(young)
    problem = Problem(made, MPI.COMM_SELF)
    path = solve_statics(problem, StaticsOptions())
    assert path.converged and path.stable
    problem.reset_origin(path.state)
    return replace(made, points=problem.positions(path.state)), panel, made


def seams(triangles, panel):
    lowest, highest = np.full(triangles.max() + 1, GORES), np.full(triangles.max() + 1, -1)
    for corner in triangles.T:
        np.minimum.at(lowest, corner, panel)
        np.maximum.at(highest, corner, panel)
    return np.flatnonzero(lowest < highest)


def away(whole, flat):
    """Largest distance of the skirt draped from flat panels to the target, over its height."""
    made = replace(
        whole,
        rest_points=np.column_stack([flat.coordinates, np.zeros(len(flat.coordinates))]),
        rest_triangles=flat.panels.corners.astype(np.int32),
        flat=True,
    )
    problem = Problem(made, MPI.COMM_SELF)
    path = solve_statics(problem, StaticsOptions())
    assert path.converged and path.stable
    problem.reset_origin(path.state)
    moved = np.linalg.norm(problem.positions(path.state) - whole.points, axis=1)
    return moved.max() / np.ptp(whole.points[:, 2])


def test_developable_rest_shape_flattens_and_drapes_back():
    hung, panel, _ = draped(1e7)
    whole = replace(hung, rest_points=hung.points, rest_triangles=hung.triangles, flat=False)
    problem = Problem(whole, MPI.COMM_SELF)
    options = InverseOptions(developable=True, iterations=8)
    result = solve_inverse(problem, whole, [], 0.0, options, exempt=seams(hung.triangles, panel))
    report = inverse_report(result)
    assert result.converged, result.reason
    assert report["developability"][0]["defect"] > 1e-3  # the exact rest shape is not developable
    assert report["largest_defect"] < 1e-8
    rest = result.target.x + problem.motion(result.rest)
    names = tuple(f"gore-{k + 1}" for k in range(GORES))
    flat = flatten(split(hung.triangles, rest, (panel, names)))
    assert np.abs(flat.stretches - 1.0).max() < 1e-6
    height = np.ptp(hung.points[:, 2]) / problem.size()
    assert result.simulation.sag < 0.01 * height
    assert away(whole, flat) < 0.04  # flat panels have lost its curvature


def test_panels_found_drape_back_and_have_the_areas_of_the_true_ones():
    hung, panel, made = draped(1e7)
    names = tuple(f"gore-{k + 1}" for k in range(GORES))
    flat = flatten(split(hung.triangles, hung.points, (panel, names)))
    start = replace(
        hung,
        rest_points=np.column_stack([flat.coordinates, np.zeros(len(flat.coordinates))]),
        rest_triangles=flat.panels.corners.astype(np.int32),
    )
    problem = Problem(start, MPI.COMM_SELF)
    result, coordinates = solve_panels(problem, start, flat, [], 0.0, InverseOptions(iterations=15))
    assert result.converged, result.reason
    assert away(hung, replace(flat, coordinates=coordinates)) < 0.002
    assert result.simulation.sag <= 1.01 * result.adjoint.trail[-1].sag  # the search sees what a drape does
    found, true = (
        np.bincount(panel, areas(points, corners))
        for points, corners in (
            (np.column_stack([coordinates, np.zeros(len(coordinates))]), start.rest_triangles),
            (made.rest_points, made.rest_triangles),
        )
    )
    np.testing.assert_allclose(found, true, rtol=0.02)


def areas(points, triangles):
    x = points[triangles]
    return 0.5 * np.linalg.norm(np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]), axis=1)
