"""The distributed problem: its derivatives, seams, supports, and the solvers on it."""

import tracemalloc

import numpy as np
import pytest
from mpi4py import MPI

from voile import _kernels
from voile.errors import InputError
from voile.problem.clamps import held_directors
from voile.problem.constraints import build_constraints
from voile.problem.problem import Problem
from voile.problem.scales import slow_rate
from voile.problem.shell import Shell, hilbert_order
from voile.solver.linear import Counts, factored, negative_pivots
from voile.solver.methods.descent import Descent
from voile.solver.methods.method import Workspace
from voile.solver.methods.mixed_newton import MixedNewton
from voile.solver.path import StaticsOptions
from voile.solver.stability import smallest_eigenpair
from voile.solver.statics import solve_statics

MODELS = ["koiter/tan/stvk", "koiter/average/neo-hookean", "discrete-shells//", "membrane//neo-hookean"]


def sheet(nx: int, ny: int, length: float = 1.0, width: float = 0.5) -> tuple[np.ndarray, np.ndarray]:
    """A rectangle in z = 0 with alternating diagonals."""
    x, y = np.meshgrid(np.linspace(0, length, nx + 1), np.linspace(0, width, ny + 1), indexing="ij")
    points = np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])
    triangles = []
    for i in range(nx):
        for j in range(ny):
            a = i * (ny + 1) + j
            b, c, d = a + ny + 1, a + ny + 2, a + 1
            triangles += [[a, b, c], [a, c, d]] if (i + j) % 2 else [[a, b, d], [b, c, d]]
    return points, np.array(triangles, dtype=np.int32)


def make_shell(points, triangles, model="koiter/tan/stvk", **given) -> Shell:
    """A cotton-like shell, its left edge (x = 0) clamped, unless given otherwise."""
    one = np.ones(len(triangles))
    values = {
        "rest_points": points,
        "rest_triangles": triangles,
        "flat": False,
        "thickness": 1e-3 * one,
        "young": 1e6 * one,
        "poisson": 0.3 * one,
        "density": 300.0 * one,
        "fixed": np.repeat(points[:, :1] < 1e-9, 3, axis=1),
        "motion": np.zeros_like(points),
        "gravity": np.array([0.0, 0.0, -9.81]),
    }
    shell = Shell(points=points, triangles=triangles, model=model, **(values | given))
    if "fixed" not in given:
        shell.clamped_edges = np.flatnonzero(shell.fixed[shell.topology.edges].all(axis=(1, 2)))
    return shell


def sewn_panels() -> Shell:
    """Two panels 4 cm apart, sewn along an edge of unlike resolution, the first one held at its far edge."""
    points, triangles = sheet(5, 4)
    other, more = sheet(5, 6)
    points = np.concatenate([points, other + np.array([1.04, 0.0, 0.0])])
    triangles = np.concatenate([triangles, more + 30]).astype(np.int32)
    right = np.arange(25, 30)  # of the first panel, y = 0 ... 0.5 in 5 points
    left = 30 + np.arange(7)
    y = points[left, 1] / 0.125
    first = np.minimum(y.astype(int), 3)
    return make_shell(
        points,
        triangles,
        slave=left.astype(np.int32),
        first=right[first].astype(np.int32),
        second=right[first + 1].astype(np.int32),
        weight=y - first,
    )


def wavy(problem: Problem, size: float):
    """Deterministic unknowns of a given size."""
    y = problem.create_vector()
    begin, end = y.getOwnershipRange()
    y.array[:] = size * np.sin(1.7 * np.arange(begin, end) + 0.3)
    return y


def cases() -> dict[str, Shell]:
    points, triangles = sheet(4, 3)
    bent = points + np.column_stack([0 * points[:, 0], 0 * points[:, 0], 0.1 * np.sin(3 * points[:, 0])])
    found = {model: make_shell(bent, triangles, model) for model in MODELS}
    found["pressure"] = make_shell(bent, triangles, pressure=50.0)
    rim = np.zeros(len(points), dtype=bool)
    rim[np.unique(found["pressure"].topology.edges[found["pressure"].topology.boundary_edges])] = True
    found["pressure"].fixed[rim] = True
    hinged = make_shell(bent, triangles)
    hinged.clamped_edges = np.zeros(0, dtype=np.int32)
    found["hinged"] = hinged
    slides = make_shell(points, triangles)
    slides.fixed[:, 0] |= points[:, 0] > 1 - 1e-9
    far = slides.fixed[slides.topology.edges][:, :, 0].all(axis=1)
    slides.clamped_edges = np.flatnonzero(far)
    found["sliding clamp"] = slides
    found["sewn"] = sewn_panels()
    found["dead force"] = make_shell(bent, triangles, force=0.01 * np.cos(np.arange(60.0)).reshape(20, 3))
    return found


@pytest.mark.parametrize("name", cases())
def test_residual_and_tangent_are_derivatives(name):
    problem = Problem(cases()[name], MPI.COMM_SELF)
    assert problem.conservative
    y, direction = wavy(problem, 1e-3), wavy(problem, 1.0)
    direction.array[:] = np.cos(direction.array * 40.0)
    residual, moved = problem.create_vector(), problem.create_vector()
    matrix = problem.create_matrix()
    problem.residual(y, residual)
    problem.tangent(y, matrix)
    bent = problem.create_vector()
    matrix.mult(direction, bent)
    slope, curvature = residual.dot(direction), bent.dot(direction)
    errors = []
    for step in (2e-5, 1e-5):
        energies, change = [], problem.create_vector()
        for sign in (1, -1):
            moved.waxpy(sign * step, direction, y)
            energies.append(problem.energy(moved))
            f = problem.create_vector()
            problem.residual(moved, f)
            change.axpy(sign / (2 * step), f)
        central = (energies[0] - energies[1]) / (2 * step)
        change.axpy(-1.0, bent)
        errors.append((abs(central - slope) / abs(slope), change.norm() / bent.norm()))
    assert errors[1][0] < 1e-4 and errors[1][1] < 1e-4
    for k in (0, 1):
        assert errors[0][k] / max(errors[1][k], 1e-300) > 3.0 or errors[1][k] < 1e-8
    transposed = problem.create_vector()
    matrix.multTranspose(direction, transposed)
    transposed.axpy(-1.0, bent)
    assert transposed.norm() < 1e-12 * bent.norm()
    assert np.isfinite(curvature)


def test_seams_are_exact():
    shell = sewn_panels()
    problem = Problem(shell, MPI.COMM_SELF)
    u, _ = problem.local(wavy(problem, 0.01))
    x = np.zeros_like(shell.points)
    x[problem.part.vertex] = problem.part.points + u.reshape(-1, 3)
    w = shell.weight[:, None]
    assert abs(x[shell.slave] - (1 - w) * x[shell.first] - w * x[shell.second]).max() < 1e-15
    assert abs(x[shell.fixed] - shell.points[shell.fixed]).max() == 0.0


def test_a_support_sewn_to_a_panel_carries_it():
    shell = sewn_panels()
    shell.fixed[:] = False
    shell.fixed[shell.slave[2]] = True
    constraints = build_constraints(shell, directors=False)
    held = constraints.fixed[: shell.points.size].reshape(-1, 3).all(axis=1)
    assert held[shell.slave[2]] and held[shell.first[2]] and held[shell.second[2]]


def test_prescribed_motion_follows_the_load_factor():
    points, triangles = sheet(4, 2)
    shell = make_shell(points, triangles, gravity=np.zeros(3))
    shell.motion[:] = [0.1, -0.2, 0.3]
    problem = Problem(shell, MPI.COMM_SELF)
    problem = problem.at(0.5)
    u, _ = problem.local(problem.create_vector())
    held = shell.fixed[problem.part.vertex, 0]
    assert np.allclose(u.reshape(-1, 3)[held], [0.05, -0.1, 0.15], atol=1e-16)


def test_a_point_is_the_same_while_nothing_changes():
    """Terms know by it what they have found there: unknowns, time and what displacements count from all matter."""
    points, triangles = sheet(4, 2)
    problem = Problem(make_shell(points, triangles), MPI.COMM_SELF)
    y = problem.create_vector()
    y.array[:] = 1e-3 * np.sin(np.arange(len(y.array)))
    at, again = problem.point(y), problem.with_terms().point(y.copy())
    assert at is again and not at.positions.flags.writeable
    assert problem.at(0.5).point(y) is not at and problem.with_passing_hinges().point(y).passes
    before = problem.point(y)
    y.array[3] += 1e-18
    assert problem.point(y) is not before
    x, zero = problem.positions(y), problem.create_vector()
    problem.point(zero)
    problem.move_origin(y)
    assert abs(problem.positions(y) - x).max() < 1e-16
    problem.reset_origin(y)
    assert abs(problem.positions(y) - x).max() < 1e-16


def test_a_clamp_that_may_tilt_is_refused():
    points, triangles = sheet(4, 2)
    shell = make_shell(points, triangles)
    shell.fixed[:, 1:] = False
    tilted = shell.points @ np.array([[0.8, 0.6, 0], [-0.6, 0.8, 0], [0, 0, 1.0]])
    shell.points[:] = tilted
    shell.clamped_edges = np.flatnonzero(shell.fixed[shell.topology.edges][:, :, 0].all(axis=1))
    with pytest.raises(InputError, match="clamped but may slide"):
        held_directors(shell)


@pytest.mark.parametrize("model", MODELS[:3])
def test_fast_steps_and_descent_find_the_same_equilibrium(model):
    points, triangles = sheet(8, 4)
    found = []
    for fast in (True, False):
        problem = Problem(
            make_shell(
                points, triangles, model, young=2e10 * np.ones(len(triangles)), gravity=np.array([0, 0, -2.0])
            ),
            MPI.COMM_SELF,
        )
        method = (MixedNewton if fast else Descent)(Workspace(problem))
        y = problem.create_vector()
        snes = method.nonlinear.snes
        method.solve(problem, y, 1e-5 * problem.load_norm(y))
        assert snes.getConvergedReason() > 0
        found.append((problem.energy(y), problem.local(y)[0], snes.getIterationNumber()))
    assert abs(found[0][0] - found[1][0]) < 1e-7 * abs(found[0][0])
    assert abs(found[0][1] - found[1][1]).max() < 1e-5
    assert found[0][2] < 15


def test_smallest_eigenvalue_agrees_with_the_inertia():
    points, triangles = sheet(6, 3)
    problem = Problem(make_shell(points, triangles), MPI.COMM_SELF)
    matrix, y = problem.create_matrix(), problem.create_vector()
    problem.tangent(y, matrix)
    pc = factored(matrix).ksp.pc
    counts = Counts()
    value, mode = smallest_eigenpair(problem, matrix, slow_rate(problem), counts)
    assert negative_pivots(pc) == 0 and value > 0
    assert counts.factorisations == 1  # SLEPc factored the shift again
    image, mass = problem.create_vector(), problem.mass()
    matrix.mult(mode, image)
    weighted = problem.create_vector()
    weighted.pointwiseMult(mass, mode)
    assert abs(image.dot(mode) / weighted.dot(mode) - value) < 1e-5 * value


def test_a_buckled_strip_ends_in_a_stable_state():
    """A straight strip on end, far heavier than its buckling load: the straight state is a saddle."""
    points, triangles = sheet(12, 2, width=0.1)
    shell = make_shell(
        points, triangles, gravity=np.array([-9.81, 0.0, 0.0]), young=2e7 * np.ones(len(triangles))
    )
    problem = Problem(shell, MPI.COMM_SELF)
    path = solve_statics(problem, StaticsOptions(load_steps=4))
    assert path.converged and path.stable
    u, _ = problem.local(path.state)
    assert abs(u.reshape(-1, 3)[:, 2]).max() > 0.1


def test_a_saddle_that_is_met_is_called_one():
    """The same strip, straight, where Newton's steps lead from the start: refused, and not for its residual."""
    points, triangles = sheet(12, 2, width=0.1)
    shell = make_shell(
        points, triangles, gravity=np.array([-9.81, 0.0, 0.0]), young=2e7 * np.ones(len(triangles))
    )
    problem = Problem(shell, MPI.COMM_SELF)
    y = problem.create_vector()
    outcome = MixedNewton(Workspace(problem)).solve(problem, y, 1e-8 * problem.load_norm(y))
    assert not outcome.converged and outcome.norm <= 1e-8 * problem.load_norm(y)
    assert "misses" not in outcome.reason and "not positive definite" in outcome.reason


def test_the_load_path_reports_what_it_did():
    points, triangles = sheet(6, 3)
    problem = Problem(make_shell(points, triangles, young=1e8 * np.ones(len(triangles))), MPI.COMM_SELF)
    seen = []
    path = solve_statics(
        problem, StaticsOptions(load_steps=4), on_step=lambda step, y: seen.append(step.factor)
    )
    assert path.converged and seen[-1] == 1.0 and seen == sorted(seen)
    assert [s.factor for s in path.steps] == seen
    assert all(s.residual <= s.tolerance for s in path.steps)


def test_too_few_steps_keep_the_last_good_state():
    points, triangles = sheet(6, 3)
    problem = Problem(make_shell(points, triangles, young=1e8 * np.ones(len(triangles))), MPI.COMM_SELF)
    path = solve_statics(problem, StaticsOptions(load_steps=40, max_steps=2))
    assert not path.converged and "max_steps" in path.reason
    assert path.steps and np.isfinite(path.state.norm()) and path.state.norm() > 0


def test_hilbert_order_keeps_neighbours_together():
    points, _ = sheet(32, 32, 1.0, 1.0)
    order = hilbert_order(points)
    assert sorted(order) == list(range(len(points)))
    steps = np.linalg.norm(np.diff(points[order], axis=0), axis=1)
    assert np.mean(steps) < 1.5 / 32


def test_the_pattern_of_a_matrix_is_not_kept():
    """It is as large as a third of the matrix."""
    points, triangles = sheet(40, 40)
    problem = Problem(make_shell(points, triangles), MPI.COMM_SELF)
    tracemalloc.start()
    matrix = problem.create_matrix()
    kept = tracemalloc.get_traced_memory()[0]
    tracemalloc.stop()
    assert kept < 0.1 * 4 * matrix.getInfo()["nz_used"]
    again = problem.create_matrix()
    for one in matrix, again:
        problem.tangent(problem.create_vector(), one)
    assert matrix.equal(again)


@pytest.mark.parametrize(
    "model", ["koiter/tan/stvk", "koiter/average/stvk", "membrane//stvk", "projective//"]
)
def test_only_models_with_directors_have_degrees_of_freedom_for_them(model):
    shell = make_shell(*sheet(3, 2), model=model)
    problem, edges = Problem(shell), len(shell.topology.edges)
    assert len(problem.part.edge) == (edges if problem.directors else 0)
    dofs = 3 * len(shell.points) + len(problem.part.edge)
    assert problem.part.matrix.shape[0] == len(problem.forces(problem.create_vector())) == dofs


def test_a_kernel_with_directors_needs_edges():
    shell = make_shell(*sheet(3, 2))
    top, none = shell.topology, np.full(shell.triangles.shape, -1, dtype=np.int32)
    with pytest.raises(ValueError, match="directors need edges"):
        _kernels.Elastic(shell.model, shell.triangles, none, top.signs, top.across, 0, shell.points)
