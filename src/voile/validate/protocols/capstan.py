"""A strip around a drum, pulled at one end: the capstan equation."""

import numpy as np

from voile.arrays import Reals
from voile.validate.bench import Bench, Mesh
from voile.validate.protocol import Curve, Findings, Plot, close
from voile.validate.shapes import fabric, nodes, sheet

TEXT = "strip around a drum: tensions at its ends, by friction times angle"
SOURCE = "Euler and Eytelwein: T_pull = T_hold exp(friction angle) where all of it slips"
RADIUS, TAIL, WIDTH = 0.1, 0.03, 0.01
BOUND = 5e-3  # 1 % of friction is as much as friction times the angle in per cent


def ratio(bench: Bench, degrees: float, friction: float) -> float:
    """Tension at the pulled end over that at the held one, by the stretch of the free tails."""
    angle, cells = np.radians(degrees), int(max(60, degrees))
    length = RADIUS * angle + 2.0 * TAIL
    flat = sheet(cells, 2, length, WIDTH)
    along = flat.points[:, 0]
    t = np.clip((along - TAIL) / RADIUS, 0.0, angle)
    tangent = np.column_stack([-np.sin(t), 0.0 * t, np.cos(t)])
    beyond = np.minimum(along - TAIL, 0.0) + np.maximum(along - TAIL - RADIUS * angle, 0.0)
    start = RADIUS * np.column_stack([np.cos(t), 0.0 * t, np.sin(t)]) + beyond[:, None] * tangent
    start[:, 1] = flat.points[:, 1]
    hold, pull = along < 1e-12, along > length - 1e-12
    move = {"displacement": (2e-3 * RADIUS * tangent[pull][0]).tolist()}
    scene = {
        "shell": {"mesh": Mesh(start, flat.triangles), "bending": "average", **fabric(1e-4, 1e8)},
        "loads": {"gravity": [0.0, 0.0, 0.0]},
        "fix": [{"select": nodes(hold)}, {"select": nodes(pull), "move": move}],
        "obstacle": [
            {
                "shape": "cylinder",
                "center": [0.0, 0.0, 0.0],
                "axis": [0.0, 1.0, 0.0],
                "radius": RADIUS,
                "friction": friction,
            }
        ],
        "contact": {"offset": 0.0},
        "statics": {"load_steps": 5},
    }
    result = bench.run(f"{degrees:g}-degrees-{friction:g}", scene).result
    x, free = result.points(), result.field("contact") == 0
    tails = (along < TAIL) & free, (along > length - TAIL) & free
    stretch = [_stretch(start[tail], x[tail], along[tail]) for tail in tails]
    return stretch[1] / stretch[0]


def _stretch(start: Reals, x: Reals, along: Reals) -> float:
    """Of a straight piece between its first and its last row of vertices."""
    rows = along < along.min() + 1e-9, along > along.max() - 1e-9

    def length(points: Reals) -> float:
        return float(np.linalg.norm(points[rows[1]].mean(axis=0) - points[rows[0]].mean(axis=0)))

    return length(x) / length(start) - 1.0


def run(bench: Bench) -> Findings:
    cases = [(90.0, 0.5), (180.0, 0.3)]
    if not bench.quick:
        cases += [(30.0, 1.0), (45.0, 0.2), (270.0, 0.7), (360.0, 0.1), (360.0, 0.5), (540.0, 0.5)]
    exponents = [friction * np.radians(degrees) for degrees, friction in cases]
    found = [ratio(bench, *case) for case in cases]
    checks = [
        close(f"T_pull / T_hold, {degrees:g} degrees, friction {friction:g}", value, np.exp(exponent), BOUND)
        for (degrees, friction), value, exponent in zip(cases, found, exponents, strict=True)
    ]
    many = np.linspace(0.0, 1.05 * max(exponents), 50)
    curves = [Curve("exp(friction angle)", many, np.exp(many)), Curve("strip", exponents, found, points=True)]
    return Findings(checks, Plot("friction times angle", "T_pull / T_hold", curves, "y"))
