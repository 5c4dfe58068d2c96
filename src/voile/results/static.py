"""What a result file holds once: the shell's mesh with its rest shape, and the obstacles' surfaces."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from voile.arrays import Array, Ints, Reals
from voile.mesh.frames import shape_between
from voile.results.fields import CELL_FIELDS, POINT_FIELDS, Field, find_field

VTK_TRIANGLE = 5
OBSTACLES = "voile/obstacles"


@dataclass(frozen=True)
class Body:
    """An obstacle as it is drawn: Coulomb's coefficient, surface points (n, 3) m at load factor 0, triangles (m, 3);
    frames (f, n, 3) m: points of one that deforms, at times 0, frame_time (s), ..."""

    name: str
    friction: float
    points: Reals
    triangles: Ints
    frames: Reals | None = None
    frame_time: float = 1.0

    def shape(self, value: float) -> Reals:
        """(n, 3) m before it is placed, at a step's time or load factor."""
        return self.points if self.frames is None else shape_between(self.frames, value, self.frame_time)


@dataclass(frozen=True)
class StaticMesh:
    """What does not change over the steps, in the input's order; needed on rank 0 only.

    start (n, 3) m; triangles (m, 3); rest (nr, 3) m, None = start; rest_triangles (m, 3) where the rest shape
    has its own vertices (seams of a flat panel), None = triangles; edges (e, 2) of the director angles, None
    = none; group (m,) with its names; point_data / cell_data: further fields of the table in `fields` that
    stay as they are; bodies: the obstacles.
    """

    start: Reals
    triangles: Ints
    rest: Reals | None = None
    rest_triangles: Ints | None = None
    edges: Ints | None = None
    group: Ints | None = None
    group_names: tuple[str, ...] = ()
    point_data: Mapping[str, Array] = field(default_factory=dict)
    cell_data: Mapping[str, Reals] = field(default_factory=dict)
    bodies: tuple[Body, ...] = ()


def static_datasets(mesh: StaticMesh) -> dict[str, Array]:
    """Datasets of the result file by path. Raises ValueError where sizes or names do not fit."""
    start = np.asarray(mesh.start, dtype=np.float64)
    triangles = np.asarray(mesh.triangles, dtype=np.int64)
    rest = start if mesh.rest is None else np.asarray(mesh.rest, dtype=np.float64)
    n, m = len(start), len(triangles)
    if mesh.rest_triangles is None and len(rest) != n:
        raise ValueError(
            f"{len(rest)} rest positions for {n} vertices: rest_triangles must say which belong where"
        )
    data = {
        "VTKHDF/NumberOfPoints": np.array([n]),
        "VTKHDF/NumberOfCells": np.array([m]),
        "VTKHDF/NumberOfConnectivityIds": np.array([3 * m]),
        "VTKHDF/Connectivity": triangles.ravel(),
        "VTKHDF/Offsets": np.arange(0, 3 * m + 1, 3),
        "VTKHDF/Types": np.full(m, VTK_TRIANGLE, dtype=np.uint8),
        "VTKHDF/PointData/start": start,
        "VTKHDF/PointData/rest": rest,
    }
    if mesh.rest_triangles is not None:
        data["voile/rest_points"] = rest
        data["voile/rest_triangles"] = np.asarray(mesh.rest_triangles, dtype=np.int64)
        data["VTKHDF/PointData/rest"] = at_vertices = np.empty((n, 3))
        at_vertices[triangles] = rest[mesh.rest_triangles]
    if mesh.edges is not None:
        data["voile/edges"] = np.asarray(mesh.edges, dtype=np.int64)
    cells = dict(mesh.cell_data) if mesh.group is None else {**mesh.cell_data, "group": mesh.group}
    for kind, table, count, extra in (
        ("Point", POINT_FIELDS, n, mesh.point_data),
        ("Cell", CELL_FIELDS, m, cells),
    ):
        for name, values in extra.items():
            spec = known(table, name)
            data[f"VTKHDF/{kind}Data/{name}"] = np.asarray(values, spec.dtype).reshape(count, *spec.row_shape)
    for k, body in enumerate(mesh.bodies):
        data[f"{OBSTACLES}/{k}/name"] = np.frombuffer(body.name.encode("utf-8"), dtype=np.uint8)
        data[f"{OBSTACLES}/{k}/friction"] = np.array(body.friction, dtype=np.float64)
        data[f"{OBSTACLES}/{k}/points"] = np.asarray(body.points, dtype=np.float64)
        data[f"{OBSTACLES}/{k}/triangles"] = np.asarray(body.triangles, dtype=np.int64)
        if body.frames is not None:  # for pictures: single precision will do
            data[f"{OBSTACLES}/{k}/frames"] = np.asarray(body.frames, dtype=np.float32).reshape(-1, 3)
            data[f"{OBSTACLES}/{k}/frame_time"] = np.array(body.frame_time, dtype=np.float64)
    return data


def known(table: Mapping[str, Field], name: str) -> Field:
    """The table's field of that name; ValueError names those there are."""
    field = find_field(table, name)
    if field is None:
        raise ValueError(f"no field {name!r} in results; known: {', '.join(table)}")
    return field
