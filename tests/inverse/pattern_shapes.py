"""Shapes to cut and lay flat: lengths in metres."""

import numpy as np
from mesh_helpers import generator

patterns = generator("patterns")


def skirt(**sizes):
    """A cone's points and triangles: developable exactly, its triangles are those of a prismatic cone."""
    return generator("skirt").skirt(size=0.05, **sizes)[:2]


def gores(points: np.ndarray, triangles: np.ndarray) -> tuple[np.ndarray, tuple[str, ...]]:
    """Four panels around the y axis; seams at 45 degrees from the axes."""
    x, _, z = points[triangles].mean(axis=1).T
    around = (np.arctan2(x, z) + np.pi / 4) / (np.pi / 2)
    return np.floor(around).astype(int) % 4, ("front", "left", "back", "right")


def hat() -> tuple[np.ndarray, np.ndarray, tuple[np.ndarray, tuple[str, ...]]]:
    """A hemisphere of radius 0.1 m and a plane brim of the same ring of vertices, with their groups."""
    points, crown = generator("hemisphere").hemisphere(radius=0.1, hole=0.0, size=0.02)
    rim = np.flatnonzero(abs(points[:, 2]) < 1e-12)
    rim = rim[np.argsort(np.arctan2(points[rim, 1], points[rim, 0]))]
    n, around = len(rim), np.roll(np.arange(len(rim)), -1)
    outer = len(points) + np.arange(n)
    brim = np.concatenate(
        [np.column_stack([rim, outer, rim[around]]), np.column_stack([rim[around], outer, outer[around]])]
    )
    group = np.repeat([0, 1], [len(crown), len(brim)])
    return (
        np.concatenate([points, 1.6 * points[rim]]),
        np.concatenate([crown, brim]),
        (group, ("crown", "brim")),
    )


def torus() -> tuple[np.ndarray, np.ndarray]:
    uv, triangles = patterns.grid(16, 8)
    a, b = 2 * np.pi * uv.T
    points = np.column_stack([(3 + np.cos(b)) * np.cos(a), (3 + np.cos(b)) * np.sin(a), np.sin(b)])
    return patterns.weld(points, triangles, 1e-6)


def octahedron() -> tuple[np.ndarray, np.ndarray]:
    points = np.concatenate([np.eye(3), -np.eye(3)])
    return points, np.array(
        [[0, 1, 2], [1, 3, 2], [3, 4, 2], [4, 0, 2], [1, 0, 5], [3, 1, 5], [4, 3, 5], [0, 4, 5]]
    )


def cylinder():
    return generator("cylinder").cylinder(radius=0.2, length=0.5, sector=150.0, size=0.04)[:2]


def t_shirt() -> tuple[np.ndarray, np.ndarray, tuple[np.ndarray, tuple[str, ...]]]:
    """Front and back in cells of 0.1 m, sewn at shoulders and along sleeves and sides, lying flat on each other.

    Body of 6 x 6 cells, sleeves of 3 x 2 beside its upper end, a neck hole 2 cells wide.
    """
    uv, triangles = patterns.grid(12, 6)
    x, y = 12 * uv[:, 0] - 6, 6 * uv[:, 1]
    middle_x, middle_y = (v[triangles].mean(axis=1) for v in (x, y))
    shape = triangles[(abs(middle_x) < 3) | (middle_y > 4)]
    sewn = (abs(y - 6) < 1e-9) & (abs(x) > 0.9)  # shoulders
    sewn |= (abs(abs(x) - 3) < 1e-9) & (y < 4.1)  # sides
    sewn |= (abs(y - 4) < 1e-9) & (abs(x) > 2.9)  # under the sleeves
    n = len(x)
    back = np.where(sewn, np.arange(n), n + np.arange(n))
    flat = 0.1 * np.column_stack([x, y, np.zeros(n)])
    points, both = np.concatenate([flat, flat]), np.concatenate([shape, back[shape][:, ::-1]])
    used, both = np.unique(both, return_inverse=True)
    group = np.repeat([0, 1], len(shape))
    return points[used], both.reshape(-1, 3), (group, ("front", "back"))


def ramp() -> tuple[np.ndarray, np.ndarray]:
    """A ramp around an axis of more than a full turn: nearly flat, but one end over the other."""
    uv, triangles = patterns.grid(40, 2)
    turn, radius = np.radians(420) * uv[:, 0], 1 + uv[:, 1]
    return np.column_stack([radius * np.cos(turn), 0.01 * turn, radius * np.sin(turn)]), triangles[:, ::-1]
