"""A heavy strip on a frictionless plane, one end lifted: the free boundary of contact."""

import numpy as np

from voile.arrays import Reals, triangle_areas
from voile.validate.bench import Bench
from voile.validate.protocol import Curve, Findings, Plot, close, small
from voile.validate.shapes import CLAMP, fabric, nodes, rigidity, sheet

TEXT = "heavy strip on a plane, one end lifted: free length and lifting force"
SOURCE = "beam theory: l = (24 B delta / (rho g h))^(1/4), lifting force rho g h l / 2 per width"
THICKNESS, YOUNG, DENSITY, GRAVITY = 1e-3, 1e9, 1000.0, 9.81
WEIGHT = DENSITY * GRAVITY * THICKNESS  # per area
BOUND = 3e-3  # 1 % of stiffness or of weight is 0.25 % of the length, 1 % of weight 0.75 % of the force


def lift(bench: Bench, height: float, cells: int) -> tuple[float, float, float, Reals]:
    """Free length, force per width, reaction times gap over the force, positions.

    A beam comes to lie down with a force at one point, the edge of contact, which the mesh spreads over some vertices:
    the edge is the centre of what they carry beyond their own weight."""
    mesh = sheet(cells, 2, 1.0, 2.0 / cells)
    held = mesh.points[:, 0] < CLAMP
    scene = {
        "shell": {"mesh": mesh, **fabric(THICKNESS, YOUNG, 0.0, DENSITY)},
        "loads": {"gravity": [0.0, 0.0, -GRAVITY]},
        "fix": [{"select": nodes(held), "move": {"displacement": [0.0, 0.0, height]}}],
        "obstacle": [{"shape": "plane", "point": [0.0, 0.0, 0.0], "normal": [0.0, 0.0, 1.0]}],
        "contact": {"offset": 0.0},
    }
    result = bench.run(f"lift-{height:g}-{cells}", scene).result
    reaction, touching = result.field("reaction")[:, 2], result.field("contact") > 0
    area = triangle_areas(mesh.points, mesh.triangles)
    own = WEIGHT * np.bincount(mesh.triangles.ravel(), np.repeat(area / 3.0, 3))
    beyond = (reaction - own)[touching]
    edge = beyond @ mesh.points[touching, 0] / beyond.sum()
    force = (own.sum() - reaction.sum()) / np.ptp(mesh.points[:, 1])
    waste = np.abs(reaction * result.field("gap")).max() / own.sum()
    return float(edge), float(force), float(waste), result.points()


def run(bench: Bench) -> Findings:
    cells = 160 if bench.quick else 320
    heights = [2e-3] if bench.quick else [5e-4, 1e-3, 2e-3, 4e-3]
    checks, curves = [], []
    for height in heights:
        length, force, waste, x = lift(bench, height, cells)
        exact = (24.0 * rigidity(THICKNESS, YOUNG) * height / WEIGHT) ** 0.25
        checks.append(close(f"free length, lifted by {height:g} L", length, exact, BOUND))
        checks.append(close(f"lifting force, lifted by {height:g} L", force, 0.5 * WEIGHT * exact, BOUND))
        checks.append(small("largest reaction times gap, over weight times length", waste, 1e-12))
        s = np.linspace(0.0, 1.0, 201)
        free = np.clip(1.0 - s / exact, 0.0, None)
        curves.append(Curve(f"beam, {height:g} L", s, height * (2.0 * free**3 - free**4)))
        line = np.abs(x[:, 1] - x[:, 1].mean()) < CLAMP
        curves.append(Curve("strip", x[line, 0], x[line, 2], points=True))
    return Findings(checks, Plot("x / L", "z / L", curves))
