"""The command line: parses, runs a command of `voile.commands`, turns errors into messages and exit codes."""

import argparse
import os
import signal
import sys
import traceback
import warnings
from typing import Any

from voile.blas import check_memory
from voile.commands import all_commands
from voile.errors import InputError, NotConverged, printable
from voile.launch import launched, without_launcher
from voile.signals import INTERRUPTED, STOPPED, noted, process

# modules that a plain install lacks -> the extra of pyproject.toml that brings them
EXTRAS = {
    "pyvista": "pictures",
    "matplotlib": "pictures",
    "av": "pictures",
    "PIL": "pictures",
    "gmsh": "meshes",
    "spyrrow": "cutting",
}
DESCRIPTION = "Equilibria of thin elastic shells: garments, sheets, strips."


def main(argv: list[str] | None = None) -> int:
    """Runs a command; returns 0 done, 2 bad input, 3 not converged or stopped, 130 stopped where there was nothing to
    keep, 1 anything else."""
    without_launcher()
    _open_streams()
    process.ends = argv is None
    told = noted() if process.ends else []
    argv, debug = list(sys.argv[1:] if argv is None else argv), False
    split = argv.index("--") if "--" in argv else len(argv)
    try:
        args = _parser(*argv[:1]).parse_args(argv[:split])
        args.petsc, debug = argv[split + 1 :], args.debug
        if process.ends and not sys.warnoptions:  # NumPy's of what is not finite, which messages tell of
            warnings.simplefilter("ignore", RuntimeWarning)
        check_memory()
        _check_folder()
        code = args.command(args) or 0
        sys.stdout.flush()
        return code
    except (InputError, NotConverged) as error:
        if _first_rank():
            print(f"voile: {printable(str(error))}", file=sys.stderr)
        return error.exit_code
    except KeyboardInterrupt:
        return _stopped()
    except MemoryError:
        return _ended("not enough memory for this; allowed: a smaller mesh, or more memory (ulimit -v)", 1)
    except BrokenPipeError:  # who reads has read enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except Exception as error:
        if told:
            return _stopped()
        if debug:
            raise
        if isinstance(error, ModuleNotFoundError) and error.name in EXTRAS:
            return _ended(f"needs {error.name}: pip install 'voile[{EXTRAS[error.name]}]'", 1)
        if _ranks() > 1:
            traceback.print_exc()
        return _ended(f"{type(error).__name__}: {error}  (--debug shows where)", 1)


def _check_folder() -> None:
    """PETSc does not start in a folder that is gone."""
    try:
        os.getcwd()
    except OSError as error:
        raise InputError(f"the working folder: {error.strerror}; allowed: one that is there (cd)") from None


def _open_streams() -> None:
    """Opens what the caller closed (`>&-`) to nowhere: the next file would take its number, and what libraries print
    would go there."""
    for number, name, mode in ((0, "stdin", "r"), (1, "stdout", "w"), (2, "stderr", "w")):
        if getattr(sys, name) is None:
            nowhere = os.open(os.devnull, os.O_RDWR)
            if nowhere != number:
                os.dup2(nowhere, number)
                os.close(nowhere)
            setattr(sys, name, os.fdopen(number, mode, closefd=False))


def _stopped() -> int:
    if process.ends:  # a second signal would cut short what the first began
        signal.signal(signal.SIGINT, signal.SIG_IGN)
    return _ended(STOPPED, INTERRUPTED)


def _ended(why: str, code: int) -> int:
    """Tells why the program ends; ranks that wait for this one end with it."""
    print(f"voile: {printable(why)}", file=sys.stderr, flush=True)
    if _ranks() > 1:
        sys.modules["mpi4py.MPI"].COMM_WORLD.Abort(code)
    if (
        launched() and "petsc4py" in sys.modules
    ):  # MPI may be half begun, and would wait at its end for other ranks
        sys.stdout.flush()
        os._exit(code)
    return code


def _ranks() -> int:
    mpi = sys.modules.get("mpi4py.MPI")
    return mpi.COMM_WORLD.size if mpi and mpi.Is_initialized() else 1


class CommandParser(argparse.ArgumentParser):
    """Takes options also between positional arguments, of which some may be left out."""

    _splitting = False

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> tuple[Any, list[str]]:
        if self._splitting:
            return super().parse_known_args(args, namespace)
        self._splitting = True
        try:
            return self.parse_known_intermixed_args(args, namespace)
        finally:
            self._splitting = False


def _parser(command: str = "") -> argparse.ArgumentParser:
    """Of all commands, or of one alone where that is named first: reading them all takes 10 ms."""
    parser = argparse.ArgumentParser(prog="voile", description=DESCRIPTION)
    parser.add_argument("--debug", action="store_true", help="show where an error came from")
    names = parser.add_subparsers(required=True, metavar="COMMAND", parser_class=CommandParser)
    for name, module in all_commands(command).items():
        sub = names.add_parser(name, help=module.TEXT, description=module.TEXT)
        sub.set_defaults(command=module.run)
        module.arguments(sub)
    return parser


def _first_rank() -> bool:
    mpi = sys.modules.get("mpi4py.MPI")
    return mpi is None or mpi.COMM_WORLD.rank == 0


if __name__ == "__main__":
    sys.exit(main())
