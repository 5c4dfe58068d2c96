"""The folder `restart`: all that a run in time goes on from, one file per rank.

`last` names the newest complete set: it is replaced when all ranks have written theirs, so that a kill at any time
leaves a set that fits together.
"""

from __future__ import annotations

import io
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from voile.arrays import Array
from voile.errors import InputError, on_all, on_root
from voile.results.folder import fresh, replace, told

if TYPE_CHECKING:
    from mpi4py import MPI

FORMAT = 2  # of the arrays


def save_restart(folder: Path, comm: MPI.Comm, step: int, arrays: Mapping[str, Array]) -> None:
    """Replaces what is in the run's folder by each rank's arrays after a number of steps. Collective."""
    inside = folder / "restart"
    on_root(comm, lambda: inside.mkdir(exist_ok=True))

    def save() -> None:
        packed = io.BytesIO()  # zip files do not survive a full disk
        np.savez(packed, **arrays)
        with told(inside), fresh(inside / f"{step}-{comm.rank}.npz") as file:
            file.write(packed.getbuffer())

    def commit() -> None:
        with told(inside):
            replace(inside / "last", f"{step} {comm.size} {FORMAT}\n".encode())
        for old in inside.glob("*.npz"):
            if not old.name.startswith(f"{step}-"):
                old.unlink()

    on_all(comm, save)
    on_root(comm, commit)


def clear_restart(folder: Path, comm: MPI.Comm) -> None:
    """Forgets what an earlier run in the folder would go on from. Collective."""
    on_root(comm, lambda: (folder / "restart" / "last").unlink(missing_ok=True))


def newest_step(folder: Path, comm: MPI.Comm) -> int:
    """That of the newest complete set. Raises InputError where there is none for as many ranks. Collective."""

    def read() -> int:
        try:
            step, ranks, *form = map(int, (folder / "restart" / "last").read_text().split())
        except (OSError, ValueError):
            raise InputError(f"{folder}: nothing there that a run could go on from (--resume)") from None
        if form != [FORMAT]:
            raise InputError(
                f"{folder}: another version of the program wrote it; allowed with --resume: the same"
            )
        if ranks != comm.size:
            raise InputError(
                f"{folder}: a run of {ranks} ranks, now {comm.size}; allowed with --resume: mpirun -n {ranks}"
            )
        return step

    return comm.bcast(on_root(comm, read))


def load_restart(folder: Path, comm: MPI.Comm) -> dict[str, Array]:
    """This rank's arrays of the newest complete set. Raises InputError where there is none for as many ranks."""
    step = newest_step(folder, comm)
    with np.load(folder / "restart" / f"{step}-{comm.rank}.npz", allow_pickle=False) as file:
        return dict(file)
