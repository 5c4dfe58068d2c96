"""Modes in pictures and films: the equilibrium, displaced by a shape."""

import re

from voile.arrays import Reals, diagonal
from voile.results import Result

LARGEST = 0.1  # of the shape's size: the largest displacement drawn


def is_mode(field: str) -> bool:
    """Whether a field of that name is one of several modes."""
    return re.fullmatch(r"mode_\d{3,}", field) is not None


def modes_of(result: Result) -> list[str]:
    """The names of its modes, in order."""
    return sorted(filter(is_mode, result.point_fields))


def displaced(result: Result, field: str, step: int = -1, phase: float = 1.0) -> Reals:
    """(n, 3) m: the points of a step, displaced by `phase` (-1 to 1) of what is drawn of a mode."""
    points = result.points(step)
    return points + phase * LARGEST * diagonal(points) * result.field(field, step)


def figure(result: Result, field: str, step: int = -1) -> str:
    """A mode's name and figure, for a title."""
    number, scalars = field.removeprefix("mode_"), result.scalars(step)
    if f"frequency_{number}" in scalars:
        return f"mode {int(number)}    {scalars[f'frequency_{number}']:.4g} Hz"
    return f"mode {int(number)}    buckles at load factor {scalars[f'load_factor_{number}']:.4g}"
