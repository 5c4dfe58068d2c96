"""Triangulations of the obstacles' surfaces at load factor 0, for pictures: contact itself uses distances."""

from functools import singledispatch

import numpy as np

from voile.contact.field import MeshBody
from voile.contact.obstacles import (
    Box,
    Capsule,
    Cone,
    Cylinder,
    Ellipsoid,
    Obstacle,
    Plane,
    Sphere,
    Torus,
    normalised,
    perpendicular,
)

AROUND = 96  # points around an axis; half as many on a meridian of a sphere
MARGIN = 0.15  # of the bounds' diagonal: how far patches of unbounded shapes reach beyond the bounds

Triangles = tuple[np.ndarray, np.ndarray]


@singledispatch
def surface(obstacle: Obstacle, bounds: np.ndarray) -> Triangles:
    """Points (n, 3) m on the obstacle's surface and triangles (m, 3), normals outwards.

    bounds (2, 3) m: lowest and highest corner of what must lie near the patch shown of an unbounded shape.
    """
    raise TypeError(f"{type(obstacle).__name__} has no surface")


@surface.register
def _mesh(obstacle: MeshBody, bounds: np.ndarray) -> Triangles:
    return obstacle.points, obstacle.triangles


@surface.register
def _plane(obstacle: Plane, bounds: np.ndarray) -> Triangles:
    """A rectangle below the bounds."""
    n = normalised(obstacle.normal)
    first = perpendicular(n)
    second = np.cross(n, first)
    (a, b), (c, d) = (_stretch(obstacle.point, along, bounds) for along in (first, second))
    ends = np.array([[a, c], [b, c], [b, d], [a, d]])
    return obstacle.point + ends @ np.stack([first, second]), np.array([[0, 1, 2], [0, 2, 3]])


@surface.register
def _sphere(obstacle: Sphere, bounds: np.ndarray) -> Triangles:
    points, triangles = _unit_sphere()
    return obstacle.center + obstacle.radius * points, triangles


@surface.register
def _ellipsoid(obstacle: Ellipsoid, bounds: np.ndarray) -> Triangles:
    points, triangles = _unit_sphere()
    return obstacle.center + obstacle.radii * points, triangles


@surface.register
def _cylinder(obstacle: Cylinder, bounds: np.ndarray) -> Triangles:
    low, high = _stretch(obstacle.center, normalised(obstacle.axis), bounds)
    return _revolve(obstacle.center, obstacle.axis, np.full(2, obstacle.radius), np.array([low, high]))


@surface.register
def _capsule(obstacle: Capsule, bounds: np.ndarray) -> Triangles:
    axis = np.subtract(obstacle.b, obstacle.a)
    t = np.linspace(-np.pi / 2, np.pi / 2, AROUND // 2)
    length = np.linalg.norm(axis) * (t > 0.0)
    return _revolve(obstacle.a, axis, obstacle.radius * np.cos(t), obstacle.radius * np.sin(t) + length)


@surface.register
def _cone(obstacle: Cone, bounds: np.ndarray) -> Triangles:
    """From the apex to the far end of the bounds."""
    high = _stretch(obstacle.apex, normalised(obstacle.axis), bounds)[1]
    z = np.array([0.0, max(high, np.linalg.norm(np.ptp(bounds, axis=0)))])
    return _revolve(obstacle.apex, obstacle.axis, z * np.tan(obstacle.half_angle), z)


@surface.register
def _torus(obstacle: Torus, bounds: np.ndarray) -> Triangles:
    t = np.linspace(-np.pi, np.pi, AROUND // 2)
    return _revolve(
        obstacle.center, obstacle.axis, obstacle.radius + obstacle.tube * np.cos(t), obstacle.tube * np.sin(t)
    )


@surface.register
def _box(obstacle: Box, bounds: np.ndarray) -> Triangles:
    """Corners of their own on every face, so that shading shows the edges."""
    points = []
    for axis in range(3):
        for side in (-1.0, 1.0):
            ends = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])[:: int(side)]
            points.append(np.roll(np.column_stack([np.full(4, side), ends]), axis, axis=1))
    triangles = np.concatenate([[4 * k + np.array([0, 1, 2]), 4 * k + np.array([0, 2, 3])] for k in range(6)])
    return obstacle.center + obstacle.sizes * np.concatenate(points), triangles


def _stretch(origin: np.ndarray, axis: np.ndarray, bounds: np.ndarray) -> tuple[float, float]:
    """From where to where the bounds, with a margin, reach along a unit axis through origin (m)."""
    low, high = bounds
    corners = np.where(np.indices((2, 2, 2)).reshape(3, 8).T == 0, low, high)
    along = (corners - origin) @ axis
    margin = MARGIN * float(np.linalg.norm(high - low))
    return float(along.min()) - margin, float(along.max()) + margin


def _unit_sphere() -> Triangles:
    t = np.linspace(-np.pi / 2, np.pi / 2, AROUND // 2)
    return _revolve(np.zeros(3), np.array([0.0, 0.0, 1.0]), np.cos(t), np.sin(t))


def _revolve(origin: np.ndarray, axis: np.ndarray, radius: np.ndarray, height: np.ndarray) -> Triangles:
    """The surface swept by a profile: distances radius (k,) from the axis at height (k,) along it from origin. Outside
    is on the right of the profile's direction, seen with the axis up and the profile on its right."""
    a = normalised(axis)
    first = perpendicular(a)
    second = np.cross(a, first)
    turn = np.linspace(0.0, 2.0 * np.pi, AROUND, endpoint=False)
    ring = np.outer(np.cos(turn), first) + np.outer(np.sin(turn), second)
    points = origin + height[:, None, None] * a + radius[:, None, None] * ring
    k = len(radius)
    here = np.arange(k * AROUND).reshape(k, AROUND)
    beside = np.roll(here, -1, axis=1)
    lower, upper = (here[:-1], beside[:-1]), (here[1:], beside[1:])
    halves = [(lower[0], lower[1], upper[1]), (lower[0], upper[1], upper[0])]
    triangles = np.concatenate([np.stack(half, axis=-1).reshape(-1, 3) for half in halves])
    points = points.reshape(-1, 3)
    corner = points[triangles]
    area = np.linalg.norm(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]), axis=1)
    return points, triangles[area > 1e-9 * area.max()]  # at the poles half of the triangles have none
