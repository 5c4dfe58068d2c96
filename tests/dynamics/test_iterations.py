"""Steps whose systems are solved by iteration with an incomplete factor, and where that gives way to a complete one."""

import numpy as np
import pytest
from moving import Recorded, cloth, move
from petsc4py import PETSc
from test_problem import sheet

from voile.contact.obstacles import Motion, Sphere

STEP, UP = 5e-3, np.array([0.0, 0.0, 1.0])
NAMES = ("step_ksp_max_it", "step_friction_ksp_max_it")


def factored(model: str) -> Recorded:
    """With complete factors only, by PETSc's options."""
    options = PETSc.Options()
    for name in NAMES:
        options.setValue(name, 0)
    try:
        return landing(2e4, model)
    finally:
        for name in NAMES:
            options.delValue(name)


def landing(young: float, model: str = "koiter/average/stvk") -> Recorded:
    """A sheet of 0.8 m whose middle lands on a turning ball, slips and is taken along."""
    points, triangles = sheet(20, 20, 0.8, 0.8)
    points = points - points.mean(axis=0) + 0.051 * UP
    ball = Sphere(
        name="ball",
        friction=0.3,
        center=-0.3 * UP,
        radius=0.3,
        motion=Motion(rotation=3.0 * UP, center=-0.3 * UP),
    )
    shell = cloth(points, triangles, young=young, density=300.0, thickness=1e-3, model=model)
    return move(shell, "implicit-euler", STEP, 0.12, [0.0, 0.0, -0.5], obstacles=[ball])


@pytest.mark.parametrize("model", ["koiter/average/stvk", "koiter/tan/stvk"])
def test_iterations_find_the_motion_that_complete_factors_find(model):
    """2e4 Pa: stretching is 3 times inertia. As many Newton iterations, at most 15 of Krylov's per solve."""
    exact, found = factored(model), landing(2e4, model)
    assert exact.path.converged and found.path.converged
    assert found.steps[-1].contact["active"] > 3 and found.steps[-1].contact["slip"] > 0
    np.testing.assert_allclose(found.end, exact.end, rtol=0, atol=1e-9)
    few, many = found.path.counts, exact.path.counts
    assert many.krylov == 0 < few.krylov < 15 * few.solves
    assert few.iterations <= many.iterations + 2


def test_stiff_sheets_go_on_with_complete_factors():
    """2e9 Pa: stretching is 3e5 times inertia, and the motion is found all the same."""
    seen = landing(2e9)
    counts = seen.path.counts
    assert seen.path.converged, seen.path.reason
    assert counts.krylov > 0  # each step tries
    assert seen.steps[-1].contact["max_penetration"] < 1e-12
    assert seen.steps[-1].residual <= seen.steps[-1].tolerance


def test_a_free_step_takes_one_factor_and_few_iterations():
    """Newton steps are as rough as their squares allow, with one tangent where that goes on well; the books close."""
    points, triangles = sheet(24, 24, 1.2, 1.2)
    held = np.flatnonzero(points[:, 0] < 1e-9)
    shell = cloth(points, triangles, held, model="koiter/average/stvk", young=2e4, density=3e3)
    run = move(shell, "implicit-euler", STEP, 8 * STEP, tolerance=1e-6)
    counts = run.path.counts
    assert counts.factorisations <= 8 and counts.krylov <= 12 * 8
    assert abs(run.path.books.error) < 1e-10 * run.path.books.most
