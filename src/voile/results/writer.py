"""Writing `result.vtkhdf`: VTKHDF 2.0, a temporal UnstructuredGrid whose topology is stored once.

UnstructuredGrid rather than PolyData: its temporal form is the oldest (ParaView 5.12, VTK 9.3), and
PolyData's four cell lists per step buy nothing for triangles.

A run may be killed at any moment. So all HDF5 metadata is laid down once, for a capacity of steps, in a file
under a temporary name; a step then writes raw rows at fixed places that no reader looks at yet, and commits
by storing one integer, the attribute NSteps. Where the capacity runs out the file is rebuilt at twice the
size beside the old one and renamed over it; closing rebuilds it to the exact size. Rows not yet written are
holes and take no disk space.

VTK copies all of Steps/Values into an array of NSteps numbers, so Values must never be longer than NSteps: it
grows just after. A kill between these two writes leaves VTK with the time 0 for the last step; `read_result`
takes the times from its own copy, written before the commit.

VTK looks for a step by its time, so these must grow. Along the arc of a path, where load factors also fall, they are
the steps' numbers; the own copy has the load factors.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from voile.arrays import Array, Ints, Reals
from voile.errors import InputError, NotWritten, on_all, on_root
from voile.files import part_of, reserve, take, told
from voile.results.checks import intact
from voile.results.fields import (
    CELL_FIELDS,
    EDGE_ANGLES,
    FORMAT_VERSION,
    PLACEMENT,
    POINT_FIELDS,
    Field,
    find_field,
)
from voile.results.folder import set_aside
from voile.results.slabs import Slabs
from voile.results.static import OBSTACLES, StaticMesh, known, static_datasets

if TYPE_CHECKING:
    from mpi4py import MPI

CAPACITY = 16  # steps, at first
COPY_BYTES = 1 << 26  # per piece when a file is rebuilt
# Bytes of a file's tables, generously: what HDF5 takes for all fields, and of each table for a step; the tables that
# VTK wants beside one for each field.
TABLES, A_TABLE, OWN_TABLES = 1 << 17, 8, 6
PAGE = 1 << 12  # bytes, that disks give at least to whatever lies apart
POINTS, EDGES = "VTKHDF/Points", "voile/edge_angles"
STEPS, VALUES, OWN_VALUES = "VTKHDF/Steps", "VTKHDF/Steps/Values", "voile/values"


@dataclass(frozen=True)
class _Stepped:
    """A dataset with `rows` rows per step."""

    rows: int
    spec: Field


class ResultWriter:
    """Writes steps to `path`, every rank its own rows. All methods are collective over `comm`.

    mesh is needed on rank 0 only. With more than one rank the file is written in parallel where h5py was
    built with MPI, else gathered on rank 0; gather=True or the environment's VOILE_GATHER=1 forces the
    latter. A result already at `path` stays until the first step is complete; it and its summary are then
    kept as `*.previous.*`. goes_on: steps after which a result at `path` of the same scene goes on, 0: anew;
    numbered: times for VTK are the steps' numbers; room: for how many steps the file is made, which costs nothing where
    just so many come. A writer is a context manager; after a crash the file
    holds the last complete step.
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        comm: MPI.Comm,
        *,
        mesh: StaticMesh | None,
        scene_text: str = "",
        versions: Mapping[str, str] | None = None,
        gather: bool = False,
        goes_on: int = 0,
        numbered: bool = False,
        room: int = CAPACITY,
    ):
        self.path, self.comm, self.steps, self.numbered = Path(path), comm, 0, numbered
        self._scene_text, self._versions = scene_text, dict(versions or {})
        self._h5py = import_h5py(comm)
        gather = gather or os.environ.get("VOILE_GATHER", "") not in ("", "0")
        self.parallel = comm.size > 1 and bool(self._h5py.get_config().mpi) and not gather
        self._static: dict[str, Array] = {}
        self._group_names: tuple[str, ...] = ()
        if comm.rank == 0:
            if mesh is None:
                raise ValueError("rank 0 must pass the mesh")
            self._static, self._group_names = static_datasets(mesh), mesh.group_names
            sizes = [len(mesh.start), len(mesh.triangles), 0 if mesh.edges is None else len(mesh.edges)]
        self.n_points, self.n_cells, self.n_edges = comm.bcast(sizes if comm.rank == 0 else None)
        self._stepped: dict[str, _Stepped] = {}
        self._capacity = room
        self._file: Any = None
        self._found: dict[str, Any] = {}  # what is open of it: looking up by name takes h5py 0.1 ms
        self._opened = self.path
        if goes_on:
            self.steps, self._capacity = comm.bcast(on_root(comm, lambda: self._cut_after(goes_on)))

    def __enter__(self) -> ResultWriter:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if kind and issubclass(kind, NotWritten):  # no room for a smaller copy
            self._close_file()
        self.close()

    def write_step(
        self,
        value: float,
        points: Reals,
        point_index: Ints,
        *,
        point_data: Mapping[str, Array] | None = None,
        cell_data: Mapping[str, Reals] | None = None,
        cell_index: Ints | None = None,
        edge_angles: Reals | None = None,
        edge_index: Ints | None = None,
        scalars: Mapping[str, float] | None = None,
        placements: Reals | None = None,
    ) -> None:
        """Append one step at `value` (time in s or load factor); readable when it returns.

        points (k, 3) m and point_data {name: (k, ...)} of the vertices this rank owns, point_index (k,) their
        place in the input's order; cell_data and edge_angles likewise with their index. scalars: figures of
        the step; placements (k, 4, 4) of the mesh's bodies; both the same on all ranks. Every step has the same
        names; names are those of `fields` (ValueError otherwise).
        """
        rows: dict[str, tuple[Any, int, Any, Field]] = {
            POINTS: (points, self.n_points, point_index, Field("m", "position", 3))
        }
        for name, data in (point_data or {}).items():
            rows[f"VTKHDF/PointData/{name}"] = (data, self.n_points, point_index, known(POINT_FIELDS, name))
        for name, data in (cell_data or {}).items():
            rows[f"VTKHDF/CellData/{name}"] = (data, self.n_cells, cell_index, known(CELL_FIELDS, name))
        if edge_angles is not None:
            rows[EDGES] = (edge_angles, self.n_edges, edge_index, EDGE_ANGLES)
        figure = Field("", "figure of a step")
        single: dict[str, tuple[Any, Field]] = {
            f"voile/steps/{name}": (float(x), figure) for name, x in (scalars or {}).items()
        }
        single[OWN_VALUES] = (float(value), figure)
        for k, matrix in enumerate(() if placements is None else placements):
            single[f"{OBSTACLES}/{k}/placement"] = (np.ravel(matrix), PLACEMENT)
        self._open({path: _Stepped(n, spec) for path, (_, n, _, spec) in rows.items()}, single)
        on_root(self.comm, self._make_room)
        slabs: dict[tuple[int, int], Slabs] = {}
        for path, (data, n, index, spec) in rows.items():
            plan = slabs.get((n, id(index)))
            if plan is None:
                plan = slabs[n, id(index)] = Slabs(self.comm, n, index, gather=not self.parallel)
            slab = plan.move(np.asarray(data, dtype=spec.dtype).reshape(len(index), *spec.row_shape))
            on_all(self.comm, partial(self._put, path, self.steps * n + plan.begin, slab))
        self._commit(value, single)

    def _item(self, path: str) -> Any:
        """A dataset or group of the open file."""
        if path not in self._found:
            self._found[path] = self._file[path]
        return self._found[path]

    def _put(self, path: str, begin: int, rows: Array) -> None:
        if self._file is not None:
            with told(self.path):
                self._item(path)[begin : begin + len(rows)] = rows

    def close(self) -> None:
        """Close the file, cut to the steps it holds. Collective; a second call does nothing."""
        try:
            there = self.steps and self._opened == self.path  # a signal may come before the first step is
            if there and self._stepped and self._capacity != self.steps:
                self._rebuild(self.steps)
        finally:
            self._close_file()

    def _close_file(self) -> None:
        """Closes it; what a signal left of a new one goes."""
        if self._file is not None:
            self._file.close()
        if self.comm.rank == 0:
            self._part.unlink(missing_ok=True)
        self._file, self._found, self._stepped = None, {}, {}

    def _open(self, stepped: dict[str, _Stepped], single: Mapping[str, tuple[Any, Field]]) -> None:
        """Create the file at the first step, make room at later ones."""
        stepped = stepped | {path: _Stepped(1, spec) for path, (_, spec) in single.items()}
        if not self._stepped and self.steps:
            self._stepped = stepped
            self._reopen(self.path)
            if self.steps == self._capacity:
                self._rebuild(2 * self._capacity)
        elif not self._stepped:
            self._stepped = stepped
            on_root(self.comm, lambda: self._create(self._part, self._capacity, self._static))
            self._static = {}
            self._reopen(self._part)
        elif stepped != self._stepped:
            changed = sorted(set(stepped) ^ set(self._stepped))
            raise ValueError(
                f"every step of a result has the same fields; these come and go: {', '.join(changed)}"
            )
        elif self.steps == self._capacity:
            self._rebuild(2 * self._capacity)

    def _cut_after(self, steps: int) -> tuple[int, int]:
        """Drops the steps of the file that is there beyond so many; these, and for how many there is room. Raises
        InputError where it is of another scene, or has fewer."""
        if not self._h5py.is_hdf5(self.path):
            raise InputError(f"{self.path}: no result that a run could go on from (--resume)")
        with intact(self.path), self._h5py.File(self.path, "r+", locking=False) as file:
            if file["voile/scene"][()].tobytes().decode("utf-8") != self._scene_text:
                raise InputError(
                    f"{self.path}: of another scene, or other --set; allowed with --resume: those of the run so far"
                )
            if file[STEPS].attrs["NSteps"] < steps:
                raise InputError(
                    f"{self.path}: fewer steps than the {steps} that the run goes on from (--resume)"
                )
            file[STEPS].attrs.modify("NSteps", np.int64(steps))
            file[VALUES].resize((steps,))
            file[VALUES][:] = np.arange(1.0, steps + 1) if self.numbered else file[OWN_VALUES][:steps]
            return steps, len(file[OWN_VALUES])

    @property
    def _part(self) -> Path:
        return part_of(self.path)

    def _reopen(self, path: Path) -> None:
        self.comm.barrier()
        self._opened, self._found = path, {}
        if self.parallel:
            self._file = self._h5py.File(path, "r+", driver="mpio", comm=self.comm)
        elif self.comm.rank == 0:  # no lock: ParaView may look on while the run goes
            self._file = self._h5py.File(path, "r+", locking=False)

    def _make_room(self) -> None:
        """Takes the room of the next step from the disk, so that HDF5, which does not survive a full one, finds it.
        Its tables have theirs since the file was made."""
        kept = f"; it holds {self.steps} complete steps" if self.steps else ""
        with told(self.path, kept), open(self._opened, "r+b") as file:
            for name, entry in self._stepped.items():
                data = self._item(name) if self._file is not None else None
                begin = data.id.get_offset() if data is not None else None
                size = entry.rows * entry.spec.row_size
                if begin is not None and size:
                    take(file, begin + self.steps * size, size)

    def _commit(self, value: float, single: Mapping[str, tuple[Any, Field]]) -> None:
        """Make the step visible: NSteps goes up when all its rows are in the file."""
        if self._file is not None:
            if self.comm.rank == 0:
                for path, (x, _) in single.items():
                    self._item(path)[self.steps] = x
            self._file.flush()
        self.comm.barrier()
        self.steps += 1
        if self._file is not None:
            self._item(STEPS).attrs.modify("NSteps", np.int64(self.steps))
            self._file.flush()
            self._item(VALUES).resize((self.steps,))
            if self.comm.rank == 0:
                self._item(VALUES)[self.steps - 1] = self.steps if self.numbered else value
            self._file.flush()
        if self.steps == 1:
            on_root(self.comm, self._publish)
            self._opened = self.path

    def _publish(self) -> None:
        set_aside(self.path)
        os.replace(self._part, self.path)

    def _rebuild(self, capacity: int) -> None:
        if self._file is not None:
            self._file.close()
            self._file = None
        self.comm.barrier()

        def copy() -> None:
            with self._h5py.File(self.path, "r", locking=False) as old:
                names: list[str] = []
                old.visititems(lambda name, item: names.append(name) if hasattr(item, "dtype") else None)
                static = {name: old[name][()] for name in names if "static" in old[name].attrs}
                self._create(self._part, capacity, static, self.steps)
                with self._h5py.File(self._part, "r+", locking=False) as new:
                    for path, entry in self._stepped.items():
                        _copy_rows(old[path], new[path], self.steps * entry.rows)
                    new[STEPS].attrs.modify("NSteps", np.int64(self.steps))
                    new[VALUES].resize((self.steps,))
                    new[VALUES][:] = old[VALUES][: self.steps]
            os.replace(self._part, self.path)

        on_root(self.comm, copy)
        self._capacity = capacity
        self._reopen(self.path)

    def _create(self, path: Path, capacity: int, static: Mapping[str, Array], steps: int = 0) -> None:
        """An empty result for `capacity` steps: all metadata, the static rows, room for the stepped ones. `steps` of
        them are to be written at once: the disk must have room for these."""
        h5py = self._h5py
        a_step = sum(entry.rows * entry.spec.row_size for entry in self._stepped.values())
        pages = PAGE * (OWN_TABLES + 2 * (len(static) + len(self._stepped)))
        tables = TABLES + capacity * A_TABLE * (OWN_TABLES + len(static) + len(self._stepped)) + pages
        with told(self.path):
            reserve(path, sum(data.nbytes for data in static.values()) + steps * a_step + tables)
        path.unlink()
        with told(self.path), h5py.File(path, "x", locking=False) as file:
            head = file.create_group("VTKHDF")
            head.attrs["Version"] = np.array([2, 0], dtype=np.int64)
            head.attrs.create("Type", b"UnstructuredGrid", dtype=h5py.string_dtype("ascii", 16))
            voile = file.create_group("voile")
            voile.attrs["format_version"] = FORMAT_VERSION
            voile.attrs["versions"] = json.dumps(self._versions)
            voile.attrs["group_names"] = json.dumps(self._group_names)
            voile["scene"] = np.frombuffer(self._scene_text.encode("utf-8"), dtype=np.uint8)
            for name, data in static.items():
                file.create_dataset(name, data=data).attrs["static"] = 1
                _describe(file[name])
            for name, entry in self._stepped.items():
                # laid out now and never moved; unwritten rows stay holes in the file
                room = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
                room.set_alloc_time(h5py.h5d.ALLOC_TIME_EARLY)
                room.set_fill_time(h5py.h5d.FILL_TIME_NEVER)
                shape = (capacity * entry.rows, *entry.spec.row_shape)
                file.create_dataset(name, shape, entry.spec.dtype, dcpl=room)
                _describe(file[name])
            self._create_steps(file["VTKHDF"], capacity)

    def _create_steps(self, head: Any, capacity: int) -> None:
        """The tables that say where each step's rows begin: static rows are read from 0 at every step."""
        steps = head.require_group("Steps")
        steps.attrs["NSteps"] = np.int64(0)
        early = self._h5py.h5p.create(self._h5py.h5p.DATASET_CREATE)
        early.set_alloc_time(self._h5py.h5d.ALLOC_TIME_EARLY)
        steps.create_dataset("Values", (1,), np.float64, maxshape=(capacity,), chunks=(capacity,), dcpl=early)
        zero = np.zeros(capacity, dtype=np.int64)
        step = np.arange(capacity, dtype=np.int64)
        steps["PartOffsets"], steps["NumberOfParts"] = zero, zero + 1
        steps["PointOffsets"] = step * self.n_points
        steps["CellOffsets"], steps["ConnectivityIdOffsets"] = zero[:, None], zero[:, None]
        for kind, n in (("Point", self.n_points), ("Cell", self.n_cells)):
            for name in head.get(f"{kind}Data", {}):
                moves = f"VTKHDF/{kind}Data/{name}" in self._stepped
                steps[f"{kind}DataOffsets/{name}"] = step * n if moves else zero


def import_h5py(comm: MPI.Comm) -> Any:
    """h5py, the MPI build where there is one and `comm` has several ranks.

    Debian installs both builds and picks at the first import, by mpirun's environment only; other launchers
    need its H5PY_ALWAYS_USE_MPI.
    """
    if comm.size > 1:
        os.environ.setdefault("H5PY_ALWAYS_USE_MPI", "1")
    import h5py

    return h5py


def _describe(dataset: Any) -> None:
    parent, name = dataset.name.rsplit("/", 1)
    tables = {"/VTKHDF/PointData": POINT_FIELDS, "/VTKHDF/CellData": CELL_FIELDS}
    if spec := find_field(tables.get(parent, {}), name):
        dataset.attrs["unit"], dataset.attrs["meaning"] = spec.unit, spec.meaning


def _copy_rows(old: Any, new: Any, count: int) -> None:
    piece = max(1, COPY_BYTES // max(1, old.dtype.itemsize * int(np.prod(old.shape[1:]))))
    for begin in range(0, count, piece):
        end = min(begin + piece, count)
        new[begin:end] = old[begin:end]
