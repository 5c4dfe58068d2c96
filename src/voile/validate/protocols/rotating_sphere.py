"""A sheet draped on a turning sphere follows it by friction; on a turning plane it speeds up as friction allows."""

from typing import Any

import numpy as np

from voile.arrays import Reals
from voile.validate.bench import Bench, Mesh, Outcome
from voile.validate.protocol import Curve, Findings, Plot, close, small
from voile.validate.shapes import fabric, sheet

TEXT = "sheet on a turning sphere, and on a turning plane: taken along by friction"
SOURCE = (
    "sticking: the sphere's own rate; slipping on a plane: rate mu g t <r> / <r^2> of a square, 2.2956 / side"
)
GRAVITY = 9.81
# <r> / <r^2> of a unit square about its middle: (sqrt(2) + log(1 + sqrt(2))) / 6 over 1 / 6.
ARM = np.sqrt(2.0) + np.log(1.0 + np.sqrt(2.0))


def turn(
    bench: Bench,
    name: str,
    body: dict[str, Any],
    mesh: Mesh,
    material: dict[str, Any],
    rate: float,
    dynamics: dict[str, Any],
) -> Outcome:
    """A sheet at rest on a body that turns about z from the start on."""
    scene = {
        "scene": {"task": "dynamics"},
        "shell": {"mesh": mesh, **material},
        "loads": {"gravity": [0.0, 0.0, -GRAVITY]},
        "obstacle": [{**body, "move": {"angular_velocity": [0.0, 0.0, rate]}}],
        "contact": {"offset": 0.0},
        "dynamics": dynamics,
    }
    return bench.run(name, scene)


def rates(done: Outcome, near: Reals) -> Reals:
    """(k,) rad/s about z of some vertices at the written steps."""
    found = []
    for k in range(1, done.result.n_steps):
        x, v = done.result.points(k)[near], done.result.field("velocity", k)[near]
        found.append((x[:, 0] * v[:, 1] - x[:, 1] * v[:, 0]).sum() / (x[:, :2] ** 2).sum())
    return np.array(found)


def run(bench: Bench) -> Findings:
    rate, step = 3.0, 5e-3
    ball = {"shape": "sphere", "center": [0.0, 0.0, -0.1], "radius": 0.1, "friction": 0.5}
    cells = 6 if bench.quick else 12
    flat = _centred(cells, 0.24)
    material = {"material": "neo-hookean", **fabric(1e-3, 5e4, 0.3, 300.0)}
    dynamics = {"time_step": step, "duration": 0.4}
    done = turn(bench, "sphere", ball, flat, material, rate, dynamics)
    draped = rates(done, np.hypot(*flat.points[:, :2].T) < 0.07)

    side, friction, duration, slow = 0.2, 0.02, 0.4, 0.6
    plane = {"shape": "plane", "point": [0.0, 0.0, 0.0], "normal": [0.0, 0.0, 1.0], "friction": friction}
    square = _centred(24 if bench.quick else 32, side)
    dynamics = {"time_step": 2.0 * step, "duration": duration, "tolerance": 1e-9}
    done_flat = turn(bench, "plane", plane, square, fabric(1e-3, 1e7, 0.3, 300.0), slow, dynamics)
    spun = rates(done_flat, np.ones(len(square.points), dtype=bool))
    time = done_flat.result.values[1:]
    exact = friction * GRAVITY * ARM / side
    slipping = np.flatnonzero(exact * time < 0.8 * slow)
    seen = float(np.polyfit(time[slipping], spun[slipping], 1)[0])
    depth = float(done.history["max_penetration"].max())
    checks = [
        close("rate of the drape at the end [rad/s]", draped[-1], rate, 0.02),
        small("deepest penetration of the sphere [m]", depth, 1e-12),
        close("angular acceleration while it slips on a plane [rad/s^2]", seen, exact, 5e-3),
        close("rate on the plane in the end [rad/s]", spun[-1], slow, 1e-3),
    ]
    many = np.linspace(0.0, duration, 101)
    curves = [
        Curve("rigid square on a plane, friction 0.02", many, np.minimum(exact * many, slow)),
        Curve("sheet on a plane", time, spun, points=True),
        Curve("drape on a sphere, friction 0.5", done.result.values[1::4], draped[::4], points=True),
    ]
    return Findings(checks, Plot("time [s]", "rate [rad/s]", curves))


def _centred(cells: int, side: float) -> Mesh:
    flat = sheet(cells, cells, side, side)
    return Mesh(flat.points - [0.5 * side, 0.5 * side, 0.0], flat.triangles)
