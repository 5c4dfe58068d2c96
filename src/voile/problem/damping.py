"""What resists velocities in an implicit step in time: the air, and Rayleigh damping.

In a step the velocity of a vertex is rate (x - still), of its scheme: each of these forces has a convex potential.
"""

from dataclasses import dataclass
from typing import Self

import numpy as np

from voile.arrays import Reals, area_vectors
from voile.problem.inertia import Inertia
from voile.problem.matrix import Blocks
from voile.problem.partition import Part
from voile.problem.terms import Hessian, Point, Term


@dataclass(frozen=True)
class Air:
    """velocity (3,) m/s of the air; drag (kg/m^3): force per area over the square of its normal relative velocity."""

    velocity: Reals
    drag: float


@dataclass(frozen=True)
class Damping:
    """Rayleigh's: mass (1/s) force per momentum, stiffness (s) force per rate of the elastic force."""

    mass: float = 0.0
    stiffness: float = 0.0


class Viscous(Inertia):
    """-a M v, with coefficient a * rate and `still` as predicted positions."""

    name = "viscous"


@dataclass
class Wind(Term):
    """drag A |u| u n on a third of each triangle at each of its vertices, u = (wind - v) . n the normal velocity of the
    air relative to the vertex; area vectors A n (m, 3) m^2 are those of the step's start."""

    part: Part
    air: Air
    areas: Reals
    rate: Reals
    still: Reals

    @classmethod
    def at(cls, part: Part, air: Air, x: Reals, rate: Reals, still: Reals) -> Self:
        """Of a step that begins at positions x (n, 3) m; rate (n, 3) 1/s and still (n, 3) m of its velocities."""
        return cls(part, air, 0.5 * area_vectors(x, part.corners), rate, still)

    def energies(self, at: Point) -> dict[str, float]:
        area, _, u = self._flow(at)
        per_rate = self.part.weight[:, None] / self.rate[self.part.corners, 0]
        return {"wind": self.air.drag / 9.0 * float((area[:, None] * abs(u) ** 3 * per_rate).sum())}

    def forces(self, at: Point) -> Reals:
        area, normal, u = self._flow(at)
        share = (self.air.drag / 3.0) * area[:, None] * abs(u) * u
        return at.over_dofs(self._gather(share[:, :, None] * normal[:, None]))

    def given(self, at: Point, h: float) -> float:
        """What the moving air works over h (s) on this rank (J)."""
        area, normal, u = self._flow(at)
        share = (self.air.drag / 3.0) * area[:, None] * abs(u) * u * self.part.weight[:, None]
        return h * float((share * (normal @ self.air.velocity)[:, None]).sum())

    def blocks(self, at: Point, which: Hessian) -> Blocks:
        area, normal, u = self._flow(at)
        stiff = (2.0 * self.air.drag / 3.0) * area[:, None] * abs(u) * self.rate[self.part.corners, 0]
        block = stiff[:, :, None, None] * (normal[:, :, None] * normal[:, None])[:, None]
        yield np.arange(len(self.part.vertex)), self._gather(block)

    def _flow(self, at: Point) -> tuple[Reals, Reals, Reals]:
        """Areas (m,), unit normals (m, 3), and u (m, 3) m/s at the corners."""
        area = np.linalg.norm(self.areas, axis=1)
        normal = self.areas / np.maximum(area, 1e-300)[:, None]
        relative = self.air.velocity - self.rate * (at.positions - self.still)
        return area, normal, np.einsum("mi,mki->mk", normal, relative[self.part.corners])

    def _gather(self, rows: Reals) -> Reals:
        """(n, ...) sums at the vertices of rows (m, 3, ...) at the corners."""
        total = np.zeros((len(self.part.vertex), *rows.shape[2:]))
        np.add.at(total, self.part.corners, rows)
        return total
