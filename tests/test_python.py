"""Voile from Python: scenes as files and dicts, meshes as arrays, results in memory, many runs in one process."""

import gc
import json
import os
import re
import subprocess
import sys
import tempfile
import warnings
from pathlib import Path

import numpy as np
import pytest
from test_cli import SCENE, cells

import voile
from voile.cli import main
from voile.post.report import report

LENGTH, THICKNESS, YOUNG, DENSITY, GRAVITY = 0.1, 1e-3, 1e7, 300.0, 0.1
MOST_LEFT = (
    0.3  # MiB that a run may leave in the process, on average: what is measured is 0.01, a leaked SNES is 1.8
)


def sheet(count: int, length: float = LENGTH) -> tuple[np.ndarray, np.ndarray]:
    """A square of count x count cells at z = 0: points (n, 3) m, triangles (m, 3)."""
    at = np.linspace(0.0, length, count + 1)
    x, y = np.meshgrid(at, at, indexing="ij")
    corner = (np.arange(count)[:, None] * (count + 1) + np.arange(count)).ravel()
    right, both = corner + count + 1, corner + count + 2
    lower, upper = np.stack([corner, right, both], 1), np.stack([corner, both, corner + 1], 1)
    return np.stack([x.ravel(), y.ravel(), 0.0 * x.ravel()], 1), np.concatenate([lower, upper])


def cantilever(count: int = 6) -> dict:
    """A sheet without Poisson's effect, clamped along x = 0, that hangs a little under its weight."""
    return {
        "scene": {"name": 'a "sheet"'},
        "shell": {
            "mesh": sheet(count), "young": YOUNG, "poisson": 0.0, "thickness": THICKNESS,
            "density": np.float64(DENSITY),
        },
        "loads": {"gravity": np.array([0.0, 0.0, -GRAVITY])},
        "fix": [{"select": {"box": [[-0.001, -1, -1], [0.001, 1, 1]]}, "clamp": True}],
    }  # fmt: skip


def falling() -> dict:
    """The same, unheld, on its way to a plane that it reaches."""
    scene = {**cantilever(), "fix": [], "scene": {"task": "dynamics"}, "loads": {"gravity": [0, 0, -9.81]}}
    plane = {"shape": "plane", "point": (0, 0, -0.002), "normal": (0, 0, 1), "friction": 0.3}
    return {**scene, "obstacle": [plane], "dynamics": {"time_step": 0.005, "duration": 0.04}}


# ---- fields that no file holds ----


def test_fields_that_are_not_stored_are_computed():
    """As a run with output.fields stores them; what does not exist is refused with the names of what does."""
    result, full = (
        voile.run(cantilever() | more) for more in ({}, {"output": {"fields": ["von_mises", "stress"]}})
    )
    assert "von_mises" in full.cell_fields and "von_mises" not in result.cell_fields
    for name in ("von_mises", "stress_top"):
        stored = full.field(name)
        assert np.allclose(result.field(name), stored, rtol=0.0, atol=1e-9 * np.abs(stored).max())
        assert result.unit(name) == "Pa"
    assert np.array_equal(result.field("displacement", 0), result.points(0) - result.start)
    assert result.unit("displacement") == "m" and "von_mises" in result.known_fields
    assert all(len(result.field(name)) for name in result.known_fields)  # none that this shell has not
    assert result.picture(field="von_mises", size=(200, 150)).size == (200, 150)
    with pytest.raises(KeyError, match="there are .*displacement.*stress_top"):
        result.field("stress")
    with pytest.raises(voile.InputError, match='"fabric_strain": allowed with'):
        result.field("fabric_strain")


# ---- the same as the command line ----


def test_a_page_opens_with_colours_that_only_the_model_tells(tmp_path):
    """--field of `voile report` takes what `render` takes, and what the page else leaves out."""
    result, out = voile.run(cantilever(), tmp_path / "run"), tmp_path / "a.html"
    for field in ("von_mises", "smooth_von_mises", "group"):
        assert field not in result.point_fields + result.cell_fields or field == "group"
        assert main(["report", str(tmp_path / "run"), "--field", field, "-o", str(out)]) == 0
        data = re.search(r'id="page-data">(.*?)</script>', out.read_text(), re.S)
        told = {shown["name"]: shown for shown in json.loads(data[1])["fields"]}
        assert {"displacement", "strain", field} <= set(told)
    assert "von_mises" not in told
    assert report(result, out, field="von_mises").steps == (result.n_steps, result.n_steps)


def test_a_file_gives_what_the_command_gives(tmp_path):
    (tmp_path / "mesh.obj").write_text(cells())
    (tmp_path / "scene.toml").write_text(SCENE)
    command = [
        sys.executable,
        "-m",
        "voile.cli",
        "run",
        "scene.toml",
        "-o",
        "out",
        "--set",
        "shell.young=2e5",
    ]
    subprocess.run(command, cwd=tmp_path, check=True, capture_output=True, timeout=100)
    there = voile.read(tmp_path / "out")
    here = voile.run(voile.load(tmp_path / "scene.toml", {"shell.young": 2e5}))
    np.testing.assert_array_equal(here.positions, there.positions)
    assert here.summary["energy"] == there.summary["energy"] and here.summary["converged"]
    assert here.scene_text.replace("200000.0", "2e5") == there.scene_text
    written = voile.run(tmp_path / "scene.toml", tmp_path / "again")
    assert written.path == tmp_path / "again" / "result.vtkhdf"
    assert not np.array_equal(written.positions, there.positions)


def test_a_sheet_of_arrays_bends_as_a_beam():
    exact = DENSITY * THICKNESS * GRAVITY * LENGTH**4 / (8 * YOUNG * THICKNESS**3 / 12)
    errors = []
    for count in (8, 16):
        result = voile.run(cantilever(count))
        tip = result.positions[np.isclose(result.start[:, 0], LENGTH), 2].mean()
        errors.append(abs(tip / -exact - 1))
    assert errors[1] < 0.01 and errors[1] < 0.5 * errors[0]


def test_what_a_result_tells(tmp_path):
    result = voile.run(falling())
    assert result.times[0] == 0.0 and result.times[-1] == pytest.approx(0.04) and len(result.times) == 9
    assert result.history["time"].shape == (8,) and result.history["contact_force"][-1, 2] > 0
    assert result.field("reaction")[:, 2].sum() == pytest.approx(result.history["contact_force"][-1, 2])
    assert result.field("velocity", step=0).shape == result.positions.shape == (49, 3)
    assert result.summary["task"] == "dynamics" and "9 steps" in repr(result)
    assert result.render(tmp_path / "a.png", field="reaction", size=(200, 150)).stat().st_size > 1000
    assert result._repr_png_().startswith(b"\x89PNG")
    with pytest.raises(KeyError, match="no field 'stress'; there are"):
        result.field("stress")


def test_a_run_in_time_leaves_no_file_open():
    with warnings.catch_warnings(record=True) as seen:
        warnings.simplefilter("always", ResourceWarning)
        voile.run(falling())
        gc.collect()
    assert not [w for w in seen if issubclass(w.category, ResourceWarning)]


def test_a_rest_shape_and_a_body_of_arrays():
    points, triangles = sheet(4)
    ball = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]]) * 0.05
    faces = np.array([[0, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4], [2, 0, 5], [1, 2, 5], [3, 1, 5], [0, 3, 5]])
    scene = cantilever(4)
    scene["shell"]["rest"] = ((1.001 * points).tolist(), triangles.tolist())  # lists of rows do, too
    scene["obstacle"] = [{"shape": "mesh", "file": (ball - [0, 0, 0.3], faces)}]
    result = voile.run(scene)
    np.testing.assert_array_equal(result.rest, 1.001 * points)
    assert result.bodies[0].triangles.shape == (8, 3)


# ---- bad input ----


@pytest.mark.parametrize(
    ("table", "key", "value", "words"),
    [
        ("shell", "yuong", 1.0, r'scene: shell.yuong: unknown key \(did you mean "young"\?\)'),
        ("shell", "young", -1, "scene: shell.young: -1 is not allowed; allowed: a finite number > 0 in Pa"),
        ("shell", "young", {1, 2}, "scene: shell.young: set is not allowed; allowed: dicts, lists, arrays"),
        ("shell", "mesh", 3, "scene: shell.mesh: 3 is an integer"),
        ("shell", "mesh", "none.obj", "none.obj: no such mesh file"),
        ("shell", "mesh", (np.zeros((3, 3)), np.zeros((1, 3))), r"shell.mesh: triangles of shape \(1, 3\), float64"),
        ("shell", "mesh", (np.zeros((3, 4)), np.zeros((1, 3), int)), r"shell.mesh: points of shape \(3, 4\)"),
        ("shell", "mesh", (np.eye(3) + 0j, np.array([[0, 1, 2]])), "shell.mesh: points are complex"),
        ("shell", "mesh", (np.eye(3), np.array([[0, 1, 3]])), "mesh of arrays: triangle 0 .* vertex out of range"),
        ("shell", "mesh", (np.nan * np.eye(3), np.array([[0, 1, 2]])), "mesh of arrays: vertex 0 is .* not finite"),
        ("loads", "gravity", np.zeros(2), "scene: loads.gravity: .* has length 2"),
        ("scene", "name", "a\ud800", "scene: scene.name: text that is not Unicode"),
        ("scene", "task", "modal", "scene: scene.task: 'modal' is not allowed"),
    ],
)  # fmt: skip
def test_bad_scenes_are_refused(table, key, value, words):
    scene = cantilever()
    scene[table][key] = value
    with pytest.raises(voile.InputError, match=words):
        voile.run(scene)


def test_bad_overrides_options_and_results_are_refused(tmp_path):
    with pytest.raises(voile.InputError, match=r"--set fix.1.axes.*allowed: an index from 0 to 0"):
        voile.load(cantilever(), {"fix.1.axes": "x"})
    with pytest.raises(voile.InputError, match="--set shell.mesh: set is not allowed"):
        voile.load(cantilever(), {"shell.mesh": {1}})
    with pytest.raises(voile.InputError, match="'snes_monitor' is neither an option"):
        voile.run(cantilever(), petsc=["snes_monitor"])
    with pytest.raises(voile.InputError, match="'-snes_monitor' is one text; allowed: a list"):
        voile.run(cantilever(), petsc="-snes_monitor")
    with pytest.raises(voile.InputError, match="no such result file"):
        voile.read(tmp_path)


def test_the_scene_of_a_result_may_be_a_dict(tmp_path):
    made = voile.run(cantilever(), tmp_path / "out")
    read = voile.read(tmp_path / "out", cantilever())
    np.testing.assert_array_equal(read.field("von_mises"), made.field("von_mises"))


def test_overrides_may_be_meshes():
    scene = voile.load(cantilever(4), {"shell.mesh": sheet(2), "shell.density": 200})
    assert voile.run(scene).n_points == 9 and "200" in scene.text and "9 points" in scene.text


# ---- runs that do not converge, and many runs ----


def test_what_was_computed_comes_with_the_refusal():
    with pytest.raises(voile.NotConverged, match="scene: .*step") as refusal:
        voile.run(voile.load(cantilever(), {"statics.load_steps": 10, "statics.max_steps": 2}))
    assert refusal.value.result.summary["converged"] is False
    assert refusal.value.result.positions.shape == (49, 3)


def test_runs_leave_the_options_of_petsc_as_they_were():
    from petsc4py import PETSc

    voile.run(cantilever())
    options = PETSc.Options()
    options.setValue("snes_max_it", "77")
    before = options.getAll()
    try:
        voile.run(falling(), petsc=["-snes_max_it", "60", "-nothing_asks"])
        assert options.getAll() == before
    finally:
        options.delValue("snes_max_it")
    result = voile.run(cantilever(), petsc=["-nothing_asks"])
    assert result.summary["unused_options"] == ["-nothing_asks"]
    assert voile.run(cantilever()).summary["unused_options"] == []


def test_many_runs_leak_nothing(monkeypatch, tmp_path):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))  # the usual one has other workers' runs
    page = os.sysconf("SC_PAGE_SIZE") / 2**20

    def memory() -> float:
        return int(Path("/proc/self/statm").read_text().split()[1]) * page

    scenes = [cantilever(), falling(), {**falling(), "scene": {}}]
    for scene in 2 * scenes:
        voile.run(scene)
    files, began, runs = len(os.listdir("/proc/self/fd")), memory(), 5 * scenes
    for scene in runs:
        voile.run(scene)
    assert (memory() - began) / len(runs) < MOST_LEFT
    assert len(os.listdir("/proc/self/fd")) <= files
    assert not list(tmp_path.glob("voile-*/result.vtkhdf"))


def test_importing_voile_is_cheap():
    code = (
        "import sys, voile; sys.exit(any(m in sys.modules for m in ('numpy', 'h5py', 'petsc4py', 'mpi4py')))"
    )
    assert subprocess.run([sys.executable, "-c", code], timeout=60).returncode == 0


# ---- in parallel ----

SWEEP = """
import numpy as np, voile
from mpi4py import MPI
from test_python import cantilever, falling
world = MPI.COMM_WORLD
together = [voile.run(cantilever()), voile.run(falling())]
scenes = [voile.load(cantilever(), {"shell.young": 1e7 * (1 + k * world.rank)}) for k in (0, 1)]
alone = [voile.run(scene, comm=MPI.COMM_SELF) for scene in scenes]
assert together[0].summary["ranks"] == world.size and alone[0].summary["ranks"] == 1
lines = world.gather([float(r.positions[:, 2].min()) for r in together + alone])
if world.rank == 0:
    for line in lines:
        print(*line)
    # It has more to do than the other: each once waited at its end for as many starts of all others.
    voile.run(cantilever(), comm=MPI.COMM_SELF).field("von_mises")
"""


def test_ranks_share_a_run_or_have_their_own(mpirun, tmp_path):
    (tmp_path / "sweep.py").write_text(
        SWEEP.replace(
            "import numpy", f"import sys; sys.path.insert(0, {str(Path(__file__).parent)!r}); import numpy"
        )
    )
    done = mpirun(2, [sys.executable, tmp_path / "sweep.py"], 100)
    assert done.returncode == 0, done.stderr
    rows = np.array([[float(word) for word in line.split()] for line in done.stdout.splitlines()])
    np.testing.assert_allclose(rows[0, :3], rows[1, :3], rtol=1e-9)
    np.testing.assert_allclose(rows[0, 0], rows[0, 2], rtol=1e-9)
    np.testing.assert_allclose(rows[0, 1], voile.run(falling()).positions[:, 2].min(), rtol=1e-6)
    assert rows[1, 3] == pytest.approx(rows[0, 3] / 2, rel=0.01)
