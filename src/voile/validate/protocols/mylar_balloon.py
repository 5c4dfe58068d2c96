"""A balloon of two round sheets that do not stretch, welded at their rims."""

import numpy as np
from scipy.integrate import quad

from voile.mesh.grids import rings
from voile.validate.bench import Bench, Mesh
from voile.validate.protocol import Check, Curve, Findings, Plot, close, order
from voile.validate.shapes import fabric, nodes

TEXT = "mylar balloon, two round sheets that hardly stretch: its volume, with wrinkles as tension field"
SOURCE = "Paulsen 1994, Am. Math. Monthly 101, 953-958: of all such balloons the one of largest volume"
PRESSURES = (100.0, 300.0)  # Pa; strains of some 5e-4 and three times as much, extrapolated to none
MESHES = (8, 16, 32)  # rings


def largest_volume() -> float:
    """m^3, of sheets of radius 1 m: its profile z(x) has the slope -t^2/sqrt(1 - t^4), t = x over the greatest x."""
    radius = 1.0 / quad(lambda t: 1.0 / np.sqrt(1.0 - t**4), 0.0, 1.0)[0]
    return float(2.0 * np.pi * radius**3 * quad(lambda t: t**4 / np.sqrt(1.0 - t**4), 0.0, 1.0)[0])


def volume(bench: Bench, count: int, model: str, pressure: float) -> float:
    """m^3."""
    counts = [1] + [6 * k for k in range(1, count + 1)]
    places, triangles = rings(counts)
    radius, angle = (
        np.repeat(np.arange(count + 1) / count, counts),
        2.0 * np.pi * np.concatenate(places),
    )
    flat = np.column_stack([radius * np.cos(angle), radius * np.sin(angle), 0.0 * angle])
    pole, rim = radius == 0.0, radius == 1.0
    turning = rim & (np.cumsum(rim) == 1)  # its first vertex
    across = "y" if abs(flat[turning, 0][0]) > abs(flat[turning, 1][0]) else "x"
    scene = {
        "shell": {
            "mesh": Mesh(flat, triangles),
            **fabric(1e-4, 1e9, 0.3),
            "model": model,
            "material": "tension-field",
        },
        "loads": {"gravity": [0.0, 0.0, 0.0], "pressure": pressure},
        "fix": [
            {"select": nodes(rim), "axes": "z"},
            {"select": nodes(pole), "axes": "xy"},
            {"select": nodes(turning), "axes": across},
        ],
    }
    x = bench.run(f"{model}-{count}-{pressure:.0f}", scene).positions()
    a, b, c = (x[triangles[:, k]] for k in range(3))
    return 2.0 * abs(float(np.einsum("ij,ij->", a, np.cross(b, c)))) / 6.0


def unstretched(bench: Bench, count: int, model: str) -> float:
    """m^3, without the part that is in proportion to the pressure."""
    low, high = PRESSURES
    return (high * volume(bench, count, model, low) - low * volume(bench, count, model, high)) / (high - low)


def run(bench: Bench) -> Findings:
    exact = largest_volume()
    checks: list[Check] = []
    curves = []
    for model, meshes in (("membrane", MESHES[:2] if bench.quick else MESHES), ("koiter", MESHES[:2])):
        found = [unstretched(bench, count, model) for count in meshes]
        checks.append(close(f"volume [m3], {model}, {meshes[-1]} rings", found[-1], exact, 0.01))
        # Wrinkles have many minima: two of 32 rings, the lower one nearer to the exact volume, give 3.1 and 4.1.
        checks.append(order(f"the volume, {model}", [value - exact for value in found], 1.2, 4.5))
        curves.append(Curve(model, [1.0 / count for count in meshes], found, points=True))
    curves.append(Curve("exact", [0.0, 1.0 / MESHES[0]], [exact, exact]))
    return Findings(checks, Plot("ring [m]", "volume [m3]", curves))
