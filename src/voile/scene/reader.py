"""Reads a scene file and its overrides; every refusal names the file, the line and the key."""

import dataclasses
import re
import tomllib
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

from voile.errors import InputError
from voile.keys import Rejected, Table
from voile.keys.overrides import TOLD, apply, parts_of
from voile.scene.library import expand
from voile.scene.plain import plain, toml, toml_value
from voile.scene.rules import check
from voile.scene.schema import Scene, homes

KeyPath = tuple[str | int, ...]
OF_DICT = "scene"  # stands in messages for the file of a scene given as a dict


def read_scene(
    source: str | Path | Mapping[str, Any],
    overrides: Iterable[str] | Mapping[str, Any] = (),
    folder: Path | None = None,
) -> Scene:
    """The scene of a TOML file, or of a dict of its tables, with `overrides` applied in their order.

    Overrides are as on the command line ("shell.young=2e5", "fix.0.axes=xy"; a value is written as in TOML, text also
    without quotes), or a dict {"shell.young": 2e5}. Paths in the scene become absolute, from `folder`: by default that
    of the scene file, or the working folder for a dict. Raises InputError that names file and line (or the override)
    and the key, what is wrong and what is allowed.
    """
    path = Path(OF_DICT) if isinstance(source, Mapping) else Path(source)
    given = _source_of_dict(source) if isinstance(source, Mapping) else read_source(path)
    tree, text, places = given.tree, given.text, dict(given.places)
    told = []
    for name, value, shown in _overrides(overrides):
        new = apply(tree, name, value, shown)
        told.append(shown)
        places = {at: place for at, place in places.items() if at[: len(new)] != new} | {
            new: f"--set {shown}"
        }
    try:
        expand(tree)
        scene = Table(Scene).read(tree)
        check(scene, set(tree))
    except Rejected as error:
        problem = error.problem
        if error.unknown and (tables := homes(str(error.path[-1]))):
            problem += f" (it belongs in {' or '.join(tables)})"
        raise refusal(path, places, problem, error.path) from None
    if told and not text.endswith("\n"):
        text += "\n"
    text += "".join(f"{TOLD}{override}\n" for override in told)
    found: Scene = dataclasses.replace(
        _absolute(scene, (folder or path.parent).resolve()), text=text, path=path
    )
    return found


@dataclasses.dataclass(frozen=True)
class Source:
    """A TOML file: what it holds, its text, and the places of its keys as messages name them."""

    tree: dict[str, Any]
    text: str
    places: dict[KeyPath, str]


def read_source(path: Path, what: str = "a scene file") -> Source:
    """A TOML file that should be `what`. Raises InputError for one that cannot be read."""
    text = _read_text(path, what)
    try:
        tree = tomllib.loads(text)
    except ValueError as error:  # TOMLDecodeError, or an integer of thousands of digits
        raise InputError(f"{path}: not TOML: {error}") from None
    except RecursionError:
        raise InputError(f"{path}: arrays or tables are nested too deeply") from None
    return Source(tree, text, {at: f"{path}, line {line}" for at, line in key_lines(text).items()})


def _source_of_dict(source: Mapping[str, Any]) -> Source:
    """A scene given as a dict, with the text of a file that has it."""
    try:
        tree = plain(source)
    except Rejected as error:
        raise InputError(f"{OF_DICT}: {'.'.join(map(_shown, error.path))}: {error.problem}") from None
    return Source(tree, toml(tree), {})


def refusal(path: Path, places: dict[KeyPath, str], problem: str, at: KeyPath) -> InputError:
    """What is wrong at a key of a file, named with its place there."""
    name = ".".join(map(_shown, at))
    place = next((places[prefix] for prefix in _prefixes(at) if prefix in places), str(path))
    return InputError(f"{place}: {name}: {problem}" if name else f"{place}: {problem}")


def _shown(part: str | int) -> str:
    """A key or index in a message: quoted keys of TOML may hold line breaks."""
    text = str(part)
    return text if text.isprintable() else repr(text)


def _read_text(path: Path, what: str) -> str:
    try:
        return path.read_text(encoding="utf-8-sig")
    except FileNotFoundError:
        raise InputError(f"{path}: no such file; {what} (TOML) is needed") from None
    except UnicodeDecodeError as error:
        if error.object.startswith(b"\x89HDF"):
            raise InputError(
                f"{path}: an HDF5 file; {what} (TOML) is needed. `voile info` reads results, `voile friction` friction "
                "problems"
            ) from None
        raise InputError(f"{path}: not UTF-8 text ({error.reason} at byte {error.start})") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from None


def _absolute(value: Any, folder: Path) -> Any:
    """A table of the scene, or what it holds, with its files' paths absolute from the scene file's folder."""
    if isinstance(value, Path):
        return folder / value
    if isinstance(value, tuple):
        return tuple(_absolute(each, folder) for each in value)
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        keys = [field.name for field in dataclasses.fields(value) if field.metadata]
        return dataclasses.replace(value, **{k: _absolute(getattr(value, k), folder) for k in keys})
    return value


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
                lines.pop(table, None)  # a subtable may have come first
                at = table
            else:
                at = table + _names(source[: row.index("=")] + "= 0")
            for prefix in _prefixes(at):  # dotted names open tables on their way
                lines.setdefault(prefix, line)
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


def _overrides(given: Iterable[str] | Mapping[str, Any]) -> Iterator[tuple[str, Any, str]]:
    """Name, value and "key=value" of overrides."""
    if isinstance(given, Mapping):
        for name, value in given.items():
            try:
                tree = plain(value)
            except Rejected as error:
                raise InputError(f"--set {name}: {error.problem}") from None
            yield name, tree, f"{name}={toml_value(tree)}"
        return
    for override in given:
        yield *parts_of(override), override
