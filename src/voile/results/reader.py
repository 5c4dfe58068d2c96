"""Reading `result.vtkhdf`. Trusts NSteps only, so a killed run reads up to its last complete step."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Self

import numpy as np

from voile.errors import InputError
from voile.results.fields import CELL_FIELDS, FORMAT_VERSION, POINT_FIELDS, Field, find_field
from voile.results.static import OBSTACLES, Body
from voile.results.writer import EDGES, OWN_VALUES, POINTS


@dataclass(frozen=True)
class Restart:
    """The state a run continues from, in the input's order.

    value: time (s) or load factor; points (n, 3) m; edge_angles (e,) rad or None; point_data: velocity,
    reaction and what else the run has per vertex and step; scalars: the step's figures.
    """

    value: float
    points: np.ndarray
    edge_angles: np.ndarray | None
    point_data: dict[str, np.ndarray]
    scalars: dict[str, float]


def read_result(path: str | os.PathLike[str]) -> Result:
    """Open the result at `path` (the file, or the directory with `result.vtkhdf` in it).

    Raises InputError where it is missing, not a result of this program, of a newer format, or truncated.
    """
    path = result_file(path)
    try:
        return Result(path, open_result(path))
    except (OSError, KeyError) as error:
        raise InputError(f"{path}: damaged result file: {_first_line(error)}") from None


def result_file(path: str | os.PathLike[str]) -> Path:
    """The file of a result given by it or its folder."""
    path = Path(path)
    return path / "result.vtkhdf" if path.is_dir() else path


@contextmanager
def opened(result: str | os.PathLike[str] | Result) -> Iterator[Result]:
    """A result that is open already, or the one at a path, which is closed afterwards."""
    if isinstance(result, Result):
        yield result
    else:
        with read_result(result) as read:
            yield read


def open_result(path: Path) -> Any:
    """The HDF5 file of a result. Raises InputError."""
    if not path.is_file():
        raise InputError(f"{path}: no such result file; `result.vtkhdf` of a run expected")
    import h5py

    if not h5py.is_hdf5(path):
        raise InputError(f"{path}: not a result file (not HDF5); `result.vtkhdf` of a run expected")
    try:
        return h5py.File(path, "r", locking=False)
    except (OSError, KeyError) as error:
        raise InputError(f"{path}: damaged result file: {_first_line(error)}") from None


class Result:
    """A result file. Arrays are read when asked for; step indices count from 0, -1 is the last one.

    Steps out of range raise IndexError, unknown fields KeyError naming the known ones.
    """

    def __init__(self, path: Path, file: Any):
        self.path, self._file = path, file
        if "VTKHDF" not in file or "voile" not in file:
            raise InputError(f"{path}: not a result of this program: it lacks the group /VTKHDF or /voile")
        own = file["voile"]
        self.format_version = int(own.attrs["format_version"])
        if self.format_version > FORMAT_VERSION:
            raise InputError(
                f"{path}: result format {self.format_version}; this program reads up to {FORMAT_VERSION}"
            )
        self.versions: dict[str, str] = json.loads(own.attrs["versions"])
        self.group_names: tuple[str, ...] = tuple(json.loads(own.attrs["group_names"]))
        self.scene_text = own["scene"][()].tobytes().decode("utf-8")
        self.n_steps = int(file["VTKHDF/Steps"].attrs["NSteps"])
        if self.n_steps == 0:
            raise InputError(f"{path}: a result without a complete step")
        self.values: np.ndarray = file[OWN_VALUES][: self.n_steps]
        self.ended = len(file[OWN_VALUES]) == self.n_steps  # else the run goes on, or was killed
        self.n_points = int(file["VTKHDF/NumberOfPoints"][0])
        self.n_cells = int(file["VTKHDF/NumberOfCells"][0])

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def close(self) -> None:
        self._file.close()

    @cached_property
    def triangles(self) -> np.ndarray:
        """(m, 3) vertex indices."""
        return self._read("VTKHDF/Connectivity").reshape(-1, 3)

    @cached_property
    def start(self) -> np.ndarray:
        """(n, 3) positions at the start of the run, m."""
        return self._read("VTKHDF/PointData/start")

    @cached_property
    def rest(self) -> np.ndarray:
        """(nr, 3) rest positions, m; which belong to a triangle: `rest_triangles`."""
        return self._read(
            "voile/rest_points" if "voile/rest_points" in self._file else "VTKHDF/PointData/rest"
        )

    @cached_property
    def rest_triangles(self) -> np.ndarray:
        """(m, 3) indices into `rest`; equal to `triangles` unless the rest shape has its own vertices."""
        own = "voile/rest_triangles"
        return self._read(own) if own in self._file else self.triangles

    @cached_property
    def edges(self) -> np.ndarray | None:
        """(e, 2) vertex pairs of the director angles, None where the run has none."""
        return self._read("voile/edges") if "voile/edges" in self._file else None

    @cached_property
    def bodies(self) -> tuple[Body, ...]:
        """The obstacles where they are at load factor 0, in the scene's order."""
        found = []
        for k in range(len(self._file.get(OBSTACLES, ()))):
            name, friction, points, triangles = (
                self._read(f"{OBSTACLES}/{k}/{part}") for part in ("name", "friction", "points", "triangles")
            )
            found.append(Body(name.tobytes().decode("utf-8"), float(friction), points, triangles))
        return tuple(found)

    def placements(self, step: int = -1) -> np.ndarray:
        """(bodies, 4, 4) matrices that take the bodies' points at load factor 0, (x, y, z, 1), to a step's."""
        paths = [f"{OBSTACLES}/{k}/placement" for k in range(len(self.bodies))]
        rows = [self._rows(path, self._step(step), 1) for path in paths]
        return np.reshape(rows, (-1, 4, 4))

    @property
    def point_fields(self) -> tuple[str, ...]:
        return tuple(self._file.get("VTKHDF/PointData", {}))

    @property
    def moving_fields(self) -> tuple[str, ...]:
        """Those of `point_fields` that every step has anew."""
        data = self._file.get("VTKHDF/PointData", {})
        return tuple(name for name in data if "static" not in data[name].attrs)

    @property
    def cell_fields(self) -> tuple[str, ...]:
        return tuple(self._file.get("VTKHDF/CellData", {}))

    def points(self, step: int = -1) -> np.ndarray:
        """(n, 3) positions, m."""
        return self._rows(POINTS, self._step(step) * self.n_points, self.n_points)

    def field(self, name: str, step: int = -1) -> np.ndarray:
        """Point data (n, ...) or cell data (m, ...) of that name; unit: `unit(name)`."""
        for kind, n in (("Point", self.n_points), ("Cell", self.n_cells)):
            path = f"VTKHDF/{kind}Data/{name}"
            if path in self._file:
                offset = int(self._file[f"VTKHDF/Steps/{kind}DataOffsets/{name}"][self._step(step)])
                return self._rows(path, offset, n)
        raise KeyError(f"no field {name!r}; there are {', '.join(self.point_fields + self.cell_fields)}")

    def describe(self, name: str) -> Field:
        """Unit and meaning of a field."""
        field = find_field(POINT_FIELDS | CELL_FIELDS, name)
        if field is None:
            raise KeyError(f"no field {name!r}; there are {', '.join(self.point_fields + self.cell_fields)}")
        return field

    def unit(self, name: str) -> str:
        """SI unit of a field, "" where it has none."""
        return self.describe(name).unit

    def edge_angles(self, step: int = -1) -> np.ndarray | None:
        """(e,) director angles, rad, in the order of `edges`; None where the run has none."""
        if EDGES not in self._file or self.edges is None:
            return None
        count = len(self.edges)
        return self._rows(EDGES, self._step(step) * count, count)

    def scalars(self, step: int = -1) -> dict[str, float]:
        """The figures stored with a step."""
        step = self._step(step)
        return {name: float(data[step]) for name, data in self._file.get("voile/steps", {}).items()}

    def figures(self) -> dict[str, np.ndarray]:
        """(n_steps,) each, the figures stored with the steps."""
        return {name: data[: self.n_steps] for name, data in self._file.get("voile/steps", {}).items()}

    def restart(self, step: int = -1) -> Restart:
        """All that a run needs to go on from a step."""
        fields = {name: self.field(name, step) for name in self.moving_fields}
        value = float(self.values[self._step(step)])
        return Restart(value, self.points(step), self.edge_angles(step), fields, self.scalars(step))

    def write_obj(self, path: str | Path, step: int = -1) -> None:
        """The shape of a step as OBJ with the mesh's groups. InputError if `path` cannot be written."""
        from voile.mesh import write_obj

        groups = (self.field("group"), self.group_names) if "group" in self.cell_fields else None
        comment = f"{self.path.name}, step {self._step(step)}, value {self.values[step]:g}"
        write_obj(path, self.points(step), self.triangles, groups=groups, comment=comment)

    def _step(self, step: int) -> int:
        if not -self.n_steps <= step < self.n_steps:
            raise IndexError(f"{self.path}: no step {step}; there are {self.n_steps}")
        return step % self.n_steps

    def _read(self, path: str) -> np.ndarray:
        try:
            return self._file[path][()]
        except (OSError, KeyError) as error:
            raise InputError(f"{self.path}: damaged result file: {_first_line(error)}") from None

    def _rows(self, path: str, begin: int, count: int) -> np.ndarray:
        try:
            return self._file[path][begin : begin + count]
        except (OSError, KeyError) as error:
            raise InputError(f"{self.path}: damaged result file: {_first_line(error)}") from None


def _first_line(error: Exception) -> str:
    return str(error.args[0] if error.args else error).splitlines()[0]
