"""What the ways to an equilibrium with contact share: outcomes, and places to come back to."""

from collections.abc import Callable
from dataclasses import dataclass

from petsc4py import PETSc

from voile.contact.state import Contact, State
from voile.problem.discrete import Problem

KICKS = 5  # attempts to leave a saddle
NEUTRAL = 1e-6  # slow rates: an eigenvalue nearer to zero is none


@dataclass
class Place:
    """Unknowns, the shift that they are counted from, and the contact's state."""

    y: PETSc.Vec
    shift: PETSc.Vec
    state: State


@dataclass
class Outcome:
    """How an equilibrium was found (`way`), or the reason why not. gone: there is none, the shell slides away; saddle:
    an unstable one found instead."""

    converged: bool
    way: str
    reason: str = ""
    gone: bool = False
    saddle: Place | None = None


Way = Callable[[PETSc.Vec, float], Outcome]


class Base:
    """Where a problem with contact counts unknowns from, which `Problem.rebase` changes on the way."""

    def __init__(self, problem: Problem, contact: Contact):
        self.problem, self.contact = problem, contact
        self.shift = problem.create_vector()

    def here(self, y: PETSc.Vec) -> Place:
        """The place y, with the contact's present state."""
        return Place(y.copy(), self.shift.copy(), self.contact.state.copy())

    def unknowns(self, place: Place) -> PETSc.Vec:
        """Those of a place, counted from the present base."""
        y = place.y.copy()
        y.axpy(1.0, place.shift)
        y.axpy(-1.0, self.shift)
        return y

    def put(self, y: PETSc.Vec, place: Place) -> None:
        """y and the contact's state become those of a place."""
        self.unknowns(place).copy(y)
        self.contact.state = place.state.copy()

    def move(self, y: PETSc.Vec) -> None:
        """Unknowns count from y on, which becomes zero: small numbers keep digits that large ones lose."""
        self.problem.rebase(y)
        self.shift.axpy(1.0, y)
        y.set(0.0)
