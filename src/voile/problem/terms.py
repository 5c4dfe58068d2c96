"""What a potential is made of: terms, each with energy, gradient, Hessian and longest step."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from voile import _kernels
from voile.arrays import Reals
from voile.problem.matrix import Blocks


@dataclass(frozen=True)
class Point:
    """Where a potential is evaluated, in local degrees of freedom: u (3 vertices,) m counts from the unknowns' origin,
    `displacement` (3 vertices,) m from the start shape; phi (edges,) director angles; positions (vertices, 3) m.
    passes: hinges may turn through 180 degrees on the way on."""

    u: Reals
    phi: Reals
    displacement: Reals
    positions: Reals
    time: float
    passes: bool = False

    def over_dofs(self, forces: Reals) -> Reals:
        """(dofs,) of forces on the vertices (vertices, 3) N alone."""
        return np.concatenate([forces.ravel(), np.zeros(len(self.phi))])


class Seen:
    """The last point, at some unknowns, which count from `base` (see `Unknowns`)."""

    point: Point

    def __init__(self) -> None:
        self._unknowns, self._base = np.zeros(0), np.zeros(0)

    def holds(self, unknowns: Reals, base: Reals, time: float, passes: bool) -> bool:
        """Whether it is that of these."""
        same = self._base is base and np.array_equal(self._unknowns, unknowns)
        return same and (self.point.time, self.point.passes) == (time, passes)

    def keep(self, point: Point, unknowns: Reals, base: Reals) -> None:
        """It is this one from now on, which nobody may change."""
        for values in (point.u, point.phi, point.displacement, point.positions):
            values.flags.writeable = False
        self.point, self._unknowns, self._base = point, unknowns.copy(), base


class Hessian(NamedTuple):
    """Which one: exact, safe (positive semidefinite), or mixed (exact but for stresses extrapolated by
    `Problem.predict`); share: of a safe one, the rest is exact."""

    kind: str = "exact"
    share: float = 1.0

    @property
    def safe(self) -> float:
        """The share that is positive semidefinite."""
        return self.share if self.kind == "safe" else 0.0


class Term:
    """A part of the potential. Its Hessian goes into the matrix as `blocks`, as `scatter`, or both."""

    def energies(self, at: Point) -> dict[str, float]:
        """This rank's shares of its parts (J), by name."""
        return {}

    def forces(self, at: Point) -> Reals:
        """(dofs,) minus its gradient (N; N m on directors), complete for what this rank's unknowns move."""
        return np.zeros(len(at.u) + len(at.phi))

    def blocks(self, at: Point, which: Hessian) -> Blocks:
        """What of its Hessian couples vertices (N/m)."""
        return ()

    def prepare(self, at: Point) -> None:
        """Whatever any term's `scatter` at this point depends on; called before all of them."""

    def scatter(self, at: Point, which: Hessian, scatter: _kernels.Scatter) -> None:
        """Writes what of its Hessian comes by triangles."""

    def predict(self, at: Point, step: Reals) -> None:
        """Extrapolates its stresses linearly over a step of the degrees of freedom (dofs,), for a mixed Hessian."""

    def longest_step(self, at: Point, step: Reals, most: float) -> float:
        """Length up to `most`, over a step of the degrees of freedom (dofs,), that it admits on this rank."""
        return most
