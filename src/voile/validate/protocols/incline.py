"""A sheet at rest on a slope: the friction at which it begins to slide."""

import numpy as np

from voile.validate.bench import Bench, Mesh
from voile.validate.protocol import Curve, Findings, Plot, close, small
from voile.validate.shapes import fabric, sheet

TEXT = "sheet on a slope: rests if friction > tan(angle), slides otherwise"
SOURCE = "Coulomb's law"
RESOLVED = 1e-3  # how far from tan(angle) both sides are tried


def rests(bench: Bench, degrees: float, share: float) -> tuple[bool, float]:
    """Whether it rests at friction = share tan(angle), and how far it moved."""
    angle = np.radians(degrees)
    flat = sheet(8, 8, 0.5, 0.5)
    down, up = np.array([np.cos(angle), 0.0, -np.sin(angle)]), np.array([np.sin(angle), 0.0, np.cos(angle)])
    points = flat.points[:, :1] * down + flat.points[:, 1:2] * np.array([0.0, 1.0, 0.0])
    slope = {"shape": "plane", "point": [0.0, 0.0, 0.0], "normal": up, "friction": share * np.tan(angle)}
    scene = {
        "shell": {"mesh": Mesh(points, flat.triangles), **fabric(1e-3, density=300.0)},
        "loads": {"gravity": [0.0, 0.0, -9.81]},
        "obstacle": [slope],
        "contact": {"offset": 0.0},
    }
    done = bench.attempt(f"angle-{degrees:g}-{share:g}", scene)
    return done.converged, float(np.abs(done.displacements).max()) if done.converged else np.nan


def run(bench: Bench) -> Findings:
    checks, found = [], []
    degrees = [5.0, 30.0, 60.0] if bench.quick else [1.0, 5.0, 15.0, 30.0, 45.0, 60.0, 80.0]
    for angle in degrees:
        low, high = 0.98, 1.02
        while high - low > RESOLVED:
            middle = 0.5 * (low + high)
            low, high = (low, middle) if rests(bench, angle, middle)[0] else (middle, high)
        share = 0.5 * (low + high)
        found.append(share * np.tan(np.radians(angle)))
        checks.append(close(f"least friction over tan(angle), {angle:g} degrees", share, 1.0, 2.0 * RESOLVED))
        checks.append(
            small(f"drift at 1.001 of it, {angle:g} degrees [m]", rests(bench, angle, 1.001)[1], 1e-9)
        )
    many = np.linspace(0.0, max(degrees), 101)
    curves = [
        Curve("tan(angle)", many, np.tan(np.radians(many))),
        Curve("found", degrees, found, points=True),
    ]
    return Findings(checks, Plot("angle [degrees]", "least friction at which it rests", curves))
