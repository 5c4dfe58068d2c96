"""Targets as a designer draws them, with no simulation behind: strips, capes, hats, skirts, cushions and sleeves, held
or resting on bodies, of fabrics from limp to firm."""

from collections.abc import Callable

import numpy as np
from everyday import Everyday, Tables, _around, _given, cloth
from mesh_helpers import generator

LEAST, MOST = 100, 300  # vertices
LIMP = 0.02  # of the size: the least length over which a shell bends under its own weight
Drawn = tuple[str, np.ndarray, np.ndarray, Tables]  # words, points, triangles, supports and obstacles


def drawn(seed: int) -> Everyday:
    """The scene of a seed: six kinds in turn."""
    rng = np.random.default_rng([seed, 7])
    kind = list(KINDS)[seed % len(KINDS)]
    words, points, triangles, holds = KINDS[kind](rng, int(rng.integers(LEAST, MOST + 1)))
    size, young, thickness, density = np.linalg.norm(np.ptp(points, axis=0)), 0.0, 1.0, 1.0
    while (young * thickness**2 / (12 * 9.81 * density)) ** (1 / 3) < LIMP * size:
        young = 10 ** rng.uniform(4, 7)
        thickness = 1e-3 * np.exp(rng.uniform(np.log(0.3), np.log(2.0)))
        density = rng.uniform(150, 600)
    shell = {
        "mesh": "cloth.obj",
        "bending": "average",
        "young": _given(young),
        "thickness": _given(thickness),
        "density": _given(density),
    }
    scene = {"scene": {"task": "inverse"}, "shell": shell} | holds
    if "obstacle" in holds:
        scene["inverse"] = {"contact_tolerance": 0.003}
    return Everyday(f"{kind} {words}", scene, (points, triangles))


def _strip(rng: np.random.Generator, vertices: int) -> Drawn:
    """Clamped at one end, drawn as a line that bends in its plane, with a little twist."""
    length = rng.uniform(0.15, 0.5)
    width = length / rng.uniform(3, 8)
    flat, triangles = cloth(length, width, vertices, str(rng.choice(["alternating", "irregular"])))
    shape = str(rng.choice(["level", "arc down", "arc up", "wave", "curl"]))
    along = flat[:, 0] / length + 0.5
    turn = rng.uniform(0.5, 1.5)
    angle = {
        "level": lambda t: 0 * t,
        "arc down": lambda t: -turn * t,
        "arc up": lambda t: turn * t,
        "wave": lambda t: 0.6 * np.sin(2 * np.pi * t * turn),
        "curl": lambda t: -4.0 * turn * t**2,
    }[shape]
    t = np.linspace(0, 1, 2001)
    steps = np.column_stack([np.cos(angle(t)), np.sin(angle(t))])
    way = length / 2000 * (np.cumsum(steps, axis=0) - 0.5 * (steps + steps[:1]))
    x, y = (np.interp(along, t, way[:, axis]) for axis in (0, 1))
    twist = rng.uniform(-0.5, 0.5) * along**2
    points = np.column_stack([x, y + flat[:, 2] * np.sin(twist), flat[:, 2] * np.cos(twist)])
    return shape, points, triangles, {"fix": [{"select": {"box": _around([0.0, None, None])}, "clamp": True}]}


def _ring(rows: int, cells: int) -> tuple:
    """Row and column of the vertices of a closed tube of quads, and the quads' corners: upper two, lower two."""
    i, j = np.meshgrid(np.arange(rows + 1), np.arange(cells), indexing="ij")
    index, right = i * cells + j, i[:-1] * cells + (j[:-1] + 1) % cells
    return i, j, (index[:-1], right, index[1:], right + cells)


def _around_axis(rng: np.random.Generator, vertices: int, length: float, girth: float) -> tuple:
    """Share along (0 at the top) and angle of the vertices of a closed tube, and its triangles."""
    cells = max(8, 2 * round(0.5 * np.sqrt(vertices * girth / length)))
    rows = max(3, round(vertices / cells))
    i, j, (a, b, c, d) = _ring(rows, cells)
    odd = ((i[:-1] + j[:-1]) % 2).astype(bool)
    one = np.where(odd[..., None], np.stack([a, c, b], -1), np.stack([a, c, d], -1))
    two = np.where(odd[..., None], np.stack([b, c, d], -1), np.stack([a, d, b], -1))
    return i.ravel() / rows, 2 * np.pi * j.ravel() / cells, np.concatenate([one, two]).reshape(-1, 3)


def _open(share: np.ndarray, angle: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """The triangles of a tube that is cut open at its front."""
    gap = 0.25
    away = np.abs(np.angle(np.exp(1j * (angle - 0.5 * np.pi))))
    return triangles[(away[triangles] > gap).all(axis=1)]


def _used(points: np.ndarray, triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    kept, triangles = np.unique(triangles, return_inverse=True)
    return points[kept], triangles.reshape(-1, 3)


TORSO = [
    {"shape": "ellipsoid", "center": [0.0, 0.0, 0.0], "radii": [0.17, 0.30, 0.11]},
    {"shape": "capsule", "a": [-0.14, 0.20, 0.0], "b": [0.14, 0.20, 0.0], "radius": 0.06},
    {"shape": "capsule", "a": [0.0, 0.20, 0.0], "b": [0.0, 0.42, 0.0], "radius": 0.055},
]


def _on(points: np.ndarray, bodies: list[Tables], hover: np.ndarray) -> np.ndarray:
    """Points laid on the bodies where they are near or inside, `hover` (m) above them."""
    worn = generator("worn")
    return worn._lay_close(points, [worn._body(body) for body in bodies], hover)


def _friction(rng: np.random.Generator, bodies: list[Tables]) -> list[Tables]:
    mu = float(rng.choice([0.0, 0.1, 0.3, 0.6, 1.0]))
    return [body | {"friction": mu} for body in bodies]


def _cape(rng: np.random.Generator, vertices: int) -> Drawn:
    """A cone open at the front over the shoulders, with waves below; held at the neck, or by friction."""
    length = rng.uniform(0.2, 0.4)
    share, angle, triangles = _around_axis(rng, vertices, length, 1.4)
    slope, waves = rng.uniform(0.5, 0.9), int(rng.integers(4, 8))
    out = 0.062 + length * slope * share
    ripple = 1 + rng.uniform(0.0, 0.10) * share * np.cos(waves * angle)
    points = np.column_stack(
        [
            1.15 * out * ripple * np.cos(angle),
            0.285 - length * share * np.sqrt(1 - slope**2),
            out * ripple * np.sin(angle),
        ]
    )
    top = points[share == 0].mean(axis=0)[1]
    points, triangles = _used(points, _open(share, angle, triangles))
    hold = str(rng.choice(["held at the neck", "resting"]))
    points = _on(points, TORSO, rng.uniform(0.0, 0.001, len(points)))
    holds: Tables = {"obstacle": _friction(rng, TORSO)}
    if hold != "resting":
        neck = np.flatnonzero(points[:, 1] > top - 0.02).tolist()
        holds |= {"fix": [{"select": {"nodes": neck}}]}
    return hold, points, triangles, holds


HEAD = [{"shape": "ellipsoid", "center": [0.0, 0.0, 0.0], "radii": [0.078, 0.115, 0.098]}]


def _hat(rng: np.random.Generator, vertices: int) -> Drawn:
    """Flat panels: a crown of several around, a lid, a brim; on a head, touching around its band."""
    sides = int(rng.choice([5, 6, 8]))
    cells = sides * max(3, round(np.sqrt(vertices * 1.2) / sides))
    rows = max(6, round(vertices / cells))
    height, brim = rng.uniform(0.08, 0.14), rng.uniform(0.03, 0.07)
    low = 0.03
    band = np.sqrt(1 - (low / 0.115) ** 2)
    # a profile from the middle of the lid over the crown's edge to the brim's
    taper = rng.uniform(0.55, 0.85)
    corners = np.array(
        [[0.08, low + height], [taper, low + height], [1.0, low], [1.0 + brim / 0.085, low - 0.3 * brim]]
    )
    lengths = np.r_[0, np.cumsum(np.hypot(*(np.diff(corners, axis=0) * [0.085, 1]).T))]
    at = np.linspace(0, lengths[-1], rows + 1)
    for corner in lengths[1:-1]:
        at[np.abs(at - corner).argmin()] = corner
    radius, level = (np.interp(at, lengths, corners[:, k]) for k in (0, 1))
    i, j, (a, b, c, d) = _ring(rows, cells)
    angle = 2 * np.pi * j / cells
    # chords between the panels' seams: flat panels
    sector = 2 * np.pi / sides
    chord = np.cos(sector / 2) / np.cos((angle % sector) - sector / 2)
    r = radius[i] * np.where(i == rows, 1.0, chord / chord.max() * 1.02)
    points = np.stack(
        [0.0785 * band * r * np.cos(angle), level[i], 0.0985 * band * r * np.sin(angle)], -1
    ).reshape(-1, 3)
    triangles = np.concatenate([np.stack([a, b, c], -1), np.stack([b, d, c], -1)]).reshape(-1, 3)
    worn = generator("worn")
    bodies = [worn._body(body) for body in HEAD]
    gap, normal = worn._gap(points, bodies)
    inside = gap < 0.002
    moved = points - (gap - rng.uniform(0.0, 0.001, len(points)))[:, None] * normal
    points = np.where(inside[:, None], moved, points)
    return f"of {sides} panels", points, triangles, {"obstacle": _friction(rng, HEAD)}


def _skirt(rng: np.random.Generator, vertices: int) -> Drawn:
    """A flared tube with waves, held at its waist or on the hips of a cone by friction or its own shape."""
    length, top = rng.uniform(0.2, 0.45), 0.11
    share, angle, triangles = _around_axis(rng, vertices, length, 2 * np.pi * 0.2)
    flare, waves, depth = rng.uniform(0.2, 0.7), int(rng.integers(4, 9)), rng.uniform(0.0, 0.15)
    hold = str(rng.choice(["held at its waist", "on hips"]))
    start = 0.0 if hold != "on hips" else 0.06
    free = np.clip(share - start / length, 0, None)
    radius = top + flare * length * share
    radius = radius * (1 + depth * free * np.cos(waves * angle))
    points = np.column_stack([radius * np.cos(angle), -length * share, radius * np.sin(angle)])
    if hold != "on hips":
        return hold, points, triangles, {"fix": [{"select": {"box": _around([None, 0.0, None])}}]}
    body = [{"shape": "ellipsoid", "center": [0.0, -0.09, 0.0], "radii": [0.125, 0.19, 0.125]}]
    points = _on(points, body, rng.uniform(0.0, 0.001, len(points)))
    return hold, points, triangles, {"obstacle": _friction(rng, body)}


def _cushion(rng: np.random.Generator, vertices: int) -> Drawn:
    """A bulging rectangle: a dome on a table, or a canopy held at its rim or its corners."""
    length = rng.uniform(0.2, 0.5)
    width = length / rng.uniform(1, 1.6)
    flat, triangles = cloth(length, width, vertices, str(rng.choice(["alternating", "irregular"])))
    u, v = 2 * flat[:, 0] / length, 2 * flat[:, 2] / width
    hold = str(rng.choice(["on a table", "held at its rim", "held at its corners"]))
    height = rng.uniform(0.05, 0.3) * width * (1 if hold == "on a table" or rng.random() < 0.5 else -1)
    bulge = (
        np.cos(0.5 * np.pi * u) * np.cos(0.5 * np.pi * v)
        if "corners" not in hold
        else 1 - 0.5 * (u**2 + v**2)
    )
    points = flat + np.outer(height * bulge, [0.0, 1.0, 0.0])
    if hold == "on a table":
        table = [{"shape": "plane", "point": [0.0, -0.0005, 0.0], "normal": [0.0, 1.0, 0.0]}]
        return hold, points, triangles, {"obstacle": _friction(rng, table)}
    rim = np.maximum(np.abs(u), np.abs(v)) if "rim" in hold else np.minimum(np.abs(u), np.abs(v))
    nodes = np.flatnonzero(rim > 1 - 1e-6).tolist()
    return (
        f"{hold}, {'up' if height > 0 else 'down'}",
        points,
        triangles,
        {"fix": [{"select": {"nodes": nodes}}]},
    )


def _sleeve(rng: np.random.Generator, vertices: int) -> Drawn:
    """A tube on a level or sloping arm, off it below; held at one end, or by friction."""
    length, radius = rng.uniform(0.2, 0.4), rng.uniform(0.05, 0.07)
    share, angle, triangles = _around_axis(rng, vertices, length, 2 * np.pi * radius)
    flare = 1 + rng.uniform(0.0, 0.6) * share
    y = radius * flare * np.sin(angle)
    points = np.column_stack([length * share, y + 0.0405 - radius * flare, radius * flare * np.cos(angle)])
    tilt = rng.uniform(0.0, 0.6)
    turn = np.array([[np.cos(tilt), -np.sin(tilt), 0], [np.sin(tilt), np.cos(tilt), 0], [0, 0, 1]])
    points = points @ turn
    ends = np.array([[-0.1, 0, 0], [0.6, 0, 0]]) @ turn
    arm = [{"shape": "capsule", "a": ends[0].tolist(), "b": ends[1].tolist(), "radius": 0.04}]
    points = _on(
        points, arm, np.where(np.abs(angle - 0.5 * np.pi) < 1.0, rng.uniform(0.0, 0.001, len(points)), 0.0005)
    )
    hold = str(rng.choice(["held at one end", "resting"]))
    holds: Tables = {"obstacle": _friction(rng, arm)}
    if hold != "resting":
        holds |= {"fix": [{"select": {"nodes": np.flatnonzero(share == 0).tolist()}}]}
    return hold, points, triangles, holds


KINDS: dict[str, Callable[[np.random.Generator, int], Drawn]] = {
    "strip": _strip,
    "cape": _cape,
    "hat": _hat,
    "skirt": _skirt,
    "cushion": _cushion,
    "sleeve": _sleeve,
}
