"""statics.control = "arc-length" from outside: what is stored and told where load factors fall, what is refused; the
same on any number of ranks."""

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.append(str(Path(__file__).parent / "verification"))
from roofs import hinged_roof, pinned_strip

from voile.cli import main
from voile.results import read_result, read_summary
from voile.tasks.run import Steps

ROOF = """
[shell]
mesh = "shell.obj"
young = 3102.75
poisson = 0.3
thickness = 6.35
density = 1e-9
[loads]
gravity = [0, 0, 0]
[[loads.force]]
select = { box = [[-1, -1, -100], [1, 1, 100]] }
value = [0, 0, -150.0]
[[fix]]
select = { box = [[-1, -1, -100], [1e-3, 300, 100]] }
axes = "x"
clamp = true
[[fix]]
select = { box = [[-1, -1, -100], [300, 1e-3, 100]] }
axes = "y"
clamp = true
[[fix]]
select = { box = [[253, -1, -100], [300, 300, 100]] }
[statics]
control = "arc-length"
"""
# Twice as thick it turns back by less: half the steps.
THICK = ROOF.replace("6.35", "12.7").replace("-150.0", "-600.0")
FORCE = ROOF[ROOF.index("[[loads.force]]") : ROOF.index("[[fix]]")]
PLANE = """
[[obstacle]]
shape = "plane"
point = [0, 0, -9.31]
normal = [0, 0, 1]
"""
COLUMN = """
[shell]
mesh = "shell.obj"
young = 1e9
poisson = 0.0
thickness = 1e-3
density = 1000.0
[loads]
gravity = [0, 0, 0]
[[loads.force]]
select = { box = [[0.999, -1, -1], [2, 1, 1]] }
value = [-0.02, 0, 0]
[[fix]]
select = { all = true }
axes = "y"
[[fix]]
select = { box = [[-1, -1, -1], [1e-6, 1, 1]] }
[[fix]]
select = { box = [[0.999, -1, -1], [2, 1, 1]] }
axes = "z"
[statics]
control = "arc-length"
max_load_factor = 2.2
"""


@pytest.fixture
def scene(tmp_path):
    """scene(text): writes scene.toml and the roof, or the strip of the column."""

    def write(text):
        shell = pinned_strip(20, 1.0) if "young = 1e9" in text else hinged_roof(6, 6, 6.35, 1.0)[0]
        lines = [*("v {:.17g} {:.17g} {:.17g}".format(*p) for p in shell.points)]
        lines += ["f {} {} {}".format(*t + 1) for t in shell.triangles]
        (tmp_path / "shell.obj").write_text("\n".join(lines) + "\n")
        (tmp_path / "scene.toml").write_text(text)
        return tmp_path / "scene.toml"

    return write


def run(path, *more):
    """Exit code of a run into the folder out beside the scene."""
    return main(["run", str(path), "-o", str(path.parent / "out"), *more])


def test_load_factors_that_fall_are_kept(scene, tmp_path):
    assert run(scene(ROOF)) == 0
    out = tmp_path / "out"
    summary = read_summary(out / "summary.json")
    assert summary["converged"] and summary["stable"] and summary["load_factor"] == 1.0
    top, bottom = summary["limit_points"]
    assert top["load_factor"] > 0.5 and bottom["load_factor"] < 0.0 and summary["bifurcations"] == []
    with read_result(out) as result:
        assert result.n_steps == summary["steps"] == len(summary["method"])
        assert result.values.max() == 1.0 and (np.diff(result.values) < 0.0).sum() > 3
        here = result.values.tolist().index(top["load_factor"])
        assert summary["method"][here] == "limit point"
        assert result.figures()["load_displacement"][here] == top["displacement"]
        shapes = [result.points(k) for k in range(result.n_steps)]
        middle = int(np.argmin(np.linalg.norm(result.start[:, :2], axis=1)))
        sag = (result.start - result.points(here))[middle, 2]
        assert abs(sag / top["displacement"] - 1.0) < 1e-12
    check_vtk(out / "result.vtkhdf", shapes)


def check_vtk(path, shapes):
    """VTK finds each step by its time."""
    reader = pytest.importorskip("vtkmodules.vtkIOHDF").vtkHDFReader()
    from vtkmodules.util.numpy_support import vtk_to_numpy
    from vtkmodules.vtkCommonExecutionModel import vtkStreamingDemandDrivenPipeline

    reader.SetFileName(str(path))
    reader.UpdateInformation()
    key, info = vtkStreamingDemandDrivenPipeline.TIME_STEPS(), reader.GetOutputInformation(0)
    times = [info.Get(key, k) for k in range(info.Length(key))]
    assert times == list(range(1, len(shapes) + 1))
    for time, shape in zip(times, shapes, strict=True):
        reader.UpdateTimeStep(time)
        np.testing.assert_array_equal(vtk_to_numpy(reader.GetOutput().GetPoints().GetData()), shape)


def test_every_few_steps_and_the_last(scene, tmp_path):
    assert run(scene(ROOF), "--set", "output.every=7") == 0
    steps = read_summary(tmp_path / "out" / "summary.json")["steps"]
    with read_result(tmp_path / "out") as result:
        assert result.n_steps == steps // 7 + (steps % 7 > 0) and result.values[-1] == 1.0


def test_plots_and_films(scene, tmp_path):
    pytest.importorskip("pyvista")
    pytest.importorskip("av")
    assert run(scene(THICK), "--set", "output.every=12") == 0
    out = str(tmp_path / "out")
    assert main(["plot", out, "load_displacement", "displacement:0"]) == 0
    assert main(["animate", out, "--field", "displacement", "-o", str(tmp_path / "a.gif")]) == 0
    assert main(["info", out]) == 0 and main(["explain", str(tmp_path / "scene.toml")]) == 0
    from PIL import Image

    with Image.open(tmp_path / "a.gif") as film, read_result(out) as result:
        assert film.n_frames == result.n_steps > 2


def test_snaps_onto_an_obstacle(scene, tmp_path):
    """The first limit point comes before it is touched; the end is that of statics under loads."""
    ends, limits = [], []
    plane = PLANE.replace("-9.31", "-13")
    for text in (THICK, THICK.replace("[statics]", plane + "[statics]")):
        assert run(scene(text + "load_steps = 20\n"), "--set", "contact.offset=0") == 0
        summary = read_summary(tmp_path / "out" / "summary.json")
        limits.append(summary["limit_points"])
        with read_result(tmp_path / "out") as result:
            ends.append(result.points())
    assert summary["contact"]["active"] > 0 and summary["contact"]["max_penetration"] < 1e-6
    (free, *_), (bounded, *_) = limits
    assert abs(free["load_factor"] - bounded["load_factor"]) < 1e-6
    assert np.abs(ends[0] - ends[1]).max() > 1.0
    text = THICK.replace('"arc-length"', '"load"').replace("[statics]", plane + "[statics]")
    assert run(scene(text), "--set", "contact.offset=0") == 0
    with read_result(tmp_path / "out") as result:
        np.testing.assert_allclose(result.points(), ends[1], rtol=0, atol=1e-5)


def test_branches(scene, tmp_path):
    ends = []
    for branch in (0, 1):
        assert run(scene(COLUMN), "--set", f"statics.branch={branch}") == 0
        summary = read_summary(tmp_path / "out" / "summary.json")
        assert len(summary["bifurcations"]) == 1 and summary["stable"] is bool(branch)
        with read_result(tmp_path / "out") as result:
            ends.append(np.abs(result.points()[:, 2]).max())
    assert ends[0] < 1e-9 < 0.1 < ends[1]


def test_a_branch_that_is_not_there(scene, tmp_path, capsys):
    assert run(scene(COLUMN), "--set", "statics.branch=2") == 3
    assert "statics.branch = 2: 1 bifurcation" in capsys.readouterr().err


def test_a_path_that_does_not_end(scene, tmp_path, capsys):
    assert run(scene(ROOF), "--set", "statics.max_steps=5") == 3
    assert "max_steps = 5 steps ended at load factor" in capsys.readouterr().err
    with read_result(tmp_path / "out") as result:
        assert 5 <= result.n_steps <= 6


@pytest.mark.parametrize("why", ["max_steps = 14 steps ended", "stopped by a signal"])
def test_a_stopped_path_tells_the_limit_points_before(scene, tmp_path, capsys, monkeypatch, why):
    if "signal" in why:
        whole = Steps.__call__

        def told(self, step, y):
            whole(self, step, y)
            if step.factor < 0.3 and self.reached > 10:
                raise KeyboardInterrupt

        monkeypatch.setattr(Steps, "__call__", told)
    assert run(scene(THICK), "--set", f"statics.max_steps={14 if 'max' in why else 1000}") == 3
    assert why in capsys.readouterr().err
    summary = read_summary(tmp_path / "out" / "summary.json")
    (top,) = summary["limit_points"]
    assert 0.6 < top["load_factor"] < 1.0 and top["displacement"] > 5.0 and summary["bifurcations"] == []


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (
            'control = "arc-length"',
            "max_load_factor = 2.0",
            "statics.max_load_factor: allowed with statics.control",
        ),
        ('control = "arc-length"', "branch = 1", "statics.branch: allowed with statics.control"),
        (
            'control = "arc-length"',
            'control = "arc-length"\nbranch = -1',
            "statics.branch: -1 is not allowed",
        ),
        (
            'control = "arc-length"',
            'control = "arc-length"\nmax_load_factor = 0',
            "statics.max_load_factor: 0 is not",
        ),
        ('"arc-length"', '"arc"', "statics.control: 'arc' is not allowed"),
        ("[shell]", '[scene]\ntask = "modes"\n[shell]', 'statics.control: "arc-length" is allowed with task'),
        (
            'axes = "x"',
            'axes = "x"\nmove = { displacement = [1.0, 0, 0] }',
            "fix.0.move: allowed with statics.control",
        ),
        (
            "[statics]",
            PLANE + "friction = 0.1\n[statics]",
            "obstacle.0.friction: 0.1; allowed with statics.control",
        ),
        (
            "[statics]",
            PLANE + "move = { displacement = [0, 0, 1.0] }\n[statics]",
            "obstacle.0.move: allowed with statics.control",
        ),
        ("[statics]", "[contact]\nself_contact = true\n[statics]", "contact.self_contact: allowed"),
        (FORCE, "", "without a load"),
    ],
)
def test_bad_scenes(scene, capsys, old, new, message):
    assert run(scene(ROOF.replace(old, new))) == 2
    err = capsys.readouterr().err
    assert message in err and err.count("\n") == 1, err


@pytest.mark.mpi
@pytest.mark.parametrize(
    ("text", "branch"),
    [
        pytest.param(THICK, 0, marks=pytest.mark.slow),
        pytest.param(ROOF.replace("[statics]", PLANE + "[statics]"), 0, marks=pytest.mark.slow),
        (COLUMN, 1),
    ],
    ids=["roof", "contact", "column"],
)
def test_ranks_agree(scene, tmp_path, run_on, rank_counts, text, branch):
    path, found, ends = scene(text.replace("[statics]", f"[statics]\nbranch = {branch}")), [], []
    for ranks in rank_counts:
        out = tmp_path / str(ranks)
        run_on(ranks, path, out, 300)
        summary = read_summary(out / "summary.json")
        found.append(
            [[p["load_factor"], p["displacement"]] for p in summary["limit_points"] + summary["bifurcations"]]
        )
        with read_result(out) as result:
            ends.append(result.points())
    size = np.ptp(ends[0])
    for other, end in zip(found[1:], ends[1:], strict=True):
        np.testing.assert_allclose(other, found[0], rtol=1e-6, atol=1e-7 * size)
        np.testing.assert_allclose(end, ends[0], rtol=0, atol=1e-6 * size)
