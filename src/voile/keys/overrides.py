"""Overrides of a file's keys, "key=value" as on the command line."""

import tomllib
from itertools import takewhile
from typing import Any

from voile.errors import InputError

KeyPath = tuple[str | int, ...]
OPTION = "--set "
SUCH = "shell.young=2e5 or fix.0.axes=xy"
TOLD = f"# {OPTION}"  # before each of them, on the last lines of a scene's text


def overridden(text: str) -> dict[str, Any]:
    """The tables of a scene's text with the overrides on its last lines. Raises InputError where it does not read."""
    try:
        tree = tomllib.loads(text)
    except (ValueError, RecursionError) as error:
        raise InputError(f"not TOML: {error}") from None
    lines = takewhile(lambda line: line.startswith(TOLD), reversed(text.splitlines()))
    for override in reversed([line.removeprefix(TOLD) for line in lines]):
        apply(tree, *parts_of(override), override)
    return tree


def parts_of(override: str, option: str = OPTION, such: str = SUCH) -> tuple[str, Any]:
    """Name and value of "key=value". Raises InputError, after the option that it stands behind, with an example."""
    if not override.isprintable():  # it becomes one line of messages and of the scene's text
        raise InputError(
            f"{option}{override!r}: a line break or control character; allowed: one printable line"
        )
    name, equals, text = override.partition("=")
    if not equals:
        raise InputError(f"{option}{override}: allowed: key=value, such as {such}")
    return name, _parse(text.strip(), option + override)


def apply(tree: dict[str, Any], name: str, value: Any, override: str) -> KeyPath:
    """Sets one key of the tree; returns the path of what is new, the key or a table made for it."""
    parts = [part.strip() for part in name.split(".")]
    if not all(parts):
        raise InputError(f"{OPTION}{override}: allowed: key=value, such as {SUCH}")
    path: KeyPath = ()
    new: KeyPath = ()
    node: Any = tree
    for last, part in ((position == len(parts) - 1, part) for position, part in enumerate(parts)):
        at = _step(node, part, path, override)
        path += (at,)
        if not new and (last or (isinstance(node, dict) and part not in node)):
            new = path
        if last:
            node[at] = value
        else:
            node = node.setdefault(at, {}) if isinstance(node, dict) else node[at]
    return new


def _step(node: Any, part: str, path: KeyPath, override: str) -> str | int:
    """The key or index that one part of an override's name means in the table, or array of tables, `node`."""
    if isinstance(node, dict):
        return part
    name = ".".join(map(str, path))
    if not isinstance(node, list) or not all(isinstance(entry, dict) for entry in node):
        raise InputError(f"{OPTION}{override}: {name} is not a table; allowed: {name}=VALUE")
    if not part.isdecimal() or int(part) >= len(node):
        allowed = f"an index from 0 to {len(node) - 1}" if node else "nothing, it is empty"
        raise InputError(f"{OPTION}{override}: {name}.{part}: allowed: {allowed}")
    return int(part)


def _parse(value: str, told: str) -> Any:
    """A TOML value, or text without its quotes."""
    try:
        parsed = tomllib.loads(f"value = {value}")
    except (ValueError, RecursionError):
        if value[:1] in ("[", "{", '"', "'"):
            raise InputError(f"{told}: the value is not TOML: {value}") from None
        return value
    if set(parsed) != {"value"}:
        raise InputError(f"{told}: allowed: one value")
    return parsed["value"]
