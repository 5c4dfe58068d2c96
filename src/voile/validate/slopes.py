"""A nearly rigid sheet that falls on, slides along or bounces off a plane."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from voile.arrays import Reals
from voile.validate.bench import Bench, Mesh
from voile.validate.shapes import fabric, sheet

GRAVITY = 9.81
SIDE, THICKNESS, DENSITY = 0.2, 1e-3, 300.0


@dataclass(frozen=True)
class Motion:
    """Of every step: time (k,) s; speed down the slope and lift along its normal (k,) m/s; contact (k,) active
    vertices; fastest (k,) m/s. Of the steps written, at times `at` (w,): way and height (w,) m."""

    time: Reals
    speed: Reals
    lift: Reals
    contact: Reals
    fastest: Reals
    at: Reals
    way: Reals
    height: Reals


def on_slope(
    bench: Bench,
    name: str,
    angle: float,
    height: float,
    dynamics: dict[str, Any],
    along: float = 0.0,
    every: int = 10,
    **laws: float,
) -> Motion:
    """A sheet parallel to a plane that falls along x by `angle`, let go at a height (m, vertically) above it, with a
    speed along it; laws: friction, restitution."""
    down, up = np.array([np.cos(angle), 0.0, -np.sin(angle)]), np.array([np.sin(angle), 0.0, np.cos(angle)])
    flat = sheet(3, 3, SIDE, SIDE)
    middle = flat.points - flat.points.mean(axis=0)
    start = middle[:, :1] * down + middle[:, 1:2] * np.array([0.0, 1.0, 0.0]) + [0.0, 0.0, height]
    scene = {
        "scene": {"task": "dynamics"},
        "shell": {
            "mesh": Mesh(start, flat.triangles),
            "velocity": along * down,
            **fabric(THICKNESS, poisson=0.3, density=DENSITY),
        },
        "loads": {"gravity": [0.0, 0.0, -GRAVITY]},
        "obstacle": [{"shape": "plane", "point": [0.0, 0.0, 0.0], "normal": up, **laws}],
        "contact": {"offset": 0.0},
        "dynamics": {"tolerance": 1e-9, **dynamics},
        "output": {"every": every},
    }
    done = bench.run(name, scene)
    result, history = done.result, done.history
    moved = np.array([(result.points(k) - start).mean(axis=0) for k in range(result.n_steps)])
    velocity = history["momentum"] / (SIDE**2 * THICKNESS * DENSITY)
    return Motion(
        history["time"],
        velocity @ down,
        velocity @ up,
        history["active"],
        history["speed"],
        result.values,
        moved @ down,
        moved @ up + height * np.cos(angle),
    )
