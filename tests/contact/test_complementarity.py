"""Frictionless contact by PETSc's SNESVI beside the default method: the same equilibrium."""

import numpy as np
import pytest
from mesh_helpers import generator
from petsc4py import PETSc

from voile.contact.obstacles import Plane
from voile.errors import InputError
from voile.problem.contact import contact_report, with_obstacles
from voile.problem.problem import Problem
from voile.problem.shell import Shell
from voile.solver.methods.complementarity import OPTION
from voile.solver.path import StaticsOptions
from voile.solver.statics import solve_statics

LENGTH, WIDTH, THICKNESS, YOUNG, DENSITY, LIFT = 1.0, 0.05, 1e-3, 1e9, 1000.0, 2e-3


def lifted_strip(friction: float = 0.0):
    """A heavy strip on a plane, one end lifted: (path, problem)."""
    points, triangles = generator("plate").plate(LENGTH, WIDTH, 0.05)
    triangles = np.asarray(triangles, dtype=np.int32)
    one, end = np.ones(len(triangles)), points[:, 0] < 1e-9
    motion = np.zeros_like(points)
    motion[end, 2] = LIFT
    shell = Shell(
        points=points,
        triangles=triangles,
        rest_points=points,
        rest_triangles=triangles,
        flat=True,
        model="koiter/tan/stvk",
        thickness=THICKNESS * one,
        young=YOUNG * one,
        poisson=0.0 * one,
        density=DENSITY * one,
        fixed=np.repeat(end[:, None], 3, axis=1),
        motion=motion,
        gravity=np.array([0.0, 0.0, -9.81]),
    )
    problem = Problem(shell)
    floor = Plane(name="floor", friction=friction, point=np.zeros(3), normal=np.array([0.0, 0.0, 1.0]))
    problem = with_obstacles(problem, [floor], 0.0)
    return solve_statics(problem, StaticsOptions(load_steps=1)), problem


@pytest.fixture
def method(request):
    PETSc.Options().setValue(OPTION, request.param)
    yield request.param
    PETSc.Options().delValue(OPTION)


@pytest.fixture(scope="module")
def reference():
    path, problem = lifted_strip()
    return problem.positions(path.state), contact_report(problem, path.state)


@pytest.mark.parametrize("method", ["vinewtonrsls", "vinewtonssls"], indirect=True)
def test_snesvi_finds_the_same_equilibrium(reference, method):
    path, problem = lifted_strip()
    positions, report = reference
    assert path.converged and path.steps[-1].method == method
    assert np.abs(problem.positions(path.state) - positions).max() < 1e-8 * LENGTH
    found = contact_report(problem, path.state)
    assert found["active"] == report["active"] > 30
    assert np.allclose(found["obstacles"][0]["force"], report["obstacles"][0]["force"], atol=1e-9)


@pytest.mark.parametrize("method", ["vinewtonrsls"], indirect=True)
def test_snesvi_refuses_friction(method):
    with pytest.raises(InputError, match="friction = 0"):
        lifted_strip(0.3)
