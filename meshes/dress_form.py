from collections.abc import Callable

import numpy as np
from patterns import command, positive, rings
from scipy.interpolate import CubicSpline

# Sections of the torso from the thighs to the neck, as a share of the height between the rounded ends:
# circumference over that of the girth named, depth over width, superellipse exponent, shift to the front (m).
SECTIONS = (
    (0.00, "hip", 0.93, 0.74, 2.2, -0.010),
    (0.20, "hip", 1.00, 0.72, 2.3, -0.010),
    (0.47, "waist", 1.00, 0.76, 2.1, 0.000),
    (0.68, "bust", 1.00, 0.76, 2.2, 0.012),
    (0.84, "bust", 1.02, 0.50, 2.4, -0.005),
    (0.93, "bust", 0.58, 0.72, 2.1, -0.018),
    (1.00, "bust", 0.42, 1.00, 2.0, -0.020),
)
BOTTOM, TOP = 0.06, 0.03  # depth of the rounded ends (m) on a form 0.8 m tall


def dress_form(
    height: float = 0.80,
    bust: float = 0.88,
    waist: float = 0.68,
    hip: float = 0.94,
    size: float = 0.015,
) -> tuple[np.ndarray, np.ndarray]:
    """Tailor's dress form: a closed smooth torso about the y axis, 0 <= y <= height, front to +z, outward.

    bust, waist, hip: circumferences (m). Superellipse sections whose sizes are cubic splines of the height,
    closed by rounded ends; meshed in rings of equal spacing with as many vertices as each ring needs.
    """
    positive(height=height, bust=bust, waist=waist, hip=hip, size=size)
    y, girth, shape = _profile(height, {"bust": bust, "waist": waist, "hip": hip})
    meridian = np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(y), np.diff(girth / (2 * np.pi))))])
    count = max(4, round(meridian[-1] / size))
    at = np.interp(np.linspace(0, meridian[-1], count + 1), meridian, np.arange(len(y)))
    levels = np.interp(at, np.arange(len(y)), y)
    girths = np.interp(at, np.arange(len(y)), girth)
    counts = [max(6, round(g / size)) for g in girths]
    counts[0] = counts[-1] = 1
    positions, triangles = rings(counts)
    points = [_section(girths[k], shape(levels[k]), positions[k], levels[k]) for k in range(len(levels))]
    return np.concatenate(points), triangles


def _profile(
    height: float, girths: dict[str, float]
) -> tuple[np.ndarray, np.ndarray, Callable[[float], np.ndarray]]:
    """Heights from bottom to top, girth at each, and (depth ratio, exponent, shift) as function of height."""
    bottom, top = BOTTOM * height / 0.8, height * (1 - TOP / 0.8)
    knots = np.array([bottom + share * (top - bottom) for share, *_ in SECTIONS])
    values = np.array([[girths[name] * factor, *rest] for _, name, factor, *rest in SECTIONS])
    spline = CubicSpline(knots, values, bc_type="clamped")  # upright at both ends, where the rounding begins
    quarter = np.linspace(0, np.pi / 2, 200)
    middle = np.linspace(bottom, top, 2001)
    y = np.concatenate([bottom * (1 - np.cos(quarter)), middle[1:-1], top + (height - top) * np.sin(quarter)])
    girth = np.concatenate(
        [spline(bottom)[0] * np.sin(quarter), spline(middle[1:-1])[:, 0], spline(top)[0] * np.cos(quarter)]
    )
    return y, girth, lambda level: spline(np.clip(level, bottom, top))[1:]


def _section(girth: float, shape: np.ndarray, positions: np.ndarray, level: float) -> np.ndarray:
    """Points (k, 3) of the superellipse |x/a|^p + |z/b|^p = 1 of that girth, at shares of its length."""
    ratio, power, shift = shape
    angle = np.linspace(0, 2 * np.pi, 2001)
    x = np.sign(np.sin(angle)) * np.abs(np.sin(angle)) ** (2 / power)
    z = ratio * np.sign(np.cos(angle)) * np.abs(np.cos(angle)) ** (2 / power)
    length = np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(x), np.diff(z)))])
    scale = girth / length[-1]
    share = positions * length[-1]
    across, along = np.interp(share, length, x), np.interp(share, length, z)
    return np.column_stack([scale * across, np.full(len(share), level), scale * along + shift])


if __name__ == "__main__":
    command(dress_form)
