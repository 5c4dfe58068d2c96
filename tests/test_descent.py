"""Descents: blends of the exact Hessian with the safe one, and lengths of steps that stretch."""

import numpy as np
import pytest
from mpi4py import MPI
from test_problem import make_shell, sheet

from voile.problem.imperfection import perturb
from voile.problem.problem import Problem
from voile.problem.rest import field_vector
from voile.solver.methods.descent import Descent, shorter
from voile.solver.methods.method import Workspace
from voile.solver.methods.steps import factor_definite


def hanging(cells: int):
    """A square cloth held at two corners of a side, flat as it starts."""
    points, triangles = sheet(cells, cells)
    corner = (points[:, 0] < 1e-9) & (
        abs(points[:, 1] - np.median(points[:, 1])) > 0.49 * np.ptp(points[:, 1])
    )
    assert corner.sum() == 2
    fixed = np.repeat(corner[:, None], 3, axis=1)
    return make_shell(points, triangles, fixed=fixed, clamped_edges=[])


@pytest.mark.parametrize("length", [1.0, 0.3])
@pytest.mark.parametrize("stretch", [0.7, 30.0, 1e4])
def test_a_step_is_cut_where_a_quartic_is_least(length, stretch):
    share = np.linspace(1e-4, 1.0, 100_001)
    along = -2.0 * (share - 0.5 * length * share**2) + stretch * share**4
    found = shorter(length, -2.0, float(along[-1]))
    assert abs(found - share[np.argmin(along)]) < 2e-5


def test_a_blend_holds_its_shares():
    problem = Problem(hanging(6), MPI.COMM_SELF)
    y, work = problem.create_vector(), Workspace(problem)
    y.array[:] = 1e-3 * np.random.default_rng(1).normal(size=y.getSize())
    matrices = []
    for kind, share in (("exact", 1.0), ("safe", 1.0), ("safe", 0.25)):
        factor_definite(work, problem, y, kind, share=share)
        matrices.append(work.matrix.getValuesCSR()[2])
    exact, safe, blend = matrices
    assert abs(exact - safe).max() > 1e-6 * abs(safe).max()
    np.testing.assert_allclose(blend, 0.75 * exact + 0.25 * safe, atol=1e-14 * abs(safe).max())


def test_a_cloth_folds_in_few_steps():
    problem = Problem(hanging(24), MPI.COMM_SELF)
    y, work = problem.create_vector(), Workspace(problem)
    perturb(problem, y, 1e-3 * problem.thickness())
    descent = Descent(work)
    assert descent.run(problem, y, 1e-8 * problem.load_norm(y))
    assert len(descent.steps) < 50 and problem.energy(y) < -0.7381


def test_short_steps_hold_back_only_what_goes_far():
    problem = Problem(hanging(6), MPI.COMM_SELF)
    y, work = problem.create_vector(), Workspace(problem)
    descent = Descent(work)
    assert not descent.run(problem, y, 1e-8 * problem.load_norm(y), 1)
    count = len(problem.vertex_mass())
    way = np.full((count, 3), 1e-4)
    way[5] = 1.0
    iteration = descent.iteration
    iteration.shift = np.zeros(count)
    iteration._adapt(0.05, field_vector(problem, way))
    held = np.flatnonzero(iteration.shift)
    assert held.tolist() == [5]
    once = iteration.shift[5]
    iteration._adapt(0.05, field_vector(problem, way))
    assert iteration.shift[5] == 4.0 * once
    values = []
    for shift in (0.0, iteration.shift):
        problem.tangent(y, work.matrix, shift=shift)
        values.append(work.matrix.getDiagonal().array.copy())
    added = values[1] - values[0]
    np.testing.assert_allclose(
        added[np.abs(added) > 1e-12 * abs(values[0]).max()], 4.0 * once * problem.vertex_mass()[5]
    )
    iteration._adapt(1.0, field_vector(problem, way))
    assert iteration.shift[5] == pytest.approx(0.4 * once) and not iteration.shift[:5].any()
