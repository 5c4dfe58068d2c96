"""The scene's [[obstacle]] table: what all obstacles have, and the keys that each shape's class declares."""

import dataclasses
from dataclasses import dataclass
from typing import Any, ClassVar

from voile.contact.obstacles import SHAPES
from voile.contact.obstacles import Obstacle as Shape
from voile.keys import Choice, Number, Rejected, Table, key
from voile.scene.moves import Move


def _required(shape: type[Shape]) -> list[str]:
    """Names of the shape's keys without a default."""
    return [name for name, own in shape.scene_keys().items() if own.default is dataclasses.MISSING]


@dataclass(frozen=True, kw_only=True)
class Body:
    """What all obstacles have; `Obstacle` adds the keys of all shapes."""

    shape: str = key(Choice(*SHAPES), "shape; the keys of its geometry are required: see the other keys")
    friction: float = key(Number(least=0), "Coulomb's coefficient of friction", default=0.0)
    restitution: float = key(
        Number(least=0, most=1), "moreau-jean: speed after an impact over that before", default=0.0
    )
    move: Move | None = key(Table(Move), "prescribed rigid motion", default=None)

    SCHEMA: ClassVar[dict[str, Any]] = {
        "allOf": [
            {"if": {"properties": {"shape": {"const": word}}}, "then": {"required": _required(shape)}}
            for word, shape in SHAPES.items()
        ]
    }

    def geometry(self) -> dict[str, Any]:
        """The values of the shape's own keys."""
        return {name: getattr(self, name) for name in SHAPES[self.shape].scene_keys()}

    def check(self, given: set[str]) -> None:
        shape = SHAPES[self.shape]
        own, needed = shape.scene_keys(), _required(shape)
        for name in sorted(given - own.keys() - {f.name for f in dataclasses.fields(Body)}):
            raise Rejected(f'not a key of shape = "{self.shape}"; allowed: {", ".join(sorted(own))}', (name,))
        for name in needed:
            if name not in given:
                needs = f'shape = "{self.shape}" needs {", ".join(needed)}'
                raise Rejected(f'the key "{name}" is missing; {needs}')
        shape.check(self)


def _geometry() -> list[tuple[str, Any, dataclasses.Field[Any]]]:
    """A field for each key of the shapes, none of them required; its meaning says whose it is. Raises TypeError where
    shapes mean different kinds of values by one key."""
    fields: dict[str, dataclasses.Field[Any]] = {}
    meanings: dict[str, dict[str, list[str]]] = {}
    for word, shape in SHAPES.items():
        for name, own in shape.scene_keys().items():
            default = None if own.default is dataclasses.MISSING else own.default
            known = fields.setdefault(name, key(own.metadata["kind"], "", default=default))
            if (known.metadata["kind"], known.default) != (own.metadata["kind"], default):
                raise TypeError(f'obstacles: shape "{word}" has another kind or default of the key "{name}"')
            meanings.setdefault(name, {}).setdefault(own.metadata["meaning"], []).append(word)
    return [
        (name, Any, key(known.metadata["kind"], _told(meanings[name]), default=known.default))
        for name, known in fields.items()
    ]


def _told(meanings: dict[str, list[str]]) -> str:
    """What a key means, with the words of the shapes that have it."""
    return "; ".join(f"{', '.join(words)}: {meaning}" for meaning, words in meanings.items())


# `__module__` lets instances travel between ranks.
Obstacle = dataclasses.make_dataclass(
    "Obstacle", _geometry(), bases=(Body,), frozen=True, kw_only=True, namespace={"__module__": __name__}
)
