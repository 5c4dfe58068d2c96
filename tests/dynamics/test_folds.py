"""Cloth without self-contact that folds flat and on through 180 degrees."""

import numpy as np
import pytest
from moving import cloth, move
from mpi4py import MPI
from test_problem import sheet

from voile.contact.obstacles import Plane
from voile.problem.problem import Problem
from voile.problem.rest import field_vector

POINTS, TRIANGLES = sheet(6, 3, 0.3, 0.15)
POINTS = POINTS - POINTS.mean(axis=0)


def folded(angle: float) -> np.ndarray:
    """The sheet, bent a little along y, with its half x > 0 turned by an angle about the y axis."""
    x, y, _ = POINTS.T
    bent = np.column_stack([x, y, 0.5 * y**2])
    right = np.column_stack([x * np.cos(angle), y, x * np.sin(angle) + 0.5 * y**2])
    return np.where((x > 1e-9)[:, None], right, bent)


@pytest.mark.parametrize("model", ["koiter/average/stvk", "koiter/sin/neo-hookean", "discrete-shells//"])
def test_a_hinge_goes_on_through_180_degrees(model):
    """Force and energy belong together on the way from 170 to 190 degrees; at 270 it has folded to the other side."""
    problem = Problem(cloth(POINTS, TRIANGLES, model=model), MPI.COMM_SELF).with_passing_hinges()
    elastic = problem.elastic

    def at(degrees):
        y = field_vector(problem, folded(np.radians(degrees)) - POINTS)
        return y, sum(elastic.energies(problem.point(y)).values())

    elastic.take_sides(elastic.sides_at(problem.point(at(170.0)[0])))
    assert set(np.unique(elastic.sides)) == {-1, 0} or set(np.unique(elastic.sides)) == {0, 1}
    f, step = problem.create_vector(), 1e-3
    for degrees in (175.0, 180.0 - step / 2, 180.0, 185.0):
        y = at(degrees)[0]
        (before, less), (after, more) = at(degrees - step), at(degrees + step)
        elastic_forces = problem.layout.collect(elastic.forces(problem.point(y)))
        f.array[:] = -elastic_forces
        after.axpy(-1.0, before)
        assert more - less == pytest.approx(f.dot(after), rel=1e-4, abs=1e-4 * abs(more) * np.radians(step))
    here = elastic.sides_at(problem.point(at(200.0)[0]))
    assert np.array_equal(here, elastic.sides)
    elastic.take_sides(here)
    there = elastic.sides_at(problem.point(at(280.0)[0]))
    assert not there.any()


def test_cloth_lies_folded_on_a_floor():
    """Both layers lie on it, their hinges at 180 degrees to the last digit; round-off chose their sign."""
    ground = Plane(point=np.zeros(3), normal=np.array([0.0, 0.0, 1.0]), friction=0.1)
    shape = folded(np.radians(150.0))
    shape[:, 2] -= shape[:, 2].min()
    shell = cloth(shape, TRIANGLES, rest_points=POINTS, model="koiter/average/stvk", young=2e4)
    run = move(shell, "implicit-euler", 5e-3, 1.0, 0.0, [ground], tolerance=1e-6)
    assert run.path.converged and run.path.attempts == run.path.count
    assert run.end[:, 2].max() < 1e-12
    assert run.solver.counts.factorisations < 5 * run.path.count
    assert abs(run.path.books.error) < 1e-8 * run.path.books.most
