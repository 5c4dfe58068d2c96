"""Rigid motion of an obstacle or of a support, prescribed in time; statics take their load factor for the time."""

import math
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
import scipy  # its parts load when they are asked for

from voile.arrays import Ints, Reals


def _zeros() -> Reals:
    return np.zeros(3)


@dataclass(frozen=True, kw_only=True)
class Motion:
    """A displacement (3,) m, or (n, 3) of n points, and a rotation vector (3,) rad about `center` (3,) m, reached at
    t = 1 in proportion to t. Another law of motion overrides `share`, or `shift`, `turn` and `moves`."""

    displacement: Reals = field(default_factory=_zeros)
    rotation: Reals = field(default_factory=_zeros)
    center: Reals = field(default_factory=_zeros)

    @cached_property
    def moves(self) -> bool:
        """Whether the body is ever elsewhere than at t = 0."""
        return bool(np.any(self.displacement) or np.any(self.rotation))

    @property
    def turns(self) -> bool:
        """Whether the body ever rotates."""
        return bool(np.any(self.rotation))

    @property
    def ends(self) -> float:
        """Time after which it stays where it is."""
        return math.inf if self.moves else 0.0

    def share(self, t: float) -> float:
        """Of the motion, at time t."""
        return t

    def shift(self, t: float) -> Reals:
        """Displacement of the centre at time t (m), shaped as `displacement`."""
        return self.share(t) * np.asarray(self.displacement)

    def turn(self, t: float) -> Reals:
        """(3, 3) rotation at time t."""
        if not self.turns:
            return np.eye(3)
        found: Reals = scipy.spatial.transform.Rotation.from_rotvec(
            self.share(t) * np.asarray(self.rotation, dtype=float)
        ).as_matrix()
        return found

    def place(self, points: Reals, t: float) -> Reals:
        """Where the body's points (n, 3) are at time t."""
        return (points - self.center) @ self.turn(t).T + self.center + self.shift(t)

    def unplace(self, points: Reals, t: float) -> Reals:
        """The inverse of `place`."""
        return (points - self.center - self.shift(t)) @ self.turn(t) + self.center

    def of(self, rows: Ints) -> "Motion":
        """That of some of the points."""
        shift = np.asarray(self.displacement)
        return replace(self, displacement=shift[rows]) if shift.ndim == 2 else self

    def between(self, points: Reals, start: float, end: float) -> Reals:
        """(n, 3) displacement (m) of the body's points, given as they are at t = 0, from time start to end."""
        turned = (points - self.center) @ (self.turn(end) - self.turn(start)).T
        found: Reals = turned + (self.shift(end) - self.shift(start))
        return found

    def matrix(self, t: float) -> Reals:
        """(4, 4) `place` of (x, y, z, 1)."""
        total = np.eye(4)
        total[:3, :3] = self.turn(t)
        total[:3, 3] = self.place(np.zeros((1, 3)), t)[0]
        return total


@dataclass(frozen=True, kw_only=True)
class Spell(Motion):
    """Displacement and rotation are those over the time from `begin` to `end` (s), at a constant rate."""

    begin: float = 0.0
    end: float

    @property
    def ends(self) -> float:
        return self.end

    def share(self, t: float) -> float:
        return min(max((t - self.begin) / (self.end - self.begin), 0.0), 1.0)


@dataclass(frozen=True, kw_only=True)
class Track(Motion):
    """Rows (k, 6) of displacement (m) and rotation vector (rad) at times (k,) s, linear between."""

    times: Reals
    rows: Reals

    @property
    def moves(self) -> bool:
        return bool(self.rows.any())

    @property
    def turns(self) -> bool:
        return bool(self.rows[:, 3:].any())

    @property
    def ends(self) -> float:
        return float(self.times[-1])

    def shift(self, t: float) -> Reals:
        return self._at(t)[:3]

    def turn(self, t: float) -> Reals:
        found: Reals = scipy.spatial.transform.Rotation.from_rotvec(self._at(t)[3:]).as_matrix()
        return found

    def _at(self, t: float) -> Reals:
        return np.array([np.interp(t, self.times, column) for column in self.rows.T])
