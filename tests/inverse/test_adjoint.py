"""The adjoint method: gradient and Hessian by Taylor tests, and what it finds where the target is not stable."""

from pathlib import Path

import numpy as np
import pytest
from inverse_shells import grid, hanging_sheet, nearest_to, shell, strip
from mpi4py import MPI
from test_direct import heavy_strip, on_incline, solve

from voile.inverse.adjoint import minimise
from voile.inverse.direct import Direct
from voile.inverse.forward import Forward
from voile.inverse.objective import Change, Objective, scaled
from voile.inverse.reduced import Reduced
from voile.inverse.target import Target
from voile.inverse.verify import simulate
from voile.problem.problem import Problem


def sample(kind, comm=MPI.COMM_SELF):
    """A target and a rest shape near its own."""
    shape, plane = (
        on_incline(0.2, 0.6, young=1e4)
        if kind == "contact"
        else (hanging_sheet(young=2e8, bending=kind), None)
    )
    bodies = [plane] if plane else []
    problem = Problem(shape if comm.rank == 0 else None, comm)
    target = Target(problem, shape if comm.rank == 0 else None, bodies, 0.5e-3, 1e-3)
    return target


def wave(target, frequency, size):
    """A smooth rest displacement, the same for any number of ranks."""
    field = size * np.sin(frequency * target.x @ np.array([[20.0, 3, 5], [7, 30, 2], [3, 11, 25.0]]))
    return target.field_vector(field)


@pytest.mark.parametrize("kind", ["average", "tan", "contact"])
def test_the_gradient_is_that_of_the_objective(kind):
    target = sample(kind)
    home = Direct(target).follow().rest
    size = 1e-5 if kind == "contact" else 1e-4  # reactions stay inside their cones
    objective = nearest_to(
        target, target.rest, target.problem.create_vector(), target.rest.state(home), 0.1, 1e-10
    )
    z = home.copy()
    z.axpy(1.0, wave(target, 1.0, size))
    direction, gradient = wave(target, 1.7, size), z.duplicate()
    value = objective.evaluate(z, gradient)
    slope = gradient.dot(direction)
    steps, left = np.array([1e-1, 1e-2]), []
    for h in steps:
        there = z.copy()
        there.axpy(h, direction)
        left.append(abs(objective.evaluate(there, there.duplicate()) - value - h * slope))
    np.testing.assert_allclose(np.log10(left[0] / left[1]), 2.0, atol=0.15)
    ahead, back = z.copy(), z.copy()
    ahead.axpy(1e-2, direction)
    back.axpy(-1e-2, direction)
    difference = objective.evaluate(ahead, z.duplicate()) - objective.evaluate(back, z.duplicate())
    assert difference / 2e-2 == pytest.approx(slope, rel=1e-6)


def test_the_hessian_is_symmetric_and_that_of_a_linear_map():
    target = sample("average")
    target.load(1.0)
    zero = target.problem.create_vector()
    objective = nearest_to(target, target.rest, zero, zero, regularisation=0.01, accuracy=1e-10)
    objective.simulate(zero)
    v, w = wave(target, 1.0, 1e-4), wave(target, 1.7, 1e-4)
    hv, hw = v.duplicate(), w.duplicate()
    objective.mult(None, v, hv)
    objective.mult(None, w, hw)
    assert v.dot(hw) == pytest.approx(w.dot(hv), rel=1e-9)
    objective.shift(None, 0.5)
    objective.mult(None, v, hw)
    assert (hw - hv - 0.5 * v).norm() < 1e-12 * v.norm()
    moved = objective.state.copy()
    ahead = zero.copy()
    ahead.axpy(1e-3, v)
    objective.simulate(ahead)
    moved.axpby(1e3, -1e3, objective.state)  # dx/dz v
    distance, change = objective.objectives
    expected = moved.dot(scaled(distance.weight, moved)) + 0.01 * v.dot(scaled(change.metric, v))
    assert v.dot(hv) == pytest.approx(expected, rel=1e-2)


def test_a_column_that_cannot_stand_is_brought_as_near_as_it_can():
    shape, _ = heavy_strip(9.0, upwards=True, cells=20)
    result = solve(shape, iterations=10, method="tao")
    assert result.direct.critical == pytest.approx(7.837 / 9.0, rel=0.03)
    assert result.adjoint is not None and result.stable and result.simulation.stable
    assert result.simulation.sag < 0.9 * result.adjoint.steps[0].sag
    assert "nearest stable answer" in result.reason


@pytest.mark.parametrize("kind", ["tan", "contact"])
def test_the_first_equilibrium_is_sought_by_all_means(kind, monkeypatch):
    """Where the short descent of later ones does not end."""
    target, found = sample(kind), []
    home = Direct(target).follow().rest
    z = home.copy()
    z.axpy(1.0, wave(target, 1.0, 1e-5))
    for solve_short in (Forward.solve, lambda *_: False):
        monkeypatch.setattr(Forward, "solve", solve_short)
        target.rest.set(home)  # masses weigh the distance
        objective = nearest_to(target, target.rest, home, target.rest.state(home), 0.1, 1e-10)
        found.append(objective.evaluate(z, z.duplicate()))
    assert found[1] == pytest.approx(found[0], rel=1e-8) and found[0] > 0.0


@pytest.mark.parametrize("kind", ["bnls", "bqnls", "blmvm", "bntr", "nls"])
def test_taos_types_can_be_chosen(kind):
    from petsc4py import PETSc

    shape = strip(8, 0.3, 0.05, young=5e8)
    problem = Problem(shape, MPI.COMM_SELF)
    target = Target(problem, shape, [], 0.0, 1e-3)
    target.load(1.0)
    missed = target.rest.weight()
    PETSc.Options().setValue("inverse_tao_type", kind)
    try:
        path = minimise(target, problem.create_vector(), 0.0, 30)
    finally:
        PETSc.Options().delValue("inverse_tao_type")
    assert path.steps[-1].objective < 0.1 * path.steps[0].objective
    best = min(step.objective for step in path.steps)  # what is returned, whatever TAO ends with
    missed.pointwiseMult(missed, path.state)
    assert 0.5 * path.state.dot(missed) / problem.size() ** 2 == pytest.approx(best, rel=1e-6)


@pytest.mark.parametrize("kind", ["average", "tan", "contact", "panels"])
def test_ranks_have_the_same_gradient_and_hessian(kind, script_on):
    figures = []
    for ranks in (1, 2):
        told = script_on(ranks, Path(__file__).parent / "gradient.py", kind)
        figures.append([float(word) for word in told.split()])
        assert figures[-1].pop() == pytest.approx(2.0, abs=0.2)  # order of the Taylor remainder
    np.testing.assert_allclose(figures[1], figures[0], rtol=1e-7)
    assert all(figures[0])


class Lift(Objective):
    """A new objective: the mean displacement of the lowest vertices is to be `height` (m) upwards."""

    def __init__(self, target, height):
        self.height, self.down = height, target.problem.create_vector()
        lowest = target.x[:, 1] < target.x[:, 1].min() + 1e-9
        self.down.axpy(1.0 / lowest.sum(), target.field_vector(lowest[:, None] * np.array([0.0, 1.0, 0.0])))

    def missed(self, y):
        return self.down.dot(y) - self.height

    def value(self, y, z):
        return 0.5 * self.missed(y) ** 2

    def by_state(self, y, z):
        return self.missed(y) * self.down

    def along_state(self, dy):
        return self.down.dot(dy) * self.down


def test_a_new_objective_is_one_class():
    target = sample("average")
    target.load(1.0)
    zero = target.problem.create_vector()
    height = -0.02 * target.problem.size()
    lift = Lift(target, height)
    steady = Change(target, target.rest, zero, 1e-6)
    reduced = Reduced(target, target.rest, [lift, steady], zero, 1e-10)
    z, direction = wave(target, 1.0, 1e-4), wave(target, 1.7, 1e-4)
    gradient, ends = z.duplicate(), []
    reduced.evaluate(z, gradient)
    for h in (1e-2, -1e-2):
        ends.append(reduced.evaluate(z + h * direction, z.duplicate()))
    assert (ends[0] - ends[1]) / 2e-2 == pytest.approx(gradient.dot(direction), rel=1e-6)
    path = minimise(target, zero, 0.0, 20, objectives=[lift, steady])
    assert abs(lift.missed(path.state)) < 1e-3 * abs(height)
    assert lift.missed(zero) == -height


def test_a_strip_that_nothing_can_hold_ends_no_farther_than_as_its_own_rest_shape():
    """Iterates whose mean distance from the target falls have a tip that sags more than with no search at all."""
    points, triangles = grid(14, 3, 0.3, 0.06)
    s = points[:, 0]
    arc = np.column_stack([0.3 * np.sin(s / 0.3), points[:, 1], 0.3 * (np.cos(s / 0.3) - 1.0)])
    held = np.repeat(s[:, None] < 0.022, 3, axis=1)
    result = solve(shell(arc, triangles, held, bending="average", young=1e5, density=300.0), iterations=8)
    assert result.adjoint is not None and result.simulation.stable
    result.target.release()
    own = simulate(result.target, result.target.problem.create_vector(), 1e-8)
    assert own.stable and result.simulation.sag <= own.sag
