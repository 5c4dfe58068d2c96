"""Anderson acceleration of fixed-point iterations (Walker & Ni 2011, type II)."""

import numpy as np
from mpi4py import MPI

from voile import _projective
from voile.arrays import Reals

FAINT = 1e-14  # of the largest: singular values of the changes' products that are round-off


class Anderson:
    """Of iterates that several ranks hold parts of, `size` numbers here; `depth` earlier steps count."""

    def __init__(self, comm: MPI.Comm, size: int, depth: int):
        self.comm, self.depth = comm, depth
        self._memory = _projective.Memory(size, depth)
        self._gram = np.zeros((depth, depth))
        self._local, self._total = np.zeros(2 * depth), np.zeros(2 * depth)

    def forget(self) -> None:
        """Starts anew."""
        self._memory.forget()

    def step(self, y: Reals, step: Reals, out: Reals) -> None:
        """Writes to `out` the step to take from the iterate y, where the iteration itself would take `step`."""
        memory, depth = self._memory, self.depth
        memory.add(y, step)
        kept = memory.kept
        if not kept:
            out[:] = step
            return
        memory.products(self._local)
        self.comm.Allreduce(self._local, self._total)
        row, right = self._total[:kept], self._total[depth : depth + kept]
        self._gram[memory.newest, :kept] = self._gram[:kept, memory.newest] = row
        share = np.linalg.lstsq(self._gram[:kept, :kept], right, rcond=FAINT)[0]
        memory.combine(share, out)
