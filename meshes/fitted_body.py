"""Body for a garment to be worn on: the union of all balls that fit inside it."""

import igl
import numpy as np
from patterns import command, positive

from voile.mesh import read_mesh

COVERED = 0.35  # share of the solid angle around a ball's centre that is cloth; 0.5 is level with an opening


def fitted_body(
    garment: str = "runs/skirt-on-form/skirt.obj",
    scale: float = 1.0,
    clearance: float = 0.0015,
    radius: float = 0.03,
    below: float = 0.1,
    slope: float = 0.3,
    size: float = 0.008,
) -> tuple[np.ndarray, np.ndarray]:
    """Closed body inside a garment (file, in metres times scale; y up), outward.

    Balls of `radius` (m) whose distance from the cloth is `clearance` (m) or more, so that what is narrower, folds and
    wrists, stays empty, and the body has no edges. From `below` (m) under the garment's highest point on, the clearance
    grows by `slope` per metre down. size: of the grid on which the body is found (m), about that of its triangles.
    """
    positive(scale=scale, clearance=clearance, radius=radius, size=size)
    if slope < 0:
        raise ValueError(f"slope = {slope}, allowed: 0 or more")
    surface = read_mesh(garment, scale)
    points, triangles = surface.points, np.ascontiguousarray(surface.triangles, dtype=np.int64)
    low, high = points.min(axis=0), points.max(axis=0)
    margin = radius + 2 * size
    axes = [np.arange(a, b + size, size) for a, b in zip(low - margin, high + margin, strict=True)]
    nodes = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).transpose(2, 1, 0, 3).reshape(-1, 3)
    # where a ball's centre may be: away from the cloth, inside it, and in its bounding box; negative there
    from_cloth = np.sqrt(igl.point_mesh_squared_distance(nodes, points, triangles)[0])
    near = radius + clearance + slope * np.maximum(high[1] - below - nodes[:, 1], 0.0) - from_cloth
    open_air = radius * (COVERED - np.abs(igl.fast_winding_number(points, triangles, nodes)))
    beyond = np.maximum(low - nodes, nodes - high).max(axis=1)
    counts = [len(axis) for axis in axes]
    centres, faces = _level(np.maximum.reduce([near, open_air, beyond]), nodes, counts)
    inside = igl.fast_winding_number(centres, faces, nodes) > 0.5
    away = np.sqrt(igl.point_mesh_squared_distance(nodes, centres, faces)[0])
    return _level(np.where(inside, -away, away) - radius, nodes, counts)


def _level(values: np.ndarray, nodes: np.ndarray, counts: list[int]) -> tuple[np.ndarray, np.ndarray]:
    """The largest connected surface (points, triangles) on which values at the nodes of a grid vanish, its normals away
    from where they are negative; counts along x, y and z, x runs first."""
    # a surface through a node would have triangles without area
    least = 0.01 * (nodes[1, 0] - nodes[0, 0])
    values = np.where(np.abs(values) < least, np.copysign(least, values), values)
    points, triangles, _ = igl.marching_cubes(values, nodes, *counts, 0.0)
    if not len(triangles):
        raise ValueError("no ball fits inside the garment, allowed: less radius or clearance")
    part = igl.facet_components(triangles)[1]
    return igl.remove_unreferenced(points, triangles[part == np.argmax(np.bincount(part))])[:2]


if __name__ == "__main__":
    command(fitted_body)
