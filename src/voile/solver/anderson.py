"""Anderson acceleration of fixed-point iterations (Walker & Ni 2011, type II)."""

import numpy as np
from mpi4py import MPI

from voile import _projective
from voile.arrays import Reals


class Anderson:
    """Of iterates that several ranks hold parts of, `size` numbers here; `depth` earlier steps count."""

    def __init__(self, comm: MPI.Comm, size: int, depth: int):
        self.comm = comm
        self._memory = _projective.Memory(size, depth)
        self._local, self._total = np.zeros(2 * depth), np.zeros(2 * depth)

    def forget(self) -> None:
        """Starts anew."""
        self._memory.forget()

    def step(self, y: Reals, step: Reals, out: Reals) -> None:
        """Writes to `out` the step to take from the iterate y, where the iteration itself would take `step`."""
        self._memory.add(y, step, self._local)
        self.comm.Allreduce(self._local, self._total)
        self._memory.combine(self._total, out)
