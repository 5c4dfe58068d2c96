"""The quick rows of scripts/extremes, and what keeps the solver honest there."""

import sys
from dataclasses import replace
from importlib.machinery import SourceFileLoader
from importlib.util import module_from_spec, spec_from_loader
from pathlib import Path

import numpy as np
import pytest
from command_line import voile
from mpi4py import MPI
from petsc4py import PETSc

from voile.elastic import model_name
from voile.problem.problem import Problem
from voile.problem.scales import round_off
from voile.problem.shell import Shell
from voile.solver.methods.method import Workspace
from voile.solver.methods.steps import factor, factor_definite
from voile.solver.path import StaticsOptions
from voile.solver.statics import solve_statics


def script():
    """The module of scripts/extremes, which has no suffix."""
    path = Path(__file__).parents[1] / "scripts" / "extremes"
    spec = spec_from_loader("extremes", SourceFileLoader("extremes", str(path)))
    assert spec and spec.loader
    sys.modules["extremes"] = module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


EXTREMES = script()
QUICK = [row for row in EXTREMES.all_rows() if row.quick]


@pytest.mark.parametrize("row", QUICK, ids=lambda row: row.name)
def test_extreme(row, tmp_path, capfd):
    outcome = EXTREMES.run(row, tmp_path, voile)
    assert not outcome.wrong, outcome
    assert not capfd.readouterr().err  # what PETSc itself would print
    assert outcome.converged == (not row.says)


def test_a_wrong_word_is_caught(tmp_path):
    """The script's own check: a shape solved for other weights is no equilibrium of the row's."""
    row = next(row for row in QUICK if row.name.startswith("cloth held"))
    assert not EXTREMES.run(row, tmp_path, voile).wrong
    with EXTREMES.read_result(tmp_path / "out") as result:
        summary = EXTREMES.json.loads((tmp_path / "out" / "summary.json").read_text())
        heavier = replace(row, gravity=(0.0, 0.0, -9.82))
        assert "not an equilibrium" in EXTREMES._check(heavier, result, summary)[0]
        assert "called converged" in EXTREMES._check(row, result, {**summary, "residual_norm": 1.0})[0]


def strip(cells: int = 10, **changed) -> Shell:
    """A strip of 20 m x 1 m held at one end, its other end to be lifted by a small force: stiff and far moved."""
    points, triangles = EXTREMES.sheet(20.0, 1.0, cells, 2)
    one = np.ones(len(triangles))
    fixed = np.repeat((points[:, 0] <= 20.0 / cells)[:, None], 3, axis=1)
    force = np.where(points[:, :1] > 19.99, [[0.0, 0.0, 0.05]], 0.0)
    shell = Shell(
        points,
        triangles.astype(np.int32),
        points,
        triangles.astype(np.int32),
        True,
        model_name("koiter", "tan", "stvk"),
        0.03 * one,
        21e6 * one,
        0.0 * one,
        one,
        fixed,
        np.zeros_like(points),
        force=force,
    )
    return replace(shell, **changed)


def test_rebase_changes_no_shape_and_no_force():
    problem = Problem(strip(), MPI.COMM_SELF)
    y, before, after = (problem.create_vector() for _ in range(3))
    y.array[:] = 1e-3 * np.sin(np.arange(problem.unknowns))
    problem.residual(y, before)
    shape, energies = problem.local(y), problem.energies(y)
    problem.move_origin(y)
    y.set(0.0)
    problem.residual(y, after)
    for old, new in zip(shape, problem.local(y), strict=True):
        assert np.abs(old - new).max() <= 1e-15
    assert problem.energies(y) == pytest.approx(energies, rel=1e-10, abs=1e-18)
    after.axpy(-1.0, before)
    assert after.norm() <= 1e-9 * before.norm()


def test_rebase_resolves_what_large_displacements_hide():
    """Far from the start the last place of a displacement is worth more than the tolerance; near zero it is not."""
    problem = Problem(strip(), MPI.COMM_SELF)
    asked = StaticsOptions(load_steps=4, tolerance=1e-7)  # at 1e-8 the path may have moved its origin already
    path = solve_statics(problem, asked)
    assert path.converged, path.reason
    last, residual = path.steps[-1], problem.create_vector()
    assert last.tolerance == pytest.approx(asked.tolerance * problem.load_norm(path.state))
    problem.residual(path.state, residual)
    assert residual.norm() == pytest.approx(last.residual) and last.residual <= last.tolerance
    stored = round_off(problem, path.state)[0]
    assert stored > 0.1 * last.tolerance
    problem.move_origin(path.state)
    path.state.scale(1e-12)
    assert round_off(problem, path.state)[0] <= 1e-9 * stored


def test_a_failed_factorisation_does_not_spoil_the_next():
    """A single flat triangle has no stiffness out of its plane: the first matrix is singular, a shifted one is not."""
    points, triangles = EXTREMES.triangle((0, 0, 0), (1, 0, 0), (0.5, 1, 0))
    one = np.ones(1)
    fixed = np.array([[True] * 3, [True] * 3, [False] * 3])
    model = model_name("membrane", "tan", "stvk")
    corners = triangles.astype(np.int32)
    shell = Shell(
        points, corners, points, corners, True, model, one, one, 0.3 * one, one, fixed, np.zeros((3, 3)),
        gravity=np.array([0.0, 0.0, -1e-3]),
    )  # fmt: skip
    problem = Problem(shell, MPI.COMM_SELF)
    work = Workspace(problem)
    y, linear = problem.create_vector(), work.symmetric
    assert factor(work, problem, y, "exact").negative and not linear.usable
    assert not factor_definite(work, problem, y, "exact", 1.0).negative and linear.usable
    right, found = y.duplicate(), y.duplicate()
    right.set(1.0)
    linear.solve(right, found)
    product = y.duplicate()
    work.matrix.mult(found, product)
    product.axpy(-1.0, right)
    assert product.norm() <= 1e-12 * right.norm() and found.norm(PETSc.NormType.INFINITY) > 0.0


def test_tolerance_without_loads_is_that_of_the_reactions():
    points, triangles = EXTREMES.sheet(1.0, 1.0, 4, 4)
    ends = np.isclose(points[:, 0], 0.0) | np.isclose(points[:, 0], 1.0)
    one = np.ones(len(triangles))
    shell = strip(
        points=points,
        triangles=triangles.astype(np.int32),
        rest_points=points,
        rest_triangles=triangles.astype(np.int32),
        thickness=1e-3 * one,
        young=1e6 * one,
        poisson=0.3 * one,
        density=one,
        fixed=np.repeat(ends[:, None], 3, axis=1),
        motion=np.where(np.isclose(points[:, :1], 1.0), [[0.1, 0.0, 0.0]], 0.0),
        force=None,
        topology=None,
    )
    problem = Problem(shell, MPI.COMM_SELF)
    path = solve_statics(problem)
    assert path.converged, path.reason
    assert problem.load_norm(path.state) == 0.0
    assert path.steps[-1].residual <= 1.0001e-8 * problem.reaction_norm(path.state)
