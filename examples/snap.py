"""A roof snaps through: a path with limit points, followed by its arc length.

The hinged cylindrical roof of Horrigmoe and Bergan (1978), with the curves of Sze, Liu and Lo (2004), "Popular
benchmark problems for geometric nonlinear analysis of shells", Finite Elements in Analysis and Design 40.
Radius 2.54 m, half angle 0.1 rad, 508 mm long, straight edges hinged, a point load on the middle. Thick, 12.7 mm, it
snaps at 2.2 kN. Thin, 6.35 mm, it snaps at 0.59 kN and its path turns back: under load control or displacement control
it would jump.

    .venv/bin/python examples/snap.py [CELLS]     writes snap.png; 8 seconds
"""

import sys

import numpy as np
from sheets import rectangle

import voile

LOAD = 3000.0  # N, at load factor 1
PUBLISHED = {
    12.7e-3: 2226.3,
    6.35e-3: 585.9,
}  # N, Sze et al.'s value next to the first limit point, by thickness (m)


def quarter(cells: int) -> tuple[np.ndarray, np.ndarray]:
    """A quarter of the roof, crown at the origin: x across, y along, z up (m)."""
    points, triangles = rectangle((cells, cells), (0.1, 0.254))
    angle = points[:, 0]
    return np.c_[2.54 * np.sin(angle), points[:, 1], 2.54 * (np.cos(angle) - 1)], triangles


def path(thickness: float, cells: int) -> tuple[np.ndarray, np.ndarray, list[float]]:
    """Loads (N) and sags of the middle (m) along the path, and the loads of its limit points (N)."""
    edge = 2.54 * np.sin(0.1) - 1e-6
    scene = {
        "shell": {
            "mesh": quarter(cells), "young": 3.10275e9, "poisson": 0.3, "thickness": thickness, "density": 1.0,
        },
        "loads": {
            "gravity": [0, 0, 0],
            "force": [{"select": {"box": [[-1, -1, -1], [1e-6, 1e-6, 1]]}, "value": [0, 0, -LOAD / 4]}],
        },
        "fix": [
            {"select": {"box": [[-1, -1, -1], [1e-6, 1, 1]]}, "axes": "x", "clamp": True},  # planes of symmetry
            {"select": {"box": [[-1, -1, -1], [1, 1e-6, 1]]}, "axes": "y", "clamp": True},
            {"select": {"box": [[edge, -1, -1], [1, 1, 1]]}},  # the hinge
        ],
        "statics": {"control": "arc-length"},
    }  # fmt: skip
    result = voile.run(scene)
    middle = int(np.argmin(np.linalg.norm(result.start, axis=1)))
    sags = np.array([-result.points(step)[middle, 2] for step in range(result.n_steps)])
    return (
        result.times * LOAD,
        sags,
        [limit["load_factor"] * LOAD for limit in result.summary["limit_points"]],
    )


def draw(paths: dict[float, tuple[np.ndarray, np.ndarray, list[float]]], png: str) -> None:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6, 4), layout="constrained")
    axes = figure.subplots()
    for thickness, (loads, sags, limits) in paths.items():
        (line,) = axes.plot(1e3 * sags, loads, ".-", label=f"{1e3 * thickness:g} mm")
        axes.plot(1e3 * sags[np.isin(loads, limits)], limits, "o", color=line.get_color(), fillstyle="none")
        axes.axhline(PUBLISHED[thickness], color=line.get_color(), linestyle=":", linewidth=1)
    axes.set(xlabel="sag of the middle (mm)", ylabel="load (N)", title="Hinged roofs; circles: limit points")
    axes.legend(frameon=False)
    figure.savefig(png, dpi=120)


if __name__ == "__main__":
    cells = int(sys.argv[1]) if len(sys.argv) > 1 else 16
    found = {thickness: path(thickness, cells) for thickness in PUBLISHED}
    for thickness, (_, _, limits) in found.items():
        print(f"{1e3 * thickness:g} mm: limit points at {limits[0]:.1f} and {limits[1]:.1f} N", end="; ")
        print(f"published {PUBLISHED[thickness]} N")
    draw(found, "snap.png")
