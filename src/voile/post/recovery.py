"""Forces, moments and stresses at the vertices, recovered from the triangles' (superconvergent patch recovery).

Zienkiewicz and Zhu (1992), "The superconvergent patch recovery and a posteriori error estimates", Int. J. Numer. Meth.
Engng 33: a linear function is fitted to the values at the centroids of the triangles round a vertex. Vertices of the
boundary take the mean of what their inner neighbours' functions say there.
"""

from dataclasses import dataclass

import numpy as np

from voile.arrays import Ints, Reals, area_vectors, row_sums, units
from voile.post.edges import edges
from voile.results import CELL_FIELDS, Result

# The fields at vertices, and the tensors on triangles that each is made of.
TENSORS = {
    "smooth_membrane_force": ("membrane_force",),
    "smooth_principal_membrane_force": ("membrane_force",),
    "smooth_bending_moment": ("bending_moment",),
    "smooth_principal_bending_moment": ("bending_moment",),
    "smooth_stress_top": ("stress_top",),
    "smooth_stress_bottom": ("stress_bottom",),
    "smooth_von_mises": ("stress_top", "stress_bottom"),
}
SIX = ((0, 1, 2, 0, 1, 0), (0, 1, 2, 1, 2, 2))  # VTK's order: xx yy zz xy yz xz
SQUARE = [[0, 3, 5], [3, 1, 4], [5, 4, 2]]
SLOPES = 1e-9  # of the fit's weights: slopes that too few triangles tell are small


@dataclass(frozen=True)
class Patches:
    """The vertices of a shape: points (n, 3) m, triangles (m, 3), orthonormal bases (n, 2, 3) of the planes at the
    vertices, the patches' sizes (n,) m, and the rotations (3 m, 3, 3) of the triangles' planes to those at corners."""

    points: Reals
    triangles: Ints
    basis: Reals
    size: Reals
    turn: Reals

    @classmethod
    def of(cls, points: Reals, triangles: Ints) -> "Patches":
        """Those of points (n, 3) m and triangles (m, 3)."""
        corners, n = points[triangles], len(points)
        across = area_vectors(points, triangles)
        vertex = triangles.ravel()
        normals = units(row_sums(vertex, np.repeat(across, 3, axis=0), n))
        turn = _rotations(np.repeat(units(across), 3, axis=0), normals[vertex])
        arm = np.repeat(corners.mean(axis=1), 3, axis=0) - points[vertex]
        count = np.maximum(np.bincount(vertex, minlength=n), 1)
        size = np.sqrt(np.bincount(vertex, (arm**2).sum(axis=1), n) / count)
        size[size == 0.0] = 1.0
        first = units(np.cross(normals, np.eye(3)[np.abs(normals).argmin(axis=1)]))
        basis = np.stack([first, np.cross(normals, first)], axis=1)
        return cls(points, triangles, basis, size, turn)

    def _rows(self, vertex: Ints, places: Reals) -> Reals:
        """(k, 3) the terms 1, x, y of the fits at vertices (k,) for places (k, 3) m."""
        arm = (places - self.points[vertex]) / self.size[vertex][:, None]
        return np.column_stack([np.ones(len(vertex)), np.einsum("kj,kij->ki", arm, self.basis[vertex])])

    def recovered(self, tensors: Reals) -> Reals:
        """(n, 3, 3) tensors at the vertices, of those on the triangles (m, 3, 3)."""
        vertex, n = self.triangles.ravel(), len(self.points)
        there = _turned(np.repeat(tensors, 3, axis=0), self.turn)
        rows = self._rows(vertex, np.repeat(self.points[self.triangles].mean(axis=1), 3, axis=0))
        left = row_sums(vertex, (rows[:, :, None] * rows[:, None, :]).reshape(-1, 9), n).reshape(-1, 3, 3)
        left[:, [1, 2], [1, 2]] += SLOPES
        left[left[:, 0, 0] == 0.0, 0, 0] = 1.0  # of no triangle
        right = row_sums(vertex, (rows[:, :, None] * there[:, *SIX][:, None, :]).reshape(-1, 18), n)
        fits = np.linalg.solve(left, right.reshape(-1, 3, 6))
        found: Reals = fits[:, 0][:, SQUARE]
        ask, told = self._from_inside()
        said = np.einsum("ki,kij->kj", self._rows(told, self.points[ask]), fits[told])[:, SQUARE]
        said = _turned(said, _rotations(self._normals[told], self._normals[ask]))
        count = np.bincount(ask, minlength=n)[:, None, None]
        mean = row_sums(ask, said.reshape(-1, 9), n).reshape(-1, 3, 3) / np.maximum(count, 1)
        return np.where(count > 0, mean, found)

    def _from_inside(self) -> tuple[Ints, Ints]:
        """Vertices of the boundary, and inner neighbours of theirs: (k,) each."""
        pairs, count = edges(self.triangles)
        rim = np.zeros(len(self.points), dtype=bool)
        rim[pairs[count == 1]] = True
        start, end = pairs.T
        ask, told = np.concatenate([start, end]), np.concatenate([end, start])
        use = rim[ask] & ~rim[told]
        return ask[use], told[use]

    @property
    def _normals(self) -> Reals:
        return np.cross(self.basis[:, 0], self.basis[:, 1])

    def principal(self, tensors: Reals) -> Reals:
        """(n, 2) principal values in the vertices' planes of tensors (n, 3, 3), the larger first."""
        plane = self.basis @ tensors @ self.basis.transpose(0, 2, 1)
        mean, half = 0.5 * (plane[:, 0, 0] + plane[:, 1, 1]), 0.5 * (plane[:, 0, 0] - plane[:, 1, 1])
        radius = np.hypot(half, plane[:, 0, 1])
        return np.column_stack([mean + radius, mean - radius])


def described(name: str) -> tuple[str, str]:
    """Unit and meaning of a field of TENSORS."""
    field = CELL_FIELDS[name.removeprefix("smooth_")]
    return field.unit, f"{field.meaning}; at vertices"


def recovered(result: Result, name: str, step: int) -> Reals:
    """(n, ...) a field of TENSORS at a step."""
    patches = Patches.of(result.points(step), result.triangles)
    tensors = [patches.recovered(result.field(each, step)[:, SQUARE]) for each in TENSORS[name]]
    if name == "smooth_von_mises":
        sides = [patches.principal(tensor).T for tensor in tensors]
        found: Reals = np.sqrt(np.max([a**2 - a * b + b**2 for a, b in sides], axis=0))
        return found
    return patches.principal(tensors[0]) if "principal" in name else tensors[0][:, *SIX]


def _rotations(start: Reals, end: Reals) -> Reals:
    """(k, 3, 3) the smallest rotations that take unit vectors to others."""
    axis, cosine = np.cross(start, end), (start * end).sum(axis=1)
    skew = np.cross(np.eye(3)[None], axis[:, None, :]).transpose(0, 2, 1) * -1.0
    found: Reals = np.eye(3) + skew + skew @ skew / np.maximum(1.0 + cosine, 1e-6)[:, None, None]
    return found


def _turned(tensors: Reals, rotations: Reals) -> Reals:
    found: Reals = rotations @ tensors @ rotations.transpose(0, 2, 1)
    return found
