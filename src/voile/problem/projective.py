"""The constant matrix of Projective Dynamics: the energies' Hessian with all projections held.

Of a triangle whose corners' shape functions have gradients D_j the deformation is F = sum_j x_j D_j^T. Stretching with
rotations held is quadratic in F. Bending is quadratic in II_i = altitude_i (nu_i + nu'_i), nu and nu' the unit outward
conormals on both sides of edge i. Where edges keep their lengths these are linear in the positions: |e_i| nu_i = -2
area sum_j (D_i . D_j) x_j (Bergou et al. 2006).
"""

import numpy as np

from voile.arrays import Reals
from voile.problem.partition import Part


def constant_blocks(part: Part, share: float = 1.0) -> Reals:
    """(m, 21, 21) N/m of the triangles, with a share of the stretching; the same for three components of corners and
    vertices across edges, none for directors. As in `triangles.gather_triangles`."""
    area, gradients = _shape_functions(part)
    thickness, young, poisson, _ = part.fabric
    mu, lam = 0.5 * young / (1.0 + poisson), young * poisson / (1.0 - poisson**2)
    # lambda < 0: mu |U - I|^2 + lambda/2 tr(U - I)^2 has two positive parts, mu + lambda and the deviator's -lambda.
    firm = 2.0 * thickness * area * (mu + np.maximum(lam, 0.0))
    scalar = np.zeros((len(area), 7, 7))
    scalar[:, :3, :3] = share * firm[:, None, None] * gradients
    forms = _second_forms(part, area, gradients)
    stiffness = (thickness**3 / 12.0 * area)[:, None, None] * _bending(gradients, mu, lam)
    scalar[:, :6, :6] += np.einsum("mip,mij,mjq->mpq", forms, stiffness, forms)
    blocks = np.zeros((len(area), 21, 21))
    for axis in range(3):
        rows = 3 * np.arange(6) + axis
        blocks[:, rows[:, None], rows] = scalar[:, :6, :6]
    return blocks


def _shape_functions(part: Part) -> tuple[Reals, Reals]:
    """(m,) areas at rest (m^2), (m, 3, 3) scalar products of the shape functions' gradients (1/m^2)."""
    corner = part.rest_points[part.rest_corners]
    edge = np.roll(corner, -2, axis=1) - np.roll(corner, -1, axis=1)  # opposite to each corner
    area = 0.5 * np.linalg.norm(np.cross(edge[:, 0], edge[:, 1]), axis=1)
    return area, np.einsum("mia,mja->mij", edge, edge) / (4.0 * area**2)[:, None, None]


def _second_forms(part: Part, area: Reals, gradients: Reals) -> Reals:
    """(m, 3, 6) the linear II_i of corners and vertices across edges (m)."""
    jumps = -2.0 * area[:, None, None] * gradients  # |e_i| nu_i by corner
    length = 2.0 * area[:, None] * np.sqrt(np.einsum("mii->mi", gradients))
    height = 2.0 * area[:, None] / length
    half = part.across.ravel()
    shared, clamped = (half >= 0), np.zeros(len(half), dtype=bool)
    clamped[part.half_edge_clamp[:, 0].astype(np.int64)] = True
    own = np.where(clamped, 1.0, np.where(shared, 0.5, 0.0)).reshape(-1, 3)
    other = np.where(shared & ~clamped, 0.5, 0.0).reshape(-1, 3)
    triangle, edge = np.divmod(np.maximum(part.across, 0), 3)
    forms = np.zeros((len(area), 3, 6))
    for i in range(3):
        forms[:, i, :3] = own[:, i, None] * jumps[:, i]
        near, k = triangle[:, i], edge[:, i]
        forms[:, i, 3 + i] += other[:, i] * jumps[near, k, k]
        forms[:, i, (i + 2) % 3] += other[:, i] * jumps[near, k, (k + 1) % 3]
        forms[:, i, (i + 1) % 3] += other[:, i] * jumps[near, k, (k + 2) % 3]
    found: Reals = 2.0 * (height / length)[:, :, None] * forms
    return found


def _bending(gradients: Reals, mu: Reals, lam: Reals) -> Reals:
    """(m, 3, 3) second derivatives of |A_rest^-1 B|^2_SV by the II_i (Pa/m^4)."""
    # The inverse of the first form in the basis of the edges from the first corner holds D_2 and D_3.
    a, b, c = gradients[:, 1, 1], gradients[:, 1, 2], gradients[:, 2, 2]
    trace = np.stack([a + 2.0 * b + c, a, c], axis=1)
    mixed = (np.ones((3, 3)) - np.eye(3)) * (a * c - b * b)[:, None, None]  # of the determinant
    square = (2.0 * mu + lam)[:, None, None] * trace[:, :, None] * trace[:, None, :]
    found: Reals = square - 2.0 * mu[:, None, None] * mixed
    return found
