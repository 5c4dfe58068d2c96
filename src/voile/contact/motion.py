"""Prescribed rigid motion of an obstacle, as a function of time."""

from dataclasses import dataclass, field

import numpy as np
from scipy.spatial.transform import Rotation


def _zeros() -> np.ndarray:
    return np.zeros(3)


@dataclass(frozen=True, kw_only=True)
class Motion:
    """A displacement (3,) m and a rotation vector (3,) rad about `center` (3,) m, reached at t = 1 in proportion to t.

    t is the time; statics take their load factor for it. Another law of motion overrides `shift`, `turn` and `moves`.
    """

    displacement: np.ndarray = field(default_factory=_zeros)
    rotation: np.ndarray = field(default_factory=_zeros)
    center: np.ndarray = field(default_factory=_zeros)

    @property
    def moves(self) -> bool:
        """Whether the body is ever elsewhere than at t = 0."""
        return bool(np.any(self.displacement) or np.any(self.rotation))

    def shift(self, t: float) -> np.ndarray:
        """(3,) displacement of the centre at time t (m)."""
        return t * np.asarray(self.displacement)

    def turn(self, t: float) -> np.ndarray:
        """(3, 3) rotation at time t."""
        return Rotation.from_rotvec(t * np.asarray(self.rotation, dtype=float)).as_matrix()

    def place(self, points: np.ndarray, t: float) -> np.ndarray:
        """Where the body's points (n, 3) are at time t."""
        return (points - self.center) @ self.turn(t).T + self.center + self.shift(t)

    def unplace(self, points: np.ndarray, t: float) -> np.ndarray:
        """The inverse of `place`."""
        return (points - self.center - self.shift(t)) @ self.turn(t) + self.center

    def matrix(self, t: float) -> np.ndarray:
        """(4, 4) `place` of (x, y, z, 1)."""
        total = np.eye(4)
        total[:3, :3] = self.turn(t)
        total[:3, 3] = self.place(np.zeros((1, 3)), t)[0]
        return total
