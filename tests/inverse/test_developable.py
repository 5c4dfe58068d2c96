"""Developable rest shapes: the constraints' derivative, and a cone skirt whose defect vanishes at next to no cost."""

from dataclasses import replace

import numpy as np
import pytest
from mpi4py import MPI
from test_panels import cone_skirt

from voile.errors import NotConverged
from voile.inverse.developable import DevelopableRest
from voile.inverse.flatten import flatten
from voile.inverse.panels import split
from voile.inverse.result import inverse_report
from voile.inverse.solve import InverseOptions, solve_inverse
from voile.inverse.target import Target
from voile.problem.problem import Problem


def skirt():
    """A cone skirt with itself as rest shape."""
    shape, _ = cone_skirt(young=5e6)
    return replace(shape, rest_points=shape.points, rest_triangles=shape.triangles, flat=False)


def test_angle_defects_by_the_rest_shape_are_exact_to_second_order():
    shape = skirt()
    target = Target(Problem(shape, MPI.COMM_SELF), shape, [], 0.0, 1e-3)
    design = DevelopableRest(target, shape)
    assert design.largest_defect() < 1e-12  # the cone itself
    z, direction = design.create(), design.create()
    z.array[:], direction.array[:] = (1e-3 * np.sin(f * np.arange(z.getSize())) for f in (1.0, 1.7))
    target.rest.set(z)
    start, slope = design.defects(), design.jacobian().createVecLeft()
    assert np.abs(start).max() > 1e-3
    design.jacobian().mult(direction, slope)
    left = []
    for h in (1e-1, 1e-2, 1e-3):
        there = z.copy()
        there.axpy(h, direction)
        target.rest.set(there)
        left.append(np.linalg.norm(design.defects() - start - h * slope.array_r))
    np.testing.assert_allclose(np.log10(np.divide(left[:-1], left[1:])), 2.0, atol=0.1)
    assert left[0] < 0.1 * 1e-1 * slope.norm()


def test_projection_and_its_tangent_space():
    shape = skirt()
    target = Target(Problem(shape, MPI.COMM_SELF), shape, [], 0.0, 1e-3)
    design = DevelopableRest(target, shape)
    z, direction = design.create(), design.create()
    z.array[:], direction.array[:] = (1e-3 * np.sin(f * np.arange(z.getSize())) for f in (1.0, 1.7))
    design.set(z)
    assert design.largest_defect() < 1e-9
    along = design.tangential(direction)
    assert (design.tangential(along) - along).norm() < 1e-8 * along.norm()  # a projection
    assert design.cotangential(z).dot(direction) == pytest.approx(z.dot(along), rel=1e-9)  # and its transpose
    z = design.projected.copy()
    z.axpy(1e-3, along)
    target.rest.set(z)
    assert design.largest_defect() < 1e-4 * 1e-3  # second order


def test_cone_skirt_becomes_developable_and_flattens_exactly():
    shape = skirt()
    problem = Problem(shape, MPI.COMM_SELF)
    result = solve_inverse(problem, shape, [], 0.0, InverseOptions(developable=True, iterations=6))
    report = inverse_report(result)
    assert result.converged, result.reason
    assert report["largest_defect"] < 1e-8
    defects, sags = ([step[name] for step in report["developability"]] for name in ("defect", "sag"))
    assert defects[0] > 1e-5 and np.all(np.diff(defects) < 0.0)
    assert sags[0] < 1e-9 and sags[-1] < 1e-3
    rest = result.target.x + problem.motion(result.rest)
    flat = flatten(split(shape.triangles, rest))
    assert np.abs(flat.stretches - 1.0).max() < 1e-6


def test_a_shape_that_cannot_be_developable_is_refused():
    """Held all around its hem and waist with a bulge in between, nothing but the bulge can give: a sphere's cap."""
    shape = skirt()
    radius = 0.1
    n = shape.points
    n /= np.linalg.norm(n - [0, 0, -0.1], axis=1)[:, None] / radius
    shape.fixed[:] = True
    shape.fixed[60] = False
    target = Target(Problem(shape, MPI.COMM_SELF), shape, [], 0.0, 1e-3)
    with pytest.raises(NotConverged, match="no developable rest shape"):
        DevelopableRest(target, shape).set(target.rest.create())
