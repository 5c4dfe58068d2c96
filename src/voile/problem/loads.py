"""External forces on a part of a shell: gravity, pressure, dead forces, end moments, all scaled by the load factor."""

import numpy as np

from voile import _kernels
from voile.problem.follower import pressure_energy, pressure_force
from voile.problem.moments import EndMoments
from voile.problem.partition import Part


class Loads:
    """gravity (3,) m/s^2; pressure (Pa, follows the normal); origin (3,) of the volume under it, None where it has no
    potential. Degrees of freedom: 3 per local vertex, one per edge."""

    def __init__(self, part: Part, gravity: np.ndarray, pressure: float, origin: np.ndarray | None):
        self.part, self.gravity, self.pressure = part, gravity, pressure
        self.origin = np.zeros(3) if origin is None else origin
        self.moments = EndMoments(part) if part.moment.any() else None
        self.own = np.zeros(len(part.vertex), dtype=bool)
        self.own[part.owned_vertices] = True
        self.weigh()

    def weigh(self) -> None:
        """Takes the weight of the present masses."""
        count = 3 * len(self.part.vertex)
        self.weight = np.zeros(count + len(self.part.edge))  # N at load factor 1
        self.weight[:count] = (self.part.mass[:count].reshape(-1, 3) * self.gravity).ravel()

    def energies(self, displacement: np.ndarray, positions: np.ndarray, factor: float) -> dict[str, float]:
        """This rank's shares of minus the work of gravity, pressure and dead forces (J); moments have no potential."""
        count, rows = len(displacement), np.repeat(self.own, 3)
        return {
            "gravity": -factor * float(np.dot(self.weight[:count] * rows, displacement)),
            "pressure": factor * pressure_energy(positions, self.part, self.pressure, self.origin)
            if self.pressure
            else 0.0,
            "force": -factor * float(np.dot(self.part.force[:count] * rows, displacement)),
        }

    def forces(
        self, kernel: _kernels.Elastic, u: np.ndarray, positions: np.ndarray, factor: float
    ) -> np.ndarray:
        """(local dofs,) N, and N m on directors, at the kernel's displacements u; complete for this rank's own."""
        total = factor * (self.weight + self.part.force)
        if self.pressure:
            total[: len(u)] += factor * pressure_force(positions, self.part, self.pressure)
        if self.moments:
            total += factor * self.moments.forces(kernel, u)
        return total

    def begin_hessian(self, kernel: _kernels.Elastic, positions: np.ndarray, factor: float) -> None:
        """Tells the kernel what moments add to its Hessian, symmetrised, and keeps their skew part."""
        if self.moments:
            kernel.set_turn_weights(-factor * self.part.moment)
            self.moments.linearise(positions)

    def add_hessian(self, scatter: _kernels.Scatter, positions: np.ndarray, factor: float) -> None:
        """Adds the derivative of the pressure's forces."""
        if self.pressure:
            _kernels.add_pressure_hessian(scatter, self.part.corners, positions, -factor * self.pressure)

    def skew_forces(self, motion: np.ndarray, factor: float) -> np.ndarray | None:
        """(local dofs,) change of the forces along a motion by the skew part of moments; None without."""
        return factor * self.moments.skew_forces(motion) if self.moments else None
