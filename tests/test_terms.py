"""Terms of the potential, the masses of sewn vertices, and what is prescribed in time."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
import scipy.sparse as sp
from hinges import crossings, fold_angles
from mpi4py import MPI
from test_problem import make_shell, sewn_panels, sheet, wavy

from voile.contact.motion import Motion
from voile.problem.constraints import build_constraints
from voile.problem.held import Supports
from voile.problem.inertia import Inertia
from voile.problem.load import Load
from voile.problem.problem import Problem
from voile.problem.rest import field_vector
from voile.problem.scales import slow_rate
from voile.solver.linear import factored
from voile.solver.methods.descent import Descent, Options
from voile.solver.methods.method import Workspace
from voile.solver.path import require
from voile.solver.statics import solve_statics

GRAVITY = 9.81  # m/s^2


def stitched() -> Problem:
    """Three triangles of 0.5 kg; a corner of the third is sewn to the middle of an edge of the first. Nothing held."""
    points = np.array(
        [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0.5, 0, 0], [0, -1, 0], [1, -1, 0]], dtype=float
    )
    triangles = np.array([[0, 1, 2], [0, 2, 3], [4, 5, 6]], dtype=np.int32)
    one = np.ones(3)
    shell = make_shell(
        points,
        triangles,
        thickness=1e-3 * one,
        density=1e3 * one,
        fixed=np.zeros_like(points, dtype=bool),
        slave=np.array([4], dtype=np.int32),
        first=np.array([0], dtype=np.int32),
        second=np.array([1], dtype=np.int32),
        weight=np.array([0.5]),
    )
    return Problem(shell, MPI.COMM_SELF)


def dense(matrix) -> np.ndarray:
    start, column, value = matrix.getValuesCSR()
    return sp.csr_matrix((value, column, start), shape=matrix.getSize()).toarray()


def test_a_stitch_of_weight_one_half_keeps_the_mass_and_falls_with_gravity():
    problem = stitched()
    matrix = problem.mass_matrix()
    fall = field_vector(problem, np.tile([0.0, 0.0, 1.0], (7, 1)))  # 1 m
    np.testing.assert_allclose(problem.motion(fall)[:, 2], 1.0)
    moved = fall.duplicate()
    matrix.mult(fall, moved)
    assert fall.dot(moved) == pytest.approx(1.5, rel=1e-14)
    assert problem.mass().dot(fall) == pytest.approx(1.5 - 1.0 / 12.0, rel=1e-14)  # the diagonal loses some
    force, acceleration = problem.create_vector(), problem.create_vector()
    problem.residual(force, acceleration)
    acceleration.copy(force)
    factored(matrix).solve(force, acceleration)
    np.testing.assert_allclose(problem.motion(acceleration)[:, :2], 0.0, atol=1e-12)
    np.testing.assert_allclose(problem.motion(acceleration)[:, 2], GRAVITY, rtol=1e-12)  # the residual's sign


def test_the_mass_matrix_is_that_of_all_vertices_through_the_seams():
    shell = sewn_panels()
    problem = Problem(shell, MPI.COMM_SELF)
    constraints, part = build_constraints(shell, directors=True), problem.part
    expected = (part.matrix.T @ sp.diags(part.mass) @ part.matrix).toarray()
    found = dense(problem.mass_matrix())
    np.testing.assert_allclose(found, expected, atol=1e-15 * abs(expected).max())
    np.testing.assert_array_equal(problem.mass().array_r, found.diagonal())
    held = constraints.fixed[: 3 * len(shell.points)].reshape(-1, 3).all(axis=1)
    along = np.zeros(found.shape[0])
    columns = part.matrix[: 3 * len(part.vertex)].indices
    along[np.unique(columns)] = 1.0  # all that is free, along all axes
    free = part.matrix @ along
    assert along @ found @ along == pytest.approx(part.mass @ free**2, rel=1e-14)
    assert held.any() and not held.all()


# ---- hinges ----


def folded(degrees: float) -> np.ndarray:
    """Two triangles that share the edge on the y axis; the one in x < 0 is turned about it out of the plane."""
    angle = np.radians(180.0 - degrees)
    flap = [np.cos(angle), 0.5, np.sin(angle)]
    return np.array([[0.0, 0.0, 0.0], [0.0, 1.0, 0.0], [1.0, 0.5, 0.0], flap])


def hinge(model: str) -> Problem:
    triangles = np.array([[0, 2, 1], [0, 1, 3]], dtype=np.int32)
    shell = make_shell(folded(0.0), triangles, model, fixed=np.zeros((4, 3), dtype=bool))
    return Problem(shell, MPI.COMM_SELF)


def displaced(problem: Problem, points: np.ndarray) -> np.ndarray:
    return (points - folded(0.0))[problem.part.vertex].ravel()


@pytest.mark.parametrize("model", ["koiter/average/stvk", "koiter/tan/stvk"])
@pytest.mark.parametrize(
    ("start", "end", "over"),
    [
        (0.0, 170.0, False),
        (-170.0, 0.0, False),
        (170.0, 175.0, False),
        (170.0, 190.0, True),
        (-170.0, -190.0, True),
        (90.0, 269.0, True),  # 179 degrees by way of 180, 181 by way of 0
        (90.0, 271.0, False),  # the other way round
        (179.95, 181.0, False),  # on which side it starts is not known
    ],
)
def test_a_hinge_that_turns_through_180_degrees_folds_over(model, start, end, over):
    problem = hinge(model)
    before, after = (displaced(problem, folded(angle)) for angle in (start, end))
    directors = np.zeros(len(problem.part.edge))
    assert problem.kernel.folds_over(before, directors, after, directors) == over


def test_the_longest_step_stops_a_hinge_before_180_degrees():
    problem = hinge("koiter/average/stvk")
    y, step = problem.create_vector(), problem.create_vector()
    free = problem.part.matrix.indices[:12]
    y.array[free] = displaced(problem, folded(120.0))
    step.array[free] = displaced(problem, folded(210.0)) - displaced(problem, folded(120.0))
    length = problem.longest_step(y, step)
    triangles = problem.part.corners
    start, end, over = (
        fold_angles(problem.positions(y + share * step), triangles) for share in (0.0, length, 1.0)
    )
    assert crossings(start, over) == 1 and crossings(start, end) == 0
    assert 0.25 <= length < 1.0
    assert problem.longest_step(y, 0.1 * step) == 1.0


# ---- terms ----


def test_a_problem_with_more_terms_leaves_the_first_as_it_is():
    problem = Problem(sewn_panels(), MPI.COMM_SELF)
    y = wavy(problem, 1e-3)
    x, energy = problem.positions(y), problem.energy(y)
    inertia = Inertia(problem.vertex_mass(), problem.own, 4.0, x - 0.1)
    step = problem.with_terms(inertia)
    assert step.energies(y)["inertia"] == pytest.approx(2.0 * problem.vertex_mass().sum() * 0.03, rel=1e-12)
    assert step.energy(y) == pytest.approx(energy + step.energies(y)["inertia"], rel=1e-12)
    assert problem.energy(y) == energy and "inertia" not in problem.energies(y)
    assert step.terms[:-1] == problem.terms and step.terms[-1] is inertia


def test_the_inertia_terms_derivatives():
    problem = Problem(sewn_panels(), MPI.COMM_SELF)
    y, direction = wavy(problem, 1e-3), wavy(problem, 0.1)
    rate = 100.0 * slow_rate(problem)
    step = problem.with_terms(Inertia(problem.vertex_mass(), problem.own, rate, problem.positions(0.5 * y)))
    plain, inertial = problem.create_matrix(), problem.create_matrix()
    problem.tangent(y, plain)
    step.tangent(y, inertial)
    np.testing.assert_allclose(
        dense(inertial) - dense(plain),
        rate * dense(problem.mass_matrix()) * problem_vertices(problem),
        atol=1e-9 * abs(dense(plain)).max(),
    )
    f, g = problem.create_vector(), problem.create_vector()
    problem.residual(y, f)
    step.residual(y, g)
    work = (g - f).dot(direction)
    ends = [step.energies(y + sign * direction)["inertia"] for sign in (1.0, -1.0)]
    assert 0.5 * (ends[0] - ends[1]) == pytest.approx(work, rel=1e-10)


def problem_vertices(problem: Problem) -> np.ndarray:
    """1 for pairs of unknowns that are displacements: directors have no inertia in time."""
    mark = np.zeros(problem.unknowns)
    mark[problem.part.matrix[: 3 * len(problem.part.vertex)].indices] = 1.0
    return np.outer(mark, mark)


# ---- in time ----


class Circle(Motion):
    """Round an axis through the centre at a constant rate: one turn in t = 1."""

    def turn(self, t):
        c, s = np.cos(2.0 * np.pi * t), np.sin(2.0 * np.pi * t)
        return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])

    @property
    def moves(self):
        return True


def test_supports_move_by_any_law_in_time():
    """One on a circle, one in proportion, and what is sewn half to each."""
    points = np.array([[1.0, 0.0, 0.0], [3.0, 0.0, 0.0]])
    shift = np.array([[0.2, 0.0, -0.4]])
    motions = [(np.array([0]), Circle()), (np.array([1]), Motion(displacement=shift))]
    carry = sp.csr_matrix(np.kron([[1.0, 0.0], [0.0, 1.0], [0.5, 0.5]], np.eye(3)))
    supports = Supports(points, motions, carry)
    moved = supports.between(0.25, 0.5).reshape(-1, 3)
    np.testing.assert_allclose(moved[0], [-1.0, -1.0, 0.0], atol=1e-15)
    np.testing.assert_allclose(moved[1], 0.25 * shift[0], atol=1e-16)
    np.testing.assert_allclose(moved[2], 0.5 * (moved[0] + moved[1]), atol=1e-15)
    last = supports.of(np.arange(6, 9))
    np.testing.assert_array_equal(last.between(0.25, 0.5), moved[2])
    second = supports.of(np.arange(3, 6))
    assert len(second.points) == 1 and supports.move and second.move
    np.testing.assert_array_equal(second.between(0.25, 0.5), moved[1])
    assert not supports.between(0.7, 0.7).any()


@dataclass(frozen=True)
class Always(Load):
    """In full from the start."""

    def factor(self, t):
        return 1.0


def test_each_load_has_its_own_law_in_time():
    points, triangles = sheet(4, 3)
    force = np.tile([0.0, 1e-3, 0.0], (len(points), 1))
    shell = make_shell(points, triangles, force=force, load_laws={"gravity": Always()})
    problem = Problem(shell, MPI.COMM_SELF).at(0.25)
    forces = problem.loads.forces(problem.point(problem.create_vector()))[: points.size].reshape(-1, 3)
    np.testing.assert_allclose(forces[:, 1], 0.25e-3, rtol=1e-15)
    np.testing.assert_allclose(
        forces[:, 2].sum(), -GRAVITY * problem.part.mass[: points.size : 3].sum(), rtol=1e-14
    )
    stiff = replace(shell, young=1e9 * np.ones(len(triangles)))
    path = require(solve_statics(Problem(stiff, MPI.COMM_SELF)))
    both = replace(stiff, load_laws={})
    again = require(solve_statics(Problem(both, MPI.COMM_SELF)))
    assert (path.state - again.state).norm() < 1e-6 * again.state.norm()


def test_descent_takes_the_terms_that_it_is_given():
    """A free sheet without gravity is held by inertia alone, at its predicted position."""
    points, triangles = sheet(4, 3)
    shell = make_shell(
        points, triangles, fixed=np.zeros_like(points, dtype=bool), gravity=np.zeros(3), clamped_edges=[]
    )
    problem = Problem(shell, MPI.COMM_SELF)
    moved = problem.part.points + np.array([0.1, -0.2, 0.3])
    step = problem.with_terms(Inertia(problem.vertex_mass(), problem.own, 1.0, moved))
    y = problem.create_vector()
    assert Descent(Workspace(step), Options(iterations=20)).solve(step, y, 1e-12).converged
    np.testing.assert_allclose(problem.positions(y), moved, atol=1e-10)
