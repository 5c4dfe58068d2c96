"""Anderson acceleration of fixed-point iterations (Walker & Ni 2011, type II)."""

import numpy as np
from mpi4py import MPI


class Anderson:
    """Of iterates that several ranks hold parts of; `depth` earlier steps count."""

    def __init__(self, comm: MPI.Comm, depth: int):
        self.comm, self.depth = comm, depth
        self.forget()

    def forget(self) -> None:
        """Starts anew."""
        self._last: tuple[np.ndarray, np.ndarray] | None = None
        self._steps: list[np.ndarray] = []  # changes of the iterates plus those of their steps
        self._changes: list[np.ndarray] = []  # of the steps

    def next(self, y: np.ndarray, step: np.ndarray) -> np.ndarray:
        """The step to take from the iterate y, where the iteration itself would take `step`."""
        if self._last is not None and self.depth:
            was, stepped = self._last
            change = step - stepped
            self._changes = [*self._changes, change][-self.depth :]
            self._steps = [*self._steps, (y - was) + change][-self.depth :]
        self._last = y.copy(), step.copy()
        if not self._changes:
            return step
        basis = np.stack(self._changes)
        products = self.comm.allreduce(np.column_stack([basis @ basis.T, basis @ step]))
        share = np.linalg.lstsq(products[:, :-1], products[:, -1], rcond=1e-14)[0]
        return step - share @ np.stack(self._steps)
