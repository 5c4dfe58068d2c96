"""Everyday scenes: strips, sheets and tablecloths over plane, ball, box and drum, as a new user would write them."""

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from mesh_helpers import generator

from voile.mesh import write_obj

HOLDS = ("free", "edge", "corner", "both edges")
MESHES = ("alternating", "right", "irregular")
LEAST, MOST = 48, 575  # vertices
MOVED = 0.4  # of the scenes with supports
NEAR = 1e-6  # m, around what a box selects
Mesh = tuple[np.ndarray, np.ndarray]
Tables = dict[str, Any]


@dataclass(frozen=True)
class Everyday:
    """scene: tables and keys of a scene file; mesh: points (n, 3) in m, y up, and triangles (m, 3)."""

    name: str
    scene: Tables
    mesh: Mesh

    @property
    def held(self) -> bool:
        return bool(self.scene.get("fix"))

    def write(self, folder: Path) -> Path:
        """The scene file, with its mesh beside it."""
        write_obj(folder / "cloth.obj", *self.mesh)
        path = folder / "scene.toml"
        path.write_text(toml(self.scene))
        return path


def toml(scene: Tables) -> str:
    """Text of a scene file: tables, arrays of tables, keys."""
    lines = []
    for name, table in scene.items():
        for one in table if isinstance(table, list) else [table]:
            lines.append(f"[[{name}]]" if isinstance(table, list) else f"[{name}]")
            lines += [f"{key} = {_value(value)}" for key, value in one.items()]
    return "\n".join(lines) + "\n"


def _value(value: Any) -> str:
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{key} = {_value(inner)}" for key, inner in value.items()) + " }"
    return json.dumps(value)


# ---- scenes ----


def everyday(seed: int) -> Everyday:
    """The scene of a seed. Sixteen seeds in a row have every pair of obstacle and hold; the rest is random."""
    rng = np.random.default_rng(seed)
    obstacle, hold = list(OBSTACLES)[seed % 4], HOLDS[seed // 4 % 4]
    kind = str(rng.choice(["strip", "sheet", "tablecloth"]))
    length = _given(rng.uniform(*((0.6, 1.2) if kind == "tablecloth" else (0.25, 0.6))))
    ratio = {"strip": rng.uniform(4, 8), "sheet": rng.uniform(1, 2), "tablecloth": 1.0}[kind]
    width = _given(length / ratio)
    pattern = str(rng.choice(MESHES))
    mesh = cloth(length, width, int(rng.integers(LEAST, MOST + 1)), pattern)
    shell = {
        "mesh": "cloth.obj",
        "young": _given(10 ** rng.uniform(5, 8)),
        "thickness": _given(1e-3 * np.exp(rng.uniform(np.log(0.3), np.log(2.0)))),
        "density": _given(rng.uniform(150, 1000)),
    }
    fixes, moved = supports(rng, hold, length, width)
    # A cloth that nothing holds lies just above its obstacle; one that is held is there to sag on it.
    below = _given(
        length * np.exp(rng.uniform(np.log(0.01), np.log(0.25))) if fixes else rng.uniform(0.002, 0.02)
    )
    friction = 0.0 if rng.random() < 0.15 else _given(rng.uniform(0, 1))
    tilt = 0.0 if moved or obstacle != "plane" or rng.random() < 0.5 else rng.uniform(2, 25)
    body = OBSTACLES[obstacle](rng, length, width, below, np.radians(tilt))
    scene = {"shell": shell, "obstacle": [{**body, "friction": friction}]}
    scene |= {"fix": fixes} if fixes else {}
    words = [kind, pattern, hold if fixes else "free", "over", obstacle]
    words += ["moved"] if moved else [f"at {tilt:.0f} degrees"] if tilt else []
    return Everyday(" ".join(words), scene, mesh)


def _given(value: float) -> float:
    """A number as one would type it."""
    return float(f"{value:.3g}")


def cloth(length: float, width: float, vertices: int, pattern: str) -> Mesh:
    """Horizontal rectangle about the origin, along x and z, of about so many vertices between LEAST and MOST."""
    size = (length * width / vertices) ** 0.5
    while True:
        mesh = sheet(length, width, size, pattern)
        if LEAST <= len(mesh[0]) <= MOST:
            return mesh
        size *= 1.05 if len(mesh[0]) > MOST else 0.95


def sheet(length: float, width: float, size: float, pattern: str = "alternating") -> Mesh:
    """The same in triangles of a size (m)."""
    shape = {"irregular": True} if pattern == "irregular" else {"diagonals": pattern}
    points, triangles = generator("plate").plate(length, width, size, **shape)
    x, y = (points[:, :2] - [length / 2, width / 2]).T
    return np.column_stack([x, 0 * x, -y]), np.asarray(triangles)


def supports(rng: np.random.Generator, hold: str, length: float, width: float) -> tuple[list[Tables], bool]:
    """The [[fix]] tables, and whether one of them moves."""
    left = _around([-length / 2, None, None])
    right = _around([length / 2, None, None])
    corner = _around([-length / 2, None, -width / 2])
    fixes = [
        {"select": {"box": box}}
        for box in {"free": [], "edge": [left], "corner": [corner], "both edges": [left, right]}[hold]
    ]
    if "edge" in hold and rng.random() < 0.35:
        for fix in fixes:
            fix["clamp"] = True
    if not fixes or rng.random() > MOVED:
        return fixes, False
    # Sideways or up, so that no support is led through an obstacle; two edges towards or past each other.
    share = rng.uniform(0.1, 0.5)
    way = (
        rng.uniform([-1.0, 0.0, -1.0], 1.0)
        if hold != "both edges"
        else rng.uniform([-1, 0, -0.3], [0, 0.5, 0.3])
    )
    step = share * length * way / np.linalg.norm(way)
    fixes[-1]["move"] = {"displacement": [_given(part) for part in step]}
    return fixes, True


def _around(place: list[float | None]) -> list[list[float]]:
    """A box around what has these coordinates, None: any."""
    return [[side * 9.0 if c is None else round(c + side * NEAR, 9) for c in place] for side in (-1, 1)]


def _plane(rng, length: float, width: float, below: float, tilt: float) -> Tables:
    """Under the lowest point of the sheet, or sloping down along x."""
    fall = 0.5 * length * np.tan(tilt)
    normal = [_given(np.sin(tilt)), _given(np.cos(tilt)), 0.0]
    return {"shape": "plane", "point": [0.0, _given(-below - fall), 0.0], "normal": normal}


def _ball(rng, length: float, width: float, below: float, tilt: float) -> Tables:
    radius = _given(rng.uniform(0.15, 0.4) * length)
    return {"shape": "sphere", "center": _under(rng, length, width, -below - radius), "radius": radius}


def _box(rng, length: float, width: float, below: float, tilt: float) -> Tables:
    sizes = [_given(part) for part in rng.uniform(0.15, 0.45, 3) * [length, length, max(width, 0.5 * length)]]
    return {"shape": "box", "center": _under(rng, length, width, -below - sizes[1]), "sizes": sizes}


def _drum(rng, length: float, width: float, below: float, tilt: float) -> Tables:
    radius, turn = _given(rng.uniform(0.1, 0.35) * length), rng.choice([0.0, 0.5, rng.uniform(0, 1)]) * np.pi
    axis = [_given(np.sin(turn)), 0.0, _given(np.cos(turn))]
    place = _under(rng, length, width, -below - radius)
    return {"shape": "cylinder", "center": place, "axis": axis, "radius": radius}


def _under(rng, length: float, width: float, height: float) -> list[float]:
    """A place under the sheet, off its middle by up to a tenth of its sides."""
    off = rng.uniform(-0.1, 0.1, 2)
    return [_given(off[0] * length), _given(height), _given(off[1] * width)]


OBSTACLES: dict[str, Callable[..., Tables]] = {"plane": _plane, "ball": _ball, "box": _box, "drum": _drum}


def dragged_strip(bending: str = "tan") -> Everyday:
    """A strip of 40 x 8 cells clamped at one end 0.2 m above a plane; the clamp moves by 0.3 m along it in 12 steps."""
    length, width = 1.0, 0.2
    end = {"select": {"box": _around([-length / 2, None, None])}, "clamp": True}
    scene = {
        "shell": {"mesh": "cloth.obj", "young": 1e6, "thickness": 1e-3, "density": 200.0, "bending": bending},
        "fix": [{**end, "move": {"displacement": [0.3, 0.0, 0.0]}}],
        "obstacle": [
            {"shape": "plane", "point": [0.0, -0.2, 0.0], "normal": [0.0, 1.0, 0.0], "friction": 0.3}
        ],
        "statics": {"load_steps": 12},
    }
    return Everyday("strip of 40 x 8 cells, its clamp moved", scene, sheet(length, width, 0.025))
