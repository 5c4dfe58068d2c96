"""When a run ends that was told to, and PETSc's objects that Python cannot free: those that call back into what holds
them.

Such circles lead through C, where Python's garbage collection does not see them. A run destroys them at its end, in the
same order on all ranks.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TypeVar

from mpi4py import MPI
from petsc4py import PETSc

Kept = TypeVar("Kept", bound=PETSc.Object)
_runs: list[list[PETSc.Object]] = []  # of the runs that go, the innermost last
_told: list[tuple[int, list[int]]] = []  # their ranks, and the signals that they got
ANOTHER = 0  # as a signal: another rank got one


def stop_if_told(comm: MPI.Comm) -> None:
    """Ends a run by KeyboardInterrupt on all of its ranks where any of them has got a signal. Collective, where ranks
    are in step anyway; it costs some microseconds."""
    if not _told:
        return
    ranks, signals = _told[-1]
    if comm.size == ranks and (comm.allreduce(len(signals)) if ranks > 1 else signals):
        signals.append(ANOTHER)
        raise KeyboardInterrupt


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
