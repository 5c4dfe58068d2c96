"""What the search for the nearest stable shape finds."""

from dataclasses import dataclass

from petsc4py import PETSc


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
