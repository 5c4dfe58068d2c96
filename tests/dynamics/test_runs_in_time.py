"""Dynamics scenes from the command line: results, history, resume, refusals."""

import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from test_problem import sheet

from voile.cli import main
from voile.results import read_result, read_summary
from voile.results.history import read_history

SCENE = """
[scene]
task = "dynamics"
[shell]
mesh = "sheet.obj"
young = 1e5
thickness = 1e-3
density = 300.0
bending = "average"
velocity = [0.2, 0.0, 0.0]
[loads]
gravity = [0.0, 0.0, -9.81]
[[obstacle]]
shape = "sphere"
center = [0.5, 0.25, -0.12]
radius = 0.1
friction = 0.4
move = { angular_velocity = [0.0, 0.0, 2.0], center = [0.5, 0.25, 0.0] }
[dynamics]
time_step = 0.005
duration = 0.2
[output]
every = 4
"""


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    points, triangles = sheet(8, 4)
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in points.tolist()]
    lines += [f"f {a} {b} {c}" for a, b, c in (triangles + 1).tolist()]
    (tmp_path / "sheet.obj").write_text("\n".join(lines))
    path = tmp_path / "scene.toml"
    path.write_text(SCENE)
    return path


def test_a_run_writes_what_it_did(scene, tmp_path, capsys):
    assert main(["run", str(scene), "-o", str(tmp_path / "out")]) == 0
    log = capsys.readouterr().out
    assert "time 0.2 of 0.2 s" in log and "s/s" in log
    summary = read_summary(tmp_path / "out" / "summary.json")
    assert summary["converged"] and summary["steps"] == 40 and summary["task"] == "dynamics"
    energy = summary["dynamics"]["energy"]
    assert {"kinetic", "stretching", "bending", "gravity", "friction_dissipated", "scheme_dissipated"} <= set(
        energy
    )
    stored = energy["kinetic"] + sum(summary["energy"].values())
    lost = sum(value for name, value in energy.items() if name.endswith("dissipated"))
    given = sum(value for name, value in energy.items() if name.endswith("work"))
    mass = 0.3 * 0.5
    assert stored + lost - given == pytest.approx(0.5 * mass * 0.2**2, abs=1e-8 * abs(energy["gravity"]))
    with read_result(tmp_path / "out") as result:
        np.testing.assert_allclose(result.values, 0.02 * np.arange(11))
        moved = result.points(-1) - result.points(-2)
        speed = result.field("velocity", -1)
        assert np.abs(speed * 0.02 - moved).max() < 0.3 * np.abs(moved).max()  # it falls faster
        np.testing.assert_allclose(result.field("velocity", 0), np.tile([0.2, 0.0, 0.0], (45, 1)))
        assert result.field("contact", -1).any()
    history = read_history(tmp_path / "out")
    assert len(history["time"]) == 40 and history["time"][-1] == 0.2
    assert history["kinetic"][-1] == energy["kinetic"] and history["momentum"].shape == (40, 3)
    assert history["contact_force"][-1, 2] > 0.0


def test_a_killed_run_goes_on_with_the_same_numbers(scene, tmp_path):
    whole, killed = tmp_path / "whole", tmp_path / "killed"
    longer = ["--set", "dynamics.duration=1", "--set", "dynamics.damping.mass=2"]
    assert main(["run", str(scene), "-o", str(whole), *longer]) == 0
    command = [sys.executable, "-m", "voile.cli", "run", str(scene), "-o", str(killed), *longer]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL) as process:
        waited = time.perf_counter()
        while not list(killed.glob("restart/[1-9]*-0.npz")):
            assert process.poll() is None and time.perf_counter() - waited < 100.0
            time.sleep(0.02)
        os.kill(process.pid, signal.SIGKILL)
    assert 0 <= int((killed / "restart" / "last").read_text().split()[0]) < 200
    assert main(["run", str(scene), "-o", str(killed), "--resume", *longer]) == 0
    with read_result(whole) as one, read_result(killed) as other:
        np.testing.assert_array_equal(one.values, other.values)
        for step in range(0, one.n_steps, 10):
            np.testing.assert_allclose(one.points(step), other.points(step), rtol=0, atol=1e-12)
        np.testing.assert_allclose(one.field("velocity"), other.field("velocity"), rtol=0, atol=1e-10)
    for name, values in read_history(whole).items():
        np.testing.assert_allclose(read_history(killed)[name], values, rtol=1e-6, atol=1e-9, err_msg=name)
    summaries = [read_summary(folder / "summary.json") for folder in (whole, killed)]
    assert summaries[0]["steps"] == summaries[1]["steps"] == 200


def test_a_run_killed_before_its_first_step_starts_again(scene, tmp_path):
    out, short = tmp_path / "out", ["--set", "dynamics.duration=0.05"]
    assert main(["run", str(scene), "-o", str(out), *short]) == 0
    whole = read_summary(out / "summary.json")
    first = tmp_path / "first"
    shutil.copytree(out, first, ignore=shutil.ignore_patterns("restart", "history.h5"))
    command = [sys.executable, "-m", "voile.cli", "run", str(scene), "-o", str(first), *short]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL) as process:
        while not (first / "restart" / "last").exists():
            assert process.poll() is None
            time.sleep(0.001)
        os.kill(process.pid, signal.SIGKILL)
    assert main(["run", str(scene), "-o", str(first), "--resume", *short]) == 0
    assert read_summary(first / "summary.json")["steps"] == whole["steps"]


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ("dynamics.time_step=0", "dynamics.time_step"),
        ("dynamics.duration=-1", "dynamics.duration"),
        ("dynamics.time_step=1e-300", "dynamics.time_step"),
        ("dynamics.duration=1e300", "dynamics.time_step"),
        ("obstacle.0.restitution=1.5", "obstacle.0.restitution"),
        ("obstacle.0.restitution=0.5", "moreau-jean"),
        ("dynamics.theta=0.4", "dynamics.theta"),
        ("dynamics.spectral_radius=1.1", "dynamics.spectral_radius"),
        ('dynamics.keeps="angular-momentum"', "theta = 0.5"),
        ("obstacle.0.move.until=0", "obstacle.0.move.until"),
        ("obstacle.0.move.from=0.2", "obstacle.0.move.from: 0.2 s"),
        ('obstacle.0.move={path="motion.csv"}', "motion.csv"),
        ("loads.history=[[0,1],[0,2]]", "loads.history"),
        ("loads.history=[[1,1]]", "loads.history: begins at t = 1 s; allowed: a first row at t = 0 s"),
        ('scene.task="statics"', "obstacle.0.move"),
    ],
)
def test_refusals(scene, tmp_path, capsys, given, message):
    assert main(["run", str(scene), "-o", str(tmp_path / "out"), "--set", given]) == 2
    said = capsys.readouterr().err
    assert message in said and said.count("\n") == 1 and not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ("0,0,0,0\n0.1,0,0,1\n", "lasts from 0 to 0.1 s"),
        ("t,x,y,z\n0,0,0,0\n0.1,0,0,1\n0.05,0,0,0\n", "line 4: t = 0.05 s is not after"),
        ("0,0,0\n", "3 numbers"),
        ("0,0,0,0\n1,a,0,0\n", "line 2: not numbers"),
        ("", "is empty"),
        ("0,0,0.1,0\n1,0,0,1\n", "at t = 0 it has moved by 0, 0.1, 0"),
        ("-1,0,0,0\n1,0,0,1\n", "at t = 0 it has moved by 0, 0, 0.5"),
    ],
)
def test_tables_of_motion_are_checked(scene, tmp_path, capsys, table, message):
    (tmp_path / "motion.csv").write_text(table)
    given = 'obstacle.0.move={path="motion.csv"}'
    assert main(["run", str(scene), "-o", str(tmp_path / "out"), "--set", given]) == 2
    assert message in capsys.readouterr().err


@pytest.mark.parametrize("given", ["wind=[1,0,0]", "drag=0.5", "history=[[0,1]]"])
def test_loads_in_time_need_time(scene, tmp_path, capsys, given):
    still = scene.read_text().replace('task = "dynamics"', 'task = "statics"')
    scene.write_text("\n".join(line for line in still.splitlines() if not line.startswith("move")))
    assert main(["run", str(scene), "-o", str(tmp_path / "out"), "--set", f"loads.{given}"]) == 2
    said = capsys.readouterr().err
    assert f"loads.{given.split('=')[0]}" in said and "task = dynamics" in said


@pytest.mark.parametrize("solver", ["newton", "local-global"])
def test_a_run_that_goes_on_from_its_end_keeps_its_summary(scene, tmp_path, solver):
    given = ["--set", "dynamics.duration=0.2", "--set", f"dynamics.solver={solver}"]
    if solver == "local-global":
        given += ["--set", "shell.model=projective", "--set", "dynamics.iterations=3"]
    told = []
    for more in ((), ("--resume",)):
        assert main(["run", str(scene), "-o", str(tmp_path / "out"), *more, *given]) == 0
        told.append(read_summary(tmp_path / "out" / "summary.json"))
    for summary in told:
        del summary["wall_time_s"], summary["peak_memory_mib"]
    assert told[0]["energy"] and told[0]["contact"]["active"] and told[0]["residual_norm"]
    assert told[0]["krylov_iterations"] if solver == "newton" else "stopped by count" in told[0]["reason"]
    assert told[0] == told[1]


def test_resume_refuses_what_is_not_its_own(scene, tmp_path, capsys):
    out = tmp_path / "out"
    assert main(["run", str(scene), "-o", str(out), "--resume"]) == 2
    assert "nothing there" in capsys.readouterr().err and not out.exists()
    assert main(["run", str(scene), "-o", str(out)]) == 0
    last = out / "restart" / "last"
    step, ranks, form = last.read_text().split()
    for changed, message in ((f"{step} 3 {form}", "mpirun -n 3"), (f"{step} {ranks}", "another version")):
        last.write_text(changed)
        assert main(["run", str(scene), "-o", str(out), "--resume"]) == 2
        assert message in capsys.readouterr().err
    last.write_text(f"{step} {ranks} {form}")
    before = (out / "result.vtkhdf").read_bytes()
    assert main(["run", str(scene), "-o", str(out), "--resume", "--set", "shell.young=2e5"]) == 2
    assert "another scene" in capsys.readouterr().err and (out / "result.vtkhdf").read_bytes() == before
    assert main(["run", str(scene), "-o", str(out), "--resume"]) == 0  # it is at its end
    assert (out / "result.vtkhdf").read_bytes() == before


def test_rest_waits_for_what_the_scene_still_does(scene, tmp_path):
    out = tmp_path / "out"
    later = ["--set", "loads.history=[[0,0],[0.1,0],[0.2,1]]", "--set", "dynamics.stop_at_rest=0.001"]
    later += ["--set", "shell.velocity=[0,0,0]"]
    assert main(["run", str(scene), "-o", str(out), *later, "--set", "dynamics.duration=0.3"]) == 0
    assert read_summary(out / "summary.json")["dynamics"]["time"] >= 0.2


def test_adaptive_steps_of_a_flat_landing(scene, tmp_path):
    head, rest = scene.read_text().split("[[obstacle]]")
    ground = (
        '[[obstacle]]\nshape = "plane"\npoint = [0.0, 0.0, -0.01]\nnormal = [0.0, 0.0, 1.0]\nfriction = 0.4\n'
    )
    scene.write_text(head + ground + rest[rest.index("[dynamics]") :])
    adaptive = ["--set", "dynamics.adaptive=true", "--set", "dynamics.accuracy=1e-6"]
    assert main(["run", str(scene), "-o", str(tmp_path / "out"), *adaptive]) == 0
    assert read_summary(tmp_path / "out" / "summary.json")["converged"]


def test_a_stiff_tile_that_nothing_loads_flies_in_whole_steps(scene, tmp_path, capsys):
    """The tolerance without loads is no less than the round-off of stretching. Below it half the steps were cut, those
    left took eight iterations, and the log said that they end above it."""
    stiff = [
        "shell.young=1e10",
        "shell.thickness=1e-2",
        "shell.velocity=[5, -2, -1]",
        "loads.gravity=[0, 0, 0]",
    ]
    away = [
        "obstacle.0.center=[0, 0, -9]",
        "dynamics.theta=0.5",
        "dynamics.time_step=1e-3",
    ]
    sets = [part for key in stiff + away for part in ("--set", key)]
    sets += ["--set", 'dynamics.scheme="moreau-jean"', "--set", "dynamics.duration=0.02"]
    assert main(["run", str(scene), "-o", str(tmp_path / "out"), *sets]) == 0
    history = read_history(tmp_path / "out")
    assert len(history["time"]) == 20 and history["iterations"].max() <= 2
    assert (
        history["residual"] <= history["tolerance"]
    ).all() and "above their tolerance" not in capsys.readouterr().out
