"""When PETSc's objects end that Python cannot free: those that call back into what holds them.

Such circles lead through C, where Python's garbage collection does not see them. A run destroys them at its end, in the
same order on all ranks.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TypeVar

from petsc4py import PETSc

Kept = TypeVar("Kept", bound=PETSc.Object)
_runs: list[list[PETSc.Object]] = []  # of the runs that go, the innermost last


def until_the_end(made: Kept) -> Kept:
    """An object that is destroyed when the run ends; without a run it stays."""
    if _runs:
        _runs[-1].append(made)
    return made


@contextmanager
def run_of_its_own() -> Iterator[None]:
    """What is made within ends with it. Collective."""
    _runs.append([])
    try:
        yield
    finally:
        for made in reversed(_runs.pop()):
            made.destroy()
