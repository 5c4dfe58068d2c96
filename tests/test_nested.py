"""Nested iteration: where it is used, what its levels are, and that its equilibria lie as low as those without."""

import json
from pathlib import Path

import command_line
import numpy as np
import pytest
from everyday import sheet
from mpi4py import MPI
from test_descent import hanging
from test_problem import make_shell

from voile.mesh import write_obj
from voile.problem.imperfection import perturb
from voile.problem.levels import coarsen
from voile.problem.problem import Problem
from voile.results import read_result
from voile.solver.equilibrium import CREEP, Solver
from voile.solver.methods.descent import Descent
from voile.solver.methods.descent import Options as DescentOptions
from voile.solver.methods.method import Workspace
from voile.solver.nested import STRETCH, Options, pays, softened
from voile.solver.path import StaticsOptions

FABRIC = "[shell]\nmesh = 'cloth.obj'\nyoung = 1e6\nthickness = 1e-3\ndensity = 300.0\n"
CORNERS = "[[fix]]\nselect = { box = [[-1e-9, -1, -1e-9], [1e-9, 1, 1e-9]] }\n" + (
    "[[fix]]\nselect = { box = [[0.999999, -1, -1e-9], [1.000001, 1, 1e-9]] }\n"
)
BALL = "[[obstacle]]\nshape = 'sphere'\ncenter = [0.5, -0.301, 0.5]\nradius = 0.3\nfriction = 0.3\n"


def square(cells: int) -> tuple[np.ndarray, np.ndarray]:
    """A square of 1 m in the plane y = 0, its corner at the origin."""
    points, triangles = sheet(1.0, 1.0, 1.0 / cells)
    return points - points.min(axis=0), triangles


CELLS = 23  # along a side: 576 vertices, just more than are solved at once


def written(folder: Path, tables: str = "") -> Path:
    """The scene of a square cloth with gravity along -y; tables may be appended to the file."""
    write_obj(folder / "cloth.obj", *square(CELLS))
    path = folder / "scene.toml"
    path.write_text(FABRIC + "[loads]\ngravity = [0.0, -9.81, 0.0]\n" + tables)
    return path


@pytest.fixture
def scene(tmp_path) -> Path:
    return written(tmp_path)


@pytest.fixture(scope="module")
def hung(tmp_path_factory) -> Path:
    """Results of the cloth held at its corners."""
    folder = tmp_path_factory.mktemp("hung")
    solved(written(folder, CORNERS), folder / "nested")
    return folder / "nested"


def voile(*arguments: object) -> str:
    done = command_line.voile(*arguments)
    assert done.returncode == 0, done.stderr
    return done.stdout


def solved(scene: Path, out: Path, *more: str) -> dict:
    voile("run", scene, "-o", out, *more)
    return summary(out)


def summary(out: Path) -> dict:
    return json.loads((out / "summary.json").read_text())


@pytest.mark.parametrize(("tables", "higher"), [(CORNERS, 1e-6), (BALL, 0.02)], ids=["corners", "ball"])
def test_its_equilibrium_is_stable_and_as_low(scene, hung, tmp_path, tables, higher):
    """Without friction the same minimum; with friction another drape may be found, but not one much higher."""
    scene.write_text(scene.read_text() + tables)
    known = tables == CORNERS
    nested = summary(hung) if known else solved(scene, tmp_path / "nested")
    plain = solved(scene, tmp_path / "plain", "--set", "statics.nested=false")
    assert any(method.startswith("nested ") for method in nested["method"])
    assert not any(method.startswith("nested ") for method in plain["method"])
    assert nested["stable"] and nested["residual_norm"] <= nested["residual_tolerance"]
    low = sum(plain["energy"].values())
    assert sum(nested["energy"].values()) <= low + higher * abs(low)


def test_a_shell_without_loads(scene, tmp_path):
    """Held all round in a frame too small for its rest shape, it buckles."""
    points, triangles = square(CELLS)
    write_obj(tmp_path / "rest.obj", 1.3 * points, triangles)
    text = scene.read_text().replace("mesh = ", "rest = 'rest.obj'\nmesh = ").replace("-9.81", "0.0")
    scene.write_text(text + "[[fix]]\nselect = { boundary = 0 }\n")
    found = solved(scene, tmp_path / "out")
    assert found["converged"] and found["stable"]
    with read_result(tmp_path / "out") as result:
        assert np.ptp(result.points()[:, 1]) > 0.05


def test_the_same_on_two_ranks(hung, tmp_path, run_on):
    run_on(2, written(tmp_path, CORNERS), tmp_path / "two", 200)
    shapes = []
    for folder in (hung, tmp_path / "two"):
        with read_result(folder) as result:
            shapes.append(result.points())
    assert np.ptp(shapes[0][:, 1]) > 0.5
    assert np.abs(shapes[1] - shapes[0]).max() < 1e-7


def test_explain_tells_of_it(scene):
    scene.write_text(scene.read_text() + CORNERS)
    assert "+ nested levels" in voile("explain", scene)
    for setting, reason in {
        "statics.nested=false": "statics.nested is false",
        "statics.load_steps=5": "statics.load_steps is given",
        "contact.self_contact=true": "layers are kept apart",
    }.items():
        text = voile("explain", scene, "--set", setting)
        line = next(line for line in text.splitlines() if "nested levels" in line)
        assert line.strip().startswith("-") and reason in line


def test_a_level_is_softer_in_its_plane_only():
    points, triangles = square(16)
    made = coarsen(make_shell(points, triangles, young=np.full(len(triangles), 1e9)))
    assert made is not None
    share = len(made[0].points) / len(points)
    soft = softened(made[0], share)
    membrane, bending = (soft.young * soft.thickness**power for power in (1, 3))
    assert np.allclose(membrane, share**2 * made[0].young * made[0].thickness, rtol=1e-12)
    assert np.allclose(bending, made[0].young * made[0].thickness ** 3, rtol=1e-12)
    assert np.allclose(soft.density * soft.thickness, made[0].density * made[0].thickness, rtol=1e-12)


def test_a_level_does_not_stretch_far_under_its_own_weight():
    points, triangles = square(16)
    made = coarsen(make_shell(points, triangles))
    assert made is not None
    soft = softened(made[0], 0.01)
    size = np.linalg.norm(np.ptp(points, axis=0))
    strain = 9.81 * size * soft.density * soft.thickness / (soft.young * soft.thickness)
    assert np.allclose(strain, STRETCH, rtol=1e-9)


def test_small_meshes_are_solved_at_once():
    points, triangles = square(4)
    problem = Problem(make_shell(points, triangles), MPI.COMM_SELF)
    assert not pays(problem)
    assert pays(problem, Options(smallest=10))


def test_descents_of_levels_end_where_they_creep():
    """What a creeping level gains is of no use to the fine one: see CREEP."""
    problem = Problem(hanging(24), MPI.COMM_SELF)
    solver = Solver(problem, StaticsOptions(nested=True))
    assert solver.nested and solver.nested.level
    coarse = solver.nested.level[1]
    assert coarse.descent.options.creep == CREEP > solver.descent.options.creep == 0.0
    y = coarse.problem.create_vector()
    assert coarse.level.solve(coarse.problem, y, 1e-4 * coarse.problem.load_norm(y)).converged


@pytest.mark.parametrize(("creep", "ends"), [(0.5, True), (0.0, False)])
def test_a_descent_that_creeps_ends(creep, ends):
    problem = Problem(hanging(12), MPI.COMM_SELF)
    descent = Descent(Workspace(problem), DescentOptions(creep=creep, look_back=3))
    y = problem.create_vector()
    perturb(problem, y, 1e-4)
    descent.run(problem, y, 1e-8 * problem.load_norm(y))
    energies = [step.energy for step in descent.steps]
    slow = [
        k
        for k in range(3, len(energies))
        if energies[k - 3] - energies[k] < 0.5 * (energies[0] - energies[k])
    ]
    assert slow and (len(energies) == slow[0] + 1) == ends
