"""Quantities of a run against time or load: the history of every step where there is one, and the stored steps."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from voile.arrays import Array, Reals
from voile.errors import InputError
from voile.results import Result
from voile.results.history import read_history

UNITS = {
    "time": "s",
    "time_step": "s",
    "momentum": "kg m/s",
    "angular_momentum": "kg m^2/s",
    "speed": "m/s",
    "residual": "N",
    "balance_residual": "N",
    "law_residual": "N",
    "tolerance": "N",
    "max_penetration": "m",
    "max_displacement": "m",
    "load_displacement": "m",
    "contact_force": "N",
}
POTENTIALS = (
    "kinetic",
    "stretching",
    "bending",
    "gravity",
    "pressure",
    "force",
    "springs",
    "contact",
    "balance_error",
)
SINCE_THE_START = ("_dissipated", "_work")  # what the names of energies spent or given end with
ENERGIES = "energies"  # all of them but for those that no one would tell from 0 beside the largest:
SEEN = 1e-3
SUPPORT = re.compile(r"support_\d+_x")  # tasks.run's names


@dataclass(frozen=True)
class Series:
    """A quantity over a run: values (k,) or (k, 3) in a unit ("" = none) at (k,) times (s) or load factors."""

    name: str
    unit: str
    at: Reals
    values: Reals


class Recorded:
    """What a result has of its run. FIELD:VERTEX is a field of the stored steps at a vertex, displacement included."""

    def __init__(self, result: Result, in_time: bool):
        self.result = result
        self._makers: dict[str, Callable[[], Reals]] = {"max_displacement": self._max_displacement}
        if "reaction" in result.point_fields:
            self._makers["contact_force"] = self._contact_force
        self._columns = {name: (result.values, figures) for name, figures in _joined(result).items()}
        history = _history(result) if in_time else {}
        self._columns |= {name: (history["time"], figures) for name, figures in history.items()}

    @property
    def names(self) -> list[str]:
        """All that `series` takes but single vertices'."""
        known = sorted({*self._columns, *self._makers})
        return [ENERGIES, *known] if any(map(is_energy, known)) else known

    def series(self, name: str) -> list[Series]:
        """The quantity of that name; those of a group. Raises InputError naming what there is."""
        if name == ENERGIES and name in self.names:
            names = sorted(
                filter(is_energy, self._columns), key=lambda known: known.endswith(SINCE_THE_START)
            )
            found = [s for known in names for s in self.series(known)]
            largest = [np.abs(s.values).max() for s in found]
            return [s for s, size in zip(found, largest, strict=True) if size >= SEEN * max(largest)]
        if name in self._columns:
            return [Series(name, unit(name), *self._columns[name])]
        if name in self._makers:
            return [Series(name, unit(name), self.result.values, self._makers[name]())]
        field, colon, vertex = name.partition(":")
        if colon and field in self._fields:
            return [self._at_vertex(name, field, vertex)]
        raise InputError(
            f"{self.result.path}: no quantity {name!r}; allowed: {', '.join(self.names)}, and at a vertex "
            + ", ".join(f"{f}:VERTEX" for f in self._fields)
        )

    @property
    def _fields(self) -> list[str]:
        return ["displacement", *self.result.moving_fields]

    def _at_vertex(self, name: str, field: str, vertex: str) -> Series:
        result = self.result
        if not vertex.isdecimal() or int(vertex) >= result.n_points:
            raise InputError(
                f"{result.path}: no vertex {vertex!r} in {name!r}; allowed: 0 to {result.n_points - 1}"
            )
        v, steps = int(vertex), range(result.n_steps)
        if field == "displacement":
            return Series(
                name, "m", result.values, np.array([(result.points(k) - result.start)[v] for k in steps])
            )
        return Series(
            name,
            result.unit(field),
            result.values,
            np.array([result.field(field, k)[v] for k in steps]),
        )

    def _max_displacement(self) -> Reals:
        result = self.result
        moved = (result.points(k) - result.start for k in range(result.n_steps))
        return np.array([np.linalg.norm(u, axis=1).max() for u in moved])

    def _contact_force(self) -> Reals:
        """What the shell gets in all: its contacts with itself are in balance."""
        return np.array([self.result.field("reaction", k).sum(axis=0) for k in range(self.result.n_steps)])


def _joined(result: Result) -> dict[str, Reals]:
    """Figures of the stored steps, the components of a support's force as one (k, 3)."""
    found = result.figures()
    for name in [name[:-2] for name in found if SUPPORT.fullmatch(name)]:
        found[name] = np.stack([found.pop(f"{name}_{axis}") for axis in "xyz"], axis=1)
    return found


def is_energy(name: str) -> bool:
    """Whether a figure is an energy (J), stored or counted since the start."""
    return name in POTENTIALS or name.endswith(SINCE_THE_START)


def unit(name: str) -> str:
    """SI unit of a recorded figure, "" where it has none."""
    if name.startswith("support_"):
        return "N m" if name.endswith("_moment") else "N"
    return "J" if is_energy(name) else UNITS.get(name, "")


def _history(result: Result) -> dict[str, Array]:
    """Columns of the figures of every step beside a result, none where a run wrote none."""
    path = result.path.with_name("history.h5")
    return read_history(path) if path.is_file() else {}
