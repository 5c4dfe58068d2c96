"""Signals that end a run."""

import signal
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from types import FrameType

# SIGUSR1 because mpirun hands it on to its ranks and then ends as they do; SIGTERM it takes for itself.
ENDING = (signal.SIGTERM, signal.SIGINT, signal.SIGUSR1)


@contextmanager
def stoppable(together: bool = False) -> Iterator[list[int]]:
    """Signals end what runs within by KeyboardInterrupt. together: they are only noted, in the list that is given, as
    ranks must end at the same place (voile.problem.lifetime.stop_if_told)."""
    told: list[int] = []

    def stop(number: int, _frame: FrameType | None) -> None:
        told.append(number)
        if not together:
            raise KeyboardInterrupt

    before = {number: signal.signal(number, stop) for number in ENDING}
    try:
        yield told
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@contextmanager
def not_lost(told: Sequence[int]) -> Iterator[None]:
    """What goes wrong after a signal is its doing: newer PETSc loses what a callback raises."""
    try:
        yield
    except Exception as other:
        if told:
            raise KeyboardInterrupt from other
        raise
