"""Obstacles: signed distance to a rigid body, with its gradient and Hessian, under a prescribed rigid motion.

A shape is one class with `derivatives` in its own frame; `gap` (without derivatives) may be cheaper. Distances are
exact; where the closest point is not unique (a sphere's centre, a cylinder's axis) some definite one is taken.
"""

from dataclasses import dataclass, field

import numpy as np
from scipy.spatial.transform import Rotation

NOWHERE = 1e-12  # of a vector's length: parts of it shorter than this are round-off and have no direction
TINY = 1e-12  # m: least radius of curvature, keeps Hessians finite at centres and axes


def _zeros() -> np.ndarray:
    return np.zeros(3)


@dataclass(frozen=True, kw_only=True)
class Motion:
    """Rigid motion reached at load factor 1, in proportion before: displacement (3,) m and a rotation vector (3,) rad
    about `center` (3,) m."""

    displacement: np.ndarray = field(default_factory=_zeros)
    rotation: np.ndarray = field(default_factory=_zeros)
    center: np.ndarray = field(default_factory=_zeros)

    @property
    def moves(self) -> bool:
        return bool(np.any(self.displacement) or np.any(self.rotation))

    def turn(self, factor: float) -> np.ndarray:
        """(3, 3) rotation at a load factor."""
        return Rotation.from_rotvec(factor * np.asarray(self.rotation, dtype=float)).as_matrix()

    def place(self, points: np.ndarray, factor: float) -> np.ndarray:
        """Where the body's points (n, 3) are at a load factor."""
        return (
            (points - self.center) @ self.turn(factor).T
            + self.center
            + factor * np.asarray(self.displacement)
        )

    def matrix(self, factor: float) -> np.ndarray:
        """(4, 4) `place` of (x, y, z, 1)."""
        total = np.eye(4)
        total[:3, :3] = self.turn(factor)
        total[:3, 3] = self.place(np.zeros((1, 3)), factor)[0]
        return total

    def unplace(self, points: np.ndarray, factor: float) -> np.ndarray:
        """The inverse of `place`."""
        return (points - self.center - factor * np.asarray(self.displacement)) @ self.turn(
            factor
        ) + self.center


@dataclass(frozen=True, kw_only=True)
class Obstacle:
    """A rigid body with Coulomb's coefficient of friction; lengths in m."""

    name: str = "obstacle"
    friction: float = 0.0
    motion: Motion = field(default_factory=Motion)

    def derivatives(self, p: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Signed distance (n,), its gradient (n, 3) and Hessian (n, 3, 3) at points (n, 3) of the body's frame."""
        raise NotImplementedError

    def distance(self, p: np.ndarray) -> np.ndarray:
        """(n,) signed distance at points of the body's frame, positive outside."""
        return self.derivatives(p)[0]

    def gap(self, points: np.ndarray, factor: float) -> np.ndarray:
        """(n,) signed distance of points (n, 3) to the body as placed at a load factor."""
        return self.distance(self.motion.unplace(points, factor) if self.motion.moves else points)

    def gap_derivatives(self, points: np.ndarray, factor: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """gap (n,), its gradient (n, 3) and its Hessian (n, 3, 3)."""
        if not self.motion.moves:
            return self.derivatives(points)
        gap, normal, curvature = self.derivatives(self.motion.unplace(points, factor))
        turn = self.motion.turn(factor)
        return gap, normal @ turn.T, turn @ curvature @ turn.T

    def carry(self, points: np.ndarray, start: float, end: float) -> np.ndarray:
        """(n, 3) where points fixed to the body go as the load factor goes from start to end."""
        if not self.motion.moves:
            return points
        return self.motion.place(self.motion.unplace(points, start), end)

    def size(self) -> float:
        """A length of the body (m), inf for unbounded ones."""
        return np.inf

    def error(self) -> float:
        """Largest known error of the gap near the surface (m)."""
        return 0.0


def dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """(n,) scalar products of rows."""
    return np.einsum("ni,ni->n", a, b)


def outer(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """(n, 3, 3) products a b^T of rows."""
    return a[:, :, None] * b[:, None, :]


def unit(
    vectors: np.ndarray, otherwise: np.ndarray, least: np.ndarray | float = 0.0
) -> tuple[np.ndarray, np.ndarray]:
    """Lengths (n,) and directions (n, 3) of vectors; `otherwise` (3,) or (n, 3) for those not longer than `least`."""
    length = np.linalg.norm(vectors, axis=1)
    some = length > least
    return length, np.where(some[:, None], vectors / np.where(some, length, 1.0)[:, None], otherwise)


def normalised(vector: np.ndarray) -> np.ndarray:
    """A vector (3,) of length 1."""
    return np.asarray(vector, dtype=float) / np.linalg.norm(vector)


def perpendicular(axis: np.ndarray) -> np.ndarray:
    """A unit vector normal to a unit axis."""
    other = np.eye(3)[np.argmin(np.abs(axis))]
    return normalised(other - (other @ axis) * axis)


def radial(d: np.ndarray, axis: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Height z (n,), radius r (n,) and unit radial direction (n, 3) of d (n, 3) in cylindrical coordinates about a unit
    axis; on the axis some definite direction, normal to it as all others."""
    z = d @ axis
    across = d - z[:, None] * axis
    across -= (across @ axis)[:, None] * axis  # once more: near the axis the first difference is round-off
    r, e = unit(across, perpendicular(axis), NOWHERE * np.linalg.norm(d, axis=1))
    return z, r, e


@dataclass(frozen=True, kw_only=True)
class Plane(Obstacle):
    """Half space below a point, `normal` pointing out of it."""

    point: np.ndarray
    normal: np.ndarray

    def derivatives(self, p):
        n = normalised(self.normal)
        return (p - self.point) @ n, np.tile(n, (len(p), 1)), np.zeros((len(p), 3, 3))


@dataclass(frozen=True, kw_only=True)
class Sphere(Obstacle):
    center: np.ndarray
    radius: float

    def derivatives(self, p):
        r, n = unit(p - self.center, np.array([0.0, 0.0, 1.0]))
        return r - self.radius, n, (np.eye(3) - outer(n, n)) / np.maximum(r, TINY)[:, None, None]

    def size(self) -> float:
        return self.radius


@dataclass(frozen=True, kw_only=True)
class Cylinder(Obstacle):
    """Unbounded along its axis."""

    center: np.ndarray
    axis: np.ndarray
    radius: float

    def derivatives(self, p):
        a = normalised(self.axis)
        _, r, n = radial(p - self.center, a)
        across = np.eye(3) - np.outer(a, a) - outer(n, n)
        return r - self.radius, n, across / np.maximum(r, TINY)[:, None, None]

    def size(self) -> float:
        return self.radius


@dataclass(frozen=True, kw_only=True)
class Capsule(Obstacle):
    """All points within `radius` of the segment from a to b."""

    a: np.ndarray
    b: np.ndarray
    radius: float

    def derivatives(self, p):
        along = np.asarray(self.b, dtype=float) - self.a
        length = float(np.linalg.norm(along))
        axis = along / length
        t, away, e = radial(p - self.a, axis)
        beyond = t - np.clip(t, 0.0, length)
        r, n = unit(away[:, None] * e + beyond[:, None] * axis, perpendicular(axis))
        inner = (beyond == 0.0)[:, None, None]
        across = np.eye(3) - outer(n, n) - inner * np.outer(axis, axis)
        return r - self.radius, n, across / np.maximum(r, TINY)[:, None, None]

    def size(self) -> float:
        return float(np.linalg.norm(np.subtract(self.b, self.a))) + 2.0 * self.radius


@dataclass(frozen=True, kw_only=True)
class Cone(Obstacle):
    """Solid, unbounded from its apex along its axis; half_angle (rad) between axis and surface."""

    apex: np.ndarray
    axis: np.ndarray
    half_angle: float

    def derivatives(self, p):
        a, sine, cosine = normalised(self.axis), np.sin(self.half_angle), np.cos(self.half_angle)
        d = p - self.apex
        z, r, e = radial(d, a)
        beyond = r * sine + z * cosine < 0.0  # nearest to the apex
        far, out = unit(d, -a)
        around = np.cross(a, e)
        flank = (cosine / np.maximum(r, TINY))[:, None, None] * outer(around, around)
        tip = (np.eye(3) - outer(out, out)) / np.maximum(far, TINY)[:, None, None]
        return (
            np.where(beyond, far, r * cosine - z * sine),
            np.where(beyond[:, None], out, cosine * e - sine * a),
            np.where(beyond[:, None, None], tip, flank),
        )


@dataclass(frozen=True, kw_only=True)
class Torus(Obstacle):
    """All points within `tube` of a circle of `radius` about the axis."""

    center: np.ndarray
    axis: np.ndarray
    radius: float
    tube: float

    def derivatives(self, p):
        a = normalised(self.axis)
        z, r, e = radial(p - self.center, a)
        far, n = unit((r - self.radius)[:, None] * e + z[:, None] * a, e)
        around = np.cross(a, e)
        across = (np.eye(3) - outer(n, n) - outer(around, around)) / np.maximum(far, TINY)[:, None, None]
        turning = (dot(n, e) / np.maximum(r, TINY))[:, None, None] * outer(around, around)
        return far - self.tube, n, across + turning

    def size(self) -> float:
        return self.radius + self.tube


@dataclass(frozen=True, kw_only=True)
class Ellipsoid(Obstacle):
    """Half axes `radii` along x, y, z."""

    center: np.ndarray
    radii: np.ndarray

    def derivatives(self, p):
        squares = np.asarray(self.radii, dtype=float) ** 2
        d = p - self.center
        foot = _ellipsoid_foot(np.abs(d), np.asarray(self.radii, dtype=float)) * np.where(d < 0.0, -1.0, 1.0)
        steepness, n = unit(foot / squares, np.array([0.0, 0.0, 1.0]))
        gap = dot(d - foot, n)
        across = np.eye(3) - outer(n, n)
        shape = across @ np.diag(1.0 / squares) @ across / steepness[:, None, None]
        return gap, n, np.linalg.solve(np.eye(3) + gap[:, None, None] * shape + 1e-14 * np.eye(3), shape)

    def size(self) -> float:
        return float(np.max(self.radii))


def _ellipsoid_foot(p: np.ndarray, radii: np.ndarray) -> np.ndarray:
    """(n, 3) closest points of an ellipsoid to points of the first octant (Eberly 2013): x_i = r_i^2 p_i / (t + r_i^2)
    with the largest root t of sum (r_i p_i / (t + r_i^2))^2 = 1, bracketed and bisected in s = t + min r_i^2, which
    keeps its digits near the centre."""
    squares, least = radii**2, float(radii.min())
    beyond = squares - squares.min()
    p = np.maximum(p, 1e-12 * least)  # off the planes of symmetry, where the root may be at the pole
    low = np.max(np.where(radii == least, radii * p, 0.0), axis=1)
    high = np.linalg.norm(radii * p, axis=1)
    for _ in range(200):
        s = 0.5 * (low + high)
        above = ((radii * p / (s[:, None] + beyond)) ** 2).sum(axis=1) > 1.0
        low, high = np.where(above, s, low), np.where(above, high, s)
        if (high - low <= 4e-16 * high).all():
            break
    return squares * p / (0.5 * (low + high)[:, None] + beyond)


@dataclass(frozen=True, kw_only=True)
class Box(Obstacle):
    """Edges along x, y, z with half lengths `sizes`; outside, surfaces at a distance are rounded at the edges."""

    center: np.ndarray
    sizes: np.ndarray

    def derivatives(self, p):
        d = p - self.center
        side = np.where(d < 0.0, -1.0, 1.0)
        beyond = np.abs(d) - self.sizes
        far, out = unit(side * np.maximum(beyond, 0.0), np.array([0.0, 0.0, 1.0]))
        nearest = np.argmax(beyond, axis=1)
        inside = far <= NOWHERE * np.linalg.norm(
            d, axis=1
        )  # on the surface too: there `out` has no direction
        face = np.zeros_like(d)
        face[np.arange(len(d)), nearest] = side[np.arange(len(d)), nearest]
        n = np.where(inside[:, None], face, out)
        rounded = np.einsum("ni,ij->nij", (beyond > 0.0).astype(float), np.eye(3)) - outer(n, n)
        curvature = np.where(inside[:, None, None], 0.0, rounded / np.maximum(far, TINY)[:, None, None])
        return np.where(inside, beyond.max(axis=1), far), n, curvature

    def size(self) -> float:
        return 2.0 * float(np.max(self.sizes))
