"""A clamped strip held on edge buckles sideways under its own weight, or under a force at its tip."""

from typing import Any

import numpy as np

from voile.validate.bench import Bench
from voile.validate.protocol import Check, Curve, Findings, Plot, close, order
from voile.validate.references.plate_strip import WIDENED
from voile.validate.shapes import CLAMP, DENSITY, YOUNG, clamp, fabric, line_forces, rigidity, sheet

TEXT = "clamped strip on edge: weight and tip load at which it buckles sideways, by width"
SOURCE = (
    "narrow strips: w L^3 / sqrt(E I G J) = 12.85376 (a zero of J_-1/6), P L^2 / sqrt(E I G J) = 4.013 at the tip; "
    "wider ones: NGSolve's von Karman plate (scripts/plate-strip)"
)
NARROW = {"weight": 12.85376, "tip load": 4.0126}
THIN = 50.0  # width over thickness
BOUND = 5e-3


def narrow(load: str, poisson: float) -> float:
    """Critical rho g h L^3 or P L^2 / b, over E h^3 / 12, of a strip whose width is small beside its length and large
    beside h."""
    return float(NARROW[load] * np.sqrt(2.0 / (1.0 + poisson)))


def scene(load: str, poisson: float, width: float, cells: int) -> dict[str, Any]:
    """A strip under a narrow one's critical load; cells: across its width."""
    thickness = width / THIN
    mesh = sheet(round(cells / width), cells, 1.0, width, "crossed")
    push = narrow(load, poisson) * rigidity(thickness)
    loads: dict[str, Any] = {"gravity": [0.0, -push / (DENSITY * thickness), 0.0]}
    if load == "tip load":
        end = mesh.points[:, 0] > 1.0 - CLAMP
        forces = line_forces(mesh.points, end, np.array([0.0, -push * width, 0.0]))
        loads = {"gravity": [0.0, 0.0, 0.0], "force": forces}
    return {
        "shell": {"mesh": mesh, **fabric(thickness, YOUNG, poisson)},
        "loads": loads,
        "fix": [clamp(mesh.points[:, 0] < CLAMP)],
    }


def by_modes(bench: Bench, load: str, poisson: float, width: float, cells: int = 8) -> float:
    """The critical load over a narrow strip's: linear buckling."""
    asked = {"scene": {"task": "modes"}, "modes": {"buckling": True, "count": 1}}
    name = f"{load.replace(' ', '-')}-{width:g}-{poisson:g}-{cells}"
    outcome = bench.run(name, scene(load, poisson, width, cells) | asked)
    return float(outcome.summary["modes"]["buckling"][0])


def by_path(bench: Bench, load: str, poisson: float, width: float) -> float:
    """The same: where the smallest eigenvalue of the plane state is zero, by secants."""

    def smallest(factor: float) -> float:
        asked = scene(load, poisson, width, 8)
        asked["statics"] = {"perturbation": 0.0, "eigenvalue": True, "load_steps": 1}
        asked["loads"]["gravity"] = [factor * each for each in asked["loads"]["gravity"]]
        return float(bench.run(f"path-{factor:.6g}", asked).summary["smallest_eigenvalue"])

    at = [1.0, 1.05]
    values = [smallest(factor) for factor in at]
    for _ in range(2):
        at.append(at[-1] - values[-1] * (at[-1] - at[-2]) / (values[-1] - values[-2]))
        values.append(smallest(at[-1]))
    return at[-1] - values[-1] * (at[-1] - at[-2]) / (values[-1] - values[-2])


def run(bench: Bench) -> Findings:
    checks: list[Check] = []
    curves = []
    cases = [("weight", 0.3), ("tip load", 0.0)] if bench.quick else list(WIDENED)
    for load, poisson in cases:
        exact, plate = narrow(load, poisson), WIDENED[load, poisson]
        widths = [0.1, 0.05] if bench.quick else list(plate)
        found = [by_modes(bench, load, poisson, width) for width in widths]
        what = f"critical {load}, nu = {poisson:g}"
        checks += [
            close(f"{what}, width {width:g} L", exact * value, exact * plate[width], BOUND)
            for width, value in zip(widths, found, strict=True)
        ]
        # The clamp hinders warping over a length like the width: an excess in proportion to width over length.
        checks.append(close(f"{what}, width to 0", exact * (2.0 * found[-1] - found[-2]), exact, BOUND))
        curves += [
            Curve(
                f"plate, {load}, nu = {poisson:g}", [0.0, *reversed(plate)], [1.0, *reversed(plate.values())]
            ),
            Curve(f"{load}, nu = {poisson:g}", widths, found, points=True),
        ]
    load, poisson, width = "weight", 0.3, 0.1
    exact, plate = narrow(load, poisson), WIDENED[load, poisson]
    on_path = by_path(bench, load, poisson, width)
    checks.append(
        close("weight, nu = 0.3, width 0.1 L, by the path", exact * on_path, exact * plate[width], BOUND)
    )
    if not bench.quick:
        errors = [by_modes(bench, load, poisson, width, cells) / plate[width] - 1.0 for cells in (4, 8, 16)]
        checks.append(order("it, by modes", errors, 1.5, 2.6))
    return Findings(checks, Plot("width over length", "critical load over the narrow strip's", curves))
