"""The natural map of contact's laws (Alart & Curnier 1991) for a shell with obstacles and with itself.

Each contact (a vertex with an obstacle, up to four vertices with each other) carries a reaction r = r_N n + r_T, kept
as explicit state with the positions at the start of the step, from which slip is measured. Everything follows from the
trial reaction lambda = r - rho (gap n + slip): the pair is open where lambda_N <= 0, sticks where |lambda_T| <= mu
lambda_N, and slips otherwise. Throughout t is the time that obstacles move in: in statics the load factor.
"""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

import numpy as np

from voile.arrays import Array, Flags, Ints, Reals
from voile.contact.directions import lengths
from voile.contact.history import History, blank
from voile.contact.interfaces import ObstacleContact, SelfContact
from voile.contact.obstacle import Obstacle
from voile.contact.pairs import PENALTY, Pairs, barrier, within

LAYERS = 30.0  # rho of the shell against itself, over that against obstacles: tight layers carry much in short gaps
OFF_BOUND = 1e-7  # share of friction
STUCK = 1e-6  # of its bound that friction of what sticks leaves at least, for a guess
SOFT = 1e-3  # of layers' penalty: 299 iterations for 382, of one pulled over another, 361 for 589 on a ball
BARRIER = 3.0  # stiffness of the barrier between layers, over rho


@dataclass
class NaturalMap:
    """That of n vertices with obstacles, and of all with each other if there is `itself`.

    offset (m): from the mid-surface to the surface that touches, one or (k obstacles, n vertices); stiffness (N/m):
    about the shell's own at a vertex, the natural map's scale; movable (n,): vertices with unknowns; own (n,): those
    counted here (each vertex on one rank); touch (m): a gap that is none to round-off; pliable (N/m): about the
    stiffness with which the shell bends at a vertex, which decides what opens.
    """

    obstacles: list[Obstacle]
    offset: float | Reals
    stiffness: float
    movable: Flags
    own: Flags
    touch: float
    itself: SelfContact | None = None
    pliable: float = np.inf
    history: History = field(init=False)
    seconds: float = 0.0  # spent on gaps and candidates

    def __post_init__(self) -> None:
        k, n = len(self.obstacles), len(self.movable)
        self.offset = np.broadcast_to(np.asarray(self.offset, dtype=float), (k, n))
        self.partners: list[ObstacleContact | SelfContact] = [
            ObstacleContact(index, o, d, self.movable, self.own)
            for index, (o, d) in enumerate(zip(self.obstacles, self.offset, strict=True))
        ]
        sizes = [(n, 1)] * k
        if self.itself:
            self.partners.append(self.itself)
            sizes.append((0, 4))
        self.history = blank(sizes, np.zeros((n, 3)))
        self.inertia = self.fall = self.closes = 0.0  # see `begin`

    @contextmanager
    def timed(self) -> Iterator[None]:
        """Counts the time as contact's."""
        began = time.perf_counter()
        yield
        self.seconds += time.perf_counter() - began

    def rho(self, k: int, softness: float = 1.0) -> float:
        """N/m, scale of the natural map with partner k, across the surface; softness: a factor on it."""
        return softness * self._scale * (1.0 if k < len(self.obstacles) else LAYERS)

    def softest(self, depth: float) -> float:
        """The softness at which the reactions to obstacles on this rank sink by up to `depth` (m)."""
        normal = self.history.normal[: len(self.obstacles)]
        return max((float(n.max(initial=0.0)) for n in normal), default=0.0) / (self._scale * depth)

    @property
    def sliding(self) -> float:
        """N/m, the same along any surface: about what resists there. What slips and turns back sticks within a way of
        twice friction's bound over it, so it never hardens, nor are layers tight along each other. Nor does it soften:
        what sticks would creep from step to step of pseudo-time."""
        return self._scale

    def reach(self, k: int) -> float:
        """Gap (m) to partner k within which a contact without a reaction may carry one. Where none does yet, that is as
        far as free vertices fall in the step, for a gap at the start is none only to the digits of the mesh."""
        return self.touch if self.history.normal[k].any() else max(self.touch, self.fall)

    @property
    def opening(self) -> float:
        """Factor on rho where the equations decide what opens: a Newton step leaves gaps of second order, and times the
        stiffness of the membrane these would outweigh any reaction of a cloth. Layers are tight."""
        return 1.0 if self.itself else min(max(self.pliable, self.inertia) / self._scale, 1.0)

    @property
    def penalty(self) -> float:
        """N/m, stiffness of the equations' constraints."""
        return PENALTY * self._scale

    @property
    def firmness(self) -> float:
        """Share of it with which the equations of a step begin. Layers meet by more pairs than needed, whose gaps
        contradict each other to second order. Times the whole penalty that makes reactions against each other, by which
        pairs open and close at random."""
        return SOFT if self.itself and self.inertia else 1.0

    @property
    def _scale(self) -> float:
        """N/m."""
        return max(self.stiffness, self.inertia)

    @property
    def moves(self) -> bool:
        """Whether an obstacle moves along the load path."""
        return any(o.moves for o in self.obstacles)

    @property
    def layered(self) -> bool:
        """Whether layers of the shell bear on each other."""
        return self.itself is not None and bool(self.history.normal[-1].any())

    @property
    def frictions(self) -> list[tuple[str, float]]:
        """Each partner's name and Coulomb coefficient."""
        own = [("itself", self.itself.friction)] if self.itself else []
        return [(o.name, o.friction) for o in self.obstacles] + own

    def begin(self, x: Reals, t: float, inertia: float = 0.0, fall: float = 0.0, closes: float = 0.0) -> None:
        """Measures slip from positions x (n, 3) at time t on. Friction starts off its bound: whether what
        slipped before now sticks is not left to round-off. Of a step in time: inertia (N/m), that of a vertex over it;
        fall (m), how far the loads lead a free vertex; closes (s), when hollows of obstacles do, see `sink`."""
        self.inertia, self.fall, self.closes = inertia, fall, closes
        self.history.reference, self.history.time = x.copy(), t
        self.history.friction = [(1.0 - OFF_BOUND) * friction for friction in self.history.friction]
        if self.itself:
            self.history.layers = self.itself.gather(x).copy()

    def sink(self, x: Reals, t: float) -> None:
        """Where a motion starts at positions x (n, 3) inside an obstacle, that has a hollow, which closes by
        `closes`."""
        for k in range(len(self.obstacles)):
            depth = -self.gap(k, x, t)
            self.history.sunk[k] = np.where(self.movable & (depth > self.touch), depth, 0.0)

    def hollow(self, k: int, t: float) -> Reals:
        """(n,) how deep (m) obstacle k lets the vertices in at time t (s)."""
        left = 1.0 - min(t / self.closes, 1.0) if self.closes else 0.0
        found: Reals = self.history.sunk[k] * (left**2 * (3.0 - 2.0 * left))
        return found

    def let_in(self, t: float) -> None:
        """The step that ends at time t ends in the hollows of obstacles at the deepest."""
        for k in range(len(self.obstacles)):
            self.history.level[k] = -self.hollow(k, t)

    def rebound(self, x: Reals, begin: float, end: float, way: Reals, fall: Reals, rest: float) -> Reals:
        """Restitution over a step that has begun at positions x (n, 3): vertices whose flight, way (n, 3) m by their
        velocity and half of fall (n, 3) m by their acceleration, enters an obstacle by `end` leave it, where they meet
        it, with the coefficient's share of the approach (Moreau's law at velocity level). No impact is an approach (m)
        within `rest`. Found is by how much (n, 3) m they seem to begin elsewhere: what flies as they do after the
        impact, all along the step, to where they end."""
        found = np.zeros_like(x)
        for k, obstacle in enumerate(self.obstacles):
            if not obstacle.restitution:
                continue
            gap, normal, _ = obstacle.gap_derivatives(x, begin, self.history.start())
            gap -= np.asarray(self.offset)[k]
            nearer = -np.einsum("pi,pi->p", normal, way - (obstacle.carry(x, begin, end) - x))
            faster = -np.einsum("pi,pi->p", normal, fall)
            rows = np.flatnonzero((gap <= nearer + 0.5 * faster) & (nearer > rest))
            above, nearer, faster = np.maximum(gap[rows], 0.0), nearer[rows], faster[rows]
            met = 2.0 * above / (nearer + np.sqrt(np.maximum(nearer**2 + 2.0 * faster * above, 0.0)))
            met = np.minimum(met, 1.0)  # share of the step before the impact
            left, leaves = 1.0 - met, obstacle.restitution * (nearer + faster * met)
            ends = np.maximum(left * (leaves - 0.5 * faster * left), 0.0)
            self.history.level[k][rows] = ends
            found[rows] += (ends - (leaves - faster * left) - above)[:, None] * normal[rows]
        return found

    def carried(self, x: Reals, t: float) -> tuple[Flags, Reals]:
        """(n,) marks vertices that stuck to an obstacle when slip was last measured anew, and where it carries them by
        time t from positions x (n, 3)."""
        s, stuck, there = self.history, np.zeros(len(x), dtype=bool), x.copy()
        for k, obstacle in enumerate(self.obstacles):
            bound = (1.0 - STUCK) * obstacle.friction * s.normal[k]
            rows = np.flatnonzero((lengths(s.friction[k]) < bound) & self.movable)
            there[rows], stuck[rows] = obstacle.carry(x[rows], s.time, t), True
        return stuck, there

    def gap(self, k: int, x: Reals, t: float, rows: slice | Ints = slice(None)) -> Reals:
        """Gaps (m) to obstacle k of the vertices `rows`, all by default, at positions x[rows]."""
        gap = self.obstacles[k].gap(x[rows], t, self.history.start(rows))
        found: Reals = gap - np.asarray(self.offset)[k][rows]
        return found

    def pairs(self, x: Reals, t: float, softness: float = 1.0) -> list[Pairs]:
        """The pairs with each partner that may carry a reaction, under the laws; softness: of rho."""
        return self._pairs(x, t, self.sliding, self._rhos(softness))

    def measured_pairs(self, x: Reals, t: float, sharp: float = np.inf) -> list[Pairs]:
        """The same for norms: layers with the rho of obstacles, and none above `sharp` (N/m). The laws are the same
        with any rho, the round-off of gaps counts for less."""
        rho = min(self._scale, sharp)
        return self._pairs(x, t, rho, [rho] * len(self.partners))

    def frozen_pairs(self, x: Reals, t: float, softness: float) -> list[Pairs]:
        """The same with the normals, weights and friction bounds of the history instead of x's."""
        return self._pairs(x, t, self.sliding, self._rhos(softness), frozen=True)

    def opening_pairs(self, x: Reals, t: float) -> list[Pairs]:
        """As `pairs`, of which equations decide what opens: see `opening`."""
        return self._pairs(x, t, self.sliding, self._rhos(self.opening))

    def _rhos(self, softness: float = 1.0) -> list[float]:
        return [self.rho(k, softness) for k in range(len(self.partners))]

    def _pairs(
        self, x: Reals, t: float, along: float, across: list[float], frozen: bool = False
    ) -> list[Pairs]:
        """along, across: rho (N/m) along the surfaces and, each partner's, across."""
        with self.timed():
            found = [self._near(k, x, t, along, rho, frozen) for k, rho in enumerate(across)]
        return [p for p in found if p is not None]

    def near(self, k: int, x: Reals, t: float, rho: float, frozen: bool) -> tuple[Reals, Ints, Reals]:
        """Positions that partner k sees, its rows that may carry a reaction, and their gaps (m)."""
        partner, wide = self.partners[k], self.partners[k].gather(x)
        if isinstance(partner, SelfContact):
            self.history = partner.renewed(wide, self.history, k)
        s = self.history
        gap = partner.gaps(wide, t, s)
        near = s.normal[k] - rho * gap >= -rho * self.reach(k)
        if frozen:
            near |= (s.tresca[k] > 0.0) & np.isfinite(gap)
        rows = np.flatnonzero(near & partner.movable(s))
        return wide, rows, gap[rows]

    def _near(self, k: int, x: Reals, t: float, along: float, across: float, frozen: bool) -> Pairs | None:
        wide, rows, _ = self.near(k, x, t, across, frozen)
        if not len(rows):
            return None
        s, partner = self.history, self.partners[k]
        g = partner.geometry(rows, wide, t, s)
        gradient_norm = lengths(g.gradient)
        unit = g.gradient / gradient_norm[:, None]
        normal, weight = (s.frozen_normal[k][rows], s.frozen_weight[k][rows]) if frozen else (unit, g.weight)
        d = partner.moved(rows, weight, wide, t, s)
        trial = within(normal, s.friction[k][rows] - along * d)
        lam_n = s.normal[k][rows] - across * g.gap
        slip, mu = within(normal, d), partner.friction
        bound = s.tresca[k][rows] if frozen else mu * gradient_norm * np.maximum(lam_n, 0.0)
        return Pairs(k, mu, across, along, rows, g, unit, gradient_norm, lam_n, trial, bound, slip, weight)

    def guard(self, p: Pairs) -> Reals:
        """`keeps_apart` of pairs."""
        return self.keeps_apart(p.index, p.row, p.gap, p.rho)

    def keeps_apart(self, k: int, rows: Ints, gap: Reals, rho: float) -> Reals:
        """(3, p) potential (J), push (N) and stiffness (N/m) of the barrier that keeps layers apart on the way, of the
        rows of partner k and their gaps (m): none where the laws hold."""
        if k < len(self.obstacles) or self.itself is None:
            return np.zeros((3, len(rows)))
        return BARRIER * rho * barrier(gap, self.history.candidates.min_distance[rows])

    def counted(self, p: Pairs) -> Flags:
        """(p,) marks the pairs that count on this rank."""
        return self.partners[p.index].counted(p.row, self.history)

    def collect(self, p: Pairs, spread: Callable[[Reals], None], total: Reals) -> None:
        """Adds the forces that `spread` adds to those on the partner's vertices to total (n, 3)."""
        partner = self.partners[p.index]
        forces = np.zeros((len(partner.free), 3))
        spread(forces)
        total += partner.restrict(forces)

    # ---- what is reported ----

    def nearest(self, k: int, x: Reals, t: float) -> Reals:
        """(n,) gaps (m) of the vertices to partner k, where it is near."""
        return self.partners[k].nearest(self.partners[k].gather(x), t, self.history)

    def least(self, p: Pairs, chosen: Flags, values: Array) -> Reals:
        """(n,) the least of the values (p,) of the chosen (p,) among a vertex's pairs, infinite without any."""
        g = p.geometry
        return self.partners[p.index].least(g.vertex[chosen], g.weight[chosen], values[chosen])

    def missed(self, pairs: list[Pairs]) -> float:
        """Sum of |r - projected trial reaction|^2 (N^2) over this rank's pairs, all at some positions: zero where the
        laws hold."""
        s, total = self.history, 0.0
        held = [normal != 0.0 for normal in s.normal]
        for p in pairs:
            normal, tangential = p.project()
            own = self.counted(p)
            total += float((((s.normal[p.index][p.row] - normal) ** 2)[own]).sum())
            total += float(((s.friction[p.index][p.row] - tangential)[own] ** 2).sum())
            held[p.index][p.row] = False
        for k, rest in enumerate(held):
            rows = np.flatnonzero(rest)
            rows = rows[self.partners[k].counted(rows, s)]
            total += float((s.normal[k][rows] ** 2).sum() + (s.friction[k][rows] ** 2).sum())
        return total
