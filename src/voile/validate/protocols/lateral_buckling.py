"""A clamped strip held on edge buckles sideways under its own weight, or under a force at its tip."""

from typing import Any

import numpy as np

from voile.validate.bench import Bench
from voile.validate.protocol import Check, Curve, Findings, Plot, close
from voile.validate.shapes import CLAMP, DENSITY, YOUNG, clamp, fabric, line_forces, rigidity, strip

TEXT = "clamped strip on edge: weight and tip load at which it buckles sideways, by width"
SOURCE = "narrow strips: w L^3 / sqrt(E I G J) = 12.85376 (a zero of J_-1/6), P L^2 / sqrt(E I G J) = 4.013 at the tip"
WEIGHT, TIP = 12.85376, 4.0126
THIN = 50.0  # width over thickness
BOUND = 5e-3


def narrow(poisson: float) -> float:
    """Critical rho g h L^3 / (E h^3 / 12) of a strip whose width is small beside its length and large beside h."""
    return WEIGHT * np.sqrt(2.0 / (1.0 + poisson))


def eigenvalue(bench: Bench, width: float, poisson: float, load: float, at_tip: bool) -> float:
    """The smallest of the plane state under `load` times the narrow strip's critical one (1/s^2)."""
    thickness, cells = width / THIN, round(4.0 / width)
    mesh = strip(cells, 4, width)
    stiffness, end = rigidity(thickness), mesh.points[:, 0] > 1.0 - CLAMP
    loads: dict[str, Any] = {
        "gravity": [0.0, -load * narrow(poisson) * stiffness / (DENSITY * thickness), 0.0]
    }
    if at_tip:
        force = -load * narrow(poisson) * TIP / WEIGHT * stiffness * width
        forces = line_forces(mesh.points, end, np.array([0.0, force, 0.0]))
        loads = {"gravity": [0.0, 0.0, 0.0], "force": forces}
    scene = {
        "shell": {"mesh": mesh, **fabric(thickness, YOUNG, poisson)},
        "loads": loads,
        "fix": [clamp(mesh.points[:, 0] < CLAMP)],
        "statics": {"perturbation": 0.0, "eigenvalue": True, "load_steps": 1},
    }
    name = f"{'tip' if at_tip else 'weight'}-{width:g}-{poisson:g}-{load:.6g}"
    return bench.run(name, scene).summary["smallest_eigenvalue"]


def critical(bench: Bench, width: float, poisson: float, at_tip: bool) -> float:
    """Over the narrow strip's: where the smallest eigenvalue is zero, by secants."""
    at = [1.0, 1.05]
    values = [eigenvalue(bench, width, poisson, load, at_tip) for load in at]
    for _ in range(2):
        at.append(at[-1] - values[-1] * (at[-1] - at[-2]) / (values[-1] - values[-2]))
        values.append(eigenvalue(bench, width, poisson, at[-1], at_tip))
    return at[-1] - values[-1] * (at[-1] - at[-2]) / (values[-1] - values[-2])


def run(bench: Bench) -> Findings:
    checks: list[Check] = []
    curves = []
    widths = [0.1, 0.05] if bench.quick else [0.1, 0.05, 0.025]
    cases = (
        [(0.3, False), (0.0, True)] if bench.quick else [(0.0, False), (0.3, False), (0.0, True), (0.3, True)]
    )
    for poisson, at_tip in cases:
        what = f"{'tip load' if at_tip else 'weight'}, nu = {poisson:g}"
        exact = TIP / WEIGHT * narrow(poisson) if at_tip else narrow(poisson)
        found = [critical(bench, width, poisson, at_tip) for width in widths]
        # The clamp hinders warping over a length like the width: an excess in proportion to width over length.
        limit = 2.0 * found[-1] - found[-2]
        checks.append(close(f"critical {what}, width to 0", exact * limit, exact, BOUND))
        checks.append(
            close(f"critical {what}, width {widths[-1]:g} L", exact * found[-1], exact, 1.0 * widths[-1])
        )
        curves.append(Curve(what, widths, found, points=True))
    curves.append(Curve("narrow strip", [0.0, widths[0]], [1.0, 1.0]))
    return Findings(checks, Plot("width over length", "critical load over the narrow strip's", curves))
