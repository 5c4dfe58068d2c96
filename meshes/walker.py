"""A dress form that walks in place on two legs."""

import numpy as np
from dress_form import dress_form
from patterns import command, positive, rings
from walking import Gait, Limbs, walk

HIP, KNEE, BEND = (0.085, 0.13, -0.01), (0.085, -0.30, -0.01), 0.08  # m, see Limbs
FOOT = -0.72  # m, height of the legs' lower end
RADII = ((0.13, 0.082), (0.0, 0.080), (-0.30, 0.056), (-0.42, 0.056), (FOOT, 0.036))  # of a leg at heights, m


def walker(
    size: float = 0.015,
    duration: float = 2.0,
    frame_time: float = 0.04,
    period: float = 1.0,
    swing: float = 20.0,
) -> tuple[np.ndarray, np.ndarray]:
    """Frames of a dress form (dress_form.py) on two legs that walks in place, outward, every frame_time (s).

    period: of two steps (s); swing: of the thighs, to the front and to the back (degrees). The legs end inside the
    form; the parts overlap.
    """
    positive(size=size, duration=duration, frame_time=frame_time, period=period)
    form, triangles = dress_form(size=size)
    leg, corners = _leg(size)
    points = np.concatenate([form, leg, leg * [-1.0, 1.0, 1.0]])
    first, second = len(form), len(form) + len(leg)
    triangles = np.concatenate([triangles, corners + first, corners[:, ::-1] + second])
    part = np.searchsorted([first, second], np.arange(len(points)), side="right")
    limbs = Limbs(HIP, KNEE, BEND, np.column_stack([part == 1, part == 2]).astype(float))
    gait = Gait(period=period, thigh=swing)
    times = frame_time * np.arange(round(duration / frame_time) + 1)
    return np.array([walk(points, limbs, gait, t) for t in times]), triangles


def _leg(size: float) -> tuple[np.ndarray, np.ndarray]:
    """The left leg standing: round, closed by half ellipsoids."""
    heights, radii = np.array(RADII).T
    quarter = np.linspace(0.0, np.pi / 2.0, 50)
    y = np.linspace(heights[-1], heights[0], 400)
    r = np.interp(y, heights[::-1], radii[::-1])
    y = np.concatenate([y[0] - r[0] * np.cos(quarter), y[1:-1], y[-1] + r[-1] * np.sin(quarter)])
    r = np.concatenate([r[0] * np.sin(quarter), r[1:-1], r[-1] * np.cos(quarter)])
    meridian = np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(y), np.diff(r)))])
    at = np.linspace(0.0, meridian[-1], max(4, round(meridian[-1] / size)) + 1)
    levels, widths = np.interp(at, meridian, y), np.interp(at, meridian, r)
    counts = [max(6, round(2.0 * np.pi * w / size)) for w in widths]
    counts[0] = counts[-1] = 1
    positions, triangles = rings(counts)
    x, _, z = HIP
    points = [
        np.column_stack(
            [x + w * np.sin(2.0 * np.pi * p), np.full(len(p), level), z + w * np.cos(2.0 * np.pi * p)]
        )
        for w, level, p in zip(widths, levels, positions, strict=True)
    ]
    return np.concatenate(points), triangles


if __name__ == "__main__":
    command(walker)
