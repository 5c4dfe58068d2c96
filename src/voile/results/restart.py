"""The folder `restart`: all that a run goes on from, one file per rank.

`last` names the newest complete set: it is replaced when all ranks have written theirs, so that a kill at any time
leaves a set that fits together.
"""

from __future__ import annotations

import io
import time
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from voile.arrays import Array
from voile.errors import InputError, on_all, on_root
from voile.files import fresh, made, replace, told
from voile.results.folder import RECORD

if TYPE_CHECKING:
    from mpi4py import MPI

FORMAT = 6  # of the arrays
OF = "of"  # the array that says which run a set is of


class Restarts:
    """What a run in a folder keeps to go on from. of: names the run's scene and meshes; lasting: all ranks see the
    folder, and a later run may go on from it."""

    PAUSE, SHARE = 0.5, 20.0  # s between two sets at least, and times what the last one took

    def __init__(self, folder: Path, comm: MPI.Comm, of: str, lasting: bool = True):
        self.folder, self.comm, self.lasting = folder, comm, lasting
        self.of = np.frombuffer(of.encode(), dtype=np.uint8)
        self.step, self._due = -1, time.perf_counter() + self.PAUSE

    def due(self) -> bool:
        """Whether it is time for another set. Collective."""
        return self.lasting and self.comm.bcast(time.perf_counter() >= self._due)

    def save(self, step: int, arrays: Mapping[str, Array], began: float | None = None) -> None:
        """Replaces the set that is there by each rank's arrays after a number of steps, which grows from set to set.
        began: when what belongs to it was begun (time.perf_counter). Collective."""
        began = time.perf_counter() if began is None else began
        inside = self.folder / "restart"

        def write() -> None:
            packed = io.BytesIO()  # zip files do not survive a full disk
            np.savez(packed, allow_pickle=False, **{OF: self.of}, **arrays)
            with told(inside), fresh(inside / f"{step}-{self.comm.rank}.npz") as file:
                file.write(packed.getbuffer())

        def commit() -> None:
            replace(inside / "last", f"{step} {self.comm.size} {FORMAT}\n".encode())
            for old in inside.glob("*.npz"):
                if not old.name.startswith(f"{step}-"):
                    old.unlink()

        if self.lasting and step > self.step:  # a set is never written over: a kill would leave none
            on_root(self.comm, lambda: made(inside))
            on_all(self.comm, write)
            on_root(self.comm, commit)
            self.step = step
        self._due = time.perf_counter() + max(self.PAUSE, self.SHARE * (time.perf_counter() - began))

    def clear(self) -> None:
        """Forgets what a run in the folder would go on from. Collective."""
        inside = self.folder / "restart"

        def forget() -> None:
            if inside.is_symlink() or not inside.is_dir():
                return  # what a link leads to is not the program's
            (inside / "last").unlink(missing_ok=True)
            for old in inside.glob("*.npz"):
                old.unlink()
            if not any(inside.iterdir()):
                inside.rmdir()

        on_root(self.comm, forget)

    def load(self) -> dict[str, Array]:
        """This rank's arrays of the newest complete set. Raises InputError where there is none of this run for as many
        ranks. Collective."""
        step, found = newest_step(self.folder, self.comm), dict[str, Array]()
        path = self.folder / "restart" / f"{step}-{self.comm.rank}.npz"

        def read() -> None:
            try:
                with np.load(path, allow_pickle=False) as file:
                    found.update(file)
                of = found.pop(OF)
            except Exception:  # zipfile and numpy raise anything at a damaged file
                raise InputError(f"{path}: damaged; a run cannot go on from it (--resume)") from None
            if not np.array_equal(of, self.of):
                raise InputError(
                    f"{self.folder}: of another scene, other meshes or other --set; allowed with --resume: those of "
                    "the run so far"
                )

        on_all(self.comm, read)
        self.step = step
        return found


def begun(folder: Path, comm: MPI.Comm) -> bool:
    """Whether a run has left something in the folder to go on from. Raises InputError where none has been there.
    Collective."""

    def look() -> bool:
        if not (folder / RECORD).exists():
            raise InputError(f"{folder}: nothing there that a run could go on from (--resume)")
        return (folder / "restart" / "last").exists()

    return bool(comm.bcast(on_root(comm, look)))


def newest_step(folder: Path, comm: MPI.Comm) -> int:
    """That of the newest complete set. Raises InputError where there is none for as many ranks. Collective."""

    def read() -> int:
        last = folder / "restart" / "last"
        try:
            step, ranks, *form = map(int, last.read_bytes().split())
            if form[1:]:
                raise ValueError
        except OSError:
            raise InputError(f"{folder}: nothing there that a run could go on from (--resume)") from None
        except ValueError:
            raise InputError(f"{last}: damaged; a run cannot go on from it (--resume)") from None
        if form != [FORMAT]:
            raise InputError(
                f"{folder}: another version of the program wrote it; allowed with --resume: the same"
            )
        if ranks != comm.size:
            raise InputError(
                f"{folder}: a run of {ranks} ranks, now {comm.size}; allowed with --resume: mpirun -n {ranks}"
            )
        return step

    return int(comm.bcast(on_root(comm, read)))
