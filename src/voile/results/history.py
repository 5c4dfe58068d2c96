"""`history.h5`: figures of every step of a run in time, in the group /voile/history, one dataset each.

HDF5 files that grow do not survive a kill. So the file is written anew beside the old one, which it replaces, at times
that cost little of the run's. Only rows since then are kept in memory.
"""

from __future__ import annotations

import mmap
import os
import time
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from voile.arrays import Array
from voile.errors import InputError, on_root
from voile.files import replace, take, told
from voile.results.checks import check_length, dataset, intact, member, open_file
from voile.results.writer import import_h5py

if TYPE_CHECKING:
    from mpi4py import MPI

PIECE = 1 << 12  # rows that are copied at a time: no array is as long as the run
PAUSE, SHARE = 2.0, 20.0  # s between two writes at least, and that many times what the last one took
TABLES, A_TABLE = (
    1 << 13,
    1 << 10,
)  # bytes that HDF5 takes beside the rows, generously, of the file and of a column


class Column:
    """Rows like a first one; those since the last write."""

    def __init__(self, like: Any):
        self._array, self.count = np.empty((64, *np.shape(like)), np.asarray(like).dtype), 0

    @property
    def rows(self) -> Array:
        """Those that are there."""
        return self._array[: self.count]

    def append(self, row: Any) -> None:
        """Makes room for as many again where there is none."""
        if self.count == len(self._array):
            self._array = np.concatenate([self._array, np.empty_like(self._array)])
        self._array[self.count] = row
        self.count += 1


class HistoryWriter:
    """Rows of figures; only rank 0 has any. Rows since the last write are in memory, those before in the file, which is
    kept open: whoever removes it takes nothing. stored: rows of the file that is there, which a resumed run goes on
    after."""

    def __init__(self, path: Path, comm: MPI.Comm, stored: int = 0):
        self.path, self.comm, self.stored = path, comm, stored
        self._columns: dict[str, Column] = {}
        self._h5py = import_h5py(comm)
        self._file = path.open("rb") if stored and not comm.rank else None
        self._due = time.perf_counter() + PAUSE

    def add(self, row: Mapping[str, Any]) -> None:
        """One step; writes the file now and then. Collective."""

        def add() -> None:
            for name, value in row.items():
                self._columns.setdefault(name, Column(value)).append(value)
            if time.perf_counter() > self._due:
                self._write()

        on_root(self.comm, add)

    def write(self) -> None:
        """Puts all rows into the file. Collective."""
        on_root(self.comm, self._write)

    def close(self) -> None:
        """Lets the file go; nothing is added after it."""
        if self._file:
            self._file.close()

    def _write(self) -> None:
        if not self._columns and not self.stored:
            return
        began = time.perf_counter()
        # Made in memory, for HDF5 does not survive a full disk; not the heap's, where images that grow leave holes.
        size = TABLES + sum(A_TABLE + values.rows.nbytes for values in self._columns.values())
        with told(self.path), os.fdopen(os.memfd_create("history"), "w+b") as memory:
            take(memory, 0, size)  # nor does it survive a limit on files, which holds for this one, too
            memory.truncate(0)
            with self._h5py.File(memory, "w") as file:
                count = self._fill(file.create_group("voile/history"))
            memory.flush()
            with mmap.mmap(memory.fileno(), 0, access=mmap.ACCESS_READ) as image:
                replace(self.path, image)
        self.stored = count
        for column in self._columns.values():
            column.count = 0
        if self._file:
            self._file.close()
        self._file = self.path.open("rb")
        self._due = time.perf_counter() + max(PAUSE, SHARE * (time.perf_counter() - began))

    def _fill(self, group: Any) -> int:
        """Puts the rows of the file so far and those since into a group, a dataset for each figure; how many."""
        since = {name: column.rows for name, column in self._columns.items()}
        if self._file is None:
            for name, rows in since.items():
                group[name] = rows
            return len(group["time"])
        with self._h5py.File(self._file, "r") as file:
            for name, old in file["voile/history"].items():
                new = since.get(name, old[:0])
                rows = group.create_dataset(name, (self.stored + len(new), *old.shape[1:]), old.dtype)
                for begin in range(0, self.stored, PIECE):
                    end = min(begin + PIECE, self.stored)
                    rows[begin:end] = old[begin:end]
                rows[self.stored :] = new
        return len(group["time"])


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
