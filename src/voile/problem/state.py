"""All of a solution that is saved and restored."""

from dataclasses import dataclass

from petsc4py import PETSc

from voile.contact.history import History


@dataclass
class State:
    """Unknowns, the unknowns of the shape that they are counted from, what contact remembers (None without), and the
    time, in statics the load factor."""

    unknowns: PETSc.Vec
    origin: PETSc.Vec
    history: History | None
    time: float


def difference(a: PETSc.Vec, b: PETSc.Vec) -> PETSc.Vec:
    """a - b."""
    result = a.duplicate()
    result.waxpy(-1.0, b, a)
    return result
