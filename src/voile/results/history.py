"""`history.h5`: figures of every step of a run in time, in the group /voile/history, one dataset each.

HDF5 files that grow do not survive a kill. So rows are kept in memory and the file is written anew beside the old one,
which it replaces, at times that cost little of the run's.
"""

from __future__ import annotations

import mmap
import os
import time
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from voile.arrays import Array, Reals
from voile.errors import InputError, on_root
from voile.files import replace
from voile.results.checks import check_length, dataset, intact, member, open_file
from voile.results.writer import import_h5py

if TYPE_CHECKING:
    from mpi4py import MPI

PAUSE, SHARE = 2.0, 20.0  # s between two writes at least, and that many times what the last one took


class Column:
    """An array that rows are added to."""

    def __init__(self, rows: Reals):
        self._array, self.count = np.array(rows), len(rows)

    @property
    def rows(self) -> Reals:
        """Those so far."""
        return self._array[: self.count]

    def append(self, row: Any) -> None:
        """Makes room for as many again where there is none."""
        if self.count == len(self._array):
            grown = np.empty((self.count + max(self.count, 64), *self._array.shape[1:]), self._array.dtype)
            grown[: self.count] = self._array  # memory that nothing has been written to costs nothing
            self._array = grown
        self._array[self.count] = row
        self.count += 1


class HistoryWriter:
    """Rows of figures; only rank 0 has any. kept: columns of the rows that a resumed run begins with."""

    def __init__(self, path: Path, comm: MPI.Comm, kept: Mapping[str, Array] | None = None):
        self.path, self.comm = path, comm
        self._columns = {name: Column(values) for name, values in (kept or {}).items()}
        self._h5py = import_h5py(comm)
        self._due = time.perf_counter() + PAUSE

    def add(self, row: Mapping[str, Any]) -> None:
        """One step; writes the file now and then. Collective."""

        def add() -> None:
            for name, value in row.items():
                if name not in self._columns:
                    self._columns[name] = Column(np.empty((0, *np.shape(value)), np.asarray(value).dtype))
                self._columns[name].append(value)
            if time.perf_counter() > self._due:
                self._write()

        on_root(self.comm, add)

    def write(self) -> None:
        """Puts all rows into the file. Collective."""
        on_root(self.comm, self._write)

    def _write(self) -> None:
        if not self._columns:
            return
        began = time.perf_counter()
        # Made in memory, for HDF5 does not survive a full disk; not the heap's, where images that grow leave holes.
        with os.fdopen(os.memfd_create("history"), "w+b") as memory:
            with self._h5py.File(memory, "w") as file:
                group = file.create_group("voile/history")
                for name, values in self._columns.items():
                    group[name] = values.rows
            memory.flush()
            with mmap.mmap(memory.fileno(), 0, access=mmap.ACCESS_READ) as image:
                replace(self.path, image)
        self._due = time.perf_counter() + max(PAUSE, SHARE * (time.perf_counter() - began))


def read_history(path: str | os.PathLike[str]) -> dict[str, Array]:
    """Columns of a history (file, or folder with it). Raises InputError where there is none."""
    path = Path(path)
    path = path / "history.h5" if path.is_dir() else path
    import h5py

    if not h5py.is_hdf5(path):
        raise InputError(f"{path}: no history of a run in time")
    with intact(path), open_file(path) as file:
        group = member(path, file, "voile/history")
        if group is None:
            raise InputError(f"{path}: no history of a run in time")
        found = {name: dataset(path, group, name)[()] for name in group}
        for name, values in found.items():
            check_length(path, name, len(values), len(found.get("time", ())))
        return found
