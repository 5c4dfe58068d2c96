"""The shells of MacNeal & Harder (1985, Finite Elem. Anal. Des. 1, 3-20), linear: loads are small enough for that.

Mappings give tangents and second derivatives for splines.py; builders take a factor on the published load and return a
Shell, the vertex where it is measured and its axis; cases return rows of displacements over that factor.
"""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import numpy as np
from shells import Row, of_case, row, solve
from splines import Mapping, Patch
from splines import solve as solve_patch

from voile.problem.shell import Shell
from voile.validate import shells as cases
from voile.validate.shells import BEAM

X, Y, Z = np.eye(3)
Built = tuple[Shell, int, int]


def twisted_beam(thickness: float, axis: int, along: int, across: int, factor: float) -> Built:
    """Its tip under a force in plane (axis 2) or out of plane (axis 1)."""
    case = cases.twisted_beam(thickness, axis, along, across)
    return of_case(case, factor), case.marks["tip"], axis


def pinched_cylinder(around: int, along: int, factor: float) -> Built:
    case = cases.pinched_cylinder(around, along)
    return of_case(case, factor), case.marks["pinched"], 0


def roof(around: int, along: int, factor: float) -> Built:
    case = cases.roof(around, along)
    return of_case(case, factor), case.marks["edge"], 2


def hemisphere(around: int, up: int, factor: float) -> Built:
    """A quarter of the hemisphere with a hole of 18 degrees, pulled and pushed by forces of 2 on the whole."""
    case = cases.pinched_hemisphere(around, up, "crossed")
    return of_case(case, factor / np.abs(case.force).max()), case.marks["pulled"], 0


# ---- limits ----


def twist(u: np.ndarray, v: np.ndarray) -> list[np.ndarray]:
    """Mapping of the twisted beam."""
    rate, width = 0.5 * np.pi, 1.1
    along, place = np.stack([0.0 * u, np.cos(rate * u), np.sin(rate * u)], axis=1), width * (v - 0.5)[:, None]
    across = np.cross(X, along)
    return [
        12.0 * X + rate * place * across,
        width * along,
        -(rate**2) * place * along,
        0.0 * along,
        rate * width * across,
    ]


def cylinder(radius: float, opening: float, length: float, first: np.ndarray, second: np.ndarray) -> Mapping:
    """Mapping of a cylinder along v that starts in the direction `first` and turns towards `second`."""

    def mapping(u: np.ndarray, v: np.ndarray) -> list[np.ndarray]:
        c, s = np.cos(opening * u)[:, None], np.sin(opening * u)[:, None]
        axis = np.abs(np.cross(first, second)) + 0.0 * c
        ahead, inward = c * second - s * first, -(c * first + s * second)
        turned = radius * opening * ahead
        return [turned, length * axis, radius * opening**2 * inward, 0.0 * axis, 0.0 * axis]

    return mapping


def sphere(u: np.ndarray, v: np.ndarray) -> list[np.ndarray]:
    """Mapping of the hemisphere's quarter: from the equator up by 72 degrees."""
    around, up, radius = 0.5 * np.pi, np.radians(72.0), 10.0
    c, s = np.cos(around * u), np.sin(around * u)
    out, ahead = np.stack([c, s, 0.0 * c], axis=1), np.stack([-s, c, 0.0 * c], axis=1)
    low, high = radius * np.cos(up * v)[:, None], radius * np.sin(up * v)[:, None]
    return [
        around * low * ahead,
        up * (low * Z - high * out),
        -(around**2) * low * out,
        -(up**2) * (low * out + high * Z),
        -around * up * high * ahead,
    ]


def limit_beam(n: int, thickness: float, axis: int) -> float:
    fabric, tip = (thickness, 29e6, 0.22), BEAM[thickness] * np.eye(3)[axis]
    patch = Patch(twist, (n, n // 4), fabric, held={"u0": (0, 1, 2)}, clamped=True, tip=tip)
    return solve_patch(patch)(1.0, 0.5)[axis]


def limit_cylinder(n: int) -> float:
    mapping = cylinder(300.0, 0.5 * np.pi, 300.0, X, Y)
    held, planes = {"v1": (0, 1)}, {"u0": 1, "u1": 0, "v0": 2}
    patch = Patch(mapping, (n, n), (3.0, 3e6, 0.3), held, planes, points={(0.0, 0.0): -0.25 * X})
    return -solve_patch(patch)(0.0, 0.0)[0]


def limit_roof(n: int) -> float:
    mapping = cylinder(25.0, np.radians(40.0), 25.0, Z, X)
    patch = Patch(mapping, (n, n), (0.25, 4.32e8, 0.0), {"v1": (0, 2)}, {"u0": 0, "v0": 1}, density=-90.0 * Z)
    return -solve_patch(patch)(1.0, 0.0)[2]


def limit_hemisphere(n: int) -> float:
    fabric, forces = (0.04, 6.825e7, 0.3), {(0.0, 0.0): X, (1.0, 0.0): -Y}
    patch = Patch(sphere, (n, n), fabric, planes={"u0": 1, "u1": 0}, pinned=(2,), points=forces)
    return solve_patch(patch)(0.0, 0.0)[0]


class Standard(NamedTuple):
    """One displacement of the set. limit: Kirchhoff-Love, by splines.py with 64 spans a side; spans: recomputes it;
    published: MacNeal & Harder's, in part with shear; build: of cells and a factor on the load; meshes from coarse to
    fine; bound: on the finest mesh's error."""

    limit: float
    spans: Callable[[int], float]
    published: float
    build: Callable[[int, int, float], Built]
    factor: float
    meshes: list[tuple[int, int]]
    bound: float


def beam(thickness: float, axis: int, limit: float, published: float, bound: float) -> Standard:
    meshes = [(24, 4), (48, 8), (96, 16)]
    spans, build = partial(limit_beam, thickness=thickness, axis=axis), partial(twisted_beam, thickness, axis)
    return Standard(limit, spans, published, build, 1.0, meshes, bound)


IN_PLANE, OUT_OF_PLANE = 2, 1
SET = {
    "twisted beam, t = 0.32, in plane": beam(0.32, IN_PLANE, 5.3998e-3, 5.424e-3, 2e-4),
    "twisted beam, t = 0.32, out of plane": beam(0.32, OUT_OF_PLANE, 1.7507e-3, 1.754e-3, 3e-3),
    "twisted beam, t = 0.0032, in plane": beam(0.0032, IN_PLANE, 5.2499e-3, 5.256e-3, 6e-4),
    "twisted beam, t = 0.0032, out of plane": beam(0.0032, OUT_OF_PLANE, 1.2928e-3, 1.294e-3, 5e-4),
    "pinched cylinder": Standard(
        1.8282e-5, limit_cylinder, 1.8248e-5, pinched_cylinder, 1.0, [(16, 16), (32, 32), (64, 64)], 0.02
    ),
    "Scordelis-Lo roof": Standard(
        0.300592, limit_roof, 0.3024, roof, 1e-4, [(12, 12), (24, 24), (48, 48)], 2e-3
    ),
    "pinched hemisphere": Standard(
        0.093520, limit_hemisphere, 0.0940, hemisphere, 1e-4, [(12, 12), (24, 24), (48, 48)], 1e-3
    ),
}


def refined(name: str) -> list[Row]:
    """A displacement of the set on finer and finer meshes against its limit."""
    case, rows = SET[name], []
    for cells in case.meshes:
        shell, vertex, axis = case.build(*cells, case.factor)
        computed = abs(solve(shell, load_steps=1).u[vertex, axis]) / case.factor
        rows.append(row(f"MacNeal-Harder: {name}", f"{cells[0]}x{cells[1]} crossed", computed, case.limit))
    return rows


CASES: dict[str, Callable[[], list[Row]]] = {name: partial(refined, name) for name in SET}
