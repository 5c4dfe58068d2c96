"""Bell skirt with folds around the dress form: a shape as a designer models it, no simulation behind it."""

import numpy as np
from dress_form import _profile, _section
from patterns import cells, command, even, grid, positive, weld

CLOSE = 0.25  # share of the length over which the skirt follows the form


def bell_skirt(
    level: float = 0.30,
    clearance: float = 0.001,
    length: float = 0.44,
    flare: float = 0.12,
    folds: int = 8,
    gores: int = 8,
    depth: float = 0.035,
    size: float = 0.02,
    diagonals: str = "alternating",
    height: float = 0.80,
    bust: float = 0.88,
    waist: float = 0.68,
    hip: float = 0.94,
) -> tuple:
    """Skirt from `level` (m) down on a dress form (height, bust, waist, hip as there), normals outward.

    clearance (m) from the form over the upper quarter of its length (m, measured down); below, it leaves the form by
    flare (m) at the hem, with `folds` waves of amplitude depth (m). Its groups are `gores` panels, their seams on the
    ridges of the folds where there are as many.
    """
    positive(clearance=clearance, length=length, flare=flare, depth=depth, size=size)
    if not 0 < level < height:
        raise ValueError(f"level = {level}, allowed: between 0 and {height}")
    y, girth, shape = _profile(height, {"bust": bust, "waist": waist, "hip": hip})
    around = float(np.interp(level, y, girth)) + np.pi * flare
    columns = gores * even(cells(around / gores, size))
    uv, triangles = grid(columns, cells(length, size), diagonals)
    share, down = uv[:, 0], 1.0 - uv[:, 1]
    lowest = 0.15 * height  # below, the form is not followed
    points = np.empty((len(uv), 3))
    for k, (angle, s) in enumerate(zip(share, down, strict=True)):
        at = level - s * length
        followed = max(at, lowest)
        section = _section(
            float(np.interp(followed, y, girth)), shape(followed), np.array([angle]), followed
        )[0]
        centre = np.array([0.0, shape(followed)[2]])
        outward = section[[0, 2]] - centre
        outward /= np.linalg.norm(outward)
        swing = max(0.0, (s - CLOSE) / (1.0 - CLOSE)) ** 1.5
        out = clearance + swing * (flare + depth * np.cos(2 * np.pi * folds * angle))
        x, z = section[[0, 2]] + out * outward
        points[k] = x, at, z
    panel = np.floor(gores * share[triangles].mean(axis=1)).astype(int)
    names = tuple(f"gore-{k + 1}" for k in range(gores))
    return *weld(points, triangles, 1e-6 * size), None, None, (panel, names)


if __name__ == "__main__":
    command(bell_skirt)
