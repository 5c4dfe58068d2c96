"""A strip that hardly bends or stretches hangs as a chain."""

import numpy as np
from scipy.optimize import brentq

from voile.validate.bench import Bench, Mesh, Outcome
from voile.validate.protocol import Curve, Findings, Plot, close, order
from voile.validate.references.elastica import catenary
from voile.validate.shapes import CLAMP, DENSITY, YOUNG, fabric, nodes, strip

TEXT = "hanging strip without noticeable stiffness: the catenary"
SOURCE = "catenary, closed form"
STRETCH, GAMMA = 1e-5, 1e5  # rho g L / E; rho g h L^3 / B
THICKNESS = float(np.sqrt(12.0 * STRETCH / GAMMA))


def hang(bench: Bench, nx: int, span: float) -> Outcome:
    """Both ends held level, from the arc of a circle."""
    rest = strip(nx, 1, 2.0 / nx)
    half = brentq(lambda a: np.sin(a) / a - span, 1e-3, 3.0)  # of the arc's angle
    angle = half * (2.0 * rest.points[:, 0] - 1.0)
    arc = rest.points.copy()
    arc[:, 0] = 0.5 * (span + np.sin(angle) / half)
    arc[:, 2] = 0.5 * (np.cos(half) - np.cos(angle)) / half
    ends = np.abs(rest.points[:, 0] - 0.5) > 0.5 - CLAMP
    scene = {
        "shell": {"mesh": Mesh(arc, rest.triangles), "rest": rest, **fabric(THICKNESS)},
        "loads": {"gravity": [0.0, 0.0, -STRETCH * YOUNG / DENSITY]},
        "fix": [{"select": nodes(ends)}],
        "statics": {"load_steps": 1},
    }
    return bench.run(f"span-{span:g}-{nx}", scene)


def run(bench: Bench) -> Findings:
    checks, curves = [], []
    for span in [0.8] if bench.quick else [0.4, 0.6, 0.8, 0.95]:
        x = hang(bench, 80, span).positions()
        exact = float(catenary(span, np.zeros(1))[0])
        checks.append(close(f"sag at a span of {span:g} L", -x[:, 2].min(), exact, 1e-3))
        place = np.linspace(0.0, span, 101)
        curves.append(Curve(f"catenary, span {span:g}", place, -catenary(span, place - 0.5 * span)))
        curves.append(Curve("strip", x[:, 0], x[:, 2], points=True))
    if not bench.quick:
        exact = float(catenary(0.8, np.zeros(1))[0])
        errors = [-hang(bench, nx, 0.8).positions()[:, 2].min() - exact for nx in (20, 40, 80)]
        checks.append(order("the sag at 0.8", errors, 1.7, 2.6))
    return Findings(checks, Plot("x / L", "z / L", curves))
