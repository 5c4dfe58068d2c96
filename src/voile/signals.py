"""Signals that end a run."""

import signal
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def stoppable() -> Iterator[None]:
    """SIGTERM and SIGINT end what runs within by KeyboardInterrupt."""
    told: list[int] = []

    def stop(number: int, _frame) -> None:
        told.append(number)
        raise KeyboardInterrupt

    before = {number: signal.signal(number, stop) for number in (signal.SIGTERM, signal.SIGINT)}
    try:
        yield
    except Exception as other:
        if told:  # newer PETSc loses what a callback raises
            raise KeyboardInterrupt from other
        raise
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
