"""Contacts as Projective Dynamics with dry friction solves them: linearised at a shape, each for itself.

Ly, Jouve, Boissieux & Bertails-Descoubes 2020 freeze everything but the masses of a contact's vertices; here their
elasticity has a share in it (solver/resistance.py), for stiff shells answer a reaction with far less motion. Contacts
are solved one after the other in levels: first those with obstacles, then layers outward from there. Gaps are in the
laws, so that a shell lands on what it touches.
"""

from dataclasses import dataclass, fields

import numpy as np

from voile import _projective
from voile.arrays import Ints, Reals
from voile.contact.directions import lengths
from voile.contact.interfaces import ObstacleContact, SelfContact
from voile.contact.natural_map import NaturalMap
from voile.contact.pairs import within

MOST = 4  # vertices of a contact
SWEEPS, SHARED = 4, 10  # passes at most, and where contacts share vertices
SETTLED = 0.05  # change of a pass over the first's, that ends them


@dataclass
class _Linearised:
    """Contacts: partner (c,), row (c,) in its part of the history; vertices and weights (c, 4); gap (c,) m at the
    anchor (c, 3) m, over the length (c,) of its gradient, unit normal (c, 3); start (c, 3) m, from which slip is
    measured; the reaction (c, 3) N; friction's coefficient, the natural map's rho (N/m), and whether it counts on this
    rank (c,)."""

    partner: Ints
    row: Ints
    vertex: Ints
    weight: Reals
    gap: Reals
    length: Reals
    normal: Reals
    anchor: Reals
    start: Reals
    reaction: Reals
    friction: Reals
    rho: Reals
    counted: Ints

    def each(self, rows: Ints) -> "_Linearised":
        """Some of them."""
        return _Linearised(*(np.ascontiguousarray(getattr(self, f.name)[rows]) for f in fields(self)))


class LocalLaws:
    """Contacts that the n vertices of a shell may have near positions x (n, 3) m at time t: those `reach` (n,) m from
    an obstacle, and its layers' candidates, whose distances are linearised at anchor (n, 3) m, on the near side of all
    layers."""

    def __init__(self, contact: NaturalMap, n: int, t: float):
        self.contact, self.t = contact, t
        self.count = len(self._gather(np.zeros(n)))
        # To each obstacle, and at which positions.
        self.gaps: list[tuple[Reals, Reals]] = []
        self.found: _Linearised | None = None

    def _gather(self, values: Reals) -> Reals:
        """(all, ...) of local vertices' values: where layers are in play contacts are those of all ranks."""
        return self.contact.itself.gather(values) if self.contact.itself else values

    def linearise(self, x: Reals, reach: Reals, anchor: Reals) -> None:
        """Anew at x, with the history's reactions."""
        with self.contact.timed():
            self._linearise(x, reach, anchor)

    def _linearise(self, x: Reals, reach: Reals, anchor: Reals) -> None:
        parts = [
            self._layers(k, p, x, anchor) if isinstance(p, SelfContact) else self._obstacle(k, p, x, reach)
            for k, p in enumerate(self.contact.partners)
        ]
        joined = (np.concatenate([getattr(p, f.name) for p in parts]) for f in fields(_Linearised))
        found = _Linearised(*joined)
        if self.contact.itself:
            found = found.each(np.argsort(self._levels(found), kind="stable"))
        self.found = found
        self._shared = bool((np.bincount(found.vertex[found.weight != 0.0]) > 1).any())
        self.laws = _projective.LocalContacts(
            found.vertex,
            found.weight,
            found.gap,
            found.normal,
            found.anchor,
            found.start,
            found.friction,
            found.reaction,
        )

    def _obstacle(self, k: int, partner: ObstacleContact, x: Reals, reach: Reals) -> _Linearised:
        history, t = self.contact.history, self.t
        if len(self.gaps) == k:
            self.gaps.append((partner.gaps(x, t, history), x))
        gap, at = self.gaps[k]
        # Distances change no faster than positions.
        near = gap - lengths(x - at) < reach
        rows = np.flatnonzero((near | (history.normal[k] > 0.0)) & partner.movable(history))
        g = partner.geometry(rows, x, t, history)
        table = np.empty((len(rows), 15))
        table[:, 0], table[:, 1:4], table[:, 4:7] = g.gap, g.gradient, x[rows]
        table[:, 7:10] = table[:, 4:7] - partner.moved(rows, np.ones((len(rows), 1)), x, t, history)
        table[:, 10], table[:, 11:14] = history.normal[k][rows], history.friction[k][rows]
        table[:, 14] = partner.counted(rows, history)
        if self.contact.itself:
            wide = np.full((len(x), 15), np.nan)
            wide[rows] = table
            wide = self._gather(wide)
            rows = np.flatnonzero(np.isfinite(wide[:, 0]))
            table = wide[rows]
        vertex, weight = np.zeros((len(rows), MOST), dtype=np.int32), np.zeros((len(rows), MOST))
        vertex[:, 0], weight[:, 0] = rows, 1.0
        return self._made(k, rows, vertex, weight, table[:, 0], table[:, 1:4], table[:, 4:7], table[:, 7:])

    def _layers(self, k: int, partner: SelfContact, x: Reals, anchor: Reals) -> _Linearised:
        wide, wide_anchor = partner.gather(x), partner.gather(anchor)
        self.contact.history = partner.renewed(wide, self.contact.history, k)
        history = self.contact.history
        gap = partner.gaps(wide_anchor, self.t, history)
        rows = np.flatnonzero(np.isfinite(gap) & partner.movable(history))
        g = partner.geometry(rows, wide_anchor, self.t, history)
        at = np.einsum("cs,csi->ci", g.weight, wide_anchor[g.vertex])
        rest = np.empty((len(rows), 8))
        rest[:, :3] = at - partner.moved(rows, g.weight, wide_anchor, self.t, history)
        rest[:, 3], rest[:, 4:7] = history.normal[k][rows], history.friction[k][rows]
        rest[:, 7] = partner.counted(rows, history)
        return self._made(k, rows, g.vertex.astype(np.int32), g.weight, g.gap, g.gradient, at, rest)

    def _made(
        self,
        k: int,
        rows: Ints,
        vertex: Ints,
        weight: Reals,
        gap: Reals,
        gradient: Reals,
        anchor: Reals,
        rest: Reals,
    ) -> _Linearised:
        count, contact = len(rows), self.contact
        length = lengths(gradient)
        normal = gradient / length[:, None]
        reaction = rest[:, 3, None] * gradient + within(normal, rest[:, 4:7])
        same = np.ones(count)
        return _Linearised(
            np.full(count, k),
            rows,
            vertex,
            weight,
            gap / length,
            length,
            normal,
            anchor,
            rest[:, :3],
            reaction,
            contact.partners[k].friction * same,
            contact.rho(k) * same,
            rest[:, 7].astype(np.uint8),
        )

    def _levels(self, found: _Linearised) -> Ints:
        """(c,) 0 with obstacles, of layers one more than the contacts that they meet nearer to an obstacle."""
        layered = found.partner == len(self.contact.obstacles)
        level = np.where(layered, len(layered), 0)
        reached = np.zeros(self.count, dtype=bool)
        reached[found.vertex[~layered, 0]] = True
        for now in range(1, len(layered) + 1):
            touched = (reached[found.vertex] & (found.weight != 0.0)).any(axis=1)
            fresh = layered & (level == len(layered)) & touched
            if not fresh.any():
                break
            level[fresh] = now
            reached[found.vertex[fresh][found.weight[fresh] != 0.0]] = True
        return level

    # ---- an iteration ----

    def sweep(self, x: Reals, resistance: _projective.Stiffness, force: Reals) -> None:
        """New reactions at positions x (n, 3) m: with them vertices that `force` (unknowns,) N moves against the
        `resistance` obey the laws."""
        wide = np.ascontiguousarray(self._gather(x))
        self.laws.sweep(wide, resistance, force, SHARED if self._shared else SWEEPS, SETTLED)

    def forces(self) -> Reals:
        """(n, 3) reactions on the shell (N)."""
        total = np.zeros((self.count, 3))
        self.laws.spread(total)
        return self.contact.itself.restrict(total) if self.contact.itself else total

    def mismatch(self, x: Reals) -> float:
        """Sum of |r - projected trial reaction|^2 (N^2) over this rank's contacts, at positions x (n, 3)."""
        assert self.found is not None
        return float(
            self.laws.mismatch(np.ascontiguousarray(self._gather(x)), self.found.rho, self.found.counted)
        )

    def remember(self) -> None:
        """The reactions become the history's."""
        found, contact = self.found, self.contact
        if found is None:
            return
        reaction = np.empty_like(found.normal)
        self.laws.reaction(reaction)
        normal = np.einsum("ci,ci->c", found.normal, reaction)
        friction = reaction - normal[:, None] * found.normal
        for k in range(len(contact.partners)):
            rows = found.partner == k
            gathered = contact.itself if k < len(contact.obstacles) else None
            count = self.count if gathered else len(contact.history.normal[k])
            parts = np.zeros(count), np.zeros((count, 3))
            for part, values in zip(parts, (normal / found.length, friction), strict=True):
                part[found.row[rows]] = values[rows]
            if gathered:
                parts = gathered.restrict(parts[0]), gathered.restrict(parts[1])
            contact.history.normal[k], contact.history.friction[k] = parts
