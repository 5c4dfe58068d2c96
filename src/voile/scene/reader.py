"""Reads a scene file and its overrides; every refusal names the file, the line and the key."""

import dataclasses
import re
import tomllib
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from voile.errors import InputError
from voile.scene.kinds import Rejected
from voile.scene.schema import Scene, homes
from voile.scene.table import Table

KeyPath = tuple[str | int, ...]


def read_scene(path: str | Path, overrides: Iterable[str] = ()) -> Scene:
    """The scene of a TOML file, with `overrides` ("shell.young=2e5", "fix.0.axes=xy") applied in their order.

    The value of an override is written as in TOML, text also without quotes. Paths in the scene become
    absolute, from the folder of the scene file. Raises InputError that names file and line (or the override)
    and the key, what is wrong and what is allowed.
    """
    path, overrides = Path(path), list(overrides)
    text = _read_text(path)
    try:
        tree = tomllib.loads(text)
    except ValueError as error:  # TOMLDecodeError, or an integer of thousands of digits
        raise InputError(f"{path}: not TOML: {error}") from None
    except RecursionError:
        raise InputError(f"{path}: arrays or tables are nested too deeply") from None
    places = {at: f"{path}, line {line}" for at, line in key_lines(text).items()}
    for override in overrides:
        places[_apply(tree, override)] = f"--set {override}"
    try:
        scene = Table(Scene).read(tree)
    except Rejected as error:
        name, problem = ".".join(map(str, error.path)), error.problem
        if error.unknown and (tables := homes(str(error.path[-1]))):
            problem += f" (it belongs in {' or '.join(tables)})"
        place = next((places[at] for at in _prefixes(error.path) if at in places), str(path))
        raise InputError(f"{place}: {name}: {problem}" if name else f"{place}: {problem}") from None
    if overrides and not text.endswith("\n"):
        text += "\n"
    text += "".join(f"# --set {' '.join(override.split())}\n" for override in overrides)
    return dataclasses.replace(_absolute(scene, path.parent), text=text, path=path)


def _read_text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8-sig")
    except FileNotFoundError:
        raise InputError(f"{path}: no such file; a scene file (TOML) is needed") from None
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: not UTF-8 text ({error.reason} at byte {error.start})") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from None


def _absolute(scene: Scene, folder: Path) -> Scene:
    """The scene with its files' paths absolute, from the scene file's folder."""
    folder = folder.resolve()
    rest = scene.shell.rest
    shell = dataclasses.replace(
        scene.shell, mesh=folder / scene.shell.mesh, rest=folder / rest if isinstance(rest, Path) else rest
    )
    obstacle = tuple(
        body if body.file is None else dataclasses.replace(body, file=folder / body.file)
        for body in scene.obstacle
    )
    return dataclasses.replace(scene, shell=shell, obstacle=obstacle)


# ---- lines of keys, which tomllib does not tell ----

# Strings and comments, whose brackets, equal signs and line ends mean nothing.
_OPAQUE = re.compile(
    r'"""(?:\\.|[^\\])*?"{3,5}' r"|'''.*?'{3,5}" r'|"(?:\\.|[^"\\\n])*"' r"|'[^'\n]*'" r"|#[^\n]*", re.DOTALL
)


def key_lines(text: str) -> dict[KeyPath, int]:
    """Path of each table and key of valid TOML -> its line, from 1; what is inside { } and [ ] has none."""
    masked = _OPAQUE.sub(lambda m: (" " if m[0].startswith("#") else "_") * len(m[0]), text)
    lines: dict[KeyPath, int] = {}
    count: dict[KeyPath, int] = {}  # [[tables]] seen per path
    table: KeyPath = ()
    depth = start = 0
    for row in masked.split("\n"):
        source = text[start : start + len(row)]
        if depth == 0 and row.strip():
            line = text.count("\n", 0, start) + 1
            if row.lstrip().startswith("["):
                table = _place(_names(source), count, opens=row.lstrip().startswith("[["))
                lines.setdefault(table, line)
            else:
                at = table + _names(source[: row.index("=")] + "= 0")
                for length in range(len(table) + 1, len(at) + 1):  # a dotted key opens tables on its way
                    lines.setdefault(at[:length], line)
        depth += sum(row.count(c) for c in "[{") - sum(row.count(c) for c in "]}")
        start += len(row) + 1
    return lines


def _names(statement: str) -> KeyPath:
    """Names in a header or before an equal sign, dotted or quoted as TOML allows."""
    names: list[str | int] = []
    tree: Any = tomllib.loads(statement)
    while isinstance(tree, dict) and tree:
        name, tree = next(iter(tree.items()))
        names.append(name)
        tree = tree[0] if isinstance(tree, list) else tree
    return tuple(names)


def _place(names: KeyPath, count: dict[KeyPath, int], opens: bool) -> KeyPath:
    """Path of a header's table: names with the indices of the arrays of tables on the way."""
    at: KeyPath = ()
    for position, name in enumerate(names):
        at += (name,)
        if opens and position == len(names) - 1:
            count[at] = count.get(at, 0) + 1
        if at in count:
            at += (count[at] - 1,)
    return at


def _prefixes(path: KeyPath) -> Iterator[KeyPath]:
    for length in range(len(path), 0, -1):
        yield path[:length]


# ---- overrides ----


def _apply(tree: dict[str, Any], override: str) -> KeyPath:
    """Sets one key=value in the tree; returns the key's path."""
    name, equals, value = override.partition("=")
    parts = [part.strip() for part in name.split(".")]
    if not equals or not all(parts):
        raise InputError(f"--set {override}: allowed: key=value, such as shell.young=2e5 or fix.0.axes=xy")
    path: list[str | int] = []
    node: Any = tree
    for position, part in enumerate(parts):
        at: str | int = part
        if isinstance(node, list):
            at = int(part) if part.isdecimal() else -1
            if not 0 <= at < len(node):
                allowed = f"an index from 0 to {len(node) - 1}" if node else "nothing, it is empty"
                raise InputError(f"--set {override}: {'.'.join(map(str, path))}.{part}: allowed: {allowed}")
        elif not isinstance(node, dict):
            raise InputError(
                f"--set {override}: {'.'.join(map(str, path))} is not a table, it has no key {part}"
            )
        path.append(at)
        if position == len(parts) - 1:
            node[at] = _parse(value.strip(), override)
        elif isinstance(node, dict):
            node = node.setdefault(part, {})
        else:
            node = node[at]
    return tuple(path)


def _parse(value: str, override: str) -> Any:
    """A TOML value, or text without its quotes."""
    try:
        parsed = tomllib.loads(f"value = {value}")
    except (ValueError, RecursionError):
        if value[:1] in ("[", "{", '"', "'"):
            raise InputError(f"--set {override}: the value is not TOML: {value}") from None
        return value
    if set(parsed) != {"value"}:
        raise InputError(f"--set {override}: allowed: one value")
    return parsed["value"]
