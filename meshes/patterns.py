"""What the generators share: unstructured plane meshes (gmsh), spheres, the command line."""

import argparse
import inspect
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree

from voile.mesh import write_obj
from voile.mesh.grids import DIAGONALS, grid, rings


def cells(length: float, size: float) -> int:
    """Number of cells of about `size` along `length`, at least one."""
    return max(1, round(length / size))


def even(count: int) -> int:
    """The next even number: alternating diagonals close up around a ring only then."""
    return count + count % 2


def side(start: ArrayLike, end: ArrayLike, count: int) -> np.ndarray:
    """(count, 2) evenly spaced points from start on, the end left out."""
    return np.asarray(start) + np.outer(np.arange(count) / count, np.subtract(end, start))


def polygon(corners: Sequence[Sequence[float]], size: float) -> np.ndarray:
    """Closed polygon with straight sides in steps of about `size`: (k, 2)."""
    ends = [*corners[1:], corners[0]]
    return np.concatenate(
        [
            side(a, b, cells(float(np.hypot(*np.subtract(b, a))), size))
            for a, b in zip(corners, ends, strict=True)
        ]
    )


def meshed(mesh) -> tuple[np.ndarray, np.ndarray]:
    """Points (n, 3) and triangles (m, 3) of a mesh of gmsh's."""
    tags, coordinates, _ = mesh.getNodes()
    _, corners = mesh.getElementsByType(2)
    place = np.zeros(int(tags.max()) + 1, dtype=np.int64)
    place[tags.astype(np.int64)] = np.arange(len(tags))
    return coordinates.reshape(-1, 3), place[corners.astype(np.int64)].reshape(-1, 3)


def unstructured(loops: Sequence[np.ndarray], size: float | str) -> tuple[np.ndarray, np.ndarray]:
    """Irregular Delaunay mesh of a plane region: points (n, 2), counter-clockwise triangles (m, 3).

    loops: closed polygons (k, 2), the outline and then the holes; their vertices are the mesh's boundary
    vertices, so two sides given alike can be joined later. size: edge length, or its gmsh formula in x and y.
    """
    import gmsh

    gmsh.initialize(interruptible=False)
    try:
        gmsh.option.setNumber("General.Verbosity", 2)
        gmsh.option.setNumber("Mesh.MeshSizeExtendFromBoundary", 0)
        gmsh.option.setNumber("Mesh.Algorithm", 6)  # frontal Delaunay
        geometry = gmsh.model.geo
        curves = []
        for loop in loops:
            tags = [geometry.addPoint(x, y, 0.0) for x, y in loop]
            lines = [geometry.addLine(a, b) for a, b in zip(tags, tags[1:] + tags[:1], strict=True)]
            for line in lines:
                geometry.mesh.setTransfiniteCurve(line, 2)
            curves.append(geometry.addCurveLoop(lines))
        geometry.addPlaneSurface(curves)
        geometry.synchronize()
        field = gmsh.model.mesh.field
        formula = field.add("MathEval")
        field.setString(formula, "F", str(size))
        field.setAsBackgroundMesh(formula)
        gmsh.model.mesh.generate(2)
        points, triangles = meshed(gmsh.model.mesh)
    finally:
        gmsh.finalize()
    points = points[:, :2]
    a, b, c = (points[triangles[:, k]] for k in range(3))
    clockwise = np.linalg.det(np.stack([b - a, c - a], axis=1)) < 0
    triangles[clockwise] = triangles[clockwise][:, [0, 2, 1]]
    return points, triangles


def weld(points: np.ndarray, triangles: np.ndarray, tolerance: float) -> tuple[np.ndarray, np.ndarray]:
    """Join vertices nearer than `tolerance` to each other: points and triangles, renumbered."""
    target = np.arange(len(points))
    pairs = cKDTree(points).query_pairs(tolerance, output_type="ndarray")
    np.minimum.at(target, pairs.max(axis=1), pairs.min(axis=1))
    kept, number = np.unique(target, return_inverse=True)
    return points[kept], number[triangles]


def spherical(
    radius: float, inner: float, outer: float, sector: float, size: float, irregular: bool, diagonals: str
) -> tuple[np.ndarray, np.ndarray]:
    """Zone of a sphere about the z axis: points (n, 3), triangles (m, 3), outward; all angles in degrees.

    inner, outer: angles from the pole; sector: angle about the axis, 360 is closed. Irregular meshes are made
    in the stereographic plane, which keeps angles: the radius there is r = tan(angle / 2), and lengths are
    2 / (1 + r^2) times as large on the unit sphere.
    """
    low, high, turn = np.radians([inner, outer, sector])
    closed = sector == 360
    if not irregular and inner == 0 and closed:
        count = cells(radius * high, size)
        positions, triangles = rings([6 * k for k in range(count, 0, -1)] + [1])
        polar = np.repeat(high * np.arange(count, -1, -1) / count, [len(p) for p in positions])
        return _on_sphere(radius, polar, 2 * np.pi * np.concatenate(positions)), triangles
    if not irregular:
        if inner == 0:
            raise ValueError("a structured sector needs a hole: hole > 0, or sector = 360, or irregular")
        around = cells(radius * turn * np.sin((low + high) / 2), size)
        uv, triangles = grid(
            even(around) if closed else around, cells(radius * (high - low), size), diagonals
        )
        points = _on_sphere(radius, high + (low - high) * uv[:, 1], turn * uv[:, 0])
        return weld(points, triangles, 1e-6 * size) if closed else (points, triangles)

    loops = _outline(radius, low, high, turn, size)
    plane, triangles = unstructured(loops, f"{size / (2 * radius)!r} * (1 + x * x + y * y)")
    polar = 2 * np.arctan(np.hypot(*plane.T))
    return _on_sphere(radius, polar, np.arctan2(plane[:, 1], plane[:, 0])), triangles


def _outline(radius: float, low: float, high: float, turn: float, size: float) -> list[np.ndarray]:
    """Boundary of the zone in the stereographic plane, in steps of `size` on the sphere; radians."""

    def path(polar: tuple[float, float], around: tuple[float, float], length: float) -> np.ndarray:
        angle = side((polar[0], around[0]), (polar[1], around[1]), cells(length, size))
        return np.tan(angle[:, :1] / 2) * np.column_stack([np.cos(angle[:, 1]), np.sin(angle[:, 1])])

    outside = path((high, high), (0, turn), radius * np.sin(high) * turn)
    inside = path((low, low), (turn, 0), radius * np.sin(low) * turn) if low > 0 else np.zeros((0, 2))
    if turn == 2 * np.pi:
        return [outside, inside] if low > 0 else [outside]
    down = path((high, low), (turn, turn), radius * (high - low))
    up = path(
        (low, high), (0, 0), radius * (high - low)
    )  # begins with the pole itself where there is no hole
    return [np.concatenate([outside, down, inside, up])]


def _on_sphere(radius: float, polar: np.ndarray, around: np.ndarray) -> np.ndarray:
    return radius * np.column_stack(
        [np.sin(polar) * np.cos(around), np.sin(polar) * np.sin(around), np.cos(polar)]
    )


def command(build: Callable[..., tuple[np.ndarray, ...]]) -> None:
    """Command line of a generator: an option for each parameter of `build`, and the OBJ file to write."""
    parser = argparse.ArgumentParser(
        description=build.__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    for name, parameter in inspect.signature(build).parameters.items():
        option, default = "--" + name.replace("_", "-"), parameter.default
        kind: dict[str, Any] = {"action": "store_true"} if default is False else {"type": type(default)}
        if name == "diagonals":
            kind["choices"] = DIAGONALS
        parser.add_argument(option, default=default, help=f"default {default}", **kind)
    parser.add_argument("output", help="OBJ file to write; of frames a pattern such as body_%%03d.obj")
    options = vars(parser.parse_args())
    output = options.pop("output")
    try:
        mesh = build(**options)
        settings = ", ".join(f"{key} = {value}" for key, value in options.items())
        points, triangles = mesh[:2]
        texture, texture_triangles, groups = (*mesh[2:], None, None, None)[:3]
        comment = f"meshes/{build.__name__}.py: {settings}; metres"
        frames = points if points.ndim == 3 else [points]
        for k, shape in enumerate(frames):
            file = output % k if points.ndim == 3 else output
            write_obj(file, shape, triangles, texture, texture_triangles, groups, comment=comment)
    except (TypeError, ValueError) as error:
        parser.error(str(error))
    print(f"{output}: {len(frames[0])} vertices, {len(triangles)} triangles")


def positive(**values: float) -> None:
    """Raise ValueError for the first of the named lengths that is not positive."""
    for name, value in values.items():
        if not value > 0:
            raise ValueError(f"{name} = {value}, allowed: a positive number")
