"""When a run ends that was told to, or a part of one whose time is over; and PETSc's objects that Python cannot free:
those that call back into what holds them.

Such circles lead through C, where Python's garbage collection does not see them. A run destroys them at its end, in the
same order on all ranks.
"""

import math
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TypeVar

from mpi4py import MPI
from petsc4py import PETSc

Kept = TypeVar("Kept", bound=PETSc.Object)
_runs: list[list[PETSc.Object]] = []  # of the runs that go, the innermost last
_told: list[tuple[int, list[int]]] = []  # their ranks, and the signals that they got
ANOTHER = 0  # as a signal: another rank got one


class TimeIsOver(Exception):
    """That of what runs `until` a clock ends it."""


class Clock:
    """Wall time that something may take (s; 0: no limit), the same on all ranks. ended: whether it was found over."""

    def __init__(self, comm: MPI.Comm, seconds: float):
        self.comm, self.end = comm, time.perf_counter() + (seconds or math.inf)
        self.ended = False

    def over(self) -> bool:
        """Whether the time is over on any rank. Collective."""
        if self.end < math.inf and not self.ended:
            here = time.perf_counter() >= self.end
            self.ended = bool(self.comm.allreduce(here, op=MPI.LOR) if self.comm.size > 1 else here)
        return self.ended


_clocks: list[Clock] = []  # of what runs, the innermost last


@contextmanager
def until(clock: Clock) -> Iterator[None]:
    """Ends what runs within by TimeIsOver, at the next evaluation of forces, when the clock is over."""
    _clocks.append(clock)
    try:
        yield
    except Exception as other:  # newer PETSc loses what a callback raises
        if clock.ended and not isinstance(other, TimeIsOver):
            raise TimeIsOver from other
        raise
    finally:
        _clocks.pop()


def stop_if_told(comm: MPI.Comm) -> None:
    """Ends a run by KeyboardInterrupt on all of its ranks where any of them has got a signal, and what is timed by
    TimeIsOver. Collective, where ranks are in step anyway; it costs some microseconds."""
    if _told:
        ranks, signals = _told[-1]
        if comm.size == ranks and (comm.allreduce(len(signals)) if ranks > 1 else signals):
            signals.append(ANOTHER)
            raise KeyboardInterrupt
    if _clocks and comm.size == _clocks[-1].comm.size and _clocks[-1].over():
        raise TimeIsOver


def until_the_end(made: Kept) -> Kept:
    """An object that is destroyed when the run ends; without a run it stays."""
    if _runs:
        _runs[-1].append(made)
    return made


@contextmanager
def run_of_its_own(ranks: int = 1, signals: list[int] | None = None) -> Iterator[None]:
    """What is made within ends with it. signals: those that this one of its ranks gets; one more where it ends by them,
    on all ranks. Collective."""
    _runs.append([])
    _told.append((ranks, [] if signals is None else signals))
    try:
        yield
    finally:
        _told.pop()
        for made in reversed(_runs.pop()):
            made.destroy()
