"""The command line in this process: what a program of its own would say and return, half a second sooner."""

import contextlib
import io
import subprocess

from voile.cli import main


def voile(*args: object, cwd: object = ".") -> subprocess.CompletedProcess[str]:
    """`voile args`, in a folder. What PETSc itself prints is not caught."""
    out, said, words = io.StringIO(), io.StringIO(), [str(arg) for arg in args]
    with contextlib.chdir(cwd), contextlib.redirect_stdout(out), contextlib.redirect_stderr(said):
        try:
            code = main(words)
        except SystemExit as ended:  # of argparse
            code = ended.code
    return subprocess.CompletedProcess(words, code, out.getvalue(), said.getvalue())


def refused(done: subprocess.CompletedProcess[str], *words: str) -> None:
    """Exit code 2 and one line on standard error that holds the words."""
    assert done.returncode == 2, (done.returncode, done.stderr)
    assert done.stderr.startswith("voile: ") and done.stderr.count("\n") == 1, done.stderr
    for word in words:
        assert word in done.stderr, done.stderr
