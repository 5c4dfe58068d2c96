"""A hat, a sock and a T-shirt on a head, a foot and a torso, as a designer models them, with no simulation behind."""

from collections.abc import Callable

import gmsh
import igl
import numpy as np
from patterns import command, meshed, positive

from voile.contact import obstacles

Opening = tuple  # centre (3,) and normal (3,) of a flat face, its half widths: one, or along x, y, z
BODIES: dict[str, list[dict]] = {  # keys of a scene's [[obstacle]]
    "hat": [{"shape": "ellipsoid", "center": [0.0, 0.0, 0.0], "radii": [0.078, 0.115, 0.098]}],
    "sock": [
        {"shape": "capsule", "a": [0.0, 0.06, 0.0], "b": [0.0, 0.40, -0.02], "radius": 0.040},
        {"shape": "capsule", "a": [0.0, 0.045, 0.0], "b": [0.0, 0.034, 0.15], "radius": 0.034},
        {"shape": "sphere", "center": [0.0, 0.042, -0.012], "radius": 0.040},
    ],
    "t-shirt": [
        {"shape": "ellipsoid", "center": [0.0, 0.0, 0.0], "radii": [0.17, 0.30, 0.11]},
        {"shape": "capsule", "a": [-0.14, 0.22, 0.0], "b": [0.14, 0.22, 0.0], "radius": 0.060},
        {"shape": "capsule", "a": [0.15, 0.22, 0.0], "b": [0.36, 0.08, 0.01], "radius": 0.045},
        {"shape": "capsule", "a": [-0.15, 0.22, 0.0], "b": [-0.36, 0.08, 0.01], "radius": 0.045},
        {"shape": "capsule", "a": [0.0, 0.20, 0.0], "b": [0.0, 0.42, 0.02], "radius": 0.055},
    ],
}
ROUNDING = 0.004  # m, of the body's creases as cloth spans them
NEAR = 0.020  # m, within which cloth lies close to the body
FAR = 0.2  # m, more than any half width of an opening in the sock


def worn(
    garment: str = "hat",
    size: float = 0.012,
    folds: float = 1.0,
    hover: float = 0.0015,
    sunk: float = 0.0002,
    noise: float = 0.0,
    seed: int = 1,
) -> tuple:
    """The garment (hat, sock or t-shirt) on its body (BODIES), irregular triangles of about `size` m, normals outward.

    Where it lies close, vertices are between `sunk` (m) inside the body and `hover` (m) off it; folds scales the waves
    of what stands off; noise (m) is the deviation of every vertex's random shift.
    """
    positive(size=size)
    if garment not in BODIES:
        raise ValueError(f"garment = {garment!r}, allowed: {', '.join(BODIES)}")
    build, openings, wave = GARMENTS[garment]
    points, triangles = _mesh(build, openings, size)
    random = np.random.default_rng(seed)
    bodies = [_body(spec) for spec in BODIES[garment]]
    points = _lay_close(points, bodies, random.uniform(-sunk, hover, len(points)))
    points = points + folds * wave(points)
    triangles, _ = igl.bfs_orient(triangles)
    a, b, c = (points[triangles[:, k]] for k in range(3))
    outward = np.einsum("ti,ti->t", np.cross(b - a, c - a), _gap((a + b + c) / 3.0, bodies)[1])
    if outward.sum() < 0.0:
        triangles = triangles[:, ::-1]
    return points + noise * random.standard_normal(points.shape), np.ascontiguousarray(triangles)


def _body(spec: dict) -> obstacles.Obstacle:
    keys = {key: value for key, value in spec.items() if key != "shape"}
    return getattr(obstacles, spec["shape"].capitalize())(
        **{key: np.array(value) if isinstance(value, list) else value for key, value in keys.items()}
    )


def _gap(points: np.ndarray, bodies: list) -> tuple[np.ndarray, np.ndarray]:
    """Distance (n,) to the bodies' union, its creases rounded, and its gradient (n, 3)."""
    gaps, slopes = zip(*(body.gap_derivatives(points, 0.0)[:2] for body in bodies), strict=True)
    least = np.min(gaps, axis=0)
    share = np.exp((least - np.array(gaps)) / ROUNDING)
    total = share.sum(axis=0)
    return least - ROUNDING * np.log(total), np.einsum("bn,bni->ni", share / total, np.array(slopes))


def _lay_close(points: np.ndarray, bodies: list, clearance: np.ndarray) -> np.ndarray:
    """Points that are near the body at their clearance (n,) m from it, those farther away where they are."""
    gap = _gap(points, bodies)[0]
    away = np.clip(gap / NEAR, 0.0, 1.0)
    away = away**2 * (3.0 - 2.0 * away)
    wanted = away * gap + (1.0 - away) * clearance
    for _ in range(20):
        gap, slope = _gap(points, bodies)
        points = points + ((wanted - gap) / np.einsum("ni,ni->n", slope, slope))[:, None] * slope
    return points


def _mesh(build: Callable, openings: list[Opening], size: float) -> tuple[np.ndarray, np.ndarray]:
    """The surface of a solid of gmsh's, without the faces in its openings."""
    gmsh.initialize(interruptible=False)
    try:
        gmsh.option.setNumber("General.Verbosity", 2)
        gmsh.option.setNumber("Mesh.MeshSizeMin", size)
        gmsh.option.setNumber("Mesh.MeshSizeMax", size)
        build(gmsh.model.occ)
        gmsh.model.occ.synchronize()
        gmsh.model.mesh.generate(2)
        points, triangles = meshed(gmsh.model.mesh)
    finally:
        gmsh.finalize()
    for centre, normal, reach in openings:
        away = (points - centre) / reach
        inside = (np.abs((points - centre) @ normal) < 1e-6) & (np.linalg.norm(away, axis=1) < 1.01)
        triangles = triangles[~inside[triangles].all(axis=1)]
    used, triangles = np.unique(triangles, return_inverse=True)
    return points[used], triangles.reshape(-1, 3)


def _hat(occ) -> None:
    """Crown: the upper head; brim: an oval ring at its edge."""
    head = occ.addSphere(0.0, 0.0, 0.0, 1.0)
    occ.rotate([(3, head)], 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, -np.pi / 2.0)  # its pole up
    occ.dilate([(3, head)], 0.0, 0.0, 0.0, 0.0795, 0.1165, 0.0995)
    lower = occ.addBox(-1.0, -1.0, -1.0, 2.0, 1.0 + BRIM, 2.0)
    crown, _ = occ.cut([(3, head)], [(3, lower)])
    disk = occ.addDisk(0.0, BRIM, 0.0, 0.16, 0.14, zAxis=[0.0, 1.0, 0.0], xAxis=[0.0, 0.0, 1.0])
    occ.fragment(crown, [(2, disk)])


BRIM = 0.035  # m, its height over the middle of the head
BAND = np.sqrt(1.0 - (BRIM / 0.1165) ** 2)  # of the head's half widths


def _hat_wave(points: np.ndarray) -> np.ndarray:
    """The brim slopes down and waves; its way is smooth at the crown."""
    x, _, z = points.T
    out = np.clip(np.hypot(x / 0.0755, z / 0.0945) - 1.0, 0.0, None)
    turn = np.arctan2(x, z)
    lift = np.zeros_like(points)
    lift[:, 1] = out**1.5 * (0.012 * np.cos(5.0 * turn) - 0.010) - 0.012 * out
    return np.where((points[:, 1] < BRIM + 0.02)[:, None], lift, 0.0)


def _sock(occ) -> None:
    leg = occ.addCylinder(0.0, 0.06, 0.0, 0.0, 0.16, -0.0094, 0.0415)
    foot = occ.addCylinder(0.0, 0.045, 0.0, 0.0, -0.011, 0.15, 0.0355)
    toe = occ.addSphere(0.0, 0.034, 0.15, 0.0355)
    heel = occ.addSphere(0.0, 0.042, -0.012, 0.0415)
    ankle = occ.addSphere(0.0, 0.06, 0.0, 0.0415)
    occ.fuse([(3, leg)], [(3, foot), (3, toe), (3, heel), (3, ankle)])


def _sock_wave(points: np.ndarray) -> np.ndarray:
    """Rings where the leg has slipped down, growing to the cuff."""
    _, y, _ = points.T
    out = points * [1.0, 0.0, 1.0]
    out /= np.maximum(np.linalg.norm(out, axis=1), 1e-3)[:, None]
    high = np.clip((y - 0.12) / 0.10, 0.0, 1.0)
    return (high**2 * (0.004 + 0.003 * np.cos(2.0 * np.pi * y / 0.035)))[:, None] * out


def _t_shirt(occ) -> None:
    """Chest, a tube below it, shoulders, sleeves, collar."""
    torso = occ.addSphere(0.0, 0.0, 0.0, 1.0)
    occ.rotate([(3, torso)], 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, -np.pi / 2.0)
    occ.dilate([(3, torso)], 0.0, 0.0, 0.0, 0.172, 0.302, 0.112)
    tube = occ.addCylinder(0.0, HEM, 0.0, 0.0, -HEM, 0.0, 1.0)
    occ.dilate([(3, tube)], 0.0, 0.0, 0.0, 0.172, 1.0, 0.112)
    below = occ.addBox(-1.0, -2.0, -1.0, 2.0, 2.0, 2.0)
    chest, _ = occ.cut([(3, torso)], [(3, below)])
    parts = [(3, tube), (3, occ.addCylinder(0.0, 0.20, 0.0, 0.0, 0.13, 0.0118, 0.0575))]
    for side in (1.0, -1.0):
        parts.append((3, occ.addCylinder(0.0, 0.225, 0.0, side * 0.13, 0.0, 0.0, 0.064)))
        parts.append((3, occ.addSphere(side * 0.13, 0.222, 0.0, 0.068)))
        parts.append((3, occ.addCylinder(side * 0.12, 0.24, 0.0, side * 0.177, -0.118, 0.007, 0.056)))
    occ.fuse(chest, parts)


HEM = -0.25  # m


def _t_shirt_wave(points: np.ndarray) -> np.ndarray:
    """Folds from the chest down, twelve around the hem, which flares."""
    x, y, z = points.T
    turn = np.arctan2(x / 0.17, z / 0.11)
    low = np.clip((0.08 - y) / 0.33, 0.0, 1.0) * (np.hypot(x / 0.172, z / 0.112) > 0.7)
    low *= np.hypot(x, z) < 0.25
    out = np.column_stack([np.sin(turn), np.zeros_like(turn), np.cos(turn)])
    return (low**1.5 * (0.02 + 0.012 * np.cos(12.0 * turn)))[:, None] * out


SLEEVE = np.array([0.177, -0.118, 0.007]) / np.linalg.norm([0.177, -0.118, 0.007])
MIRROR = np.array([-1.0, 1.0, 1.0])
GARMENTS: dict[str, tuple] = {
    "hat": (_hat, [((0.0, BRIM, 0.0), (0.0, 1.0, 0.0), [0.0795 * BAND, 1.0, 0.0995 * BAND])], _hat_wave),
    "sock": (_sock, [((0.0, 0.22, -0.0094), (0.0, 0.16 / 0.16028, -0.0094 / 0.16028), FAR)], _sock_wave),
    "t-shirt": (
        _t_shirt,
        [
            ((0.0, HEM, 0.0), (0.0, 1.0, 0.0), 2.0 * FAR),
            ((0.297, 0.122, 0.007), SLEEVE, 0.07),
            ((-0.297, 0.122, 0.007), SLEEVE * MIRROR, 0.07),
            ((0.0, 0.33, 0.0118), (0.0, 0.13 / 0.13053, 0.0118 / 0.13053), 0.07),
        ],
        _t_shirt_wave,
    ),
}

if __name__ == "__main__":
    command(worn)
