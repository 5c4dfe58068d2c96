"""Triangulations for pictures of obstacles: surfaces of revolution, and how far unbounded shapes are shown."""

import numpy as np

from voile.arrays import Ints, Reals, triangle_areas
from voile.contact.directions import normalised, perpendicular

AROUND = 96  # points around an axis; half as many on a meridian of a sphere
MARGIN = 0.15  # of the bounds' diagonal: how far patches of unbounded shapes reach beyond the bounds

Triangles = tuple[Reals, Ints]  # points (n, 3) m and triangles (m, 3)


def stretch(origin: Reals, axis: Reals, bounds: Reals) -> tuple[float, float]:
    """From where to where the bounds, with a margin, reach along a unit axis through origin (m)."""
    low, high = bounds
    corners = np.where(np.indices((2, 2, 2)).reshape(3, 8).T == 0, low, high)
    along = (corners - origin) @ axis
    margin = MARGIN * float(np.linalg.norm(high - low))
    return float(along.min()) - margin, float(along.max()) + margin


def unit_sphere() -> Triangles:
    """The sphere of radius 1 m about the origin."""
    t = np.linspace(-np.pi / 2, np.pi / 2, AROUND // 2)
    return revolve(np.zeros(3), np.array([0.0, 0.0, 1.0]), np.cos(t), np.sin(t))


def revolve(origin: Reals, axis: Reals, radius: Reals, height: Reals) -> Triangles:
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
    area = triangle_areas(points, triangles)
    return points, triangles[area > 1e-9 * area.max()]  # at the poles half of the triangles have none
