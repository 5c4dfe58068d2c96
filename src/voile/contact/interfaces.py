"""What a shell's contacts are with: rigid obstacles or the shell itself, one interface for the laws.

A partner has contacts in the history, numbered in its own way, over vertices whose positions `gather` gives from
this rank's; `restrict` takes forces back. Its gaps, their geometry and the relative motion since the start of the step
are all that Signorini's and Coulomb's laws need.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from voile.arrays import Array, Flags, Ints, Reals
from voile.contact.candidates import BAND, Candidates, Layers, closest
from voile.contact.closest import Closest, direction, hessian
from voile.contact.history import PER_PARTNER, History
from voile.contact.obstacle import Obstacle
from voile.contact.pairs import Geometry


@dataclass
class ObstacleContact:
    """Every local vertex with one obstacle, at `offset` (n,) m from it; index: its part of the history."""

    index: int
    obstacle: Obstacle
    offset: Reals
    free: Flags
    own: Flags

    @property
    def friction(self) -> float:
        return self.obstacle.friction

    def gather(self, x: Reals) -> Reals:
        return x

    def restrict(self, forces: Reals) -> Reals:
        return forces

    def gaps(self, x: Reals, t: float, history: History) -> Reals:
        """(n,) m."""
        return self.nearest(x, t, history) - history.level[self.index]

    def geometry(self, rows: Ints, x: Reals, t: float, history: History) -> Geometry:
        """That of some contacts."""
        gap, gradient, curvature = self.obstacle.gap_derivatives(x[rows], t, history.start(rows))
        gap -= self.offset[rows] + history.level[self.index][rows]
        return Geometry(gap, gradient, rows[:, None], np.ones((len(rows), 1)), lambda: curvature)

    def moved(self, rows: Ints, weight: Reals, x: Reals, t: float, history: History) -> Reals:
        """(p, 3) relative motion of some contacts since the start of the step (m)."""
        return x[rows] - self.obstacle.carry(history.reference[rows], history.time, t)

    def movable(self, history: History) -> Flags:
        """(n,) marks the contacts that have unknowns."""
        return self.free

    def counted(self, rows: Ints, history: History) -> Flags:
        """(p,) marks the contacts that count on this rank."""
        return self.own[rows]

    def places(self, code: Ints, history: History) -> Ints:
        """Rows of the contacts known by codes (p,): the vertices themselves."""
        return code

    def codes(self, rows: Ints, history: History) -> Ints:
        """(p,) by which some contacts are known."""
        return rows

    def nearest(self, x: Reals, t: float, history: History) -> Reals:
        """(n,) gap (m) of each vertex."""
        return self.obstacle.gap(x, t, history.start()) - self.offset

    def least(self, vertex: Ints, weight: Reals, values: Array) -> Reals:
        """(n,) the least of the values (p,) of a vertex's contacts, infinite without any."""
        least = np.full(len(self.free), np.inf)
        np.minimum.at(least, vertex[:, 0], values)
        return least


@dataclass
class SelfContact:
    """A shell's contacts with itself. gather: positions (n, 3) of all vertices from this rank's local ones; here (local
    vertices,): those among all; free (n,): vertices with unknowns; own (n,): a pair counts where its first vertex is
    its rank's own."""

    layers: Layers
    gather: Callable[[Reals], Reals]
    here: Ints
    free: Flags
    own: Flags
    _last: tuple[Candidates, Reals, Closest] | None = field(default=None, repr=False)

    @property
    def friction(self) -> float:
        return self.layers.friction

    def restrict(self, forces: Reals) -> Reals:
        """(local vertices, 3) of the forces on all vertices (n, 3)."""
        return forces[self.here]

    def renewed(self, x: Reals, history: History, k: int) -> History:
        """The history, in which this partner's part is k, with the candidates at positions x (n, 3)."""
        old = history.candidates
        if self.layers.valid(old, x):
            return history
        carry = (history.normal[k] != 0.0) | (history.tresca[k] != 0.0)
        fresh = self.layers.find(x, old.code[carry])
        there = np.flatnonzero(np.isin(fresh.code, old.code))
        back = np.searchsorted(old.code, fresh.code[there])
        renewed = history.copy()
        renewed.candidates = fresh
        for part in (getattr(renewed, name) for name in PER_PARTNER):
            rows = np.zeros((len(fresh.code), *part[k].shape[1:]))
            rows[there] = part[k][back]
            part[k] = rows
        return renewed

    def gaps(self, x: Reals, t: float, history: History) -> Reals:
        """(c,) m; infinite for edges that are not closest inside both."""
        return self._closest(history.candidates, x).distance - history.candidates.min_distance

    def geometry(self, rows: Ints, x: Reals, t: float, history: History) -> Geometry:
        """That of some contacts, whose gaps are finite."""
        near = history.candidates
        vertex, c = near.vertex[rows], self._closest(near, x)[rows]
        gap, corner = c.distance - near.min_distance[rows], x[vertex]
        return Geometry(gap, direction(c, corner), vertex, c.weight, partial(hessian, c, corner))

    def _closest(self, candidates: Candidates, x: Reals) -> Closest:
        """As `closest`, which is asked for again and again at the same positions."""
        if self._last is None or self._last[0] is not candidates or not np.array_equal(self._last[1], x):
            self._last = candidates, x.copy(), closest(candidates, x)
        return self._last[2]

    def moved(self, rows: Ints, weight: Reals, x: Reals, t: float, history: History) -> Reals:
        """(p, 3) relative motion of some contacts since the start of the step (m)."""
        vertex = history.candidates.vertex[rows]
        found: Reals = np.einsum("ps,psi->pi", weight, x[vertex] - history.layers[vertex])
        return found

    def movable(self, history: History) -> Flags:
        """(c,) marks the contacts that have unknowns."""
        found: Flags = self.free[history.candidates.vertex].any(axis=1)
        return found

    def counted(self, rows: Ints, history: History) -> Flags:
        """(p,) marks the contacts that count on this rank."""
        found: Flags = self.own[history.candidates.vertex[rows, 0]]
        return found

    def places(self, code: Ints, history: History) -> Ints:
        """Rows of the contacts known by codes (p,), which are among the candidates."""
        return np.searchsorted(history.candidates.code, code)

    def codes(self, rows: Ints, history: History) -> Ints:
        """(p,) by which some contacts are known, also when candidates are others."""
        return history.candidates.code[rows]

    def nearest(self, x: Reals, t: float, history: History) -> Reals:
        """(local vertices,) least gap (m) of each vertex's contacts, the search's reach where there is none."""
        gap = self.gaps(x, t, history)
        least = np.full(len(self.free), BAND * self.layers.thickness)
        np.minimum.at(least, history.candidates.vertex, gap[:, None])
        return least[self.here]

    def least(self, vertex: Ints, weight: Reals, values: Array) -> Reals:
        """(local vertices,) the least of the values (p,) of the contacts that a vertex carries a share of, infinite
        without any."""
        least, carries = np.full(len(self.free), np.inf), weight != 0.0
        np.minimum.at(least, vertex[carries], np.repeat(values, carries.sum(axis=1)))
        return least[self.here]
