"""Settings: keys of a scene, or of how it is run, with values that a study gives them."""

import dataclasses
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from voile.elastic import BENDING, MODELS
from voile.keys import Integer, Rejected, Selection, Table, Tables
from voile.keys.kinds import Kind
from voile.keys.kinds import read_key as read_named
from voile.scene import Scene
from voile.scene.plain import toml_value
from voile.scene.schema import homes
from voile.study import problems
from voile.study.problems import TOLERANCE, Problem

Settings = dict[str, Any]
SHORT = {"refine": "shell.refine"}  # words of a study for keys of scenes
RANKS = "ranks"  # MPI processes: no key of scenes
OWN = {RANKS: Integer(1)}

# What a key changes, by the longest prefix that fits; all others change the model.
MODEL, DISCRETE, TIME, ITERATION, COST = "model", "discretisation", "time step", "iteration", "cost only"
CHANGES = {
    "shell.refine": DISCRETE,
    "shell.refine_smooth": DISCRETE,  # of facets another shell than of what they stand for
    "shell.mesh": DISCRETE,
    "shell.bending": DISCRETE,  # mid-edge normals of one shell, see `changes`
    "dynamics.time_step": TIME,
    "dynamics.scheme": TIME,
    "dynamics.adaptive": TIME,
    "dynamics.accuracy": TIME,
    "dynamics.spectral_radius": TIME,
    "dynamics.theta": TIME,
    "dynamics.solver": ITERATION,
    "dynamics.iterations": ITERATION,
    "dynamics.tolerance": ITERATION,
    "statics": ITERATION,
    "statics.control": MODEL,
    "statics.max_load_factor": MODEL,
    "inverse.method": ITERATION,
    "inverse.tolerance": ITERATION,
    "inverse.iterations": ITERATION,
    "inverse.max_seconds": ITERATION,
    "modes.count": COST,
    "output": COST,
    TOLERANCE: ITERATION,
    RANKS: COST,
}
NORMALS, SMOOTH = "shell.bending", "shell.refine_smooth"
# Keys that only some scenes make anything of, and which.
TAKEN: dict[str, Callable[[Scene], bool]] = {
    NORMALS: lambda scene: MODELS[scene.shell.model].normals,
    "shell.material": lambda scene: MODELS[scene.shell.model].material,
    "dynamics.iterations": lambda scene: scene.dynamics.solver == "local-global",
    "dynamics.accuracy": lambda scene: scene.dynamics.adaptive,
    "dynamics.spectral_radius": lambda scene: scene.dynamics.scheme == "generalized-alpha",
    "dynamics.theta": lambda scene: scene.dynamics.scheme == "moreau-jean",
}
TASKS = "dynamics", "modes", "inverse"  # tables of one task, of which others make nothing


def full(name: str) -> str:
    """A setting's key as scenes spell it."""
    return SHORT.get(name, name)


def brief(name: str) -> str:
    """A setting's key as studies spell it."""
    return {key: word for word, key in SHORT.items()}.get(name, name)


def changes(name: str, *values: Any) -> str:
    """What a setting changes, between these values: MODEL, DISCRETE, TIME, ITERATION or COST."""
    if name == NORMALS and not all(BENDING.get(value, True) for value in values):
        return MODEL  # without directors a shell bends as its triangles lie, on many meshes at any size
    parts = full(name).split(".")
    prefixes = (".".join(parts[:k]) for k in range(len(parts), 0, -1))
    return next((CHANGES[p] for p in prefixes if p in CHANGES), MODEL)


def flattened(tree: dict[str, Any], at: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], Any]]:
    """Keys of a file's table, those that dots made nested tables of too, and their values."""
    for name, value in tree.items():
        if isinstance(value, dict) and value:
            yield from flattened(value, (*at, name))
        else:
            yield (*at, name), value


def check(name: str, value: Any) -> None:
    """Raises Rejected for a key that neither scenes nor friction problems have, and a value that is not of its kind."""
    own = OWN | problems.KEYS
    if name in own:
        own[name].read(value)
        return
    kind: Kind = Table(Scene)
    for part in full(name).split("."):
        if isinstance(kind, Tables) and part.isdecimal():
            kind = kind.table
        elif isinstance(kind, Table | Selection):
            kind = _inner(kind, part, name)
        else:
            raise Rejected(f"no scene has such a key; allowed: {name.rpartition('.')[0]}")
    kind.read(value)


def _inner(kind: Table | Selection, part: str, name: str) -> Kind:
    if part in kind.keys:
        return kind.keys[part]
    try:
        read_named(kind.keys, part, None)
    except Rejected as error:
        wrong, _, allowed = error.problem.partition("; allowed: ")
        if part == name:
            allowed = f"{', '.join([*SHORT, *OWN])}, or a key of a table of the scene, such as shell.young"
        tables = homes(full(name).rpartition(".")[2])
        hint = f" (scenes have it in {' or '.join(tables)})" if tables else ""
        wrong = wrong.replace("unknown key", "no scene has such a key", 1)
        raise Rejected(f"{wrong}{hint}; allowed: {allowed}") from None
    raise AssertionError("a key that is there was refused")


def overrides(settings: Settings) -> list[str]:
    """The scene's keys among settings, as `--set` takes them."""
    return [f"{full(name)}={toml_value(value)}" for name, value in settings.items() if name not in OWN]


def value_of(scene: Scene | Problem, name: str) -> Any:
    """What a scene has for a key, its defaults included; None where it has no such table or key."""
    node: Any = scene
    for part in full(name).split("."):
        if isinstance(node, tuple) and part.isdecimal():
            node = node[int(part)] if int(part) < len(node) else None
        elif isinstance(node, dict):
            node = node.get(part)
        elif node is not None:
            field = Table(type(node)).fields.get(part)
            node = field and getattr(node, field.name, None)
    return node


def taken(scene: Scene | Problem) -> Scene | Problem:
    """A scene with None for the keys that it makes nothing of: what decides its result."""
    if isinstance(scene, Problem):
        return scene
    for name, takes in TAKEN.items():
        if not takes(scene):
            table, key = name.split(".")
            bare = dataclasses.replace(getattr(scene, table), **{key: None})
            scene = dataclasses.replace(scene, **{table: bare})
    idle: dict[str, Any] = dict.fromkeys(task for task in TASKS if task != scene.scene.task)
    return dataclasses.replace(scene, **idle)


def different(one: Settings, other: Settings) -> list[str]:
    """The settings that differ, of those that both make something of."""
    names = [*TAKEN, *(n for n in one if n.split(".")[0] in TASKS)] if _tasks_differ(one, other) else TAKEN
    idle = [name for name in names if None in (one.get(name), other.get(name))]
    return [name for name in one if name not in idle and repr(one[name]) != repr(other[name])]


def _tasks_differ(one: Settings, other: Settings) -> bool:
    return bool(one.get("scene.task") != other.get("scene.task"))


def plain(value: Any) -> Any:
    """A value of a scene as files hold it: of tables what differs from their defaults, of paths the name."""
    if isinstance(value, Path):
        return value.name
    if isinstance(value, tuple | list):
        return [plain(each) for each in value]
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        fields = Table(type(value)).fields.items()
        return {n: plain(v) for n, f in fields if (v := getattr(value, f.name)) != f.default}
    return value


def told(settings: Settings) -> str:
    """Settings in one line: key=value, text without quotes."""
    return " ".join(f"{brief(n)}={v if isinstance(v, str) else toml_value(v)}" for n, v in settings.items())
