"""Signals that end a run."""

import os
import signal
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from types import FrameType

from voile.files import unfinished

INTERRUPTED = 130  # as shells say it of Ctrl-C
STOPPED = "stopped by a signal"
# What a user, a terminal that closes and a batch system's limits send. SIGUSR1 and SIGUSR2 mpirun hands on to its ranks
# and then ends as they do; SIGTERM it takes for itself.
ENDING = (signal.SIGTERM, signal.SIGINT, signal.SIGUSR1, signal.SIGUSR2, signal.SIGHUP, signal.SIGXCPU)


@dataclass
class Process:
    """ends: it does after the command that runs, as it does not where a program or a test calls one; over: what signals
    end has ended."""

    ends: bool = False
    over: bool = False


process = Process()


@contextmanager
def stoppable(together: bool = False) -> Iterator[list[int]]:
    """Signals end what runs within by KeyboardInterrupt, and are noted in the list that is given. together: noted only,
    as ranks must end at the same place (voile.problem.lifetime.stop_if_told). There also a run of one rank ends whose
    signal came while Python freed something, which swallows what is raised.

    Once one has come, others end nothing, as a second Ctrl-C is common, and service managers send two signals at once.
    Nor does one end what is left of a process that has done its work: handlers are put back for programs only."""
    told: list[int] = []
    raised = process.over = False

    def stop(number: int, _frame: FrameType | None) -> None:
        nonlocal raised
        told.append(number)
        if not (together or raised or process.over):
            raised = True
            raise KeyboardInterrupt

    def swallowed(what: "sys.UnraisableHookArgs") -> None:
        nonlocal raised
        if what.exc_type is not KeyboardInterrupt:
            sys.__unraisablehook__(what)
        else:
            raised = False

    hook, sys.unraisablehook = sys.unraisablehook, swallowed
    before = {number: signal.signal(number, stop) for number in ENDING if not _outlived(number)}
    try:
        yield told
    finally:
        sys.unraisablehook = hook
        for number, handler in before.items():
            signal.signal(number, signal.SIG_IGN if process.ends else handler)


def noted() -> list[int]:
    """The list in which every Ctrl-C is noted from now on, beside what Python does with it: a module of C that meets it
    while it is loaded says instead that it cannot be imported."""
    told: list[int] = []

    def stop(number: int, _frame: FrameType | None) -> None:
        told.append(number)
        raise KeyboardInterrupt

    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, stop)
    return told


def _outlived(number: int) -> bool:
    """Whether a run is to outlive this signal: nohup has the end of the terminal ignored."""
    return number == signal.SIGHUP and signal.getsignal(number) == signal.SIG_IGN


def ends_at_once() -> None:
    """From here on Ctrl-C ends the process where Python hears of it, without an exception on the way: VTK, which loads
    as it draws, crashes where one comes out of what it has begun. Unfinished files go."""
    if process.ends and signal.getsignal(signal.SIGINT) != signal.SIG_IGN:
        signal.signal(signal.SIGINT, _end)


def _end(_number: int, _frame: FrameType | None) -> None:
    for part in unfinished:
        part.unlink(missing_ok=True)
    os.write(2, f"voile: {STOPPED}\n".encode())
    os._exit(INTERRUPTED)


@contextmanager
def not_lost(told: Sequence[int]) -> Iterator[None]:
    """What goes wrong after a signal is its doing: newer PETSc loses what a callback raises. Signals that come after
    what runs within end nothing."""
    try:
        yield
    except Exception as other:
        if told:
            raise KeyboardInterrupt from other
        raise
    finally:
        process.over = True
