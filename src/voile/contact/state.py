"""Contact of a shell's vertices with obstacles: reactions, history, and what they add to residual and tangent.

Each pair of vertex and obstacle carries a reaction r = r_N n + r_T, kept as explicit state with the positions at the
start of the step, from which slip is measured. Everything follows from the trial reaction of the natural map
(Alart & Curnier 1991), lambda = r - rho (gap n + slip): the pair is open where lambda_N <= 0, sticks where
|lambda_T| <= mu lambda_N, and slips otherwise. Two forms of it serve the solver:

- `force`, `energy`, `blocks`: the projection of lambda on the cone, with frozen r and (but in the normal direction)
  frozen bounds mu r_N the gradient of a potential, to descend on (augmented Lagrangian, Simo & Laursen 1992);
- `linearise`: the semismooth Newton equations of Signorini's and Coulomb's laws for the reactions themselves.
"""

import time
from dataclasses import dataclass, field, fields

import numpy as np

from voile.contact.obstacles import Obstacle

FREE, STICK, SLIP = 0, 1, 2
FIRM = 1e5  # times rho: stiffness by which `linearise` eliminates the reactions; its refinement leaves no trace of it


@dataclass
class Pairs:
    """Vertices near one obstacle (p of them): index in `vertex`, gap (m), its gradient (along the normal, of length 1
    where distances are exact) and Hessian, unit normal, and the trial reaction: lam_n along the gradient, lam_t (p, 3)
    N in the tangent plane; slip (p, 3) m, tangential since the start of the step."""

    index: int
    vertex: np.ndarray
    gap: np.ndarray
    gradient: np.ndarray
    curvature: np.ndarray
    unit: np.ndarray
    steepness: np.ndarray
    lam_n: np.ndarray
    lam_t: np.ndarray
    slip: np.ndarray


def dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """(p,) scalar products of rows."""
    return np.einsum("pi,pi->p", a, b)


def outer(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """(p, 3, 3) products a b^T of rows."""
    return a[:, :, None] * b[:, None, :]


def times(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """(p, 3) products of matrices (p, 3, 3) and rows (p, 3)."""
    return np.einsum("pij,pj->pi", a, b)


def within(normal: np.ndarray, v: np.ndarray) -> np.ndarray:
    """(p, 3) parts of rows in the planes of unit normals."""
    return v - dot(normal, v)[:, None] * normal


@dataclass
class State:
    """What a step starts from and can be replayed from: reactions (k obstacles, n vertices[, 3]), in N, the frozen
    friction bounds (N) and planes (unit normals) of the potential; positions (n, 3) m and load factor at its start."""

    normal: np.ndarray
    friction: np.ndarray
    bound: np.ndarray
    plane: np.ndarray
    reference: np.ndarray
    factor: float

    def copy(self) -> "State":
        arrays = {f.name: getattr(self, f.name).copy() for f in fields(self) if f.name != "factor"}
        return State(**arrays, factor=self.factor)


@dataclass
class Contact:
    """Contact of n vertices with obstacles.

    offset (m): from the mid-surface to the surface that touches, one or (k obstacles, n vertices); stiffness (N/m):
    about the shell's own at a vertex, the natural map's scale; movable (n,): vertices with unknowns; own (n,): those
    counted here (each vertex on one rank); touch (m): a gap that is none to round-off.
    """

    obstacles: list[Obstacle]
    offset: float | np.ndarray
    stiffness: float
    movable: np.ndarray
    own: np.ndarray
    touch: float
    state: State = field(init=False)
    softness: float = 1.0  # factor on rho
    seconds: float = 0.0  # spent on gaps and candidates

    def __post_init__(self) -> None:
        k, n = len(self.obstacles), len(self.movable)
        self.offset = np.broadcast_to(np.asarray(self.offset, dtype=float), (k, n))
        self.state = State(
            np.zeros((k, n)),
            np.zeros((k, n, 3)),
            np.zeros((k, n)),
            np.zeros((k, n, 3)),
            np.zeros((n, 3)),
            0.0,
        )

    @property
    def rho(self) -> float:
        """N/m, scale of the natural map."""
        return self.softness * self.stiffness

    def begin(self, x: np.ndarray, factor: float) -> None:
        """Measures slip from positions x (n, 3) at this load factor on."""
        self.state.reference, self.state.factor = x.copy(), factor

    def gap(self, k: int, x: np.ndarray, factor: float, rows: slice | np.ndarray = slice(None)) -> np.ndarray:
        """Gaps (m) to obstacle k of the vertices `rows`, all by default, at positions x[rows]."""
        return self.obstacles[k].gap(x[rows], factor) - np.asarray(self.offset)[k][rows]

    # ---- the natural map ----

    def pairs(self, x: np.ndarray, factor: float, *, frozen: bool = False) -> list[Pairs]:
        """The pairs of each obstacle that may carry a reaction. frozen: planes of the state instead of x's."""
        began = time.perf_counter()
        found = [self._near(k, x, factor, frozen) for k in range(len(self.obstacles))]
        self.seconds += time.perf_counter() - began
        return [p for p in found if p is not None]

    def _near(self, k: int, x: np.ndarray, factor: float, frozen: bool) -> Pairs | None:
        s, obstacle = self.state, self.obstacles[k]
        gap = self.gap(k, x, factor)
        near = s.normal[k] - self.rho * gap >= -self.rho * self.touch
        if frozen:
            near |= s.bound[k] > 0.0
        v = np.flatnonzero(near & self.movable)
        if not len(v):
            return None
        g, gradient, c = obstacle.gap_derivatives(x[v], factor)
        g = g - np.asarray(self.offset)[k][v]
        steepness = np.linalg.norm(gradient, axis=1)
        unit = gradient / steepness[:, None]
        d = x[v] - obstacle.carry(s.reference[v], s.factor, factor)
        plane = s.plane[k][v] if frozen else unit
        trial = within(plane, s.friction[k][v] - self.rho * d)
        lam_n = s.normal[k][v] - self.rho * g
        return Pairs(k, v, g, gradient, c, unit, steepness, lam_n, trial, within(plane, d))

    def _bounds(self, p: Pairs, frozen: bool) -> np.ndarray:
        if frozen:
            return self.state.bound[p.index][p.vertex]
        return self.obstacles[p.index].friction * p.steepness * np.maximum(p.lam_n, 0.0)

    def project(self, p: Pairs, frozen: bool = False) -> tuple[np.ndarray, np.ndarray]:
        """Projection of the trial reaction on the cone: normal (p,) and tangential (p, 3) parts, N."""
        size = np.linalg.norm(p.lam_t, axis=1)
        bound = self._bounds(p, frozen)
        share = np.where(size > bound, bound / np.maximum(size, 1e-300), 1.0)
        return np.maximum(p.lam_n, 0.0), share[:, None] * p.lam_t

    def slips(self, p: Pairs) -> np.ndarray:
        """(p,) whether the trial reaction is beyond friction's bound: at mu = 0 all that touches slips."""
        return (p.lam_n > 0.0) & (np.linalg.norm(p.lam_t, axis=1) > self._bounds(p, False)) | (
            self.obstacles[p.index].friction == 0.0
        )

    # ---- as a potential ----

    def energy(self, x: np.ndarray, factor: float) -> float:
        """Augmented Lagrangian (J) of this rank's vertices, less its constant."""
        total = 0.0
        for p in self.pairs(x, factor, frozen=True):
            size, bound = np.linalg.norm(p.lam_t, axis=1), self._bounds(p, True)
            stuck = np.where(size <= bound, 0.5 * size**2, bound * (size - 0.5 * bound))
            total += float((0.5 * np.maximum(p.lam_n, 0.0) ** 2 + stuck)[self.own[p.vertex]].sum()) / self.rho
        return total

    def force(self, x: np.ndarray, factor: float, frozen: bool) -> np.ndarray:
        """(n, 3) projected trial reactions on the shell (N)."""
        total = np.zeros_like(x)
        for p in self.pairs(x, factor, frozen=frozen):
            normal, tangential = self.project(p, frozen)
            total[p.vertex] += normal[:, None] * p.gradient + tangential
        return total

    def blocks(self, x: np.ndarray, factor: float, convex: bool):
        """Hessian of `energy`, per obstacle (vertices, (p, 3, 3) N/m); convex: without its negative part."""
        for p in self.pairs(x, factor, frozen=True):
            active = p.lam_n > 0.0
            block = self.rho * active[:, None, None] * outer(p.gradient, p.gradient)
            pressed = np.maximum(p.lam_n, 0.0)[:, None, None] * p.curvature
            block -= np.zeros_like(pressed) if convex else pressed
            size, bound = np.linalg.norm(p.lam_t, axis=1), self._bounds(p, True)
            slips = size > bound
            share = np.where(slips, bound / np.maximum(size, 1e-300), 1.0)
            plane = self.state.plane[p.index][p.vertex]
            along = p.lam_t / np.maximum(size, 1e-300)[:, None]
            tangent = np.eye(3) - outer(plane, plane) - slips[:, None, None] * outer(along, along)
            yield p.vertex, block + self.rho * (share * (bound > 0.0))[:, None, None] * tangent

    def adopt(self, x: np.ndarray, factor: float) -> None:
        """The projected trial reactions become the reactions, and with them bounds and planes of the potential."""
        s = self.state
        fresh = State(
            np.zeros_like(s.normal),
            np.zeros_like(s.friction),
            np.zeros_like(s.bound),
            np.zeros_like(s.plane),
            s.reference,
            s.factor,
        )
        for p in self.pairs(x, factor):
            normal, tangential = self.project(p)
            fresh.normal[p.index][p.vertex], fresh.friction[p.index][p.vertex] = normal, tangential
        self.state = fresh
        self.freeze(x, factor)

    def freeze(self, x: np.ndarray, factor: float) -> None:
        """Bounds and planes of the potential as the reactions and positions x have them."""
        s = self.state
        for k, obstacle in enumerate(self.obstacles):
            s.bound[k] = obstacle.friction * np.maximum(s.normal[k], 0.0)
            v = np.flatnonzero(s.bound[k] > 0.0)
            if len(v):
                gradient = obstacle.gap_derivatives(x[v], factor)[1]
                steepness = np.linalg.norm(gradient, axis=1)
                s.plane[k][v] = gradient / steepness[:, None]
                s.bound[k][v] *= steepness

    # ---- as equations ----

    def linearise(self, x: np.ndarray, factor: float) -> "Linearised":
        """The laws' semismooth Newton equations at x and the present reactions."""
        return Linearised(self, [_Equations(self, p) for p in self.pairs(x, factor)])

    # ---- what is reported ----

    def mismatch(self, x: np.ndarray, factor: float) -> float:
        """Sum of |r - projected trial reaction|^2 (N^2) over this rank's pairs: zero where the laws hold."""
        s, total = self.state, 0.0
        held = [s.normal[k] != 0.0 for k in range(len(self.obstacles))]
        for p in self.pairs(x, factor):
            normal, tangential = self.project(p)
            own = self.own[p.vertex]
            total += float((((s.normal[p.index][p.vertex] - normal) ** 2)[own]).sum())
            total += float(((s.friction[p.index][p.vertex] - tangential)[own] ** 2).sum())
            held[p.index][p.vertex] = False
        for k, rest in enumerate(held):
            rest &= self.own
            total += float((s.normal[k][rest] ** 2).sum() + (s.friction[k][rest] ** 2).sum())
        return total


class _Equations:
    """Reactions f = a - D dx of one obstacle's pairs for a step dx of their vertices, with constraints (gap and, for
    those that stick, slip) kept by a firm stiffness and corrected by `advance`."""

    def __init__(self, contact: Contact, p: Pairs):
        self.p, self.mu = p, contact.obstacles[p.index].friction
        s, rho = contact.state, contact.rho
        self.firm = FIRM * contact.stiffness
        fresh = not s.normal[p.index].any()  # no reactions yet: all that touches may carry one, and sticks
        self.active = p.gap <= contact.touch if fresh else p.lam_n > 0.0
        self.normal = s.normal[p.index][p.vertex].copy()
        self.friction = within(p.unit, s.friction[p.index][p.vertex])
        size = np.maximum(np.linalg.norm(p.lam_t, axis=1), 1e-300)
        bound = self.mu * p.steepness * np.maximum(p.lam_n, 0.0)
        self.stick = self.active & (fresh | (size <= bound)) & (self.mu > 0.0)
        self.slips = self.active & ~self.stick
        along = p.lam_t / size[:, None]
        self.along = (self.mu * p.steepness)[:, None] * along  # friction per lam_n
        self.plane = np.eye(3) - outer(p.unit, p.unit)
        self.sideways = self.plane - outer(along, along)
        share = np.where(self.slips & (self.mu > 0.0), np.minimum(bound / size, 1.0 - 1e-5), 0.0)
        self.turning = rho * share / (1.0 - share)  # N/m: friction's direction follows the slip's
        self.pressed = np.maximum(p.lam_n, 0.0)

    @property
    def symmetric(self) -> bool:
        return self.mu == 0.0 or not self.slips.any()

    def constant(self) -> np.ndarray:
        """(p, 3) a: the reactions without a step, N."""
        p = self.p
        stuck = self.normal[:, None] * p.gradient + self.friction
        stuck -= self.firm * (p.gap[:, None] * p.gradient + p.slip)
        moved = (self.normal - self.firm * p.gap)[:, None] * (p.gradient + self.along)
        moved -= self.turning[:, None] * times(self.sideways, p.slip)
        return np.where(self.stick[:, None], stuck, np.where(self.slips[:, None], moved, 0.0))

    def blocks(self) -> np.ndarray:
        """(p, 3, 3) D, N/m."""
        p = self.p
        moved = self.firm * outer(p.gradient + self.along, p.gradient)
        moved += self.turning[:, None, None] * self.sideways - self.pressed[:, None, None] * p.curvature
        turned = times(p.curvature, self.along) / p.steepness[:, None]  # the tangent plane follows the normal
        moved += self.pressed[:, None, None] * outer(p.unit, turned)
        return self._chosen(moved)

    def held(self) -> np.ndarray:
        """(p, 3, 3) symmetric stiffness of the constraints, N/m: what slips may go on the way it slips."""
        p = self.p
        moved = self.firm * (outer(p.gradient, p.gradient) + (self.mu > 0.0) * self.sideways)
        return self._chosen(moved - self.pressed[:, None, None] * p.curvature)

    def _chosen(self, moved: np.ndarray) -> np.ndarray:
        """Blocks of what sticks, slips (`moved`) or is open."""
        stuck = self.firm * (outer(self.p.gradient, self.p.gradient) + self.plane)
        which = np.where(self.stick[:, None, None], stuck, moved)
        return np.where(self.active[:, None, None], which, 0.0)

    def advance(self, dx: np.ndarray) -> None:
        """Takes the firm stiffness's share of the reactions after the step dx (p, 3) into the multipliers."""
        p = self.p
        slid = p.slip + within(p.unit, dx)
        opened = p.gap + dot(p.gradient, dx)
        self.normal = np.where(self.active, self.normal - self.firm * opened, 0.0)
        turned = self.normal[:, None] * self.along - self.turning[:, None] * times(self.sideways, slid)
        stuck = self.friction - self.firm * slid
        self.friction = np.where(self.stick[:, None], stuck, np.where(self.slips[:, None], turned, 0.0))


@dataclass
class Linearised:
    """Equations of all pairs that may carry a reaction."""

    contact: Contact
    parts: list[_Equations]

    @property
    def symmetric(self) -> bool:
        return all(part.symmetric for part in self.parts)

    def states(self) -> list[tuple[bytes, ...]]:
        """Which pairs are active and stick, to recognise a cycle."""
        return [(e.p.vertex[e.active].tobytes(), e.p.vertex[e.stick].tobytes()) for e in self.parts]

    def force(self) -> np.ndarray:
        """(n, 3) reactions without a step, N."""
        total = np.zeros((len(self.contact.movable), 3))
        for e in self.parts:
            total[e.p.vertex] += e.constant()
        return total

    def blocks(self):
        """Their derivative by the step, per obstacle (vertices, (p, 3, 3) N/m)."""
        for e in self.parts:
            yield e.p.vertex, e.blocks()

    def held(self):
        """What the constraints add to the tangent that decides stability, per obstacle."""
        for e in self.parts:
            yield e.p.vertex, e.held()

    def advance(self, dx: np.ndarray) -> None:
        """Corrects the multipliers after the step dx (n, 3)."""
        for e in self.parts:
            e.advance(dx[e.p.vertex])

    def reactions(self, share: float) -> None:
        """The present reactions move by a share (0 to 1) of the way to those of the step."""
        s = self.contact.state
        normal, friction = np.zeros_like(s.normal), np.zeros_like(s.friction)
        for e in self.parts:
            normal[e.p.index][e.p.vertex], friction[e.p.index][e.p.vertex] = e.normal, e.friction
        s.normal = s.normal + share * (normal - s.normal)
        s.friction = s.friction + share * (friction - s.friction)
