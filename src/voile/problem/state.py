"""All of a solution that is saved and restored."""

from dataclasses import dataclass

from petsc4py import PETSc

from voile.contact.state import State as History


@dataclass
class State:
    """Unknowns, the unknowns of the shape that they are counted from, and what contact remembers (None without)."""

    unknowns: PETSc.Vec
    origin: PETSc.Vec
    history: History | None


def difference(a: PETSc.Vec, b: PETSc.Vec) -> PETSc.Vec:
    """a - b."""
    result = a.duplicate()
    result.waxpy(-1.0, b, a)
    return result
