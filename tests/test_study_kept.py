"""What a study keeps: the same tables again, kills and stops, runs by themselves, what runs again and what does not."""

import fcntl
import json
import os
import shutil
import signal
import subprocess
import time
from pathlib import Path

import pytest
from command_line import voile
from studies import SCENE, THREE, done, place, table, write_strip
from test_cli import VOILE

from voile.study.plan import read_plan


@pytest.fixture
def study(tmp_path):
    """study(text): writes study.toml beside the scene of a coarse strip."""
    return place(tmp_path)


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """Results of the study THREE, once for all tests that go on from them."""
    folder = tmp_path_factory.mktemp("finished")
    done(place(folder)(THREE), folder / "out")
    return folder / "out"


def test_two_studies_find_the_same(study, tmp_path):
    """With the second of the finest run between them, whoever else is at work."""
    path = study(THREE.replace("1, 2]", "4]").replace("repeats = 1", 'repeats = 2\nclock = "cpu"'))
    one, other = (done(path, tmp_path / name) for name in ("one", "other"))
    assert table(tmp_path / "one", timeless=True) == table(tmp_path / "other", timeless=True)
    assert [r["run"] for r in one["pareto"]] == [r["run"] for r in other["pareto"]]
    assert [r["run"] for r in one["recommended"]] == [r["run"] for r in other["recommended"]]


def test_a_killed_study_goes_on_to_the_same_table(study, finished, tmp_path):
    path = study(THREE)
    with subprocess.Popen(
        [*VOILE, "study", path, "-o", tmp_path / "killed"], stderr=subprocess.PIPE, text=True
    ) as going:
        assert going.stderr is not None and going.stderr.readline().startswith("refine=0: ")
        time.sleep(0.3)  # within the second run
        os.kill(going.pid, signal.SIGKILL)
    assert going.returncode == -signal.SIGKILL
    again = voile("study", path, "-o", tmp_path / "killed")
    assert again.returncode == 0, again.stderr
    assert again.stderr.splitlines()[0].endswith(", known")
    assert table(tmp_path / "killed", timeless=True) == table(finished, timeless=True)


@pytest.mark.parametrize("number", [signal.SIGINT, pytest.param(signal.SIGTERM, marks=pytest.mark.slow)])
def test_a_stopped_study_leaves_no_half_run(number, study, tmp_path):
    path = study(THREE.replace("2]", "5]"))
    with subprocess.Popen(
        [*VOILE, "study", path, "-o", tmp_path / "out"], stderr=subprocess.PIPE, text=True
    ) as going:
        assert going.stderr is not None and going.stderr.readline().startswith("refine=0: ")
        time.sleep(0.3)
        os.kill(going.pid, number)
        told = going.stderr.read()
    assert going.returncode == 3 and told.endswith("out, the same command goes on\n"), told
    records = [json.loads(p.read_text()) for p in (tmp_path / "out" / "runs").glob("*/run.json")]
    assert records and all(record["status"] == "converged" for record in records)


def test_a_run_by_itself_that_is_stopped_takes_its_program_along(study, tmp_path):
    path, runs = study(THREE.replace("2]", "6]")), tmp_path / "out" / "runs"
    with subprocess.Popen(
        [*VOILE, "study", path, "-o", tmp_path / "out", "--run", "3"], stderr=subprocess.PIPE, text=True
    ) as going:
        while not list(runs.glob("*/log.txt")):
            time.sleep(0.02)
        going.send_signal(signal.SIGTERM)
        assert going.stderr is not None and "the same command goes on" in going.stderr.read()
    assert going.returncode == 3 and not list(runs.glob("*/run.json"))
    (lock,) = runs.glob("*.lock")
    with open(lock) as file:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)  # which the program would hold


def test_a_study_that_waits_for_another_s_run_is_stopped_at_once(study, tmp_path):
    path = study(THREE)
    (tmp_path / "out" / "runs").mkdir(parents=True)
    runs = read_plan(path).runs
    lock = tmp_path / "out" / "runs" / f"{runs[0].folder}.lock"
    with (
        open(lock, "w") as held,
        subprocess.Popen(
            [*VOILE, "study", path, "-o", tmp_path / "out"], stderr=subprocess.PIPE, text=True
        ) as going,
    ):
        fcntl.flock(held, fcntl.LOCK_EX)
        while lock not in [file.resolve() for file in Path(f"/proc/{going.pid}/fd").iterdir()]:
            time.sleep(0.05)
        time.sleep(0.3)
        going.send_signal(signal.SIGTERM)
        going.send_signal(signal.SIGINT)
        told = going.communicate(timeout=20)[1]
    assert going.returncode == 3 and told.endswith("out, the same command goes on\n"), told


def test_a_study_that_nohup_starts_outlives_its_terminal(study, tmp_path):
    with subprocess.Popen(
        ["nohup", *VOILE, "study", study(THREE), "-o", tmp_path / "out"],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    ) as going:
        assert going.stderr is not None and going.stderr.readline().startswith("refine=0: ")
        going.send_signal(signal.SIGHUP)
        told = going.stderr.read()
    assert going.returncode == 0, told


def test_runs_by_themselves_are_collected_later(study, tmp_path):
    path = study(THREE)
    listed = voile("study", path, "-o", tmp_path / "out", "--list-runs").stdout.splitlines()
    assert len(listed) == 3 and listed[1].endswith("--run 2")
    subprocess.run(
        f"{listed[1]} & {listed[1]} & wait", shell=True, check=True, capture_output=True, timeout=60
    )
    left = voile("study", path, "-o", tmp_path / "out", "--list-runs").stdout.splitlines()
    assert left == [listed[0], listed[2]]
    (record,) = (tmp_path / "out" / "runs").glob("*/run.json")
    kept = record.read_text()
    record.write_text(json.dumps(json.loads(kept) | {"status": "failed", "reason": "no memory"}))
    assert voile("study", path, "-o", tmp_path / "out", "--list-runs").stdout.splitlines() == listed
    subprocess.run(listed[1], shell=True, check=True, capture_output=True, timeout=60)
    assert json.loads(record.read_text())["status"] == "converged"
    again = voile("study", path, "-o", tmp_path / "out")
    assert again.returncode == 0
    assert [line.endswith("known") for line in again.stderr.splitlines()] == [False, True, False]


def test_what_decides_a_result_decides_what_runs_again(study, finished, tmp_path):
    path = study(THREE)
    shutil.copytree(finished, tmp_path / "out")

    def again():
        return [
            line.endswith("known")
            for line in voile("study", path, "-o", tmp_path / "out").stderr.splitlines()
        ]

    (tmp_path / "scene.toml").write_text("# a remark\n" + SCENE)
    assert again() == [True] * 3
    study(THREE.replace("[0, 1, 2]", "[0, 3]").replace('measure = "tip"', 'measure = ["tip"]'))
    assert again() == [True, False]
    write_strip(tmp_path, 0.2)
    assert again() == [False, False]


def test_a_new_measure_needs_no_new_run(study, finished, tmp_path):
    shutil.copytree(finished, tmp_path / "out")
    study(THREE.replace('"tip"\nreference', '"max_displacement"\nreference'))
    run = voile("study", tmp_path / "study.toml", "-o", tmp_path / "out")
    assert run.returncode == 0 and all(line.endswith("known") for line in run.stderr.splitlines())
    assert 0.6 < float(table(tmp_path / "out")[0]["max_displacement"]) < 0.9


def test_a_run_that_takes_too_long_is_ended(study, finished, tmp_path):
    shutil.copytree(finished, tmp_path / "out")  # what is known needs no second that others may take
    text = THREE.replace("repeats", "max_seconds = 1.0\nrepeats").replace("2]", "7]")
    run = voile("study", study(text), "-o", tmp_path / "out")
    assert run.returncode == 0
    assert table(tmp_path / "out")[2]["status"] == "too long"
