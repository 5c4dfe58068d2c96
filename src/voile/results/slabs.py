"""From the rows each rank owns, anywhere in the global order, to contiguous slabs for a file."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from voile.arrays import Array, Ints

if TYPE_CHECKING:
    from mpi4py import MPI


class Slabs:
    """Who writes which of n global rows: even slabs over the ranks, or all of them on rank 0 (`gather`).

    `index` (k,) are the global rows this rank owns, each row owned by exactly one rank (ValueError otherwise,
    on every rank). Collective.
    """

    def __init__(self, comm: MPI.Comm, n: int, index: Ints, gather: bool):
        index = np.asarray(index, dtype=np.int64)
        fractions = np.minimum(np.arange(comm.size + 1), 1 if gather else comm.size)
        bounds = fractions * n // (1 if gather else comm.size)
        in_range = index.size == 0 or (index.min() >= 0 and index.max() < n)
        if not comm.allreduce(int(in_range), op=_min()):
            raise ValueError(f"a global index lies outside 0..{n - 1}")
        self.comm, self.begin, self.end = comm, int(bounds[comm.rank]), int(bounds[comm.rank + 1])
        self.order = np.argsort(index, kind="stable")
        target = np.searchsorted(bounds, index, side="right") - 1
        self.sent = np.bincount(target, minlength=comm.size).astype(np.int32)
        self.received = np.empty_like(self.sent)
        comm.Alltoall(self.sent, self.received)
        self.place = np.arange(self.received.sum())
        self.place = self.move(index) - self.begin
        once = np.array_equal(np.bincount(self.place, minlength=len(self)), np.ones(len(self)))
        if not comm.allreduce(int(once), op=_min()):
            raise ValueError(f"each of the {n} global indices must be owned by exactly one rank")

    def __len__(self) -> int:
        return self.end - self.begin

    def move(self, rows: Array) -> Array:
        """The slab's rows in global order, from this rank's `rows` (k, ...) in `index` order. Collective."""
        from mpi4py import MPI

        rows = np.ascontiguousarray(np.asarray(rows)[self.order])
        arrived = np.empty((int(self.received.sum()), *rows.shape[1:]), dtype=rows.dtype)
        row = MPI.BYTE.Create_contiguous(rows.dtype.itemsize * int(np.prod(rows.shape[1:]))).Commit()
        self.comm.Alltoallv([rows, (self.sent, None), row], [arrived, (self.received, None), row])
        row.Free()
        slab = np.empty_like(arrived)
        slab[self.place] = arrived
        return slab


def _min() -> MPI.Op:
    from mpi4py import MPI

    return MPI.MIN
