"""What the search for the nearest stable shape finds, and what a step of it goes by."""

from dataclasses import dataclass

from petsc4py import PETSc

from voile.arrays import Reals
from voile.inverse.moves import Move, Tangent
from voile.inverse.neighbours import Checkpoint
from voile.inverse.spectral import Model


@dataclass
class NearestStep:
    """An accepted step: fraction of the load, largest displacement from the target over the size, smallest eigenvalue
    and the margin asked for (1/s^2)."""

    fraction: float
    sag: float
    eigenvalue: float
    margin: float


@dataclass
class NearestPath:
    """The outcome: rest displacements with director angles, the equilibrium found with its sag (over the size), its
    smallest eigenvalue (1/s^2) and mode (unknowns, largest entry 1), the margin (over g/L), the steps, the fraction of
    the load, and whether time ended the search."""

    rest: PETSc.Vec
    state: PETSc.Vec
    sag: float
    eigenvalue: float
    mode: PETSc.Vec
    margin: float
    steps: list[NearestStep]
    fraction: float = 1.0
    timed_out: bool = False


@dataclass
class Local:
    """The model at a point, in units of `cut` (1/s^2), what all of the way adds to its matrix, the merit there and the
    distance's part of it; moves are those of the tangent, and `loaded`, of length `reach`, for all of the way; `end`:
    mu that settles there."""

    model: Model
    cut: float
    rise: Reals
    merit: float
    half: float
    tangent: Tangent
    loaded: Move
    reach: float
    end: float


@dataclass
class Trial:
    """A point proposed, a share of the way ahead, the length of the move to it, and the merit and the lowest eigenvalue
    above the margin, in cuts, that its model has there; sink: of its eigenvalues by the square of the length, where it
    is an equilibrium."""

    point: Checkpoint
    share: float
    length: float
    merit: float
    lowest: float
    sink: float | None = None
