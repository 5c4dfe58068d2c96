"""Several signals at once: a second Ctrl-C, a service manager's SIGTERM and SIGHUP."""

import json
import signal
import subprocess
import sys

import pytest
from test_folder import voile  # noqa: F401, a fixture

from voile.results import ResultWriter, read_result
from voile.signals import stoppable

IMPATIENT = """
import atexit, signal, sys
atexit.register(signal.raise_signal, signal.SIGHUP)  # while the process ends
from voile.results import ResultWriter
import voile.tasks.run as runs
write_step, write_summary = ResultWriter.write_step, runs.write_summary
def stepped(self, *values, **more):
    write_step(self, *values, **more)
    signal.raise_signal(signal.SIGINT)
def told(*values):
    signal.raise_signal(signal.SIGTERM)  # while the summary is written
    write_summary(*values)
    signal.raise_signal(signal.SIGHUP)
ResultWriter.write_step, runs.write_summary = stepped, told
from voile.cli import main
sys.exit(main())
"""


def test_signals_after_the_first_cut_nothing_short(voile):  # noqa: F811
    scene = voile.folder.parent / "one.toml"
    command = [sys.executable, "-c", IMPATIENT, "run", scene, "-o", voile.folder]
    done = subprocess.run(command, capture_output=True, text=True, timeout=100)
    assert done.returncode == 3, done.stderr
    assert done.stderr.count("\n") == 1 and "stopped by a signal; what was computed is kept" in done.stderr
    assert json.loads((voile.folder / "summary.json").read_text())["reason"] == "stopped by a signal"
    assert read_result(voile.folder).n_steps == 1


LATE = """
import atexit, signal, sys
from pathlib import Path
import voile.petsc_options as options
import voile.results.folder as folder
from voile.cli import main
from voile.tasks import Progress
atexit.register(signal.raise_signal, signal.SIGTERM)  # while the process ends
def late(module, name):
    whole = getattr(module, name)
    def told(*values):
        if Path(sys.argv[4], "summary.json").exists():
            signal.raise_signal(signal.SIGTERM)
        return whole(*values)
    setattr(module, name, told)
late({where})
sys.exit(main())
"""


@pytest.mark.parametrize("where", ['options, "unused_options"', 'folder, "part_of"', 'Progress, "line"'])
@pytest.mark.parametrize("code", [0, 3])
def test_signals_after_the_last_step_change_nothing(voile, where, code):  # noqa: F811
    """A run that has done its work ends with its own exit code: it ended by the signal, or as if stopped."""
    scene = voile.folder.parent / "one.toml"
    command = [sys.executable, "-c", LATE.replace("{where}", where), "run", scene, "-o", voile.folder]
    command += ["--set", f"statics.max_steps={1 if code else 100}"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=100)
    assert done.returncode == code and "stopped by" not in done.stderr, done.stderr
    assert json.loads((voile.folder / "summary.json").read_text())["converged"] is (code == 0)


@pytest.mark.parametrize("where", ["_publish", "_rebuild"])
def test_a_signal_while_a_result_is_made_leaves_no_part_of_it(voile, monkeypatch, where):  # noqa: F811
    def told(self, *words):
        self._create(self._part, 1, {})
        raise KeyboardInterrupt

    monkeypatch.setattr(ResultWriter, where, told)
    assert voile("one")[0] == 3
    assert not list(voile.folder.glob(".*.part"))


def test_programs_that_call_the_command_line_have_their_signals_again():
    before = signal.getsignal(signal.SIGTERM)
    with pytest.raises(KeyboardInterrupt), stoppable() as told:
        signal.raise_signal(signal.SIGTERM)
    assert told == [signal.SIGTERM] and signal.getsignal(signal.SIGTERM) is before


LOADING = """
import signal, sys
from voile import cli
from voile.commands import all_commands
signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background ignores it
def told(args):
    try:
        signal.raise_signal(signal.SIGINT)
    except KeyboardInterrupt:
        raise ImportError("numpy.core.multiarray failed to import") from None
all_commands()["schema"].run = told
sys.exit(cli.main())
"""


def test_a_signal_that_a_module_meets_while_it_is_loaded_is_one():
    """Modules of C say that they cannot be imported: "voile: ImportError: ..." and exit code 1 at times."""
    command = [sys.executable, "-c", LOADING, "schema"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=100)
    assert done.returncode == 130 and done.stderr == "voile: stopped by a signal\n", done.stderr


DRAWN_TO = """
import os, signal, sys
from PIL import Image
signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background ignores it
def save(*words, **more):
    try:
        signal.raise_signal(signal.SIGINT)
    except BaseException:
        os._exit(9)  # an exception on the way
Image.Image.save = save
from voile.cli import main
sys.exit(main())
"""


def test_ctrl_c_ends_what_draws_at_once(voile):  # noqa: F811
    """VTK crashes where an exception comes out of what it loads."""
    assert voile("one") == (0, "")
    command = [sys.executable, "-c", DRAWN_TO, "render", voile.folder, "-o", voile.folder / "a.png"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=100)
    assert (done.returncode, done.stderr) == (130, "voile: stopped by a signal\n")
    assert not list(voile.folder.glob("*a.png*"))
