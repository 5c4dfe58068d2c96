"""Bodies that deform in time: frames of one mesh, linear between."""

from dataclasses import dataclass, field
from pathlib import Path

import igl
import numpy as np

from voile.arrays import Reals
from voile.contact.field import DistanceField, another_shape
from voile.errors import InputError
from voile.mesh.frames import frame_before, shape_between

KEPT = 3  # distance fields in memory: the two of a step, and the next


@dataclass(frozen=True)
class Frames:
    """points (f, n, 3) m of a mesh at times 0, step, 2 step, ... (s); first: the field of the first; source: where the
    last is from. The gap at a time between two frames is the mean of theirs, by its share; a point on the body moves
    with the place of the mesh that is nearest to it."""

    points: Reals
    step: float
    first: DistanceField
    source: str
    _fields: dict[int, DistanceField] = field(default_factory=dict, repr=False, compare=False)
    _trees: dict[float, tuple[Reals, igl.AABB]] = field(default_factory=dict, repr=False, compare=False)

    @property
    def lasts(self) -> float:
        """Time of the last frame (s)."""
        return (len(self.points) - 1) * self.step

    def between(self, t: float) -> tuple[int, float]:
        """The frame before a time, and the share of the way to the next one."""
        return frame_before(t, self.step, len(self.points))

    def at(self, t: float) -> Reals:
        """(n, 3) m."""
        return shape_between(self.points, t, self.step)

    def distance(self, p: Reals, t: float) -> Reals:
        """(n,) m."""
        found: Reals = np.sum([weight * part.distance(p) for weight, part in self._parts(t)], axis=0)
        return found

    def derivatives(self, p: Reals, t: float) -> tuple[Reals, Reals, Reals]:
        """Distance (n,), its gradient (n, 3) and Hessian (n, 3, 3)."""
        found = [[weight * d for d in part.derivatives(p)] for weight, part in self._parts(t)]
        gap, gradient, hessian = (np.sum(parts, axis=0) for parts in zip(*found, strict=True))
        return gap, gradient, hessian

    def carry(self, p: Reals, start: float, end: float) -> Reals:
        """(n, 3) where points near the body go with it."""
        if not len(p) or self.between(start) == self.between(end):
            return p
        before, tree = self._tree(start)
        corners = self.first.triangles
        _, near, foot = tree.squared_distance(before, corners, np.ascontiguousarray(p))
        share, moved = _shares(foot, before[corners[near]]), self.at(end) - before
        found: Reals = p + np.einsum("pk,pki->pi", share, moved[corners[near]])
        return found

    def _tree(self, t: float) -> tuple[Reals, igl.AABB]:
        """The points (n, 3) m at a time and a search tree of the triangles there: a step asks for its start's often."""
        if t not in self._trees:
            self._trees.clear()
            before, tree = self.at(t), igl.AABB()
            tree.init(before, self.first.triangles)
            self._trees[t] = before, tree
        return self._trees[t]

    def _parts(self, t: float) -> list[tuple[float, DistanceField]]:
        k, share = self.between(t)
        return [(1.0 - share, self._field(k))] + ([(share, self._field(k + 1))] if share else [])

    def _field(self, k: int) -> DistanceField:
        if k == 0:
            return self.first
        if k not in self._fields:
            if len(self._fields) >= KEPT:
                del self._fields[min(self._fields)]
            self._fields[k] = another_shape(self.first, self.points[k], f"frame {k} to {self.source}")
        return self._fields[k]


def _shares(p: Reals, corner: Reals) -> Reals:
    """(k, 3) barycentric coordinates of points (k, 3) in triangles (k, 3, 3)."""
    u, v, w = corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0], p - corner[:, 0]
    uu, uv, vv, wu, wv = (np.einsum("ki,ki->k", a, b) for a, b in ((u, u), (u, v), (v, v), (w, u), (w, v)))
    area = np.maximum(uu * vv - uv**2, 1e-300)
    second, third = (vv * wu - uv * wv) / area, (uu * wv - uv * wu) / area
    return np.column_stack([1.0 - second - third, second, third])


def frame_files(pattern: Path) -> list[Path]:
    """The files of a pattern such as body_%03d.obj, numbered from 0 or 1 to the first that is missing. Raises
    InputError where there are not two."""
    try:
        names = [Path(str(pattern) % k) for k in (0, 1)]
    except (TypeError, ValueError):
        names = [pattern, pattern]
    if names[0] == names[1]:
        raise InputError(f"{pattern}: not a name with one number in it; allowed: such as body_%03d.obj")
    number, files = 0 if names[0].is_file() else 1, []
    while (file := Path(str(pattern) % number)).is_file():
        files.append(file)
        number += 1
    if len(files) < 2:
        raise InputError(f"{file}: no such file; two frames at least are needed")
    return files
