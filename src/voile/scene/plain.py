"""Scenes given as dicts: their values as a file would have them, and the text that the file would have."""

import hashlib
import json
import math
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from voile.keys import Rejected
from voile.mesh import RawMesh, mesh_of_arrays

_BARE = re.compile(r"[A-Za-z0-9_-]+$")
ARRAYS = "arrays: "  # what stands for a mesh of arrays in a scene's text begins with it


def plain(value: Any) -> Any:
    """A value as TOML reads one: dicts, lists, numbers, text; a pair of arrays or lists of rows, (n, 2 or 3), (m, 3),
    is a mesh. Raises Rejected for others, with the keys that lead there."""
    if isinstance(value, Mapping):
        return {str(name): _under(str(name), entry) for name, entry in value.items()}
    if isinstance(value, tuple | list):
        both = [_matrix(entry) for entry in value] if len(value) == 2 else []
        if both and all(entry is not None for entry in both):
            try:
                return mesh_of_arrays(*both)
            except ValueError as error:
                raise Rejected(str(error)) from None
        return [_under(index, entry) for index, entry in enumerate(value)]
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    if isinstance(value, Path):
        return str(value)
    if isinstance(value, str) and not value.isascii() and value.encode(errors="replace").decode() != value:
        raise Rejected("text that is not Unicode")
    if isinstance(value, bool | int | float | str | RawMesh):
        return value
    raise Rejected(
        f"{type(value).__name__} is not allowed; allowed: dicts, lists, arrays, numbers, text, paths"
    )


def _matrix(value: Any) -> Any:
    """A value with rows, as an array or lists of them have; None of others."""
    if isinstance(value, list | tuple) and value and isinstance(value[0], list | tuple | np.ndarray):
        try:
            value = np.array(value)
        except ValueError:  # rows of several lengths
            return None
    return value if isinstance(value, np.ndarray) and value.ndim == 2 else None


def _under(name: str | int, value: Any) -> Any:
    try:
        return plain(value)
    except Rejected as error:
        raise error.under(name) from None


def toml(tree: Mapping[str, Any]) -> str:
    """The text of a scene that `plain` gave. Meshes of arrays are told by sizes and a hash: no file has them."""
    lines = []
    tables = {name: value for name, value in tree.items() if _is_table(value)}
    for name in (each for each in tree if each not in tables):
        lines.append(f"{_name(name)} = {toml_value(tree[name])}")
    for name, value in tables.items():
        for table in value if isinstance(value, list) else [value]:
            lines.append(f"[[{_name(name)}]]" if isinstance(value, list) else f"[{_name(name)}]")
            lines += [f"{_name(key)} = {toml_value(entry)}" for key, entry in table.items()]
    return "".join(f"{line}\n" for line in lines)


def _is_table(value: Any) -> bool:
    return isinstance(value, dict) or (
        isinstance(value, list) and bool(value) and all(isinstance(entry, dict) for entry in value)
    )


def toml_value(value: Any) -> str:
    """A value of TOML on one line."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, float):
        return repr(value) if math.isfinite(value) else str(value)
    if isinstance(value, int):
        return str(value)
    if isinstance(value, RawMesh):
        digest = hashlib.sha256(value.points.tobytes() + value.triangles.tobytes()).hexdigest()[:16]
        return f'"{ARRAYS}{len(value.points)} points, {len(value.triangles)} triangles, {digest}"'
    if isinstance(value, list):
        return f"[{', '.join(map(toml_value, value))}]"
    if isinstance(value, dict):
        return (
            "{ " + ", ".join(f"{_name(name)} = {toml_value(entry)}" for name, entry in value.items()) + " }"
        )
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")


def _name(key: str) -> str:
    return key if _BARE.match(key) else toml_value(key)
