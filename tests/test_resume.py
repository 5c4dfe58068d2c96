"""`voile run --resume`: what is killed goes on from its last complete step, and ends as if nothing had been."""

import shutil
import signal
import subprocess
import sys
import time

import h5py
import numpy as np
import pytest
from campaign_sources import STRIP

from voile.cli import main
from voile.results import read_result, read_summary
from voile.results.restart import Restarts

SHELL = """
[shell]
mesh = "strip.obj"
young = 1e8
thickness = 1e-3
density = 300.0
[[fix]]
select = { box = [[-0.01, -1, -1], [0.01, 1, 1]] }
clamp = true
"""
SPHERE = """
[[obstacle]]
shape = "sphere"
center = [0.1, -0.05, 0.025]
radius = 0.045
friction = 0.3
"""
STATICS = '[scene]\ntask = "statics"\n[statics]\nload_steps = 40\n'
ARC = '[scene]\ntask = "statics"\n[statics]\nload_steps = 40\ncontrol = "arc-length"\n'
SCENES = {"load": STATICS + SHELL + SPHERE, "arc": ARC + SHELL}
SOFT = SHELL.replace("young = 1e8", "young = 6e6")
SCENES["nearest"] = '[scene]\ntask = "inverse"\n' + SOFT
SCENES["panels"] = '[scene]\ntask = "inverse"\n[inverse]\ndevelopable = "panels"\niterations = 8\n' + SOFT


@pytest.fixture
def write(tmp_path):
    """write(name): the file of a scene."""
    (tmp_path / "strip.obj").write_text(STRIP)

    def scene(name):
        path = tmp_path / f"{name}.toml"
        path.write_text(SCENES[name])
        return path

    return scene


def kept(folder):
    """The number of the set that a run in a folder goes on from, -1 without one."""
    try:
        return int((folder / "restart" / "last").read_text().split()[0])
    except (OSError, IndexError):
        return -1


# Keeps every step, but what follows the step given as first word is not kept: the run waits to be killed.
WAITING = """
import sys, time
from voile.cli import main
from voile.results.restart import Restarts
Restarts.PAUSE = Restarts.SHARE = 0.0
save, last = Restarts.save, int(sys.argv.pop(1))
def until(self, step, *more):
    time.sleep(1000.0 * (step > last))
    save(self, step, *more)
Restarts.save = until
sys.exit(main(sys.argv[1:]))
"""


def killed(scene, folder, step):
    """Runs a scene until it has kept a step, then ends it by SIGKILL."""
    words = [sys.executable, "-c", WAITING, str(step), "run", scene, "-o", folder]
    with subprocess.Popen(words, stdout=-3) as process:
        while kept(folder) < step:
            assert process.poll() is None
            time.sleep(0.002)
        process.send_signal(signal.SIGKILL)


@pytest.mark.parametrize("name", ["load", "arc"])
def test_a_killed_path_goes_on(write, tmp_path, name, capsys):
    """The results are those of one run to the solver's tolerance."""
    scene, whole, parts = write(name), tmp_path / "whole", tmp_path / "parts"
    assert main(["run", str(scene), "-o", str(whole)]) == 0
    killed(scene, parts, 7)
    first = kept(parts)
    assert 7 <= first < 40 and read_result(parts).n_steps >= first
    capsys.readouterr()
    assert main(["run", str(scene), "-o", str(parts), "--resume"]) == 0
    done = sum(line.startswith("load ") for line in capsys.readouterr().out.splitlines())
    with read_result(whole) as one, read_result(parts) as other:
        assert done == one.n_steps - first
        np.testing.assert_allclose(other.values, one.values, rtol=1e-8)
        for step in range(one.n_steps):
            np.testing.assert_allclose(other.points(step), one.points(step), rtol=0, atol=1e-8)
    one, other = (read_summary(folder / "summary.json") for folder in (whole, parts))
    for figure in ("converged", "reason", "steps", "method", "stable", "limit_points", "newton_iterations"):
        assert one.get(figure) == other.get(figure), figure
    before = (parts / "result.vtkhdf").read_bytes()
    assert main(["run", str(scene), "-o", str(parts), "--resume"]) == 0  # it is at its end
    assert (parts / "result.vtkhdf").read_bytes() == before


@pytest.mark.parametrize(
    ("name", "step"), [("nearest", 12), ("panels", 6), pytest.param("panels", 13, marks=pytest.mark.slow)]
)
def test_a_killed_search_goes_on(write, tmp_path, name, step):
    """The nearest stable shape, or the panels, found after a kill on the way are those of one search, bit for bit; the
    adjoint method's, too, whose trials are often rejected."""
    scene, whole, parts = write(name), tmp_path / "whole", tmp_path / "parts"
    one = main(["run", str(scene), "-o", str(whole)])
    killed(scene, parts, step)
    assert not (parts / "result.vtkhdf").exists()
    assert main(["run", str(scene), "-o", str(parts), "--resume"]) == one
    with read_result(whole) as a, read_result(parts) as b:
        np.testing.assert_array_equal(a.rest, b.rest)
        np.testing.assert_allclose(a.points(), b.points(), rtol=0, atol=1e-8)
    found, again = (read_summary(folder / "summary.json") for folder in (whole, parts))
    assert found["reason"] == again["reason"] and not (parts / "restart").exists()  # it has ended
    found, again = found["inverse"], again["inverse"]
    if name == "nearest":
        assert found["nearest"]["steps"] > 12 and found["nearest"] == again["nearest"]
    else:
        assert found["forward_solves"] > found["adjoint_iterations"] + 1  # trials were rejected
        for figure in ("adjoint_iterations", "sag"):
            assert found[figure] == again[figure]


def test_resume_starts_anew_where_nothing_is_kept_and_refuses_what_is_not_its_own(
    write, tmp_path, capsys, monkeypatch
):
    monkeypatch.setattr(Restarts, "PAUSE", 0.0)  # runs of under half a second keep nothing
    scene, out = write("load"), tmp_path / "out"
    short = ["--set", "statics.load_steps=2"]
    assert main(["run", str(scene), "-o", str(out), "--resume", *short]) == 2
    assert "nothing there" in capsys.readouterr().err and not out.exists()
    assert main(["run", str(scene), "-o", str(out), *short]) == 0
    (out / "restart" / "last").unlink()
    capsys.readouterr()
    assert main(["run", str(scene), "-o", str(out), "--resume", *short]) == 0
    assert "no step to go on from: the run starts anew" in capsys.readouterr().out
    for change in (["--set", "shell.young=2e8"], ()):
        if not change:
            (tmp_path / "strip.obj").write_text(STRIP.replace("v 0.04", "v 0.041"))
        assert main(["run", str(scene), "-o", str(out), "--resume", *short, *change]) == 2
        assert "of another scene, other meshes or other --set" in capsys.readouterr().err
    (tmp_path / "strip.obj").write_text(STRIP)
    (set_of_one,) = (out / "restart").glob("*.npz")
    data = set_of_one.read_bytes()
    for broken in (data[: len(data) // 2], data[:600] + b"\xff" + data[601:], b""):
        set_of_one.write_bytes(broken)
        assert main(["run", str(scene), "-o", str(out), "--resume", *short]) == 2
        assert "damaged" in capsys.readouterr().err


def test_no_run_goes_on_in_a_damaged_folder(write, tmp_path, capsys):
    """A damaged result gets no further steps, and `last` is said to be what is damaged."""
    scene, whole, out = write("load"), tmp_path / "whole", tmp_path / "out"
    killed(scene, whole, 2)

    def refused(name, change):
        shutil.rmtree(out, ignore_errors=True)
        shutil.copytree(whole, out)
        change(out / name)
        data = (out / name).read_bytes()
        capsys.readouterr()
        assert main(["run", str(scene), "-o", str(out), "--resume"]) == 2
        said = capsys.readouterr().err
        assert "damaged" in said and str(out / name) in said
        assert (out / name).read_bytes() == data

    def misplace(path):
        with h5py.File(path, "r+") as file:
            file["VTKHDF/Connectivity"][0] = 1 << 20

    def overwrite(path):  # the table of VTK's offsets, which no reader of ours asks for
        with h5py.File(path) as file:
            place = h5py.h5o.get_info(file["VTKHDF/Steps/PointOffsets"].id).addr
        data = path.read_bytes()
        path.write_bytes(data[:place] + 16 * b"\xff" + data[place + 16 :])

    for change in (misplace, overwrite):
        refused("result.vtkhdf", change)
    for last in (b"2x1 6\n", b"\xf7 1 6\n", b"2 1 6\n2 1 6\n"):
        refused("restart/last", lambda path, last=last: path.write_bytes(last))
    step = (whole / "restart" / "last").read_text().split()[0]  # a kill may leave the one before beside it

    def repack(path):  # in a way that no one knows
        data = path.read_bytes()
        place = data.index(b"PK\x01\x02") + 10
        path.write_bytes(data[:place] + b"\x63" + data[place + 1 :])

    refused(f"restart/{step}-0.npz", repack)
