"""Fold angles of a triangle mesh in space, and hinges that have passed 180 degrees, from positions alone."""

import numpy as np

from voile.mesh import build_topology


def fold_angles(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """(k,) signed angles in (-pi, pi] between the normals at the inner edges, 0 where flat, in a fixed order."""
    across = build_topology(triangles).across
    inner = across.ravel() > np.arange(across.size)  # each edge once
    return _folds(points, np.asarray(triangles), across).ravel()[inner]


def crossings(before: np.ndarray, after: np.ndarray) -> int:
    """Hinges whose fold angles of two shapes, one after the other, lie nearer by way of 180 degrees than of 0."""
    return int((np.abs(after - before) > np.pi).sum())


def inside_out(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Inner vertices around which an odd number of hinges has passed 180 degrees since the sheet was flat.

    A walk once around a vertex turns by the corners about the normals and by the fold angles about the edges, and ends
    as it began: a rotation by 0 or by 2 pi, +1 or -1 as quaternions. It is -1 where the sheet is flat. Bending does not
    change it; a hinge that passes 180 degrees changes it at both its ends.
    """
    t = np.asarray(triangles, dtype=np.int64)
    across = build_topology(t).across
    first, second = (_unit(points[np.roll(t, -k, axis=1)] - points[t]) for k in (1, 2))
    corner = np.arctan2(np.linalg.norm(np.cross(first, second), axis=2), (first * second).sum(axis=2))
    # From corner k one leaves the triangle by the edge to corner k + 2, which is opposite corner k + 1.
    fold = np.roll(_folds(points, t, across), -1, axis=1)
    wrong = []
    for vertex, fan in _fans(t, across).items():
        turn = np.eye(2, dtype=complex)
        for triangle, k in fan:
            turn = turn @ _about_z(corner[triangle, k]) @ _about_x(fold[triangle, k])
        if turn[0, 0].real > 0.0:
            wrong.append(vertex)
    return np.array(sorted(wrong), dtype=np.int64)


def _folds(points: np.ndarray, t: np.ndarray, across: np.ndarray) -> np.ndarray:
    """(m, 3) fold angles at the edges opposite the corners, 0 on the boundary."""
    a, b, c = (points[t[:, k]] for k in range(3))
    normal = _unit(np.cross(b - a, c - a))[:, None]
    edge = _unit(np.stack([c - b, a - c, b - a], axis=1))
    beyond = normal[across // 3, 0]
    angle = np.arctan2((np.cross(normal, beyond) * edge).sum(axis=2), (normal * beyond).sum(axis=2))
    return np.where(across < 0, 0.0, angle)


def _fans(t: np.ndarray, across: np.ndarray) -> dict[int, list[tuple[int, int]]]:
    """Per inner vertex the triangles around it in order, each with the vertex's corner in it."""
    open_edges = np.argwhere(across < 0)
    rim = {int(t[triangle, (k + j) % 3]) for triangle, k in open_edges for j in (1, 2)}
    fans: dict[int, list[tuple[int, int]]] = {}
    for start, vertex in enumerate(t.ravel().tolist()):
        if vertex in rim or vertex in fans:
            continue
        fan, here = [], start
        while not fan or here != start:
            triangle, k = divmod(here, 3)
            fan.append((triangle, k))
            beyond = int(across[triangle, (k + 1) % 3])
            here = 3 * (beyond // 3) + (beyond + 1) % 3
        fans[vertex] = fan
    return fans


def _about_z(angle: float) -> np.ndarray:
    """Rotation as a matrix of SU(2), as below."""
    return np.diag(np.exp([-0.5j * angle, 0.5j * angle]))


def _about_x(angle: float) -> np.ndarray:
    c, s = np.cos(angle / 2), -1j * np.sin(angle / 2)
    return np.array([[c, s], [s, c]])


def _unit(v: np.ndarray) -> np.ndarray:
    return v / np.linalg.norm(v, axis=-1, keepdims=True)
