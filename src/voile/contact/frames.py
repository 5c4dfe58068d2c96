"""Bodies that deform in time: frames of one mesh, linear between."""

from dataclasses import dataclass, field
from pathlib import Path

import igl
import numpy as np

from voile.arrays import Ints, Reals
from voile.contact.field import DistanceField, distance_field
from voile.errors import InputError

KEPT = 3  # distance fields in memory: the two of a step, and the next


@dataclass(frozen=True)
class Frames:
    """points (f, n, 3) m of triangles (m, 3) at times 0, step, 2 step, ... (s). The gap at a time between two frames is
    the mean of theirs, by its share; a point on the body moves with the place of the mesh that is nearest to it."""

    points: Reals
    triangles: Ints
    step: float
    resolution: float | None
    source: str
    _fields: dict[int, DistanceField] = field(default_factory=dict, repr=False, compare=False)

    @property
    def lasts(self) -> float:
        """Time of the last frame (s)."""
        return (len(self.points) - 1) * self.step

    def between(self, t: float) -> tuple[int, float]:
        """The frame before a time, and the share of the way to the next one."""
        last = len(self.points) - 1
        k = min(max(int(t / self.step), 0), last)
        return k, min(max(t / self.step - k, 0.0), 1.0) if k < last else 0.0

    def at(self, t: float) -> Reals:
        """(n, 3) m."""
        k, share = self.between(t)
        found: Reals = self.points[k] + share * (
            self.points[min(k + 1, len(self.points) - 1)] - self.points[k]
        )
        return found

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
        before, after = self.at(start), self.at(end)
        if not len(p) or np.array_equal(before, after):
            return p
        triangles = self.triangles.astype(np.int64)
        _, near, foot = igl.point_mesh_squared_distance(np.ascontiguousarray(p), before, triangles)
        share = _shares(foot, before[triangles[near]])
        found: Reals = p + np.einsum("pk,pki->pi", share, (after - before)[triangles[near]])
        return found

    def _parts(self, t: float) -> list[tuple[float, DistanceField]]:
        k, share = self.between(t)
        return [(1.0 - share, self._field(k))] + ([(share, self._field(k + 1))] if share else [])

    def _field(self, k: int) -> DistanceField:
        if k not in self._fields:
            if len(self._fields) >= KEPT:
                del self._fields[min(self._fields)]
            self._fields[k] = distance_field(
                self.points[k], self.triangles, self.resolution, f"{self.source}, frame {k}"
            )
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
        raise InputError(f"{pattern}: no number in it; allowed: a pattern such as body_%03d.obj")
    number, files = 0 if names[0].is_file() else 1, []
    while (file := Path(str(pattern) % number)).is_file():
        files.append(file)
        number += 1
    if len(files) < 2:
        raise InputError(f"{file}: no such file; two frames at least are needed")
    return files
