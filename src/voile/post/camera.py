"""Where to look at a shape from: upright axis, direction, and the tightest frame around all its points."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from voile.arrays import Reals
from voile.errors import InputError
from voile.keys.overrides import overridden

VIEWS = {
    "front": (0.0, 0.0),
    "back": (180.0, 0.0),
    "left": (-90.0, 0.0),
    "right": (90.0, 0.0),
    "top": (0.0, 90.0),
}
VIEWS["oblique"] = (30.0, 20.0)
FLAT = 0.12  # a shape this much thinner than wide is seen obliquely
# the picture's parts kept free: left, right (colour bar), bottom, top (title), as fractions of the half size
MARGINS = (0.06, 0.34, 0.06, 0.16)


def _directions(count: int) -> Reals:
    """(count, 3) unit vectors spread evenly over the sphere, on Fibonacci's spiral."""
    k = np.arange(count) + 0.5
    height, turn = 1 - 2 * k / count, np.pi * (1 + np.sqrt(5)) * k
    across = np.sqrt(1 - height**2)
    return np.column_stack([across * np.cos(turn), across * np.sin(turn), height])


DIRECTIONS = _directions(
    256
)  # 13 degrees apart: what lies outside is under a hundredth of the size, less than margins


@dataclass(frozen=True)
class Camera:
    """Position and focus (m), up vector, vertical view angle in degrees."""

    position: Reals
    focus: Reals
    up: Reals
    angle: float


def parse_scene(text: str) -> dict[str, Any]:
    """The tables of the scene stored with a result, as overrides on the command line made them; empty where there is
    none that reads."""
    try:
        return {name: table for name, table in overridden(text).items() if isinstance(table, dict)}
    except InputError:
        return {}


def upright(scene: dict[str, Any]) -> Reals:
    """Unit vector against gravity along the nearest axis; y, as garments come, where there is no gravity."""
    try:
        gravity = np.array(scene.get("loads", {}).get("gravity"), dtype=float).reshape(3)
    except (TypeError, ValueError):
        gravity = np.zeros(3)
    axis = int(np.argmax(np.abs(gravity))) if gravity.any() else 1
    up = np.zeros(3)
    up[axis] = -1.0 if gravity[axis] > 0 else 1.0
    return up


def outermost(points: Reals) -> Reals:
    """(k, 3) those of points (n, 3) that lie furthest in one of DIRECTIONS: a film's frame needs no others."""
    found: Reals = points[np.unique((points @ DIRECTIONS.T).argmax(axis=0))]
    return found


def look(points: Reals, up: Reals, view: str | tuple[float, float] | None, size: tuple[int, int]) -> Camera:
    """Camera that shows all `points` (k, 3) m as large as the margins allow in a picture of `size` pixels.

    view: a name of VIEWS, (azimuth, elevation) in degrees from the front, or None: a garment is seen from the
    front, a little from the side and above; a flat piece obliquely on its face and with hardly any
    perspective.
    """
    extent = np.ptp(points, axis=0)
    front = _front(up, extent)
    flat = extent.min() < FLAT * extent.max()
    if view is None:
        lying = int(np.argmin(extent)) == int(np.argmax(np.abs(up)))
        azimuth, elevation = ((35.0, 32.0) if lying else (35.0, 20.0)) if flat else (24.0, 12.0)
    elif isinstance(view, str):
        if view not in VIEWS:
            raise InputError(f"view {view!r} is unknown; allowed: {', '.join(VIEWS)} or (azimuth, elevation)")
        azimuth, elevation = VIEWS[view]
    else:
        azimuth, elevation = view
    a, e = np.radians([azimuth, elevation])
    side = np.cross(up, front)
    towards = np.cos(e) * (np.cos(a) * front + np.sin(a) * side) + np.sin(e) * up  # from the shape to the eye
    right = np.cos(a) * side - np.sin(a) * front
    above = np.cross(towards, right)
    angle = 10.0 if flat else 24.0
    return _frame(points, right, above, -towards, angle, size)


def _front(up: Reals, extent: Reals) -> Reals:
    """The horizontal axis the viewer is on: +z if y is up, -y if z is up; the other one for a deep shape."""
    axis = int(np.argmax(np.abs(up)))
    first, second = {0: ((2, 1.0), (1, 1.0)), 1: ((2, 1.0), (0, 1.0)), 2: ((1, -1.0), (0, 1.0))}[axis]
    chosen = second if extent[first[0]] > 1.5 * extent[second[0]] else first
    front = np.zeros(3)
    front[chosen[0]] = chosen[1]
    return front


def _frame(
    points: Reals,
    right: Reals,
    above: Reals,
    forward: Reals,
    angle: float,
    size: tuple[int, int],
) -> Camera:
    """The nearest eye from which all points lie inside the picture's margins.

    A point with coordinates (a, b, z) along right, above, forward is inside where a - a0 <= t (z - z0), and
    so on for the other three sides with their own slopes t; each is linear in the eye (a0, b0, z0).
    """
    across, high, z = points @ right, points @ above, points @ forward
    slope = np.tan(np.radians(angle) / 2)
    wide = slope * size[0] / size[1]
    left_margin, right_margin, low_margin, top_margin = MARGINS
    slopes = (
        (wide * (1 - right_margin), wide * (1 - left_margin), across),
        (slope * (1 - top_margin), slope * (1 - low_margin), high),
    )
    bounds = [(np.max(x - plus * z), np.max(-x - minus * z), plus, minus) for plus, minus, x in slopes]
    z0 = min(-(most + least) / (plus + minus) for most, least, plus, minus in bounds)
    eye = [(most + plus * z0 - least - minus * z0) / 2 for most, least, plus, minus in bounds]
    if not z.min() > z0:  # a single point, or points without any extent across
        z0 = z.min() - 1.0
    position = eye[0] * right + eye[1] * above + z0 * forward
    return Camera(position, position + forward * (np.mean(z) - z0), above, angle)
