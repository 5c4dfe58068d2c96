"""What protocols build their scenes of: grids, strips, selections, forces."""

from typing import Any

import numpy as np

from voile.arrays import Flags, Reals
from voile.mesh.grids import grid
from voile.validate.bench import Mesh

YOUNG, DENSITY = 1e6, 1000.0  # Pa, kg/m^3 of strips
CLAMP = 1e-9  # how near to an end a vertex counts as on it


def rigidity(thickness: float, young: float = YOUNG, poisson: float = 0.0) -> float:
    """Bending stiffness B or D of a plate (N m)."""
    return young * thickness**3 / (12.0 * (1.0 - poisson**2))


def sheet(nx: int, ny: int, length: float, width: float, diagonals: str = "alternating") -> Mesh:
    """0 <= x <= length, 0 <= y <= width, z = 0."""
    uv, triangles = grid(nx, ny, diagonals)
    return Mesh(np.column_stack([uv * [length, width], np.zeros(len(uv))]), triangles)


def strip(nx: int, ny: int, width: float = 0.05, uniform: float = 1.0) -> Mesh:
    """A sheet 1 m long; cells at x = 0 are `uniform` times the mean length."""
    mesh = sheet(nx, ny, 1.0, width)
    x = mesh.points[:, 0]
    mesh.points[:, 0] = x * (uniform + (1.0 - uniform) * x)
    return mesh


def nodes(mask: Flags) -> dict[str, list[int]]:
    """The selection of the vertices of a mask (n,)."""
    return {"nodes": np.flatnonzero(mask).tolist()}


def clamp(mask: Flags, **more: Any) -> dict[str, Any]:
    """A support that holds a mask of vertices and their directors."""
    return {"select": nodes(mask), "clamp": True, **more}


def fabric(
    thickness: float, young: float = YOUNG, poisson: float = 0.0, density: float = DENSITY
) -> dict[str, Any]:
    """The [shell] keys of a material."""
    return {"thickness": thickness, "young": young, "poisson": poisson, "density": density}


def shared_by_length(points: Reals, line: Flags, total: Reals) -> Reals:
    """(n, 3) dead forces of a total (3,) spread evenly by length over a straight line of vertices along an axis."""
    at = np.flatnonzero(line)
    place = points[at, np.ptp(points[at], axis=0).argmax()]
    at, place = at[np.argsort(place)], np.sort(place)
    share = np.zeros(len(points))
    share[at[:-1]] += 0.5 * np.diff(place)
    share[at[1:]] += 0.5 * np.diff(place)
    found: Reals = share[:, None] / np.ptp(place) * total
    return found


def line_forces(points: Reals, line: Flags, total: Reals) -> list[dict[str, Any]]:
    """The same as [[loads.force]] tables."""
    force = shared_by_length(points, line, total)
    return [
        {"select": {"nodes": [int(vertex)]}, "value": force[vertex].tolist()}
        for vertex in np.flatnonzero(line)
    ]
