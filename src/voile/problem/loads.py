"""External forces on a part of a shell: gravity, pressure, dead forces, end moments, each with its law in time."""

import copy
from collections.abc import Mapping
from typing import Self

import numpy as np

from voile import _kernels
from voile.arrays import Reals
from voile.problem.elastic import Elastic
from voile.problem.follower import Rim, pressure_energy, pressure_force
from voile.problem.load import Load
from voile.problem.moments import EndMoments
from voile.problem.partition import Part
from voile.problem.terms import Hessian, Point, Term

LOADS = ("gravity", "pressure", "force", "moment")


class Loads(Term):
    """Minus the work of the loads. gravity (3,) m/s^2; rim: where pressure ends, None without pressure; laws in time by
    LOADS, by default in proportion; `share`: of all that acts. Moments turn triangles of `elastic`'s kernel."""

    def __init__(
        self,
        part: Part,
        elastic: Elastic,
        gravity: Reals,
        rim: Rim | None,
        laws: Mapping[str, Load] | None = None,
    ):
        self.part, self.elastic, self.gravity = part, elastic, gravity
        self.rim = None if rim is None else rim.here(part)
        self.laws = {name: Load() for name in LOADS} | dict(laws or {})
        self.pressed = rim is not None
        self.moments = EndMoments(part) if part.moment.any() else None
        self.share = 1.0
        self.own = np.zeros(len(part.vertex), dtype=bool)
        self.own[part.owned_vertices] = True
        self.weigh()

    def weigh(self) -> None:
        """Takes the weight of the present masses."""
        count = 3 * len(self.part.vertex)
        self.weight = np.zeros(count + len(self.part.edge))  # N where all of gravity acts
        self.weight[:count] = (self.part.mass[:count].reshape(-1, 3) * self.gravity).ravel()
        self._dead: tuple[tuple[float, float], Reals] | None = None

    def factor(self, name: str, time: float) -> float:
        """How much of a load acts."""
        return self.share * self.laws[name].factor(time)

    def scaled(self, share: float) -> Self:
        """A share of them all."""
        other = copy.copy(self)
        other.share = share
        return other

    def gravity_at(self, time: float) -> Reals:
        """(3,) m/s^2."""
        return self.factor("gravity", time) * self.gravity

    def energies(self, at: Point) -> dict[str, float]:
        """Moments have no potential."""
        count, rows = len(at.displacement), np.repeat(self.own, 3)
        work = {
            "gravity": float(np.dot(self.weight[:count] * rows, at.displacement)),
            "pressure": -pressure_energy(at.positions, self.part, self.rim) if self.rim else 0.0,
            "force": float(np.dot(self.part.force[:count] * rows, at.displacement)),
        }
        return {name: -self.factor(name, at.time) * value for name, value in work.items()}

    def forces(self, at: Point) -> Reals:
        total = self._dead_at(at.time)
        if self.pressed or self.moments:
            total = total.copy()
        if self.pressed:
            force = pressure_force(at.positions, self.part)
            total[: len(at.u)] += self.factor("pressure", at.time) * force
        if self.moments:
            total += self.factor("moment", at.time) * self.moments.forces(self.elastic.kernel, at.u)
        return total

    def _dead_at(self, time: float) -> Reals:
        """(dofs,) N, of gravity and dead forces, kept for the next call."""
        if not self._dead or self._dead[0] != (self.share, time):
            gravity, force = self.factor("gravity", time), self.factor("force", time)
            self._dead = (self.share, time), gravity * self.weight + force * self.part.force
            self._dead[1].flags.writeable = False
        return self._dead[1]

    def prepare(self, at: Point) -> None:
        """Tells the kernel what moments add to its Hessian, symmetrised, and keeps their skew part."""
        if self.moments:
            self.elastic.kernel.set_turn_weights(-self.factor("moment", at.time) * self.part.moment)
            self.moments.linearise(at.positions)

    def scatter(self, at: Point, which: Hessian, scatter: _kernels.Scatter) -> None:
        """The derivative of the pressure's forces, which is indefinite."""
        if self.pressed and which.safe < 1.0:
            pressure = (1.0 - which.safe) * self.factor("pressure", at.time) * self.part.pressure
            _kernels.add_pressure_hessian(scatter, self.part.corners, at.positions, -pressure)

    def skew_forces(self, motion: Reals, time: float) -> Reals | None:
        """(local dofs,) change of the forces along a motion by the skew part of moments; None without."""
        return self.factor("moment", time) * self.moments.skew_forces(motion) if self.moments else None
