"""A naturally curved ribbon hangs from a clamp as a planar curl; curved more, it twists out of its plane to a helix."""

import numpy as np

from voile.validate.bench import Bench, Mesh
from voile.validate.protocol import Check, Curve, Findings, Plot, close, order
from voile.validate.references.curl import Curl, critical, planar
from voile.validate.shapes import CLAMP, DENSITY, YOUNG, clamp, fabric, rigidity, strip

TEXT = "hanging curled ribbon: natural curvature at which it twists out of its plane"
SOURCE = "a Kirchhoff rod's boundary value problem and second variation (case of Miller, Lazarus, Audoly & Reis 2014)"
# Beside bending, a ribbon is 4 G / E times as stiff against twist. An isotropic one, 2 at nu = 0, stays in its plane at
# any natural curvature; this woven one twists easily.
SHEAR, TORSION = 0.1, 0.4
WIDTH = 0.04  # over the curl's size (B / w)^(1/3)
RATIO = 20.0  # width over thickness; its square is the stiffness against bending out of the plane
BOUND = 5e-3


def followed(weight: float, natural: float) -> Curl:
    """The rod's curl, from the straight one."""
    curl: Curl | None = None
    for share in np.linspace(0.0, 1.0, 2 + int(natural)):
        curl = planar(weight, share * natural, curl)
    assert curl is not None
    return curl


def softness(bench: Bench, weight: float, natural: float, cells: int) -> float:
    """The lowest frequency's square about the planar curl (1/s^2), from the rod's as start."""
    width = WIDTH / np.cbrt(weight)
    flat, thickness = strip(cells, cells // 25, width), width / RATIO
    s, across = flat.points[:, 0], flat.points[:, 1]
    radius = 0.5 / (cells * np.sin(0.5 * natural / cells))  # chords are as long as flat cells
    rest = np.column_stack([radius * np.sin(natural * s), across, radius * (1.0 - np.cos(natural * s))])
    ends = np.linspace(0.0, 1.0, cells + 1)
    angle = followed(weight, natural)(0.5 * (ends[1:] + ends[:-1]))[0]
    depth, aside = (np.r_[0.0, np.cumsum(f(angle)) / cells] for f in (np.cos, np.sin))
    start = np.column_stack([np.interp(s, ends, depth), across, np.interp(s, ends, aside)])
    scene = {
        "scene": {"task": "modes"},
        "shell": {
            "mesh": Mesh(start, flat.triangles),
            "rest": Mesh(rest, flat.triangles),
            "material": "orthotropic",
            "shear": SHEAR * YOUNG,
            "warp": [1.0, 0.0, 0.0],
            **fabric(thickness),
        },
        "loads": {"gravity": [weight * rigidity(thickness) / (DENSITY * thickness), 0.0, 0.0]},
        "fix": [clamp(s < CLAMP)],
        "statics": {"perturbation": 0.0, "load_steps": 1},
        "modes": {"count": 1},
    }
    outcome = bench.run(f"{weight:g}-{cells}-{natural:.6g}", scene)
    frequency = outcome.summary["modes"]["frequencies"][0]
    return float(frequency * abs(frequency))


def found(bench: Bench, weight: float, exact: float, cells: int) -> float:
    """The critical natural curvature: from three below it, as a quadratic of what goes to zero."""
    natural = np.array([0.96, 0.975, 0.99]) * exact
    soft = np.array([softness(bench, weight, each, cells) for each in natural])
    return float(np.polyfit(soft / soft[0], natural, 2)[-1])


def run(bench: Bench) -> Findings:
    weights = [50.0, 200.0] if bench.quick else [10.0, 20.0, 50.0, 100.0, 200.0]
    exact = [critical(weight, RATIO**2, TORSION) for weight in weights]
    seen = [found(bench, weight, each, 100) for weight, each in zip(weights, exact, strict=True)]
    checks: list[Check] = [
        close(f"critical curvature times length, rho g h L^3 / B = {weight:g}", value, each, BOUND)
        for weight, value, each in zip(weights, seen, exact, strict=True)
    ]
    if not bench.quick:
        finer = found(bench, weights[-1], exact[-1], 200)
        checks.append(close("the last, cells half as large", finer, exact[-1], 2e-3))
        checks.append(order("the last", [seen[-1] - exact[-1], finer - exact[-1]], 1.0, 2.6))
    many = np.geomspace(weights[0], weights[-1], 4 if bench.quick else 13)
    curves = [
        Curve("Kirchhoff rod", many, [critical(weight, RATIO**2, TORSION) for weight in many]),
        Curve("woven ribbon", weights, seen, points=True),
    ]
    return Findings(checks, Plot("rho g h L^3 / B", "critical natural curvature times length", curves, "x"))
