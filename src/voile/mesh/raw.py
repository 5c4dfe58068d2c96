"""A mesh as its file says it, before any check or repair."""

from dataclasses import dataclass, field

import numpy as np

from voile.arrays import Ints, Reals

# m: areas squared of larger and smaller ones are near the ends of double precision.
LARGEST, SMALLEST = 1e30, 1e-30


@dataclass(eq=False)
class RawMesh:
    """What a reader found; vertices and triangles are counted from 0 in the file's order.

    points (n, 3) float64; triangles (m, 3) int64; group (m,) int32 index into group_names;
    texture (nt, 2) with texture_triangles (m, 3), both None where the file has none;
    stitch_vertices (s, 3) int64 (slave, first, second) and stitch_weight (s,);
    vertex_groups: vertices (k,) of named points and lines;
    point_lines (n,), triangle_lines (m,), stitch_lines (s,): line numbers from 1 in a text file, else None.
    """

    source: str
    points: Reals
    triangles: Ints
    group: Ints
    group_names: tuple[str, ...]
    texture: Reals | None = None
    texture_triangles: Ints | None = None
    stitch_vertices: Ints | None = None
    stitch_weight: Reals | None = None
    point_lines: Ints | None = None
    triangle_lines: Ints | None = None
    stitch_lines: Ints | None = None
    vertex_groups: dict[str, Ints] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    in_metres: bool = False  # the file says so: no scale applies
    polygons: int = 0  # faces of more than three corners

    def __str__(self) -> str:
        return self.source

    def vertex(self, index: int) -> str:
        """Name of a vertex in a message."""
        return f"vertex {index}" + _line(self.point_lines, index)

    def triangle(self, index: int) -> str:
        """Name of a triangle in a message."""
        corners = ", ".join(str(v) for v in self.triangles[index])
        return f"triangle {index} (vertices {corners})" + _line(self.triangle_lines, index)

    def stitch(self, index: int) -> str:
        """Name of a stitch record in a message."""
        return f"stitch {index}" + _line(self.stitch_lines, index)


def mesh_of_arrays(points: Reals, triangles: Ints) -> RawMesh:
    """The mesh of points (n, 2 or 3) and triangles (m, 3), vertices counted from 0. Raises ValueError for others."""
    if np.iscomplexobj(points):
        raise ValueError("points are complex; real numbers expected")
    points = np.array(points, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] not in (2, 3):
        raise ValueError(f"points of shape {points.shape}; (n, 3) expected")
    corners = np.asarray(triangles)
    if corners.ndim != 2 or corners.shape[1] != 3 or corners.dtype.kind not in "iu":
        raise ValueError(f"triangles of shape {corners.shape}, {corners.dtype}; (m, 3) integers expected")
    points = np.column_stack([points, np.zeros((len(points), 3 - points.shape[1]))])
    group = np.zeros(len(corners), dtype=np.int32)
    return RawMesh("mesh of arrays", points, corners.astype(np.int64), group, ("default",))


def _line(lines: Ints | None, index: int) -> str:
    return "" if lines is None else f" in line {lines[index]}"


def fan(corners: Ints) -> tuple[Ints, Ints]:
    """Fan triangulation of polygons with `corners` (p,) >= 3 corners each, stored one after the other.

    Returns (m, 3) positions in that storage and (m,) the polygon of each triangle.
    """
    pieces = corners - 2
    polygon = np.repeat(np.arange(len(corners)), pieces)
    start = (np.cumsum(corners) - corners)[polygon]
    step = np.arange(len(polygon)) - (np.cumsum(pieces) - pieces)[polygon] + 1
    return np.column_stack([start, start + step, start + step + 1]), polygon
