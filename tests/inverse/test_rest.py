"""The rest shape as unknowns: Taylor tests of dR/dX and of the parameters' derivatives."""

import numpy as np
import pytest
from inverse_shells import clamped_sheet, hanging_sheet, panels
from mpi4py import MPI

from voile.problem.problem import Problem
from voile.problem.rest import RestShape


def remainders(change, slope, steps=(1e-2, 1e-3, 1e-4)):
    """|R(h) - R(0) - h R'| for the steps h."""
    start = change(0.0)
    return np.array([np.linalg.norm(change(h) - start - h * slope) for h in steps])


def wave(problem, frequency, size):
    v = problem.create_vector()
    v.array[:] = size * np.sin(frequency * np.arange(problem.unknowns))
    return v


@pytest.mark.parametrize("bending", ["average", "sin", "tan", "theta"])
@pytest.mark.parametrize("build", [hanging_sheet, clamped_sheet, panels])
def test_the_residual_by_the_rest_shape_is_exact_to_second_order(bending, build):
    problem = Problem(build(bending=bending), MPI.COMM_SELF)
    rest = RestShape(problem)
    z, direction, y = (wave(problem, f, s) for f, s in ((1.0, 3e-4), (1.7, 1e-2), (2.3, 2e-4)))
    direction.array[~rest.is_vertex] = 0.0
    rest.set(z)
    matrix, slope = problem.create_matrix(), problem.create_vector()
    rest.jacobian(y, matrix)
    matrix.mult(direction, slope)

    def residual(h):
        shifted = z.copy()
        shifted.axpy(h, direction)
        rest.set(shifted)
        f = problem.create_vector()
        problem.residual(y, f)
        return f.array.copy()

    left = remainders(residual, slope.array.copy())
    assert left[0] < 0.3 * 1e-2 * slope.norm()
    np.testing.assert_allclose(np.log10(left[:-1] / left[1:]), 2.0, atol=0.1)


@pytest.mark.parametrize("build", [hanging_sheet, clamped_sheet, panels])
def test_pulling_without_the_matrix_is_its_transpose(build):
    problem = Problem(build(bending="tan"), MPI.COMM_SELF)
    rest = RestShape(problem)
    rest.set(wave(problem, 1.0, 3e-4))
    y, w, v = wave(problem, 2.3, 2e-4), wave(problem, 0.7, 1.0), wave(problem, 1.3, 1.0)
    v.array[~rest.is_vertex] = 0.0
    rest.linearise(y)
    alone = rest.pull(w)  # by the kernels' product
    pushed = rest.push(v)  # assembles
    assembled = rest.pull(w)
    assert abs(alone.dot(v) - pushed.dot(w)) < 1e-12 * alone.norm() * v.norm()
    assert (alone - assembled).norm() < 1e-13 * alone.norm()
    rest.set(wave(problem, 1.0, 6e-4))
    rest.linearise(y)
    assert (rest.pull(w) - assembled).norm() > 1e-3 * alone.norm()  # a new derivative, not the old matrix


@pytest.mark.parametrize("name", ["thickness", "young", "poisson", "density"])
def test_the_residual_by_each_parameter_is_exact_to_second_order(name):
    problem = Problem(hanging_sheet(bending="tan"), MPI.COMM_SELF)
    rest, y = RestShape(problem), wave(problem, 2.3, 2e-4)
    rest.set(wave(problem, 1.0, 3e-4))
    fabric = problem.part.fabric
    index = ("thickness", "young", "poisson", "density").index(name)
    value = fabric[index].copy()
    slope = rest.fabric_derivative(y, name).array.copy() * value[0]

    def residual(h):
        fabric[index] = (1.0 + h) * value
        problem.kernel.set_fabric(*(np.ascontiguousarray(row) for row in fabric[:3]))
        problem.set_rest(problem.part.rest_points)
        f = problem.create_vector()
        problem.residual(y, f)
        return f.array.copy()

    left = remainders(residual, slope, (1e-1, 1e-2, 1e-3))
    if name in ("young", "density"):  # the residual is linear in them
        assert left.max() < 1e-10 * np.linalg.norm(slope)
    else:
        np.testing.assert_allclose(np.log10(left[:-1] / left[1:]), 2.0, atol=0.15)
        assert left[0] < 0.2 * 1e-1 * np.linalg.norm(slope)


def test_masses_follow_the_rest_shape():
    problem = Problem(hanging_sheet(), MPI.COMM_SELF)
    rest = RestShape(problem)
    before = problem.loads.weight.sum()
    rest.base = 2.0 * rest.base
    rest.set(problem.create_vector())
    assert problem.loads.weight.sum() == pytest.approx(4.0 * before, rel=1e-12)
