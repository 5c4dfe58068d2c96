"""A pull towards where a step of pseudo-time starts."""

from dataclasses import dataclass

import numpy as np
from petsc4py import PETSc


def difference(a: PETSc.Vec, b: PETSc.Vec) -> PETSc.Vec:
    """a - b."""
    result = a.duplicate()
    result.waxpy(-1.0, b, a)
    return result


@dataclass
class Anchor:
    """A pull towards `home` (unknowns), rate (1/s^2) times the diagonal mass: one step of pseudo-time."""

    home: PETSc.Vec
    rate: float
    mass: PETSc.Vec

    def pull(self, y: PETSc.Vec) -> np.ndarray:
        """rate * mass * (y - home) of this rank's unknowns, N."""
        return self.rate * self.mass.array_r * (y.array_r - self.home.array_r)

    def energy(self, y: PETSc.Vec) -> float:
        """This rank's part of the pull's potential, J."""
        return 0.5 * float(self.pull(y) @ (y.array_r - self.home.array_r))

    def add_to(self, matrix: PETSc.Mat) -> None:
        """Adds the pull's derivative to a tangent."""
        shift = self.mass.copy()
        shift.scale(self.rate)
        matrix.setDiagonal(shift, addv=PETSc.InsertMode.ADD_VALUES)
        shift.destroy()
