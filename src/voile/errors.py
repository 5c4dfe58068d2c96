"""The two ways a run fails, the exit code of each (see interface: 2 bad input, 3 not converged), and how what fails on
one rank ends all of them."""

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from mpi4py import MPI


def printable(text: str) -> str:
    """A text whose control characters, which a file may hold and a terminal would obey, are written as escapes."""
    return "".join(c if c.isprintable() or c == "\n" else repr(c)[1:-1] for c in text)


class InputError(ValueError):
    """Bad input: one message naming the file, line or key, what is wrong and what is allowed."""

    exit_code = 2


class NotConverged(RuntimeError):
    """A solver did not converge; the message says which quantity missed which tolerance."""

    exit_code = 3

    def __init__(self, message: str, result: Any = None):
        """result: what was computed, a voile.api.Result, of runs from Python."""
        super().__init__(message)
        self.result = result


class NotWritten(NotConverged):
    """Results cannot be written any more: no room, no right. What was written before stays."""


class Hinged(NotConverged):
    """Parts (joints, all vertices) of a target that turn freely about the one or two vertices that they hang by."""

    def __init__(self, message: str, parts: list[Any]):
        super().__init__(message)
        self.parts = parts


def on_root(comm: "MPI.Comm", action: Callable[[], Any]) -> Any:
    """What an action gives on rank 0, None elsewhere; its error on all ranks, so that none waits for another."""
    outcome = failure = None
    if comm.rank == 0:
        try:
            outcome = action()
        except Exception as caught:
            failure = caught
    failure = comm.bcast(failure)
    if failure is not None:
        raise failure
    return outcome


def on_all(comm: "MPI.Comm", action: Callable[[], None]) -> None:
    """An action of every rank's own; the error of the first rank that has one on all of them."""
    failure = None
    try:
        action()
    except Exception as caught:
        failure = caught
    for found in comm.allgather(failure):
        if found is not None:
            raise found
