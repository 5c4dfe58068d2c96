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

from voile.arrays import Array, Ints, Reals
from voile.errors import InputError
from voile.results.checks import check_finite, check_indices, check_length, dataset, intact, member, open_file
from voile.results.fields import CELL_FIELDS, FORMAT_VERSION, POINT_FIELDS, Field, find_field
from voile.results.static import OBSTACLES, Body
from voile.results.writer import EDGES, OWN_VALUES, POINTS, STEPS

FIGURES = "voile/steps"


@dataclass(frozen=True)
class Restart:
    """The state a run continues from, in the input's order.

    value: time (s) or load factor; points (n, 3) m; edge_angles (e,) rad or None; point_data: velocity,
    reaction and what else the run has per vertex and step; scalars: the step's figures.
    """

    value: float
    points: Reals
    edge_angles: Reals | None
    point_data: dict[str, Array]
    scalars: dict[str, float]


def read_result(path: str | os.PathLike[str]) -> Result:
    """Open the result at `path` (the file, or the directory with `result.vtkhdf` in it).

    Raises InputError where it is missing, not a result of this program, of a newer format, or truncated.
    """
    path = result_file(path)
    return Result(path, open_result(path))


def result_file(path: str | os.PathLike[str]) -> Path:
    """The file of a result given by it or its folder."""
    path = Path(path)
    return path / "result.vtkhdf" if path.is_dir() else path


def look_through(path: Path) -> None:
    """Reads a result once, but of its steps the last one alone. Raises InputError where it is damaged."""
    with read_result(path) as result, intact(path):
        _ = result.triangles, result.start, result.rest_triangles, result.edges
        _ = result.placements(), result.restart()
        for name in (*result.point_fields, *result.cell_fields):
            result.field(name)
        result.visit()


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
    with intact(path):
        return open_file(path)


class Result:
    """A result file. Arrays are read when asked for; step indices count from 0, -1 is the last one.

    Steps out of range raise IndexError, unknown fields KeyError naming the known ones.
    """

    computed_fields: tuple[str, ...] = ()  # on triangles, that `field` of a derived class computes

    def __init__(self, path: Path, file: Any):
        self.path, self._file = path, file
        with intact(path):
            if member(path, file, "VTKHDF") is None or member(path, file, "voile") is None:
                raise InputError(
                    f"{path}: not a result of this program: it lacks the group /VTKHDF or /voile"
                )
            self._read_head(member(path, file, "voile"))

    def _read_head(self, own: Any) -> None:
        path = self.path
        self.format_version = int(own.attrs["format_version"])
        if self.format_version > FORMAT_VERSION:
            raise InputError(
                f"{path}: result format {self.format_version}; this program reads up to {FORMAT_VERSION}"
            )
        self.versions: dict[str, str] = {
            str(k): str(v) for k, v in dict(json.loads(own.attrs["versions"])).items()
        }
        self.group_names: tuple[str, ...] = tuple(map(str, json.loads(own.attrs["group_names"])))
        self.scene_text = dataset(path, own, "scene", "indices", 0)[()].tobytes().decode("utf-8")
        self.n_steps = int(member(path, self._file, STEPS).attrs["NSteps"])
        if self.n_steps == 0:
            raise InputError(f"{path}: a result without a complete step")
        values = self._data(OWN_VALUES, "reals", 0)
        if not 0 < self.n_steps <= len(values):
            raise InputError(f"{path}: damaged result file: {self.n_steps} steps, but room for {len(values)}")
        self.values: Reals = values[: self.n_steps]
        check_finite(path, OWN_VALUES, self.values)
        self.ended = len(values) == self.n_steps  # else the run goes on, or was killed
        self.n_points, self.n_cells = (
            int(self._read(f"VTKHDF/NumberOf{what}", "indices", 0)[0]) for what in ("Points", "Cells")
        )
        check_length(path, "VTKHDF/Connectivity", len(self._data("VTKHDF/Connectivity")), 3 * self.n_cells)
        if min(self.n_points, self.n_cells) < 1:
            raise InputError(f"{path}: damaged result file: no vertices or triangles")
        self.bodies: tuple[Body, ...] = tuple(self._bodies())

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def close(self) -> None:
        """Closes the file; arrays that were read stay."""
        self._file.close()

    def visit(self) -> None:
        """Meets all objects of the file, also those that only others read."""
        self._file.visititems(lambda *_: None)

    @cached_property
    def triangles(self) -> Ints:
        """(m, 3) vertex indices."""
        return self._indices("VTKHDF/Connectivity", 0, self.n_points).reshape(-1, 3)

    @cached_property
    def start(self) -> Reals:
        """(n, 3) positions at the start of the run, m."""
        return self._places("VTKHDF/PointData/start", self.n_points)

    @cached_property
    def rest(self) -> Reals:
        """(nr, 3) rest positions, m; which belong to a triangle: `rest_triangles`."""
        own = "voile/rest_points"
        return self._places(own) if self._has(own) else self._places("VTKHDF/PointData/rest", self.n_points)

    @cached_property
    def rest_triangles(self) -> Ints:
        """(m, 3) indices into `rest`; equal to `triangles` unless the rest shape has its own vertices."""
        own = "voile/rest_triangles"
        return self._indices(own, 3, len(self.rest), self.n_cells) if self._has(own) else self.triangles

    @cached_property
    def edges(self) -> Ints | None:
        """(e, 2) vertex pairs of the director angles, None where the run has none."""
        return self._indices("voile/edges", 2, self.n_points) if self._has("voile/edges") else None

    def _bodies(self) -> Iterator[Body]:
        """The obstacles where they are at load factor 0, in the scene's order."""
        group = member(self.path, self._file, OBSTACLES)
        for k in range(0 if group is None else len(group)):
            name, friction = (self._read(f"{OBSTACLES}/{k}/{part}") for part in ("name", "friction"))
            points = self._places(f"{OBSTACLES}/{k}/points")
            triangles = self._indices(f"{OBSTACLES}/{k}/triangles", 3, len(points))
            yield Body(
                name.tobytes().decode("utf-8"),
                float(friction),
                points,
                triangles,
                *self._frames(k, len(points)),
            )

    def _frames(self, k: int, count: int) -> tuple[Reals | None, float]:
        """(f, count, 3) m and the time between them (s) of an obstacle that deforms."""
        path = f"{OBSTACLES}/{k}/frames"
        if not self._has(path):
            return None, 1.0
        frames, step = self._places(path), float(self._read(f"{OBSTACLES}/{k}/frame_time", "reals", 0))
        check_length(self.path, path, len(frames), max(1, len(frames) // count) * count)
        if not 0.0 < step < np.inf:
            raise InputError(f"{self.path}: damaged result file: {path} are {step:g} s apart")
        return frames.reshape(-1, count, 3), step

    def placements(self, step: int = -1) -> Reals:
        """(bodies, 4, 4) matrices that take the bodies' points at load factor 0, (x, y, z, 1), to a step's."""
        paths = [f"{OBSTACLES}/{k}/placement" for k in range(len(self.bodies))]
        rows = [self._rows(path, self._step(step), 1, 16) for path in paths]
        return np.reshape(rows, (-1, 4, 4))

    @property
    def point_fields(self) -> tuple[str, ...]:
        """Names of the fields at vertices that `field` takes."""
        return self._names("VTKHDF/PointData", POINT_FIELDS)

    @property
    def moving_fields(self) -> tuple[str, ...]:
        """Those of `point_fields` that every step has anew."""
        return tuple(
            name for name in self.point_fields if "static" not in self._data(f"VTKHDF/PointData/{name}").attrs
        )

    @property
    def cell_fields(self) -> tuple[str, ...]:
        """Names of the fields on triangles that `field` takes."""
        return self._names("VTKHDF/CellData", CELL_FIELDS)

    def points(self, step: int = -1) -> Reals:
        """(n, 3) positions at a step, m; negative steps count from the end. Raises IndexError for a step that is not
        there, InputError for damaged data."""
        return self._rows(POINTS, self._step(step) * self.n_points, self.n_points, 3)

    def field(self, name: str, step: int = -1) -> Array:
        """Point data (n, ...) or cell data (m, ...) of that name at a step; unit: `unit(name)`. Raises KeyError for
        a name that is not there, InputError for damaged data."""
        for kind, n, table, names in (
            ("Point", self.n_points, POINT_FIELDS, self.point_fields),
            ("Cell", self.n_cells, CELL_FIELDS, self.cell_fields),
        ):
            spec = find_field(table, name)
            if spec and name in names:
                offsets = self._data(f"VTKHDF/Steps/{kind}DataOffsets/{name}", "indices", 0)
                check_length(self.path, f"offsets of {name}", min(len(offsets), self.n_steps), self.n_steps)
                begin = int(offsets[self._step(step)])
                finite = (
                    kind == "Point" and spec.components > 0
                )  # others may have none where nothing is measured
                values = self._rows(f"VTKHDF/{kind}Data/{name}", begin, n, spec.components, finite)
                if name == "group":
                    check_indices(self.path, name, values, max(1, len(self.group_names)))
                return values
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

    def edge_angles(self, step: int = -1) -> Reals | None:
        """(e,) director angles, rad, in the order of `edges`; None where the run has none."""
        if self.edges is None or not self._has(EDGES):
            return None
        count = len(self.edges)
        return self._rows(EDGES, self._step(step) * count, count, 0)

    def scalars(self, step: int = -1) -> dict[str, float]:
        """The figures stored with a step."""
        step = self._step(step)
        return {name: float(values[step]) for name, values in self.figures().items()}

    def figures(self) -> dict[str, Reals]:
        """(n_steps,) each, the figures stored with the steps."""
        names = member(self.path, self._file, FIGURES)
        return {name: self._figures(f"{FIGURES}/{name}") for name in (() if names is None else names)}

    def _figures(self, path: str) -> Reals:
        with intact(self.path):
            values: Reals = self._data(path, "reals", 0)[: self.n_steps]
        check_length(self.path, path, len(values), self.n_steps)
        return values

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

    # ---- the file's arrays, checked ----

    def _has(self, path: str) -> bool:
        with intact(self.path):
            return member(self.path, self._file, path) is not None

    def _names(self, group: str, known: dict[str, Field]) -> tuple[str, ...]:
        with intact(self.path):
            found = member(self.path, self._file, group)
            return tuple(name for name in (() if found is None else found) if find_field(known, name))

    def _data(self, path: str, kind: str = "numbers", columns: int | None = None) -> Any:
        with intact(self.path):
            return dataset(self.path, self._file, path, kind, columns)

    def _read(self, path: str, kind: str = "numbers", columns: int | None = None) -> Array:
        with intact(self.path):
            found: Array = self._data(path, kind, columns)[()]
            return found

    def _indices(self, path: str, columns: int, count: int, rows: int | None = None) -> Ints:
        """Indices below a count; rows: how many there must be."""
        found = self._read(path, "indices", columns).astype(np.int64, copy=False)
        check_length(self.path, path, len(found), len(found) if rows is None else rows)
        check_indices(self.path, path, found, count)
        return found

    def _places(self, path: str, rows: int | None = None) -> Reals:
        """Points (rows, 3) m."""
        found = self._read(path, "reals", 3)
        check_length(self.path, path, len(found), len(found) if rows is None else rows)
        check_finite(self.path, path, found)
        return found

    def _rows(self, path: str, begin: int, count: int, columns: int, finite: bool = True) -> Array:
        """Rows of a step."""
        with intact(self.path):
            found: Array = self._data(path, "numbers", columns)[max(0, begin) : max(0, begin) + count]
        check_length(self.path, path, len(found) if begin >= 0 else 0, count)
        if finite:
            check_finite(self.path, path, found)
        return found
