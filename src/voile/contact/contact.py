"""Contact of a shell with obstacles and with itself: what its reactions add to residual and tangent.

Two forms of the natural map serve the solver:

- `force`, `energy`, `blocks`: the projection of lambda on the cone, with frozen r and (but in the normal direction)
  frozen bounds mu r_N the gradient of a potential, to descend on (augmented Lagrangian, Simo & Laursen 1992);
- `reactions`: the projection on Coulomb's cone itself, which the laws ask r to be; `linearise`: their semismooth Newton
  equations for r.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from voile.arrays import Flags, Ints, Reals
from voile.contact.crossing import entries
from voile.contact.directions import lengths, unit
from voile.contact.equations import Equations, Linearised
from voile.contact.history import History
from voile.contact.natural_map import NaturalMap
from voile.contact.obstacle import Start
from voile.contact.pairs import FREE, SLIP, STICK, Pairs, outer, within

__all__ = ["FREE", "SLIP", "STICK", "Contact", "History", "Linearised", "Pairs"]
FIRMER = 10.0  # penalty of the equations over that of those before
SLID = 0.05  # of its length, by which it may lead deeper where it ends at the obstacle
CLEAR = 0.02  # sizes: a gap from which it does not end there


@dataclass
class Contact(NaturalMap):
    """The natural map as a potential and as equations."""

    def free_share(self, x: Reals, moved: Reals) -> float:
        """Share of the way from x to `moved` (n, 3) on which no layer passes through another, at most 1."""
        if not self.itself:
            return 1.0
        with self.timed():
            before, after = self.itself.gather(x), self.itself.gather(moved)
            return self.itself.layers.free_share(before, after, self.history.candidates)

    def inside_between(
        self,
        x: Reals,
        began: float,
        moved: Reals,
        ended: float,
        shares: Reals,
        size: float,
        touching: float,
    ) -> Flags:
        """(n,) marks vertices that are in an obstacle after some of `shares` of the straight way from x (n, 3), at the
        time `began`, to `moved`, at `ended`: deep in one at which the way ends, for there they may slide. size
        (m): the shell's; touching: sizes that no depth is."""
        way = moved - x
        length, inside = lengths(way), np.zeros(len(x), dtype=bool)
        with self.timed():
            for k in range(len(self.obstacles)):
                ends_here = self.gap(k, moved, ended) < CLEAR * size
                depth = touching * size + SLID * length * ends_here
                for share in shares:
                    inside |= self.gap(k, x + share * way, began + share * (ended - began)) < -depth
        return inside & self.movable

    def crosses(self, x: Reals, began: float, moved: Reals, ended: float) -> Flags:
        """(n,) marks vertices whose straight way from x (n, 3), at the time `began`, to `moved`, at `ended`, enters an
        obstacle and ends on another side of it: where the normal is another (see contact.crossing)."""
        found = np.zeros(len(x), dtype=bool)
        with self.timed():
            for k in range(len(self.obstacles)):
                found[self._crossing(k, x, began, moved, ended)] = True
        return found

    def _crossing(self, k: int, x: Reals, began: float, moved: Reals, ended: float) -> Ints:
        """The vertices that cross obstacle k."""
        obstacle = self.obstacles[k]
        begin, end = obstacle.way(x, began, moved, ended)
        length = lengths(end - begin)
        going = np.flatnonzero((self.gap(k, x, began) < length) & self.movable)
        offset, start = np.asarray(self.offset)[k][going], Start(x, began)

        def gap(points: Reals, rows: Ints) -> tuple[Reals, Reals]:
            here, normal = obstacle.derivatives_on_way(points, replace(start, rows=going[rows]))[:2]
            return here - offset[rows], unit(normal, np.zeros(3))[1]

        entry = entries(begin[going], end[going], gap, obstacle.finest, self.touch)
        entered = entry.any(axis=1)
        normal = obstacle.derivatives_on_way(end[going[entered]], replace(start, rows=going[entered]))[1]
        turned = np.einsum("pi,pi->p", normal, entry[entered]) < obstacle.turned
        found: Ints = going[entered][turned]
        return found

    # ---- as a potential ----

    def energy(self, x: Reals, t: float, softness: float = 1.0) -> float:
        """Augmented Lagrangian (J) of the pairs that count on this rank, less its constant."""
        with self.timed():
            return sum(self._energy(k, x, t, softness) for k in range(len(self.partners)))

    def _energy(self, k: int, x: Reals, t: float, softness: float) -> float:
        partner, rho = self.partners[k], self.rho(k, softness)
        wide, rows, gap = self.near(k, x, t, rho, True)
        s = self.history
        laws = 0.5 * np.maximum(s.normal[k][rows] - rho * gap, 0.0) ** 2 / rho
        rubs = s.tresca[k][rows] > 0.0
        if rubs.any():
            these = rows[rubs]
            moved = partner.moved(these, s.frozen_weight[k][these], wide, t, s)
            along = self.sliding
            trial = within(s.frozen_normal[k][these], s.friction[k][these] - along * moved)
            size, bound = lengths(trial), s.tresca[k][these]
            laws[rubs] += np.where(size <= bound, 0.5 * size**2, bound * (size - 0.5 * bound)) / along
        laws += self.keeps_apart(k, rows, gap, rho)[0]
        return float(laws[partner.counted(rows, s)].sum())

    def force(self, x: Reals, t: float, softness: float = 1.0) -> Reals:
        """(n, 3) minus the gradient of `energy` (N)."""
        return self.force_of(self.frozen_pairs(x, t, softness), x)

    def force_of(self, pairs: list[Pairs], x: Reals) -> Reals:
        """The same of the `frozen_pairs` at positions x."""
        total = np.zeros_like(x)
        for p in pairs:
            normal, tangential = p.project()
            self.collect(p, partial(p.spread, normal + self.guard(p)[1], tangential), total)
        return total

    def blocks(
        self, x: Reals, t: float, convex: float, softness: float = 1.0
    ) -> Iterator[tuple[Ints, Reals]]:
        """Hessian of `energy`, per partner (stencils, (p, 3s, 3s) N/m); convex: share of its negative part left out."""
        return self.blocks_of(self.frozen_pairs(x, t, softness), convex)

    def blocks_of(self, pairs: list[Pairs], convex: float) -> Iterator[tuple[Ints, Reals]]:
        """The same of `frozen_pairs`."""
        for p in pairs:
            _, push, stiff = self.guard(p)
            stiff += p.rho * (p.lam_n > 0.0)
            block = p.over_vertices(stiff[:, None, None] * outer(p.gradient, p.gradient), p.geometry.weight)
            if convex < 1.0:
                block -= ((1.0 - convex) * (np.maximum(p.lam_n, 0.0) + push))[:, None, None] * p.curvature
            size, slips = lengths(p.lam_t), lengths(p.lam_t) > p.bound
            normal = self.history.frozen_normal[p.index][p.row]
            along = p.lam_t / np.maximum(size, 1e-300)[:, None]
            tangent = np.eye(3) - outer(normal, normal) - slips[:, None, None] * outer(along, along)
            tangent *= p.along * (p.share * (p.bound > 0.0))[:, None, None]
            yield p.stencil, block + p.over_vertices(tangent, p.slip_weight)

    def adopt(self, x: Reals, t: float, softness: float = 1.0) -> None:
        """The projected trial reactions, with the barrier's push, become the reactions, and with them what is frozen
        in the potential."""
        pairs = self.pairs(x, t, softness)
        fresh = self.history.each(np.zeros_like)
        for p in pairs:
            normal, fresh.friction[p.index][p.row] = p.project()
            fresh.normal[p.index][p.row] = normal + self.guard(p)[1]
        self.history = fresh
        self.freeze(x, t)

    def freeze(self, x: Reals, t: float) -> None:
        """Tresca bounds, normals and weights of the potential as the reactions and positions x have them."""
        s = self.history
        for k, partner in enumerate(self.partners):
            wide = partner.gather(x)
            s.tresca[k] = partner.friction * np.maximum(s.normal[k], 0.0)
            s.tresca[k][~np.isfinite(partner.gaps(wide, t, s))] = 0.0
            rows = np.flatnonzero(s.tresca[k] > 0.0)
            if len(rows):
                g = partner.geometry(rows, wide, t, s)
                gradient_norm = lengths(g.gradient)
                s.frozen_normal[k][rows] = g.gradient / gradient_norm[:, None]
                s.frozen_weight[k][rows] = g.weight
                s.tresca[k][rows] *= gradient_norm

    # ---- as laws ----

    def reactions(self, x: Reals, t: float) -> Reals:
        """(n, 3) projected trial reactions on the shell (N): the reactions themselves where the laws hold."""
        return self.projected(self.pairs(x, t))

    def projected(self, pairs: list[Pairs]) -> Reals:
        """`reactions` of all pairs at some positions."""
        total = np.zeros((len(self.movable), 3))
        for p in pairs:
            self.collect(p, partial(p.spread, *p.project()), total)
        return total

    def linearise(self, x: Reals, t: float, before: Linearised | None = None) -> Linearised:
        """The laws' semismooth Newton equations at x and the present reactions, which those `before` have left."""
        firmness = min(FIRMER * before.firmness, 1.0) if before else self.firmness
        equations = [Equations(self, p, firmness) for p in self.opening_pairs(x, t)]
        return Linearised(self, equations, firmness, before.doubted if before else {})
