"""The linear shells of MacNeal and Harder (1985)."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from voile.validate import shells
from voile.validate.bench import Bench
from voile.validate.protocol import Check, Curve, Findings, Plot, close, order
from voile.validate.shells import Case

TEXT = "twisted beam, pinched cylinder and hemisphere, Scordelis-Lo roof: small displacements"
SOURCE = "Kirchhoff-Love in B-splines, 64 spans a side (tests/verification/splines.py); published: with shear"
IN_PLANE, OUT_OF_PLANE = 2, 1


class Standard(NamedTuple):
    """limit: of refinement; build: of cells; mark and axis where it is measured; factor: on the load, small enough to
    be linear; meshes: from coarse to fine; bounds: on the middle and on the finest."""

    limit: float
    build: Callable[[int, int], Case]
    mark: str
    axis: int
    factor: float
    meshes: list[tuple[int, int]]
    bounds: tuple[float, float]


def _beam(thickness: float, axis: int, limit: float, bounds: tuple[float, float]) -> Standard:
    def build(along: int, across: int) -> Case:
        return shells.twisted_beam(thickness, axis, along, across)

    return Standard(limit, build, "tip", axis, 1.0, [(24, 4), (48, 8), (96, 16)], bounds)


def _hemisphere(around: int, up: int) -> Case:
    return shells.pinched_hemisphere(around, up, "crossed")


SET = {
    "twisted beam, thick, in plane": _beam(0.32, IN_PLANE, 5.3998e-3, (1e-3, 2e-4)),
    "twisted beam, thick, out of plane": _beam(0.32, OUT_OF_PLANE, 1.7507e-3, (0.01, 3e-3)),
    "twisted beam, thin, in plane": _beam(0.0032, IN_PLANE, 5.2499e-3, (3e-3, 6e-4)),
    "twisted beam, thin, out of plane": _beam(0.0032, OUT_OF_PLANE, 1.2928e-3, (3e-3, 5e-4)),
    "pinched cylinder": Standard(
        1.8282e-5, shells.pinched_cylinder, "pinched", 0, 1.0, [(16, 16), (32, 32), (64, 64)], (0.06, 0.02)
    ),
    "Scordelis-Lo roof": Standard(
        0.300592, shells.roof, "edge", 2, 1e-4, [(12, 12), (24, 24), (48, 48)], (8e-3, 2e-3)
    ),
    # Under forces of 2, where large displacements take 400.
    "pinched hemisphere": Standard(
        0.093520, _hemisphere, "pulled", 0, 1e-4, [(12, 12), (24, 24), (48, 48)], (6e-3, 1e-3)
    ),
}
HEMISPHERE = 2.0 / 400.0


def run(bench: Bench) -> Findings:
    checks: list[Check] = []
    curves = []
    for name, standard in SET.items():
        meshes = standard.meshes[:2] if bench.quick else standard.meshes
        found = []
        for cells in meshes:
            case = standard.build(*cells)
            load = standard.factor * (HEMISPHERE if standard.build is _hemisphere else 1.0)
            scene = case.scene(load) | {"statics": {"load_steps": 1}}
            u = bench.run(f"{name.replace(', ', '-').replace(' ', '-')}-{cells[0]}", scene).displacements
            found.append(abs(u[case.marks[standard.mark], standard.axis]) / standard.factor)
        bound = standard.bounds[len(meshes) - 2]
        checks.append(close(f"{name}, {cells[0]}x{cells[1]}", found[-1], standard.limit, bound))
        errors = np.array(found) / standard.limit - 1.0
        if not bench.quick:
            checks.append(order(name, errors, 0.9, 4.0, 2))  # some errors change their sign between
        curves.append(Curve(name, [1.0 / cells[0] for cells in meshes], np.abs(errors), points=True))
    many = np.array([0.01, 0.1])
    second = Curve("second order", many, 10.0 * many**2)
    return Findings(checks, Plot("1 / cells along", "error of the displacement", [second, *curves], "xy"))
