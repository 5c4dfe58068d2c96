"""What contact remembers from step to step."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from voile.arrays import Ints, Reals
from voile.contact.candidates import Candidates
from voile.contact.obstacle import Start

PER_PARTNER = ("normal", "friction", "tresca", "frozen_normal", "frozen_weight", "level", "sunk")


@dataclass
class History:
    """What a step starts from and can be replayed from. Per partner (obstacles, then the shell itself), of its c
    contacts: reactions normal (c,) and friction (c, 3) in N; of the augmented Lagrangian Tresca's friction bounds
    tresca (c,) N, frozen_normal (c, 3) and frozen_weight (c, s) of the contact's vertices; level (c,) m, the gap that
    the step must leave: 0 but for rebounds and where a motion starts inside, by sunk (c,) m. Of the step's start:
    positions reference (n, 3) m and, of all vertices, layers; its time, in statics the load factor. candidates: the
    shell's contacts with itself."""

    normal: list[Reals]
    friction: list[Reals]
    tresca: list[Reals]
    frozen_normal: list[Reals]
    frozen_weight: list[Reals]
    level: list[Reals]
    sunk: list[Reals]
    reference: Reals
    time: float
    candidates: Candidates
    layers: Reals

    def start(self, rows: slice | Ints = slice(None)) -> Start:
        """That of some vertices, all by default."""
        return Start(self.reference, self.time, rows)

    def each(self, change: Callable[[Reals], Reals]) -> "History":
        """The history with all that there is per partner changed alike."""
        changed: dict[str, Any] = {name: [change(a) for a in getattr(self, name)] for name in PER_PARTNER}
        return replace(self, **changed)

    def copy(self) -> "History":
        return self.each(np.copy)


def blank(sizes: list[tuple[int, int]], reference: Reals) -> History:
    """No reactions for partners of sizes (contacts, vertices of each)."""
    scalars, vectors, weights = (
        [np.zeros(shape(c, s)) for c, s in sizes]
        for shape in (lambda c, s: c, lambda c, s: (c, 3), lambda c, s: (c, s))
    )
    none = Candidates(
        np.zeros(0, dtype=np.int64), np.zeros((0, 4), dtype=np.int32), 0, np.zeros((0, 3)), np.zeros(0)
    )
    blank = History(
        scalars, vectors, scalars, vectors, weights, scalars, scalars, reference, 0.0, none, np.zeros((0, 3))
    )
    return blank.copy()
