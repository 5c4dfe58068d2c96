"""Bodies that deform in time: frames of one mesh, linear between."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from voile.arrays import Ints, Reals
from voile.contact.field import DistanceField, another_shape
from voile.contact.obstacle import Start
from voile.errors import InputError
from voile.mesh.frames import frame_before, shape_between

KEPT = 3  # distance fields in memory: the two of a step, and the next


@dataclass(frozen=True)
class Frames:
    """points (f, n, 3) m of a mesh at times 0, step, 2 step, ... (s); first: the field of the first; source: where the
    last is from. A point near the body moves with the place of the mesh that is nearest to it at the start of a step.
    Its gap at a time between two frames is the mean of theirs, by its share, where that place would have it in them: so
    a body that only moves keeps its shape, and what turns by an angle a is off by a^2 / 4 of its slip in the step."""

    points: Reals
    step: float
    first: DistanceField
    source: str
    _fields: dict[int, DistanceField] = field(default_factory=dict, repr=False, compare=False)
    _trees: dict[float, tuple[Reals, Any]] = field(default_factory=dict, repr=False, compare=False)
    _known: list[tuple[Start, Ints, Reals]] = field(default_factory=list, repr=False, compare=False)

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

    def distance(self, p: Reals, t: float, start: Start | None = None) -> Reals:
        """(n,) m; start: that of p."""
        found: Reals = np.sum([w * part.distance(at) for w, part, at in self._parts(p, t, start)], axis=0)
        return found

    def derivatives(self, p: Reals, t: float, start: Start | None = None) -> tuple[Reals, Reals, Reals]:
        """Distance (n,), its gradient (n, 3) and Hessian (n, 3, 3), with a start as it is."""
        found = [[w * d for d in part.derivatives(at)] for w, part, at in self._parts(p, t, start)]
        gap, gradient, hessian = (np.sum(parts, axis=0) for parts in zip(*found, strict=True))
        return gap, gradient, hessian

    def carry(self, p: Reals, start: float, end: float, turns: bool = True) -> Reals:
        """(n, 3) where points near the body go with it. What they are off their places, as by half a thickness, turns
        with the triangles there, but where points may be anywhere."""
        if not len(p) or self.between(start) == self.between(end):
            return p
        before, after, (corners, shares) = self.at(start), self.at(end), self._nearest(p, start)
        found: Reals = p + _at(after - before, corners, shares)
        if turns:
            off = p - _at(before, corners, shares)
            found += _turned(off, before[corners], after[corners]) - off
        return found

    def _nearest(self, p: Reals, t: float) -> tuple[Ints, Reals]:
        """The place of the mesh at a time that is nearest to each point (n, 3): the vertices (n, 3) of its triangle and
        their shares (n, 3)."""
        shape, tree = self._tree(t)
        _, near, foot = tree.squared_distance(shape, self.first.triangles, np.ascontiguousarray(p))
        corners = self.first.triangles[near]
        return corners, _shares(foot, shape[corners])

    def _way(self, k: int, start: Start) -> Reals:
        """(n, 3) m from frame k to the next of the places that are nearest to a start, asked for again and again."""
        known = [
            each for each in self._known if each[0].points is start.points and each[0].time == start.time
        ]
        if not known:
            known = [(start, *self._nearest(start.points, start.time))]
            self._known[:] = [*self._known[-1:], *known]
        _, corners, shares = known[0]
        return _at(self.points[k + 1] - self.points[k], corners[start.rows], shares[start.rows])

    def _tree(self, t: float) -> tuple[Reals, Any]:
        """The points (n, 3) m at a time and a search tree of the triangles there: a step asks for its start's often."""
        import igl

        if t not in self._trees:
            self._trees.clear()
            before, tree = self.at(t), igl.AABB()
            tree.init(before, self.first.triangles)
            self._trees[t] = before, tree
        return self._trees[t]

    def _parts(self, p: Reals, t: float, start: Start | None) -> list[tuple[float, DistanceField, Reals]]:
        """The frames beside a time: share, field, and where points p are in it."""
        k, share = self.between(t)
        if not share:
            return [(1.0, self._field(k), p)]
        way = self._way(k, start or Start(p, t))
        before, after = p - share * way, p + (1.0 - share) * way
        return [(1.0 - share, self._field(k), before), (share, self._field(k + 1), after)]

    def _field(self, k: int) -> DistanceField:
        if k == 0:
            return self.first
        if k not in self._fields:
            if len(self._fields) >= KEPT:
                del self._fields[min(self._fields)]
            self._fields[k] = another_shape(self.first, self.points[k], f"frame {k} to {self.source}")
        return self._fields[k]


def _at(values: Reals, corners: Ints, shares: Reals) -> Reals:
    """(k, 3) of values (n, 3) of vertices, in triangles of vertices (k, 3) by shares (k, 3)."""
    found: Reals = np.einsum("pk,pki->pi", shares, values[corners])
    return found


def _turned(off: Reals, before: Reals, after: Reals) -> Reals:
    """(k, 3) of vectors (k, 3) that turn with triangles (k, 3, 3)."""
    found: Reals = np.einsum("kij,kil,kl->kj", _axes(after), _axes(before), off)
    return found


def _axes(corner: Reals) -> Reals:
    """(k, 3, 3) rows of unit vectors along the first edges of triangles (k, 3, 3), in their planes and across."""
    edge = corner[:, 1] - corner[:, 0]
    normal = np.cross(edge, corner[:, 2] - corner[:, 0])
    rows = np.stack([edge, np.cross(normal, edge), normal], axis=1)
    found: Reals = rows / np.maximum(np.linalg.norm(rows, axis=2, keepdims=True), 1e-300)
    return found


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
