"""Pressure that follows the surface, at load factor 1."""

import numpy as np

from voile.problem.partition import Part
from voile.problem.shell import area_vectors


def pressure_energy(x: np.ndarray, part: Part, pressure: float) -> float:
    """-p V (J) with V the volume under this rank's surface at x (vertices, 3), the sum of x0.(x1 x x2)/6."""
    corner = x[part.corners]
    volume = np.einsum("ti,ti->t", corner[:, 0], np.cross(corner[:, 1], corner[:, 2])) / 6.0
    return -pressure * float(volume @ part.weight)


def pressure_force(x: np.ndarray, part: Part, pressure: float) -> np.ndarray:
    """(3 vertices,) forces p A n / 3 at each corner (N)."""
    share = area_vectors(x, part.corners) * (pressure / 6.0)
    force = np.zeros((len(part.vertex), 3))
    for k in range(3):
        np.add.at(force, part.corners[:, k], share)
    return force.ravel()
