"""Pressure that follows the surface, at load factor 1."""

import numpy as np

from voile.arrays import Reals
from voile.problem.partition import Part
from voile.problem.shell import Shell, area_vectors


def pressure_origin(shell: Shell) -> Reals | None:
    """(3,) a point against which pressure has the potential -p V, V the volume between it and the surface; None where
    there is none, as for patches of it, or none is looked for, as where supports hold along local axes.

    Sliding the rim changes V by the triangles from it to the point, which is not work of the pressure. They have no
    volume where each edge of the rim stays in a plane through the point, as on planes of symmetry.
    """
    if shell.patch_pressure is not None or shell.axes is not None:
        return None
    rim = shell.topology.edges[shell.topology.boundary_edges]
    fixed = shell.fixed[rim]
    rim, fixed = rim[~fixed.all(axis=(1, 2))], fixed[~fixed.all(axis=(1, 2))]
    x, still = shell.points[rim], fixed & (shell.motion[rim] == 0.0)
    flat = still.all(axis=1) & (x[:, 0] == x[:, 1])  # (rim, 3) axes to which the edge's plane is normal
    origin = np.zeros(3)
    for axis in range(3):
        alone = flat[:, axis] & (flat.sum(axis=1) == 1)  # edges along two planes may stay in either
        places = x[alone if alone.any() else flat[:, axis], 0, axis]
        origin[axis] = places[0] if len(places) else 0.0
    within = flat & (x[:, 0] == origin)
    return origin if within.any(axis=1).all() else None


def pressure_energy(x: Reals, part: Part, origin: Reals) -> float:
    """-p V (J) with V the volume from the origin to this rank's surface at x (vertices, 3), the sum of
    x0.(x1 x x2)/6."""
    corner = x[part.corners] - origin
    volume = np.einsum("ti,ti->t", corner[:, 0], np.cross(corner[:, 1], corner[:, 2])) / 6.0
    return -float((part.pressure * volume) @ part.weight)


def pressure_force(x: Reals, part: Part) -> Reals:
    """(3 vertices,) forces p A n / 3 at each corner (N)."""
    share = area_vectors(x, part.corners) * (part.pressure / 6.0)[:, None]
    force = np.zeros((len(part.vertex), 3))
    for k in range(3):
        np.add.at(force, part.corners[:, k], share)
    return force.ravel()
