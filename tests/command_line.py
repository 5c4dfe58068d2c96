"""The command line in this process: what a program of its own would say and return, half a second sooner."""

import contextlib
import io
import runpy
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from unittest import mock

from voile.cli import main


def voile(*args: object, cwd: object = ".") -> subprocess.CompletedProcess[str]:
    """`voile args`, in a folder. What PETSc itself prints is not caught."""
    words = [str(arg) for arg in args]
    with contextlib.chdir(cwd):
        return _caught(words, lambda: main(words))


def script(*args: object) -> subprocess.CompletedProcess[str]:
    """`python args`, of which the first is a file."""
    words = [str(arg) for arg in args]

    def run() -> None:
        folders = [str(Path(words[0]).parent), *sys.path]
        with mock.patch.object(sys, "argv", words), mock.patch.object(sys, "path", folders):
            runpy.run_path(words[0], run_name="__main__")

    return _caught(words, run)


def _caught(words: list[str], run: Callable[[], int | None]) -> subprocess.CompletedProcess[str]:
    out, said = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(said):
        try:
            code = run()
        except SystemExit as ended:  # of argparse
            code = ended.code
    return subprocess.CompletedProcess(words, code or 0, out.getvalue(), said.getvalue())


def refused(done: subprocess.CompletedProcess[str], *words: str) -> None:
    """Exit code 2 and one line on standard error that holds the words."""
    assert done.returncode == 2, (done.returncode, done.stderr)
    assert done.stderr.startswith("voile: ") and done.stderr.count("\n") == 1, done.stderr
    for word in words:
        assert word in done.stderr, done.stderr
