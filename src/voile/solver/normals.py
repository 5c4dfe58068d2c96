"""Normals of a shell, and how free of stretching motions along them are."""

import numpy as np

from voile.arrays import Reals, area_vectors, row_sums, sums, units
from voile.problem.problem import Problem


def normals(problem: Problem, x: Reals, stiffness: Reals) -> tuple[Reals, Reals]:
    """Unit normals n of the vertices at positions x (n, 3) m, and w n: (own unknowns,) each. Stretching of a
    `stiffness` (own unknowns,), over the inertia, resists n by its share d: what triangles turn away from n and from
    each other, as mean squares of sines. w = 1/sqrt(1 + d stiffness): 1 where the shell is flat, little on a fold."""
    part, layout = problem.part, problem.layout
    twice = area_vectors(x, part.corners)
    size, unit = np.linalg.norm(twice, axis=1), units(twice)
    across = np.where(part.across[..., None] < 0, unit[:, None], unit[part.across // 3])
    bent = 0.5 * (1.0 - np.einsum("mi,mki->mk", unit, across)).sum(axis=1)  # sin^2 of half the angles
    rows = np.repeat(np.column_stack([twice, size, size * bent]), 3, axis=0)
    around = row_sums(part.corners.ravel(), rows, len(x))
    none = np.zeros(len(part.edge))
    normal = layout.collect(np.concatenate([around[:, :3].ravel(), none]))  # sewn vertices share theirs
    area, bent = (layout.diagonal(np.concatenate([np.repeat(around[:, k], 3), none])) for k in (3, 4))
    area = np.maximum(area, 1e-300)
    square = sums(part.place, normal**2, len(x) + len(none))[part.place]
    resists = np.maximum(1.0 - square / area**2, 0.0) + bent / area
    normal /= np.sqrt(np.maximum(square, 1e-300))
    return normal, normal / np.sqrt(1.0 + resists * stiffness)
