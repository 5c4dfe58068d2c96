"""Multigrid over coarser levels of the mesh: the same equilibria as with factors, on one rank and two; where it is not
allowed."""

import sys

import numpy as np
import pytest
from everyday import generator

from voile import read, run
from voile.api import modelled
from voile.errors import InputError
from voile.mesh import write_obj
from voile.problem.levels import coarsen
from voile.problem.problem import Problem
from voile.problem.transfer import smooth_weights, transfers
from voile.scene import read_scene
from voile.solver import multigrid
from voile.solver.linear import factored
from voile.solver.methods.method import Workspace

CHOLESKY = "-pc_type", "cholesky"
MULTIGRID = "-pc_type", "mg"

SCENE = """
[shell]
mesh = "plate.obj"
young = 1e6
poisson = 0.3
thickness = 0.01
density = 100.0

[loads]
gravity = [0.0, 0.0, -0.1]

[[fix]]
select = { box = [[-0.01, -1.0, -1.0], [0.001, 2.0, 1.0]] }
clamp = true

[[fix]]
select = { box = [[0.999, -1.0, -1.0], [1.01, 2.0, 1.0]] }
MOVE
[statics]
load_steps = 1
tolerance = 1e-10
"""


def scene(folder, size: float, move: str = "", more: str = "", **shape):
    """A square of 1 m that sags between a clamped edge and one that is held, and may move."""
    write_obj(folder / "plate.obj", *generator("plate").plate(1.0, 1.0, size, **shape))
    path = folder / "scene.toml"
    path.write_text(SCENE.replace("MOVE", move) + more)
    return path


def test_the_same_equilibrium_as_with_factors(tmp_path, mpirun):
    """Directors, large turns, stability; two ranks."""
    path = scene(tmp_path, 1 / 46)
    run(path, tmp_path / "direct")
    run(path, tmp_path / "levels", petsc=MULTIGRID)
    command = [sys.executable, "-m", "voile.cli", "run", path, "-o", tmp_path / "ranks", "--", *MULTIGRID]
    done = mpirun(2, command, 300)
    assert done.returncode == 0, done.stderr
    direct, *others = (read(tmp_path / out) for out in ("direct", "levels", "ranks"))
    sag = np.abs(direct.positions - direct.start).max()
    assert sag > 0.003 and direct.summary["krylov_iterations"] == 0
    for other in others:
        summary = other.summary
        assert np.abs(other.positions - direct.positions).max() < 1e-8 * sag
        assert summary["energy"]["bending"] == pytest.approx(direct.summary["energy"]["bending"], rel=1e-8)
        assert summary["stable"] is True and summary["unused_options"] == []
        assert 0 < summary["krylov_iterations"] < 25 * summary["linear_solves"]


def test_interpolation_reproduces_what_bends_least(tmp_path):
    """Every field that is quadratic on the plate: rigid motions and constant curvatures are among them."""
    shell = modelled(read_scene(str(scene(tmp_path, 1 / 32, irregular=True)))).shell
    _, made = coarsen(shell)
    weights, (x, y, _) = smooth_weights(shell, made), shell.points.T
    fields = np.column_stack([np.ones_like(x), x, y, x * x, x * y, y * y])
    assert weights.shape[1] < 0.3 * len(x) and weights.nnz < 12 * len(x)
    assert np.abs(weights @ fields[made.kept] - fields).max() < 1e-8


def test_a_matrix_that_is_not_positive_definite(tmp_path):
    """A strip pressed together beyond its buckling load: neither the coarsest level nor iterations pass over it; a
    factor takes over. Just below the load the smallest eigenvalue is positive."""
    path = scene(tmp_path, 1 / 24)
    problem = Problem(modelled(read_scene(str(path))).shell)
    work, x = Workspace(problem), problem.create_vector()
    levels = multigrid.Multigrid(problem, work.symmetric, transfers(problem, 1000))
    b = problem.create_vector()
    problem.residual(x, b)
    for strain, positive in (1e-5, True), (1e-2, False):
        u = np.zeros_like(problem.part.points)
        u[:, 0] = -strain * problem.part.points[:, 0]
        y = problem.create_vector()
        y.array[:] = problem.layout.along(np.concatenate([u.ravel(), np.zeros(len(problem.part.edge))]))
        problem.tangent(y, work.matrix)
        assert (factored(work.matrix).negative == 0) is positive
        assert levels.positive(work.matrix) is positive
        levels.factor(work.matrix)
        levels.solve(b, x)
        assert bool(levels.negative) is not positive
        residual = b.duplicate()
        work.matrix.mult(x, residual)
        residual.axpy(-1.0, b)
        assert residual.norm() < 2.0 * multigrid.RELATIVE * b.norm()


def test_a_mesh_that_is_its_own_coarsest_level(tmp_path):
    """Is factored, whatever asks for levels."""
    path = scene(tmp_path, 0.25)
    direct, asked = (
        run(path, tmp_path / out, petsc=more) for out, more in (("d", CHOLESKY), ("a", MULTIGRID))
    )
    assert np.array_equal(direct.positions, asked.positions)
    assert asked.summary["unused_options"] == []


def test_solves_end_where_newton_does(tmp_path):
    """No digits that a nonlinear solve has no use for."""
    problem = Problem(modelled(read_scene(str(scene(tmp_path, 1 / 24)))).shell)
    work, x, b = Workspace(problem), problem.create_vector(), problem.create_vector()
    problem.residual(x, b)
    problem.tangent(x, work.matrix)
    counts = []
    for tolerance in 0.0, 1e-2 * b.norm():
        levels = multigrid.Multigrid(problem, Workspace(problem).symmetric, transfers(problem, 1000))
        levels.aim(tolerance)
        levels.factor(work.matrix)
        levels.solve(b, x)
        counts.append(levels.counts.krylov)
        residual = b.duplicate()
        work.matrix.mult(x, residual)
        residual.axpy(-1.0, b)
        assert residual.norm() <= max(tolerance, 2.0 * multigrid.RELATIVE * b.norm())
    assert counts[1] < 0.8 * counts[0]


@pytest.mark.parametrize(
    ("more", "why"),
    [
        ("[[obstacle]]\nshape = 'plane'\npoint = [0, 0, -0.1]\nnormal = [0, 0, 1]\n", "contact"),
        ("control = 'arc-length'\n", "no levels here"),
    ],
)
def test_where_there_are_no_levels(tmp_path, more, why):
    path = scene(tmp_path, 0.25, more=more)
    if "control" in more:
        path.write_text(path.read_text().replace("load_steps = 1\n", ""))
    with pytest.raises(InputError, match=f"pc_type mg .*{why}.*; allowed: "):
        run(path, petsc=MULTIGRID)
