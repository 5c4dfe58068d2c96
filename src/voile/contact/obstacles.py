"""The shapes of obstacles: each one class, with the keys of its scene table, signed distance and drawing surface.

Distances are exact but for meshes; where the closest point is not unique (a sphere's centre, a cylinder's axis) some
definite one is taken.
"""

from dataclasses import Field, dataclass, fields
from math import pi
from pathlib import Path
from typing import Any, Self

import numpy as np

from voile.arrays import Ints, Reals, diagonal
from voile.contact.directions import NOWHERE, TINY, lengths, normalised, perpendicular, radial, unit
from voile.contact.field import DistanceField, check_inside, distance_field
from voile.contact.frames import Frames, frame_files
from voile.contact.motion import Motion
from voile.contact.obstacle import SHAPES, Obstacle, Start
from voile.contact.pairs import dot, outer
from voile.contact.surfaces import AROUND, Triangles, revolve, stretch, unit_sphere
from voile.errors import InputError
from voile.keys import File, MeshFile, Number, Rejected, Vector3, key, vector
from voile.mesh import RawMesh, read_body

LONGEST = 1e6  # half axis of an ellipsoid over the shortest: their squares keep four digits beside each other

__all__ = ["SHAPES", "Motion", "Obstacle"]


@dataclass(frozen=True, kw_only=True)
class Plane(Obstacle, shape="plane"):
    """Half space below a point, `normal` pointing out of it."""

    flat = True
    point: Reals = key(vector("m"), "a point of it")
    normal: Reals = key(vector(nonzero=True), "outward direction, any length")

    def derivatives(self, p: Reals) -> tuple[Reals, Reals, Reals]:
        n = normalised(self.normal)
        return (p - self.point) @ n, np.tile(n, (len(p), 1)), np.zeros((len(p), 3, 3))

    def distance(self, p: Reals) -> Reals:
        return (p - self.point) @ normalised(self.normal)

    def surface(self, bounds: Reals) -> Triangles:
        """A rectangle below the bounds."""
        n = normalised(self.normal)
        first = perpendicular(n)
        second = np.cross(n, first)
        (a, b), (c, d) = (stretch(self.point, along, bounds) for along in (first, second))
        ends = np.array([[a, c], [b, c], [b, d], [a, d]])
        return self.point + ends @ np.stack([first, second]), np.array([[0, 1, 2], [0, 2, 3]])


@dataclass(frozen=True, kw_only=True)
class Sphere(Obstacle, shape="sphere"):
    center: Reals = key(vector("m"), "centre")
    radius: float = key(Number("m", above=0), "radius")

    def derivatives(self, p: Reals) -> tuple[Reals, Reals, Reals]:
        r, n = unit(p - self.center, np.array([0.0, 0.0, 1.0]))
        return r - self.radius, n, (np.eye(3) - outer(n, n)) / np.maximum(r, TINY)[:, None, None]

    def distance(self, p: Reals) -> Reals:
        found: Reals = lengths(p - self.center) - self.radius
        return found

    def surface(self, bounds: Reals) -> Triangles:
        points, triangles = unit_sphere()
        return self.center + self.radius * points, triangles


@dataclass(frozen=True, kw_only=True)
class Cylinder(Obstacle, shape="cylinder"):
    """Unbounded along its axis."""

    center: Reals = key(vector("m"), "centre")
    axis: Reals = key(vector(nonzero=True), "direction of the axis, any length")
    radius: float = key(Number("m", above=0), "radius")

    def derivatives(self, p: Reals) -> tuple[Reals, Reals, Reals]:
        a = normalised(self.axis)
        _, r, n = radial(p - self.center, a)
        across = np.eye(3) - np.outer(a, a) - outer(n, n)
        return r - self.radius, n, across / np.maximum(r, TINY)[:, None, None]

    def distance(self, p: Reals) -> Reals:
        return radial(p - self.center, normalised(self.axis))[1] - self.radius

    def surface(self, bounds: Reals) -> Triangles:
        low, high = stretch(self.center, normalised(self.axis), bounds)
        return revolve(self.center, self.axis, np.full(2, self.radius), np.array([low, high]))


@dataclass(frozen=True, kw_only=True)
class Capsule(Obstacle, shape="capsule"):
    """All points within `radius` of the segment from a to b."""

    a: Reals = key(vector("m"), "one end of its centre line")
    b: Reals = key(vector("m"), "other end of its centre line")
    radius: float = key(Number("m", above=0), "radius")

    @classmethod
    def check(cls, table: Any) -> None:
        if table.a == table.b:
            raise Rejected("equals a; allowed: another point (equal ends make a sphere)", ("b",))

    def derivatives(self, p: Reals) -> tuple[Reals, Reals, Reals]:
        along = np.asarray(self.b, dtype=float) - self.a
        length = float(np.linalg.norm(along))
        axis = along / length
        t, away, e = radial(p - self.a, axis)
        beyond = t - np.clip(t, 0.0, length)
        r, n = unit(away[:, None] * e + beyond[:, None] * axis, perpendicular(axis))
        inner = (beyond == 0.0)[:, None, None]
        across = np.eye(3) - outer(n, n) - inner * np.outer(axis, axis)
        return r - self.radius, n, across / np.maximum(r, TINY)[:, None, None]

    def surface(self, bounds: Reals) -> Triangles:
        axis = np.subtract(self.b, self.a)
        t = np.linspace(-np.pi / 2, np.pi / 2, AROUND // 2)
        length = np.linalg.norm(axis) * (t > 0.0)
        return revolve(self.a, axis, self.radius * np.cos(t), self.radius * np.sin(t) + length)


@dataclass(frozen=True, kw_only=True)
class Cone(Obstacle, shape="cone"):
    """Solid, unbounded from its apex along its axis."""

    apex: Reals = key(vector("m"), "apex")
    axis: Reals = key(vector(nonzero=True), "direction of the axis, any length")
    half_angle: float = key(Number("rad", above=0, below=pi / 2), "angle between axis and surface")

    def derivatives(self, p: Reals) -> tuple[Reals, Reals, Reals]:
        a, sine, cosine = normalised(self.axis), np.sin(self.half_angle), np.cos(self.half_angle)
        d = p - self.apex
        z, r, e = radial(d, a)
        beyond = r * sine + z * cosine < 0.0  # nearest to the apex
        far, out = unit(d, -a)
        around = np.cross(a, e)
        flank = (cosine / np.maximum(r, TINY))[:, None, None] * outer(around, around)
        tip = (np.eye(3) - outer(out, out)) / np.maximum(far, TINY)[:, None, None]
        return (
            np.where(beyond, far, r * cosine - z * sine),
            np.where(beyond[:, None], out, cosine * e - sine * a),
            np.where(beyond[:, None, None], tip, flank),
        )

    def surface(self, bounds: Reals) -> Triangles:
        """From the apex to the far end of the bounds."""
        high = stretch(self.apex, normalised(self.axis), bounds)[1]
        z = np.array([0.0, max(high, diagonal(bounds))])
        return revolve(self.apex, self.axis, z * np.tan(self.half_angle), z)


@dataclass(frozen=True, kw_only=True)
class Torus(Obstacle, shape="torus"):
    """All points within `tube` of a circle of `radius` about the axis."""

    center: Reals = key(vector("m"), "centre")
    axis: Reals = key(vector(nonzero=True), "direction of the axis, any length")
    radius: float = key(Number("m", above=0), "of its centre line")
    tube: float = key(Number("m", above=0), "radius of the tube, below radius")

    @classmethod
    def check(cls, table: Any) -> None:
        if table.tube >= table.radius:
            raise Rejected(f"{table.tube:g}; allowed: below radius = {table.radius:g}", ("tube",))

    @property
    def finest(self) -> float:
        return self.tube

    def derivatives(self, p: Reals) -> tuple[Reals, Reals, Reals]:
        a = normalised(self.axis)
        z, r, e = radial(p - self.center, a)
        far, n = unit((r - self.radius)[:, None] * e + z[:, None] * a, e)
        around = np.cross(a, e)
        across = (np.eye(3) - outer(n, n) - outer(around, around)) / np.maximum(far, TINY)[:, None, None]
        turning = (dot(n, e) / np.maximum(r, TINY))[:, None, None] * outer(around, around)
        return far - self.tube, n, across + turning

    def surface(self, bounds: Reals) -> Triangles:
        t = np.linspace(-np.pi, np.pi, AROUND // 2)
        return revolve(self.center, self.axis, self.radius + self.tube * np.cos(t), self.tube * np.sin(t))


@dataclass(frozen=True, kw_only=True)
class Ellipsoid(Obstacle, shape="ellipsoid"):
    center: Reals = key(vector("m"), "centre")
    radii: Reals = key(vector("m", above=0), "half axes along x, y, z")

    @classmethod
    def check(cls, table: Any) -> None:
        if max(table.radii) > LONGEST * min(table.radii):
            raise Rejected(
                f"{list(table.radii)}; allowed: the longest at most {LONGEST:g} times the shortest",
                ("radii",),
            )

    def distance(self, p: Reals) -> Reals:
        return self._nearest(p)[0]

    def _nearest(self, p: Reals) -> tuple[Reals, Reals, Reals]:
        """Signed distance (n,), normal (n, 3) at the closest point, and length (n,) of (x / r^2) there (1/m)."""
        radii, d = np.asarray(self.radii, dtype=float), p - self.center
        foot = _ellipsoid_foot(np.abs(d), radii) * np.where(d < 0.0, -1.0, 1.0)
        gradient_norm, n = unit(foot / radii**2, np.array([0.0, 0.0, 1.0]))
        return dot(d - foot, n), n, gradient_norm

    def derivatives(self, p: Reals) -> tuple[Reals, Reals, Reals]:
        gap, n, gradient_norm = self._nearest(p)
        across = np.eye(3) - outer(n, n)
        shape = across @ np.diag(1.0 / np.asarray(self.radii) ** 2) @ across / gradient_norm[:, None, None]
        return gap, n, np.linalg.solve(np.eye(3) + gap[:, None, None] * shape + 1e-14 * np.eye(3), shape)

    def surface(self, bounds: Reals) -> Triangles:
        points, triangles = unit_sphere()
        return self.center + self.radii * points, triangles


def _ellipsoid_foot(p: Reals, radii: Reals) -> Reals:
    """(n, 3) closest points of an ellipsoid to points of the first octant (Eberly 2013): x_i = r_i^2 p_i / (t + r_i^2)
    with the largest root t of |w| = 1, w_i = r_i p_i / (t + r_i^2). In s = t + min r_i^2, which keeps its digits near
    the centre, 1 / |w| is concave and nearly straight: from below Newton's method on it only climbs (Moré & Sorensen
    1983)."""
    squares, least = radii**2, float(radii.min())
    beyond = squares - squares.min()
    p = np.maximum(p, 1e-12 * least)  # off the planes of symmetry, where the root may be at the pole
    s = (radii * p - beyond).max(axis=1)  # no component of w exceeds 1 at the root
    for _ in range(200):  # 6 to 10, on needles and discs 20
        w = (radii * p / (s[:, None] + beyond)) ** 2
        square = w.sum(axis=1)
        s = s + (np.sqrt(square) - 1.0) * square / (w / (s[:, None] + beyond)).sum(axis=1)
        if (square <= 1.0 + 2e-15).all():
            break
    found: Reals = squares * p / (s[:, None] + beyond)
    return found


@dataclass(frozen=True, kw_only=True)
class Box(Obstacle, shape="box"):
    """Edges along x, y, z; outside, surfaces at a distance are rounded at the edges."""

    turned = -0.5  # however short, a way round an edge turns by a right angle
    center: Reals = key(vector("m"), "centre")
    sizes: Reals = key(vector("m", above=0), "half edges along x, y, z")

    def derivatives(self, p: Reals) -> tuple[Reals, Reals, Reals]:
        d = p - self.center
        side = np.where(d < 0.0, -1.0, 1.0)
        beyond = np.abs(d) - self.sizes
        far, out = unit(side * np.maximum(beyond, 0.0), np.array([0.0, 0.0, 1.0]))
        nearest = np.argmax(beyond, axis=1)
        inside = far <= NOWHERE * lengths(d)  # on the surface too: there `out` has no direction
        face = np.zeros_like(d)
        face[np.arange(len(d)), nearest] = side[np.arange(len(d)), nearest]
        n = np.where(inside[:, None], face, out)
        rounded = np.einsum("ni,ij->nij", (beyond > 0.0).astype(float), np.eye(3)) - outer(n, n)
        curvature = np.where(inside[:, None, None], 0.0, rounded / np.maximum(far, TINY)[:, None, None])
        return np.where(inside, beyond.max(axis=1), far), n, curvature

    def distance(self, p: Reals) -> Reals:
        d = p - self.center
        beyond = np.abs(d) - self.sizes
        far = lengths(np.maximum(beyond, 0.0))
        return np.where(far <= NOWHERE * lengths(d), beyond.max(axis=1), far)

    def surface(self, bounds: Reals) -> Triangles:
        """Corners of their own on every face, so that shading shows the edges."""
        points = []
        for axis in range(3):
            for side in (-1.0, 1.0):
                ends = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])[:: int(side)]
                points.append(np.roll(np.column_stack([np.full(4, side), ends]), axis, axis=1))
        corners = np.arange(24).reshape(6, 4)
        triangles = np.concatenate([corners[:, [0, 1, 2]], corners[:, [0, 2, 3]]], axis=1).reshape(-1, 3)
        return self.center + self.sizes * np.concatenate(points), triangles


@dataclass(frozen=True, kw_only=True)
class MeshKeys:
    """The scene table of a mesh."""

    file: Path | RawMesh | None = key(MeshFile(), "triangle mesh of the body, normals outwards", default=None)
    frames: Path | None = key(
        File(),
        "dynamics: in place of file, the body as it deforms, a pattern such as body_%03d.obj of meshes with the same "
        "triangles",
        default=None,
    )
    frame_time: float | None = key(Number("s", above=0), "time between two frames", default=None)
    scale: float = key(Number("m", above=0), "metres per unit of the file", default=1.0)
    translate: Vector3 = key(vector("m"), "shift after scaling", default=(0.0, 0.0, 0.0))
    resolution: float | None = key(
        Number("m", above=0),
        "spacing of the grid of the smooth distance field; default: half the mesh's mean edge, or the thickness "
        "of a thin body",
        default=None,
    )


@dataclass(frozen=True, kw_only=True)
class MeshBody(DistanceField, Obstacle, shape="mesh"):
    """A body bounded by triangles; with frames as it deforms in time."""

    frames: Frames | None = None

    @property
    def finest(self) -> float:
        """A part of the mesh that is much thinner than the spacing is none of the field's."""
        return 0.25 * self.spacing

    @property
    def moves(self) -> bool:
        return self.motion.moves or self.frames is not None

    @property
    def ends(self) -> float:
        return max(self.frames.lasts if self.frames else 0.0, self.motion.ends)

    def gap(self, points: Reals, t: float, start: Start | None = None) -> Reals:
        return self.frames.distance(points, t, start) if self.frames else super().gap(points, t)

    def gap_derivatives(
        self, points: Reals, t: float, start: Start | None = None
    ) -> tuple[Reals, Reals, Reals]:
        return (
            self.frames.derivatives(points, t, start) if self.frames else super().gap_derivatives(points, t)
        )

    def carry(self, points: Reals, start: float, end: float) -> Reals:
        return self.frames.carry(points, start, end) if self.frames else super().carry(points, start, end)

    def way(self, points: Reals, began: float, moved: Reals, ended: float) -> tuple[Reals, Reals]:
        """In the shape that the body has at the beginning."""
        if not self.frames:
            return super().way(points, began, moved, ended)
        return points, moved - (self.frames.carry(points, began, ended, turns=False) - points)

    def derivatives_on_way(self, points: Reals, start: Start) -> tuple[Reals, Reals, Reals]:
        return self.frames.derivatives(points, start.time, start) if self.frames else self.derivatives(points)

    @classmethod
    def scene_keys(cls) -> dict[str, Field[Any]]:
        return {f.name: f for f in fields(MeshKeys)}

    @classmethod
    def check(cls, table: Any) -> None:
        if table.file is None and table.frames is None:
            raise Rejected('the key "file" is missing; shape = "mesh" needs file, or frames', ())
        if table.file and table.frames:
            raise Rejected("not together with file", ("frames",))
        if table.frames and table.frame_time is None:
            raise Rejected('the key "frame_time" is missing; frames need it')
        if table.frame_time and not table.frames:
            raise Rejected("allowed with frames only", ("frame_time",))
        if table.frames and table.move:
            raise Rejected("frames do not go together with a move", ("move",))

    @classmethod
    def build(cls, values: dict[str, Any], **common: Any) -> Self:
        files = [values["file"]] if values["file"] else frame_files(values["frames"])
        bodies = [read_body(file, values["scale"]) for file in files]
        points, triangles = bodies[0]
        for file, (other, corners) in zip(files, bodies, strict=True):
            if other.shape != points.shape or not np.array_equal(corners, triangles):
                raise InputError(f"{file}: other triangles than {files[0]}; frames need the same")
            check_inside(other, corners.astype(np.int64), str(file))
        shifted = np.array([body[0] for body in bodies]) + values["translate"]
        body = distance_field(shifted[0], triangles, values["resolution"], str(files[0]))
        if values["frames"]:
            common["frames"] = Frames(shifted, values["frame_time"], body, str(files[-1]))
        return cls(**vars(body), **common)

    @classmethod
    def around(
        cls,
        points: Reals,
        triangles: Ints,
        resolution: float | None = None,
        source: str = "mesh",
        **common: Any,
    ) -> Self:
        """The body of points (n, 3) m and triangles (m, 3) from `source`; see `distance_field`."""
        return cls(**vars(distance_field(points, triangles, resolution, source)), **common)

    def surface(self, bounds: Reals) -> Triangles:
        return self.points, self.triangles

    def about(self) -> str:
        return (
            f"{len(self.triangles)} triangles as a smooth distance field: spacing {self.spacing:.3g} m, "
            f"largest error {self.measured:.2g} m" + (f"; {self.blurred}" if self.blurred else "")
        )
