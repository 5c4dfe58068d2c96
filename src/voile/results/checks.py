"""What a reader believes of an HDF5 file that someone may have damaged or prepared.

Every dataset is reached here: by links that stay in the file, stored in the file itself, no larger than it, of numbers,
of the shape expected. So nothing of another file is read, and no memory is asked for that the file does not fill.
"""

from __future__ import annotations

import mmap
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from voile.arrays import Ints, Reals
from voile.errors import InputError
from voile.mesh.guards import send_ahead

LARGEST = (
    1e30  # m, N, ...: numbers beyond have squares that single precision, which viewers use, does not hold
)
HEAP = b"GCOL\x01\0\0\0"
LOOKED_AT = 1 << 28  # bytes of a file: its strings come before its steps
DEFLATES = 1032  # times at most, of data that deflate packs (zlib)
KINDS = {"numbers": "iufb", "indices": "iu", "reals": "f"}


@contextmanager
def intact(path: Path) -> Iterator[None]:
    """Whatever goes wrong within is the file's fault: InputError."""
    try:
        yield
    except InputError:
        raise
    except RecursionError:
        raise InputError(f"{path}: damaged result file: nested too deeply") from None
    except Exception as error:  # h5py and numpy raise anything at a damaged file
        raise InputError(f"{path}: damaged result file: {_first_line(error)}") from None


def open_file(path: Path) -> Any:
    """An HDF5 file, open for reading. InputError where the library would not come back from its strings, or crash."""
    import h5py

    _check_strings(path)
    send_ahead(path)
    return h5py.File(path, "r", locking=False)


def _check_strings(path: Path) -> None:
    """InputError for a heap of strings with an object that is free and takes no room: HDF5 looks there without end.
    (HDF5 file format, III.E: objects of index, count, reserved, size and data, each of a multiple of 8 bytes)."""
    with open(path, "rb") as file:
        size = min(os.fstat(file.fileno()).st_size, LOOKED_AT)
        if not size:
            return
        with mmap.mmap(file.fileno(), size, access=mmap.ACCESS_READ) as data:
            heap = data.find(HEAP)
            while heap >= 0:
                end = min(heap + int.from_bytes(data[heap + 8 : heap + 16], "little"), size)
                at = heap + 16
                while at + 16 <= end:
                    index = int.from_bytes(data[at : at + 2], "little")
                    room = int.from_bytes(data[at + 8 : at + 16], "little")
                    if not (index or room):
                        raise InputError(f"{path}: damaged result file: its strings have no end")
                    at += 16 + (room + 7) // 8 * 8 if index else room
                heap = data.find(HEAP, heap + 16)


def member(path: Path, group: Any, name: str) -> Any:
    """The dataset or group of that name, None where there is none. InputError for links and data of other files."""
    import h5py

    here = group
    for part in name.split("/"):
        if not isinstance(here, h5py.Group):
            return None
        link = here.get(part, getlink=True)
        if link is None:
            return None
        if not isinstance(link, h5py.HardLink):
            raise InputError(
                f"{path}: damaged result file: {name} is a link; data of the file itself expected"
            )
        here = here[part]
    if isinstance(here, h5py.Dataset):
        _check_storage(path, name, here)
    return here


def dataset(path: Path, group: Any, name: str, kind: str = "numbers", columns: int | None = None) -> Any:
    """A dataset that must be there. kind: of KINDS; columns: 0 for (n,), k for (n, k), None for any."""
    import h5py

    found = member(path, group, name)
    if not isinstance(found, h5py.Dataset):
        raise InputError(f"{path}: damaged result file: {name} is missing")
    if found.dtype.kind not in KINDS[kind] or (
        columns is not None and found.shape[1:] != ((columns,) if columns else ())
    ):
        raise InputError(
            f"{path}: damaged result file: {name} is of {found.dtype} {found.shape}; {kind} expected"
        )
    return found


def check_indices(path: Path, name: str, indices: Ints, count: int) -> None:
    """InputError unless all are from 0 to count - 1."""
    if indices.size and not (indices.min() >= 0 and indices.max() < count):
        raise InputError(f"{path}: damaged result file: {name} has indices outside 0 to {count - 1}")


def check_finite(path: Path, name: str, values: Reals) -> None:
    """InputError for numbers that are not finite, or no quantity of this world."""
    with np.errstate(invalid="ignore"):
        good = bool((np.abs(values) <= LARGEST).all())
    if not good:
        raise InputError(
            f"{path}: damaged result file: {name} has numbers that are not finite, or beyond {LARGEST:g}"
        )


def check_length(path: Path, name: str, found: int, expected: int) -> None:
    """InputError unless the rows are as many as they must be."""
    if found != expected:
        raise InputError(f"{path}: damaged result file: {name} has {found} rows; {expected} expected")


def _check_storage(path: Path, name: str, data: Any) -> None:
    layout = data.id.get_create_plist()
    if data.is_virtual or layout.get_external_count():
        raise InputError(
            f"{path}: damaged result file: {name} is stored in another file; data of the file itself expected"
        )
    size = data.dtype.itemsize * int(np.prod(data.shape, dtype=object))
    if data.chunks is None:
        within = size <= max(data.file.id.get_filesize(), 0)
    else:
        packed = DEFLATES if layout.get_nfilters() else 1
        within = size <= max(packed * data.id.get_storage_size(), data.dtype.itemsize)
    if not within:
        raise InputError(f"{path}: damaged result file: {name} is larger than the file")


def _first_line(error: Exception) -> str:
    lines = str(error.args[0] if error.args else error).splitlines()
    return f"{type(error).__name__}: {lines[0]}" if lines else type(error).__name__
