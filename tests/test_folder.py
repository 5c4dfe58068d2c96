"""The folder of a run: one run at a time, results of one scene, files of its own only."""

import fcntl
import json
import os
import resource
import signal
import subprocess
import sys
import time

import pytest
from mpi4py import MPI

from voile.cli import main
from voile.errors import NotWritten
from voile.results import read_result
from voile.results.history import HistoryWriter, read_history

SCENE = """
[shell]
mesh = "strip.obj"
young = 1e6
thickness = 1e-3
density = 300.0

[[fix]]
select = { box = [[-0.01, -1, -1], [0.06, 1, 1]] }
"""
STRIP = "\n".join(
    [f"v {0.05 * i} {0.05 * j} 0" for i in range(5) for j in range(2)]
    + [f"f {2 * i + a} {2 * i + b} {2 * i + c}" for i in range(4) for a, b, c in ((1, 3, 4), (1, 4, 2))]
)


@pytest.fixture
def voile(tmp_path, capsys):
    """voile(name, *arguments): runs a scene of that name into out; exit code and standard error."""
    (tmp_path / "strip.obj").write_text(STRIP)
    for name in ("one", "other"):
        (tmp_path / f"{name}.toml").write_text(SCENE)

    def run(name, *arguments):
        code = main(["run", str(tmp_path / f"{name}.toml"), "-o", str(tmp_path / "out"), *arguments])
        return code, capsys.readouterr().err

    run.folder = tmp_path / "out"
    return run


def test_a_second_run_in_a_folder_is_refused_while_the_first_goes(voile):
    assert voile("one") == (0, "")
    before = (voile.folder / "result.vtkhdf").read_bytes()
    with open(voile.folder / ".voile-run") as held:
        fcntl.flock(held, fcntl.LOCK_EX)
        code, said = voile("one", "--force")
    assert code == 2 and "out: a run is writing there (process " in said and said.count("\n") == 1
    assert (voile.folder / "result.vtkhdf").read_bytes() == before
    assert voile("one") == (0, "")  # the lock ended with who held it; its file stays


def test_results_of_another_scene_stay_unless_forced(voile):
    assert voile("one") == (0, "")
    assert voile("one", "--set", "shell.young=2e6") == (0, "")
    code, said = voile("other")
    assert (
        code == 2 and "out: holds results of '../one.toml'; allowed: another folder (-o), or --force" in said
    )
    assert "young=2e6" in read_result(voile.folder).scene_text
    assert voile("other", "--force") == (0, "")
    assert voile("one")[0] == 2


def test_results_without_a_record_are_of_the_scene_that_they_hold(voile):
    assert voile("one") == (0, "")
    (voile.folder / ".voile-run").unlink()
    assert voile("other") == (0, "")  # the same text
    (voile.folder / ".voile-run").unlink()
    (voile.folder.parent / "one.toml").write_text(SCENE.replace("1e6", "3e6"))
    assert voile("one")[0] == 2


def test_a_run_that_ends_before_its_first_step_leaves_no_older_result_beside_its_summary(voile, monkeypatch):
    assert voile("one") == (0, "")
    from voile.tasks import statics

    def told(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr(statics, "solve_statics", told)
    for _ in range(2):
        assert voile("one")[0] == 3
        assert json.loads((voile.folder / "summary.json").read_text())["reason"] == "stopped by a signal"
        assert not (voile.folder / "result.vtkhdf").exists()
        assert json.loads((voile.folder / "summary.previous.json").read_text())["converged"]
        assert read_result(voile.folder / "result.previous.vtkhdf").n_steps


@pytest.mark.parametrize("how", ["symlink", "link", "fifo"])
def test_prepared_files_are_not_written_through(voile, tmp_path, how):
    (tmp_path / "precious").write_text("precious")
    voile.folder.mkdir()
    for name in (
        ".result.vtkhdf.part",
        ".summary.json.part",
        ".result.part",
        "summary.json",
        "result.vtkhdf",
    ):
        if how == "fifo":
            os.mkfifo(voile.folder / name)
        else:
            getattr(os, how)(tmp_path / "precious", voile.folder / name)
    assert voile("one", "--force")[0] == 0
    assert (tmp_path / "precious").read_text() == "precious"
    assert read_result(voile.folder).n_steps
    assert not list(voile.folder.glob(".*part"))


@pytest.mark.parametrize(
    "name",
    [
        "summary.json",
        "result.vtkhdf",
        ".voile-run",
        "history.h5",
        "pattern.svg",
        "restart/last",
        ".summary.json.part",
    ],
)
def test_a_folder_where_a_file_is_to_be(voile, name):
    (voile.folder / name).mkdir(parents=True)
    code, said = voile("one")
    assert code == 2 and f"{name}: a folder; runs write a file of that name" in said


def test_a_link_in_place_of_the_record(voile, tmp_path):
    (tmp_path / "precious").write_text("precious")
    voile.folder.mkdir()
    os.symlink(tmp_path / "precious", voile.folder / ".voile-run")
    code, said = voile("one")
    assert code == 2 and ".voile-run: cannot be opened" in said
    assert (tmp_path / "precious").read_text() == "precious"


DYNAMICS = '[scene]\ntask = "dynamics"\n[dynamics]\nduration = 1e3\ntime_step = 0.01\n'


# 260,000 are the file's first tables
@pytest.mark.parametrize("room", [400_000, pytest.param(600_000, marks=pytest.mark.slow)])
def test_a_full_disk_ends_a_run_with_a_message(voile, room):
    """The steps so far are readable, and the summary says why."""
    (voile.folder.parent / "long.toml").write_text(DYNAMICS + SCENE)
    done = subprocess.run(
        [sys.executable, "-m", "voile.cli", "run", voile.folder.parent / "long.toml", "-o", voile.folder],
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (room, room)),
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert done.returncode == 3 and "cannot be written: File too large" in done.stderr
    assert done.stderr.count("\n") == 1
    assert "File too large" in json.loads((voile.folder / "summary.json").read_text())["reason"]
    with read_result(voile.folder) as result:
        assert result.n_steps >= 16 and abs(result.points()).max() < 1.0


def test_a_limit_on_files_ends_a_history_and_leaves_the_one_before(tmp_path):
    """HDF5 would not survive it, not even in memory."""
    history = HistoryWriter(tmp_path / "history.h5", MPI.COMM_SELF)
    history.add({"time": 0.0, "figure": 1.0})
    history.write()
    for k in range(1, 8001):
        history.add({"time": float(k), "figure": 1.0})
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, limits[1]))
    try:
        with pytest.raises(NotWritten, match=r"history.h5: cannot be written: File too large"):
            history.write()
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert read_history(tmp_path)["time"] == [0.0]
    history.write()
    assert len(read_history(tmp_path)["time"]) == 8001


@pytest.mark.parametrize("number", [signal.SIGHUP, signal.SIGUSR2, signal.SIGXCPU])
def test_terminals_that_close_and_limits_end_a_run_with_its_summary(voile, monkeypatch, number):
    from voile.results import ResultWriter

    write_step = ResultWriter.write_step

    def told(self, *values, **more):
        write_step(self, *values, **more)
        signal.raise_signal(number)

    monkeypatch.setattr(ResultWriter, "write_step", told)
    before = signal.signal(number, signal.SIG_DFL)  # nohup may have started the tests themselves
    try:
        code, said = voile("one")
    finally:
        signal.signal(number, before)
    assert code == 3 and "stopped by a signal" in said
    assert json.loads((voile.folder / "summary.json").read_text())["reason"] == "stopped by a signal"


def test_what_nohup_starts_outlives_its_terminal(voile, monkeypatch):
    from voile.results import ResultWriter

    write_step = ResultWriter.write_step

    def told(self, *values, **more):
        write_step(self, *values, **more)
        signal.raise_signal(signal.SIGHUP)

    monkeypatch.setattr(ResultWriter, "write_step", told)
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        assert voile("one") == (0, "")
    finally:
        signal.signal(signal.SIGHUP, before)


@pytest.mark.parametrize("streams", [">&-", ">&- 2>&- <&-", "> /dev/full"])
def test_a_run_needs_nobody_who_reads_it(voile, streams):
    command = (
        f"{sys.executable} -m voile.cli run {voile.folder.parent / 'one.toml'} -o {voile.folder} {streams}"
    )
    assert subprocess.run(command, shell=True, timeout=100).returncode == 0
    assert read_result(voile.folder).n_steps >= 1


def test_a_folder_that_is_gone_is_told(voile):
    gone = voile.folder.parent / "gone"
    gone.mkdir()
    command = (
        f"cd {gone} && rmdir {gone} && {sys.executable} -m voile.cli run {voile.folder.parent / 'one.toml'}"
    )
    done = subprocess.run(command, shell=True, timeout=100, capture_output=True, text=True)
    assert done.returncode == 2 and done.stderr.count("\n") == 1
    assert done.stderr.startswith("voile: the working folder: ")


@pytest.mark.mpi
@pytest.mark.parametrize("number", [signal.SIGTERM, pytest.param(signal.SIGINT, marks=pytest.mark.slow)])
def test_a_signal_to_one_rank_ends_all_of_them(voile, mpirun, number):
    scene = voile.folder.parent / "long.toml"
    scene.write_text(DYNAMICS + SCENE)
    program = (
        "import os, signal, sys, threading, time\n"
        "from mpi4py import MPI\n"
        "def tell():\n"
        f"    while not os.path.exists({str(voile.folder / 'result.vtkhdf')!r}):\n"
        "        time.sleep(0.1)\n"
        f"    os.kill(os.getpid(), {int(number)})\n"
        "if MPI.COMM_WORLD.rank == 1:\n"
        "    threading.Thread(target=tell, daemon=True).start()\n"
        "from voile.cli import main\n"
        f"sys.exit(main(['run', {str(scene)!r}, '-o', {str(voile.folder)!r}]))\n"
    )
    done = mpirun(2, [sys.executable, "-c", program], 200)
    assert done.returncode == 3, done.stderr
    assert done.stderr.count("stopped by a signal") == 1
    assert json.loads((voile.folder / "summary.json").read_text())["reason"] == "stopped by a signal"
    assert read_result(voile.folder).n_steps >= 1


def test_a_signal_that_comes_while_something_is_freed_ends_the_run_too(voile, monkeypatch):
    """Python swallows what is raised then, and would print it."""
    from voile.results import ResultWriter

    class Freed:
        def __del__(self):
            signal.raise_signal(signal.SIGTERM)

    steps, write_step = [], ResultWriter.write_step

    def told(self, *values, **more):
        write_step(self, *values, **more)
        steps.append(Freed())
        steps[-1] = None

    monkeypatch.setattr(ResultWriter, "write_step", told)
    (voile.folder.parent / "one.toml").write_text(DYNAMICS.replace("1e3", "1.0") + SCENE)
    code, said = voile("one")
    assert code == 3 and said.count("\n") == 1 and "stopped by a signal" in said
    assert len(steps) == 1 and read_result(voile.folder).n_steps == 1


@pytest.mark.parametrize("seconds", [0.3, 0.6])
def test_ctrl_c_at_the_start_leaves_no_traceback(voile, seconds):
    command = [
        sys.executable,
        "-c",
        "import sys; from voile.cli import main; print(flush=True); sys.exit(main())",
    ]
    with subprocess.Popen(
        [*command, "run", voile.folder.parent / "one.toml", "-o", voile.folder],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        assert process.stdout
        process.stdout.readline()
        time.sleep(seconds)
        process.send_signal(signal.SIGINT)
        said = process.communicate(timeout=100)[1]
    # -SIGINT: told while the interpreter left, after the run was complete; shells call it 130 too
    assert "Traceback" not in said and process.returncode in (0, 3, 130, -signal.SIGINT)


def test_a_run_goes_on_when_nobody_reads_its_lines(voile):
    command = [sys.executable, "-m", "voile.cli", "run", voile.folder.parent / "one.toml", "-o", voile.folder]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stdout and process.stderr
        process.stdout.close()
        said = process.stderr.read()
    assert process.returncode == 0 and said == ""
    assert json.loads((voile.folder / "summary.json").read_text())["converged"]


def test_too_little_memory_is_told(voile):
    done = subprocess.run(
        [sys.executable, "-m", "voile.cli", "run", voile.folder.parent / "one.toml", "-o", voile.folder],
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_AS, (400 << 20, 400 << 20)),
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert done.returncode == 2
    assert "the address space is limited to 400 MiB (ulimit -v); allowed: from 1024 MiB" in done.stderr


@pytest.mark.parametrize(
    ("option", "told"),
    [
        ("-snes_atol 1e30", "the option -snes_atol 1e+30 is above it"),
        ("-snes_stol 1", "the option -snes_stol 1 may have ended it"),
    ],
)
def test_a_tolerance_above_the_scene_s_is_no_convergence(voile, option, told):
    from voile.petsc_options import options_of_run, start_petsc

    start_petsc()
    with options_of_run(option.split()):
        code, said = voile("one")
    assert code == 3 and told in said


@pytest.mark.parametrize(
    ("text", "allowed"),
    [
        (STRIP.replace("v 0.05 ", "v 1e300 "), "allowed: at most 1e+30"),
        ("v 0 0 0\nv 1e-150 0 0\nv 0 1e-150 0\nf 1 2 3\n", "smaller than 1e-30 m"),
        (STRIP + "\nstitch 5 5 5 0.5\n", "ties vertex 5"),
        (STRIP + "\nf 1 \x1b[31m 3\n", "\\x1b[31m"),
    ],
)
def test_meshes_beyond_numbers_and_terminals(voile, text, allowed):
    (voile.folder.parent / "strip.obj").write_text(text)
    code, said = voile("one")
    assert code == 2 and allowed in said and said.strip().isprintable() and "Warning" not in said


def test_strings_have_no_end(voile):
    """HDF5 itself would look without end for the next string of a heap whose rest is zeros."""
    assert voile("one") == (0, "")
    result = voile.folder / "result.vtkhdf"
    data = bytearray(result.read_bytes())
    heap = data.index(b"GCOL")
    data[heap + 16 : heap + 32] = bytes(16)
    result.write_bytes(data)
    assert main(["info", str(voile.folder)]) == 2


def test_stitches_in_a_circle_are_told(voile):
    (voile.folder.parent / "strip.obj").write_text(STRIP + "\nstitch 0 1 1 0\nstitch 1 0 0 0\n")
    voile("one")
    notes = json.loads((voile.folder / "summary.json").read_text())["notes"]
    assert any("2 stitches join vertices in a circle" in note for note in notes)
