"""Targets in layers: cloth held by nothing but cloth, under Coulomb's law like any other contact."""

import json
from dataclasses import replace

import numpy as np
import pytest
from command_line import voile
from inverse_shells import grid, shell
from scipy.spatial import Delaunay
from test_cli_inverse import ROD, SCENE
from test_direct import rod, tube

from voile.contact.obstacles import Plane
from voile.errors import NotConverged
from voile.inverse.result import inverse_report
from voile.inverse.solve import InverseOptions, solve_inverse
from voile.inverse.target import Target
from voile.mesh import read_mesh, write_obj
from voile.problem.contact import shell_layers
from voile.problem.problem import Problem

OFFSET = 0.5e-3
HOVER = 0.2e-3  # of a captured layer over the one below


def two_tubes(up: int = 8):
    """A tube that hangs on a rod, and another over it; its vertices are marked. up: cells along the rod."""
    points, triangles = tube(up=up)
    radius = np.hypot(points[:, 0], points[:, 1])[:, None]
    outer = points * np.column_stack(
        [1.0 + (2.0 * OFFSET + HOVER) / radius] * 2 + [np.full(len(points), 0.8)]
    )
    above = np.arange(2 * len(points)) >= len(points)
    return np.concatenate([points, outer]), np.concatenate([triangles, triangles + len(points)]), above


def solve(shape, bodies, friction, **options):
    layers = shell_layers(shape, OFFSET, friction)
    return solve_inverse(Problem(shape), shape, bodies, OFFSET, InverseOptions(**options), layers=layers)


def test_cloth_held_by_cloth():
    """The rod carries both tubes, the inner one the outer one, where it hovers: there is no jump at the start."""
    points, triangles, above = two_tubes()
    shape = shell(points, triangles, np.zeros(points.shape, dtype=bool), young=1e7)
    result = solve(shape, [rod(0.5)], 0.5, contact_tolerance=1e-3)
    assert result.converged, result.reason
    assert result.simulation.sag < 1e-12 and result.disturbed.sag < 1e-10
    target, report = result.target, inverse_report(result)["reactions"]
    load = target.problem.loads.weight[: 3 * len(points)].reshape(-1, 3)
    np.testing.assert_allclose(report["force"], -load.sum(axis=0), atol=1e-9)
    on_rod, between = target.contacts
    pressed = between.spread(target.reactions[len(on_rod) :])
    np.testing.assert_allclose(pressed[above].sum(axis=0), -load[above].sum(axis=0), atol=1e-9)
    assert report["least_margin"] > 0.0 and (between.gap > 2.0 * OFFSET + 0.5 * HOVER).all()
    step = result.simulation.path.steps[-1].contact
    assert step["friction_error"] < 1e-8 and step["slip"] == 0 and step["self_contacts"] > 10


def on_incline(slope: float, cells=(6, 4)):
    """A patch on a sheet (cells a side) on an incline, and the incline, on which the sheet cannot slip."""
    points, triangles = grid(cells[0], cells[0], 0.3, 0.3)
    patch, corners = grid(cells[1], cells[1], 0.17, 0.17)
    patch += [0.06, 0.07, 2.0 * OFFSET]
    turn = np.array([[np.cos(slope), 0, -np.sin(slope)], [0, 1, 0], [np.sin(slope), 0, np.cos(slope)]])
    both = (np.concatenate([points, patch]) + np.array([0, 0, OFFSET])) @ turn.T
    body = Plane(name="incline", friction=5.0, point=np.zeros(3), normal=turn[:, 2])
    fixed = np.zeros(both.shape, dtype=bool)
    return shell(both, np.concatenate([triangles, corners + len(points)]), fixed, young=1e7), body


def test_the_least_friction_between_layers_is_the_slope():
    slope = np.radians(20.0)
    shape, incline = on_incline(slope, (3, 2))
    with pytest.raises(NotConverged, match=r"hold the target on incline .*, itself \(friction 0.3\)") as told:
        solve(shape, [replace(incline, friction=0.3)], 0.3)
    least = float(str(told.value).split("would do is ")[1].split(",")[0])
    assert least == pytest.approx(np.tan(slope), rel=1e-2)
    result = solve(shape, [incline], 1.05 * np.tan(slope))
    assert result.converged and result.simulation.sag < 1e-12


def test_derivative_by_the_rest_positions():
    """Taylor remainders of order 2 of the balance with reactions between layers that stick and slip."""
    shape, incline = on_incline(0.3)
    target = Target(Problem(shape), shape, [incline], OFFSET, 1e-3, layers=shell_layers(shape, OFFSET, 0.4))
    problem, rng = target.problem, np.random.default_rng(3)
    z = target.field_vector(1e-4 * rng.normal(size=shape.points.shape))
    direction = target.field_vector(rng.normal(size=shape.points.shape))

    def balance(step: float) -> np.ndarray:
        moved = z + float(step) * direction
        target.rest.set(moved)
        target.hold(moved)
        f = problem.create_vector()
        target.residual(target.rest.state(moved), f)
        return f.array.copy()

    first = balance(0.0)
    matrix = problem.create_matrix()
    target.jacobian(target.rest.state(z), matrix)
    slope = problem.create_vector()
    matrix.mult(direction, slope)
    between = target.reactions[len(target.contacts[0]) :]
    assert (np.linalg.norm(between, axis=1) > 0.0).sum() > 10
    steps = 1e-6 * 0.5 ** np.arange(4)
    missed = [np.linalg.norm(balance(s) - first - s * slope.array) for s in steps]
    assert np.log2(np.divide(missed[:-1], missed[1:])).min() > 1.8


def irregular(seed: int, height: float):
    """An irregular patch of 0.2 m at a height (m)."""
    points, _ = grid(8, 8, 0.2, 0.2)
    plane = points[:, :2] + np.random.default_rng(seed).uniform(-0.008, 0.008, (len(points), 2))
    return np.column_stack([plane, np.full(len(plane), height)]), Delaunay(plane).simplices


def test_pairs_between_layers_are_independent():
    """Between irregular layers no pair's normal jump follows from the others', and so no reaction."""
    (below, lower), (above, upper) = irregular(1, 0.0), irregular(2, 2.0 * OFFSET + HOVER)
    points = np.concatenate([below, above])
    shape = shell(points, np.concatenate([lower, upper + len(below)]), np.zeros(points.shape, dtype=bool))
    shape.fixed[: len(below)] = True
    target = Target(Problem(shape), shape, [], OFFSET, 1e-3, layers=shell_layers(shape, OFFSET, 0.4))
    (between,) = target.contacts
    rows = np.zeros((len(between), len(points)))
    np.add.at(rows, (np.arange(len(between))[:, None], between.geometry.vertex), between.geometry.weight)
    assert len(between) > 60 and len(np.unique(between.geometry.vertex)) > 100
    assert np.linalg.svd(rows, compute_uv=False).min() > 1e-3


LAYERS = "[contact]\nself_contact = true\nself_friction = 0.5\noffset = 0.5e-3\n"


def layered_scene(folder, points, triangles, inverse=""):
    write_obj(folder / "target.obj", points, triangles)
    held = ROD.format(friction=0.5) + LAYERS
    text = SCENE.format(held=held, bending="tan", young=1e7, inverse=inverse, name="layers")
    (folder / "scene.toml").write_text(text)


def test_ranks_agree_on_layers(tmp_path, run_on):
    layered_scene(tmp_path, *two_tubes(3)[:2])
    found = []
    for ranks in (1, 2):
        out = tmp_path / f"out{ranks}"
        run_on(ranks, tmp_path / "scene.toml", out, 200)
        summary = json.loads((out / "summary.json").read_text())
        assert summary["contact"]["self_contacts"] > 10 and summary["inverse"]["sag"] < 1e-12
        found.append((read_mesh(out / "rest.obj").points, summary["inverse"]["reactions"]))
    (one, first), (two, second) = found
    assert np.abs(one - two).max() < 1e-10
    assert first["contacts"] == second["contacts"] and first["bearing"] == second["bearing"]
    np.testing.assert_allclose(first["force"], second["force"], atol=1e-9)


def test_layers_through_each_other_are_refused(tmp_path):
    points, triangles, above = two_tubes()
    points[above] += [0.001, 0.003, 0.002]
    layered_scene(tmp_path, points, triangles)
    done = voile("run", tmp_path / "scene.toml", "-o", tmp_path / "out")
    assert done.returncode == 2 and "passing through itself" in done.stderr
    assert done.stderr.count("voile:") == 1
