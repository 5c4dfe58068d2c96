"""What a key may hold: each kind reads a TOML value, says what is allowed and gives its JSON schema."""

import dataclasses
import difflib
import math
from collections.abc import Iterable
from pathlib import Path
from typing import Any, Protocol

from voile.mesh.raw import LARGEST, RawMesh

Vector3 = tuple[float, float, float]
_NAMES = {
    bool: "a boolean",
    int: "an integer",
    float: "a number",
    str: "text",
    list: "an array",
    dict: "a table",
}


class Rejected(Exception):
    """A value that is not allowed: `problem`, and the `path` of keys and indices to it, from the table read.

    unknown: the last key of the path is one that its table does not have.
    """

    def __init__(self, problem: str, path: tuple[str | int, ...] = (), unknown: bool = False):
        super().__init__(problem)
        self.problem, self.path, self.unknown = problem, path, unknown

    def under(self, *path: str | int) -> "Rejected":
        """The same, seen from further up."""
        return Rejected(self.problem, path + self.path, self.unknown)


class Kind(Protocol):
    """A kind of value; `read` raises Rejected, `allowed` completes "allowed: ..."."""

    def read(self, value: Any) -> Any: ...
    def allowed(self) -> str: ...
    def schema(self) -> dict[str, Any]: ...


def wrong_type(value: Any, kind: Kind) -> Rejected:
    """A refusal of a value's type."""
    return Rejected(
        f"{show(value)} is {_NAMES.get(type(value), 'a date or time')}; allowed: {kind.allowed()}"
    )


def _not_allowed(value: Any, kind: Kind) -> Rejected:
    return Rejected(f"{show(value)} is not allowed; allowed: {kind.allowed()}")


def show(value: Any) -> str:
    """A value as TOML writes it, at most 80 characters."""
    text = str(value).lower() if isinstance(value, bool) else repr(value)
    return text if len(text) <= 80 else text[:77] + "..."


@dataclasses.dataclass(frozen=True)
class Number:
    """A finite number in `unit`, above and below exclusive bounds, at least and at most inclusive ones. Lengths (m) are
    at most those of meshes, where `most` is not given: what obstacles make of larger ones is not finite."""

    unit: str = ""
    above: float | None = None
    below: float | None = None
    least: float | None = None
    most: float | None = None

    def read(self, value: Any) -> float:
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise wrong_type(value, self)
        try:
            number = float(value)
        except OverflowError:
            raise _not_allowed(value, self) from None
        inside = (
            math.isfinite(number)
            and (self.above is None or number > self.above)
            and (self.below is None or number < self.below)
            and (self.least is None or number >= self.least)
            and (self.most is None or number <= self.most)
        )
        if not inside:
            raise _not_allowed(value, self)
        if abs(number) > self._reach:
            raise Rejected(f"{show(value)} is not allowed; allowed: at most {LARGEST:g} m")
        return number

    @property
    def _reach(self) -> float:
        return LARGEST if self.unit == "m" and self.most is None else math.inf

    def allowed(self) -> str:
        bounds = [
            f"{sign} {bound:g}"
            for sign, bound in (
                (">", self.above),
                (">=", self.least),
                ("<", self.below),
                ("<=", self.most),
            )
            if bound is not None and math.isfinite(bound)
        ]
        unit = f" in {self.unit}, written without the unit" if self.unit else ""
        return f"a finite number {' and '.join(bounds)}".rstrip() + unit

    def schema(self) -> dict[str, Any]:
        bounds = {
            "exclusiveMinimum": self.above,
            "exclusiveMaximum": self.below,
            "minimum": self.least,
            "maximum": self._reach if self.most is None else self.most,
        }
        if self.above is None and self.least is None:
            bounds["minimum"] = -self._reach
        known = {name: bound for name, bound in bounds.items() if bound is not None and math.isfinite(bound)}
        return {"type": "number", **known}


@dataclasses.dataclass(frozen=True)
class Integer:
    """An integer, at least `least`."""

    least: int = 0

    def read(self, value: Any) -> int:
        if isinstance(value, bool) or not isinstance(value, int):
            raise wrong_type(value, self)
        if not self.least <= value < 2**31:
            raise _not_allowed(value, self)
        return value

    def allowed(self) -> str:
        return f"an integer >= {self.least}, below 2^31"

    def schema(self) -> dict[str, Any]:
        return {"type": "integer", "minimum": self.least, "exclusiveMaximum": 2**31}


@dataclasses.dataclass(frozen=True)
class Boolean:
    """true or false; only true where `only_true`."""

    only_true: bool = False

    def read(self, value: Any) -> bool:
        if not isinstance(value, bool):
            raise wrong_type(value, self)
        if self.only_true and not value:
            raise _not_allowed(value, self)
        return value

    def allowed(self) -> str:
        return "true" if self.only_true else "true, false"

    def schema(self) -> dict[str, Any]:
        return {"const": True} if self.only_true else {"type": "boolean"}


@dataclasses.dataclass(frozen=True)
class Text:
    """Text; not empty where `filled`."""

    filled: bool = False

    def read(self, value: Any) -> str:
        if not isinstance(value, str):
            raise wrong_type(value, self)
        if self.filled and not value.strip():
            raise _not_allowed(value, self)
        return value

    def allowed(self) -> str:
        return "text, not empty" if self.filled else "text"

    def schema(self) -> dict[str, Any]:
        return {"type": "string", "minLength": 1} if self.filled else {"type": "string"}


@dataclasses.dataclass(frozen=True)
class File:
    """A path relative to the scene file, or one of `words`; the reader makes paths absolute."""

    words: tuple[str, ...] = ()

    def read(self, value: Any) -> Path | str:
        text = Text(filled=True)
        if not isinstance(value, str):
            raise wrong_type(value, self)
        return value if value in self.words else Path(text.read(value))

    def allowed(self) -> str:
        return ", ".join([*(f'"{word}"' for word in self.words), "a path relative to the scene file"])

    def schema(self) -> dict[str, Any]:
        return {"type": "string", "minLength": 1}


class MeshFile(File):
    """A mesh: a file, or from Python arrays in its place, (points, triangles)."""

    def read(self, value: Any) -> Any:
        if isinstance(value, RawMesh):
            return value
        return super().read(value)


class Choice:
    """One of the given values."""

    def __init__(self, *values: str | bool):
        self.values = values

    def read(self, value: Any) -> str | bool:
        for allowed in self.values:
            if type(value) is type(allowed) and value == allowed:
                return allowed
        near = _near(value, [v for v in self.values if isinstance(v, str)]) if isinstance(value, str) else ""
        raise Rejected(f"{show(value)} is not allowed{near}; allowed: {self.allowed()}")

    def allowed(self) -> str:
        return ", ".join(f'"{v}"' if isinstance(v, str) else show(v) for v in self.values)

    def schema(self) -> dict[str, Any]:
        return {"enum": list(self.values)}


class Grain:
    """A direction of any length, or one of several names: by default those of the texture coordinates."""

    def __init__(self, *names: str) -> None:
        self.direction, self.names = vector(nonzero=True), names or ("u", "v")

    def read(self, value: Any) -> tuple[float, ...] | str:
        if isinstance(value, str):
            if value not in self.names:
                raise Rejected(f"{show(value)} is not allowed; allowed: {self.allowed()}")
            return value
        found: tuple[float, ...] | str = self.direction.read(value)
        return found

    def allowed(self) -> str:
        return ", ".join([*(f'"{name}"' for name in self.names), self.direction.allowed()])

    def schema(self) -> dict[str, Any]:
        return {"anyOf": [{"enum": list(self.names)}, self.direction.schema()]}


class Axes:
    """Some of the axes x, y, z, each once, at least one."""

    def read(self, value: Any) -> str:
        if not isinstance(value, str):
            raise wrong_type(value, self)
        if not value or not set(value) <= set("xyz") or len(set(value)) < len(value):
            raise _not_allowed(value, self)
        return value

    def allowed(self) -> str:
        return 'one or more of the letters x, y, z, each once, such as "xy"'

    def schema(self) -> dict[str, Any]:
        return {"type": "string", "pattern": r"^(?!.*(.).*\1)[xyz]{1,3}$"}


LONG = 500  # powers of two: the square of a longer direction is beyond double precision


@dataclasses.dataclass(frozen=True)
class Array:
    """An array of `length` items (without it `least` or more), each of kind `item`; read to a tuple.

    `lone`: an item without brackets is allowed too, and read to itself. nonzero: a direction, of any length.
    """

    item: Kind
    length: int | None = None
    least: int = 0
    nonzero: bool = False
    lone: bool = False

    def read(self, value: Any) -> Any:
        if self.lone and not isinstance(value, list):
            try:
                return self.item.read(value)
            except Rejected:
                raise _not_allowed(value, self) from None
        if not isinstance(value, list):
            raise wrong_type(value, self)
        if len(value) != (self.length or len(value)) or len(value) < self.least:
            raise Rejected(f"{show(value)} has length {len(value)}; allowed: {self.allowed()}")
        items = []
        for entry in value:
            try:
                items.append(self.item.read(entry))
            except Rejected as error:
                raise Rejected(f"in {show(value)}, {error.problem}") from None
        if self.nonzero:
            if not any(items):
                raise _not_allowed(value, self)
            exponent = math.frexp(max(map(abs, items)))[1]
            if abs(exponent) > LONG:  # the square of its length is no number, or none
                items = [math.ldexp(item, -exponent) for item in items]
        return tuple(items)

    def allowed(self) -> str:
        each = self.item.allowed()
        count = str(self.length) if self.length else f"{self.least} or more" if self.least else "any number"
        text = f"an array of {count} values, each {each}" + (", not all zero" if self.nonzero else "")
        return f"{each}; or {text}" if self.lone else text

    def schema(self) -> dict[str, Any]:
        array: dict[str, Any] = {"type": "array", "items": self.item.schema()}
        if self.length:
            array |= {"minItems": self.length, "maxItems": self.length}
        elif self.least:
            array |= {"minItems": self.least}
        return {"anyOf": [self.item.schema(), array]} if self.lone else array


def vector(unit: str = "", above: float | None = None, nonzero: bool = False) -> Array:
    """Three numbers."""
    return Array(Number(unit, above=above), length=3, nonzero=nonzero)


class Box:
    """Two opposite corners [[min], [max]] (m), as far away as one likes."""

    corners = Array(vector(), length=2)

    def read(self, value: Any) -> tuple[Vector3, Vector3]:
        try:
            low, high = self.corners.read(value)
        except Rejected:
            raise _not_allowed(value, self) from None
        if not all(a <= b for a, b in zip(low, high, strict=True)):
            raise _not_allowed(value, self)
        return low, high

    def allowed(self) -> str:
        return "[[xmin, ymin, zmin], [xmax, ymax, zmax]] in m, min <= max"

    def schema(self) -> dict[str, Any]:
        return self.corners.schema()


class Selection:
    """A table that selects vertices by all of its keys at once; checked, and kept as it is."""

    def __init__(self, keys: dict[str, Kind]):
        self.keys = keys

    def read(self, value: Any) -> dict[str, Any]:
        if not isinstance(value, dict):
            raise wrong_type(value, self)
        if not value:
            raise _not_allowed(value, self)
        for name, entry in value.items():
            read_key(self.keys, name, entry)
        return value

    def allowed(self) -> str:
        return f"a table with one or more of the keys {', '.join(self.keys)}"

    def schema(self) -> dict[str, Any]:
        properties = {name: kind.schema() for name, kind in self.keys.items()}
        return {"type": "object", "minProperties": 1, "additionalProperties": False, "properties": properties}


def read_key(keys: dict[str, Kind], name: str, value: Any) -> Any:
    """The value of one key of a table with the given keys; raises Rejected with the key in its path."""
    if name not in keys:
        raise Rejected(f"unknown key{_near(name, keys)}; allowed: {', '.join(keys)}", (name,), unknown=True)
    try:
        return keys[name].read(value)
    except Rejected as error:
        raise error.under(name) from None


def _near(name: str, known: Iterable[str]) -> str:
    close = difflib.get_close_matches(name.lower(), list(known), n=1)
    return f' (did you mean "{close[0]}"?)' if close else ""
