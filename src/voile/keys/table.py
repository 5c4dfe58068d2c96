"""Tables of a scene file: frozen dataclasses whose fields' metadata hold kind and meaning of a key."""

import dataclasses
from typing import Any

from voile.keys.kinds import Array, Kind, Number, Rejected, read_key, wrong_type


def key(kind: Kind, meaning: str, word: str = "", **default: Any) -> Any:
    """A field of a table: required without `default` or `default_factory`. word: its key in the file, where the
    field's name is another."""
    return dataclasses.field(metadata={"kind": kind, "meaning": meaning, "word": word}, **default)


class Table:
    """A table of the file, read into the frozen dataclass `of`."""

    def __init__(self, of: Any):
        self.of = of
        self.fields = {f.metadata["word"] or f.name: f for f in dataclasses.fields(of) if f.metadata}
        self.keys: dict[str, Kind] = {name: f.metadata["kind"] for name, f in self.fields.items()}

    def read(self, value: Any) -> Any:
        if not isinstance(value, dict):
            raise wrong_type(value, self)
        values = {name: read_key(self.keys, name, entry) for name, entry in value.items()}
        for name in self.required():
            if name not in values:
                raise Rejected(
                    f'the key "{name}" is missing: {self.fields[name].metadata["meaning"]}; '
                    f"allowed: {self.keys[name].allowed()}"
                )
        table = self.of(**{self.fields[name].name: entry for name, entry in values.items()})
        if hasattr(table, "check"):
            table.check(set(values))
        return table

    def required(self) -> list[str]:
        """Names of the keys without a default."""
        missing = dataclasses.MISSING
        return [n for n, f in self.fields.items() if f.default is missing and f.default_factory is missing]

    def allowed(self) -> str:
        return f"a table with the keys {', '.join(self.keys)}"

    def schema(self) -> dict[str, Any]:
        properties = {}
        for name, field in self.fields.items():
            kind, unit = self.keys[name], _unit(self.keys[name])
            described = field.metadata["meaning"] + (f" ({unit})" if unit else "")
            properties[name] = {"description": described, **kind.schema()}
            if isinstance(field.default, int | float | str | tuple) and field.default != ():
                default = field.default
                properties[name]["default"] = list(default) if isinstance(default, tuple) else default
        table: dict[str, Any] = {"type": "object", "additionalProperties": False, "properties": properties}
        if self.required():
            table["required"] = self.required()
        return table | getattr(self.of, "SCHEMA", {})


class Tables:
    """An array of tables, [[name]] in the file; read into a tuple."""

    def __init__(self, of: Any):
        self.table = Table(of)

    def read(self, value: Any) -> tuple[Any, ...]:
        if not isinstance(value, list) or not all(isinstance(entry, dict) for entry in value):
            raise wrong_type(value, self)
        tables = []
        for index, entry in enumerate(value):
            try:
                tables.append(self.table.read(entry))
            except Rejected as error:
                raise error.under(index) from None
        return tuple(tables)

    def allowed(self) -> str:
        return f"tables in double brackets, [[...]], with the keys {', '.join(self.table.keys)}"

    def schema(self) -> dict[str, Any]:
        return {"type": "array", "items": self.table.schema()}


def _unit(kind: Kind) -> str:
    if isinstance(kind, Array):
        return _unit(kind.item)
    return kind.unit if isinstance(kind, Number) else ""
