"""What the mesh tests share: small files, areas, normals, loops, and the generators of meshes/."""

import importlib
import sys
from pathlib import Path
from types import ModuleType

import numpy as np

from voile.contact.obstacles import Box
from voile.mesh import Surface, boundary_loops, build_topology

GENERATORS = Path(__file__).parents[1] / "meshes"
SQUARE = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n"
SQUARE_POINTS = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], dtype=float)


def obj(folder: Path, text: str, name: str = "mesh.obj") -> Path:
    path = folder / name
    path.write_text(text)
    return path


def normals(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """(m, 3) normals, twice the area long."""
    a, b, c = (points[triangles[:, i]] for i in range(3))
    return np.cross(b - a, c - a)


def areas(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    return np.linalg.norm(normals(points, triangles), axis=1) / 2


def loops_of(surface: Surface) -> list[np.ndarray]:
    return boundary_loops(surface.triangles, build_topology(surface.triangles), surface.points)


def generator(name: str) -> ModuleType:
    """A module of meshes/, whose programs import each other by their bare names."""
    sys.path.insert(0, str(GENERATORS))
    try:
        return importlib.import_module(name)
    finally:
        sys.path.remove(str(GENERATORS))


def plate_mesh(side: float, thickness: float) -> tuple[np.ndarray, np.ndarray]:
    """Of 12 triangles, around y = 0."""
    points, triangles = Box(center=np.zeros(3), sizes=0.5 * np.array([side, thickness, side])).surface(
        np.zeros((2, 3))
    )
    points, place = np.unique(np.round(points, 12), axis=0, return_inverse=True)
    return points, place.ravel()[triangles]
