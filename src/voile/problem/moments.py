"""End moments about boundary edges, at load factor 1.

A moment that keeps turning its edge's triangle does the work M dpsi, with dpsi the turn about the edge. Turns in space
depend on the path, so there is no potential, and the derivative of the forces M dpsi/dx is not symmetric.
"""

import numpy as np

from voile import _kernels
from voile.arrays import Reals
from voile.problem.partition import Part


class EndMoments:
    """The half edges of a part that moments act on. Degrees of freedom: 3 per local vertex, then one per edge."""

    def __init__(self, part: Part):
        half = np.flatnonzero(part.moment)
        triangle, opposite = np.divmod(half, 3)
        vertices = part.corners[triangle[:, None], (opposite[:, None] + np.arange(3)) % 3]
        self._size = (3 * len(part.vertex), len(part.edge))
        self._all, self._moment = part.moment, part.moment[half]
        self._dofs = (3 * vertices[..., None] + np.arange(3)).reshape(-1, 9)
        self._edges = self._size[0] + part.triangle_edges.ravel()[half]
        self._signs = part.signs.ravel()[half]
        self._skew = np.zeros((len(half), 9, 9))

    def forces(self, kernel: _kernels.Elastic, u: Reals) -> Reals:
        """(local dofs,) N, and N m on directors, at the kernel's displacements u (3 vertices,)."""
        total = np.zeros(sum(self._size))
        kernel.turn_gradient(u, np.zeros(self._size[1]), self._all, total[: len(u)])
        if self._size[1]:
            np.subtract.at(total, self._edges, self._moment * self._signs)
        return total

    def linearise(self, x: Reals) -> None:
        """Evaluates the skew part of the derivative at positions x (vertices, 3); the kernel has the symmetric one."""
        corner = x.ravel()[self._dofs].reshape(-1, 3, 3)
        columns = turn_derivative(corner, np.eye(9).reshape(9, 1, 3, 3)).reshape(9, -1, 9)
        derivative = self._moment[:, None, None] * columns.transpose(1, 2, 0)
        self._skew = 0.5 * (derivative - derivative.transpose(0, 2, 1))

    def skew_forces(self, motion: Reals) -> Reals:
        """(local dofs,) change of the forces (N) along a motion (local dofs,), by the skew part."""
        total = np.zeros_like(motion)
        np.add.at(total, self._dofs, np.einsum("hij,hj->hi", self._skew, motion[self._dofs]))
        return total


def turn_derivative(corner: Reals, motion: Reals) -> Reals:
    """(..., k, 3, 3) derivative along motions (..., k or 1, 3, 3) of the gradient of triangles' turn, (k, 3, 3), about
    their edge e_0 opposite corner 0: at corner j it is -(e_0 . e_j) N / (|N|^2 |e_0|) with N = e_0 x e_1
    (src/cpp/geometry.hpp)."""
    e, de = (x[..., [2, 0, 1], :] - x[..., [1, 2, 0], :] for x in (corner, motion))
    e0, e1, de0, de1 = e[..., :1, :], e[..., 1:2, :], de[..., :1, :], de[..., 1:2, :]
    normal = np.cross(e0, e1)
    d_normal = np.cross(de0, e1) + np.cross(e0, de1)
    area, length = _dot(normal, normal), _dot(e0, e0)
    relative = 2.0 * _dot(normal, d_normal) / area + _dot(e0, de0) / length
    change = (_dot(de0, e) + _dot(e0, de)) * normal + _dot(e0, e) * (d_normal - relative * normal)
    found: Reals = -change / (area * np.sqrt(length))
    return found


def _dot(a: Reals, b: Reals) -> Reals:
    found: Reals = np.einsum("...i,...i->...", a, b)[..., None]
    return found
