"""Contacts that may carry a reaction, whatever the shell touches, and the algebra of their rows."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from voile.arrays import Flags, Ints, Reals
from voile.contact.directions import lengths

FREE, STICK, SLIP = 0, 1, 2
PENALTY = 1e5  # times rho: stiffness by which the equations eliminate the reactions; refinement leaves no trace of it


@dataclass
class Geometry:
    """Of p contacts: gap (m), its gradient by the relative position (p, 3) (along the normal, of length 1 where
    distances are exact), the s vertices `vertex` (p, s) of each contact and their weights (p, s) in the relative
    position: 1 on an obstacle, which has one vertex; hessian: makes `curvature`, which norms and searches do not
    need."""

    gap: Reals
    gradient: Reals
    vertex: Ints
    weight: Reals
    hessian: Callable[[], Reals]

    @cached_property
    def curvature(self) -> Reals:
        """(p, 3s, 3s) the gap's Hessian over the vertices (1/m)."""
        return self.hessian()


@dataclass
class Pairs:
    """Contacts of the shell with one partner (obstacle or itself; p of them). The natural map's scale (N/m): rho across
    the surface, `along` it; `row` their places in its part of the history; the gap's Geometry; the unit normal, the
    gradient's length, and the trial reaction: lam_n along the gradient, lam_t (p, 3) N in the tangent plane; friction's
    bound (p,) N, mu lam_n but where the potential freezes it; slip (p, 3) m, tangential since the start of the step;
    slip_weight (p, s) the vertices' weights in slip and friction: those of the gap but where the potential freezes
    them."""

    index: int
    friction: float
    rho: float
    along: float
    row: Ints
    geometry: Geometry
    unit: Reals
    gradient_norm: Reals
    lam_n: Reals
    lam_t: Reals
    bound: Reals
    slip: Reals
    slip_weight: Reals

    @property
    def gap(self) -> Reals:
        return self.geometry.gap

    @property
    def gradient(self) -> Reals:
        return self.geometry.gradient

    @property
    def curvature(self) -> Reals:
        return self.geometry.curvature

    @property
    def vertex(self) -> Ints:
        """(p,) the vertex itself; of a contact of several, the first."""
        return self.geometry.vertex[:, 0]

    @property
    def stencil(self) -> Ints:
        """The vertices that the reactions act on: (p,) local ones on an obstacle, else (p, s) of all vertices."""
        return self.vertex if self.geometry.vertex.shape[1] == 1 else self.geometry.vertex

    @property
    def slips(self) -> Flags:
        """(p,) whether the trial reaction is beyond friction's bound: at mu = 0 all that touches slips."""
        found: Flags = (self.lam_n > 0.0) & (lengths(self.lam_t) > self.bound) | (self.friction == 0.0)
        return found

    @property
    def share(self) -> Reals:
        """(p,) of the tangential trial reaction that friction's bound leaves."""
        size = lengths(self.lam_t)
        return np.divide(self.bound, size, out=np.ones_like(size), where=size > self.bound)

    def project(self) -> tuple[Reals, Reals]:
        """Projection of the trial reaction on the cone: normal (p,) and tangential (p, 3) parts, N."""
        return np.maximum(self.lam_n, 0.0), self.share[:, None] * self.lam_t

    def spread(self, normal: Reals, tangential: Reals, total: Reals) -> None:
        """Adds reactions, normal (p,) along the gradient and tangential (p, 3), to the vertices' forces (n, 3)."""
        g = self.geometry
        force = (g.weight * normal[:, None])[:, :, None] * g.gradient[:, None]
        np.add.at(total, g.vertex, force + self.slip_weight[:, :, None] * tangential[:, None])

    def motion(self, dx: Reals) -> tuple[Reals, Reals]:
        """Of displacements (n, 3): the gap's change (p,) and the relative motion (p, 3), to first order."""
        g = self.geometry
        relative = np.einsum("ps,psi->pi", g.weight, dx[g.vertex])
        return dot(g.gradient, relative), np.einsum("ps,psi->pi", self.slip_weight, dx[g.vertex])

    def over_vertices(self, block: Reals, weight: Reals) -> Reals:
        """(p, 3s, 3s) what blocks (p, 3, 3) of the relative position are over the vertices."""
        p, s = weight.shape
        found: Reals = np.einsum("ps,pt,pij->psitj", weight, weight, block).reshape(p, 3 * s, 3 * s)
        return found


def dot(a: Reals, b: Reals) -> Reals:
    """(p,) scalar products of rows."""
    found: Reals = np.einsum("pi,pi->p", a, b)
    return found


def outer(a: Reals, b: Reals) -> Reals:
    """(p, 3, 3) products a b^T of rows."""
    return a[:, :, None] * b[:, None, :]


def times(a: Reals, b: Reals) -> Reals:
    """(p, 3) products of matrices (p, 3, 3) and rows (p, 3)."""
    found: Reals = np.einsum("pij,pj->pi", a, b)
    return found


def within(normal: Reals, v: Reals) -> Reals:
    """(p, 3) parts of rows in the planes of unit normals: taken twice, for what round-off of v leaves off the plane,
    times a penalty, would be a force along the normal."""
    for _ in range(2):
        v = v - dot(normal, v)[:, None] * normal
    return v


def margin(normal: Reals, tangential: Reals, friction: float | Reals) -> Reals:
    """(p,) share of friction's bound that reactions, normal (p,) and tangential (p, 3) N, leave: 1 without any, 0
    where it slips, as all active contacts without friction do."""
    bound, size = friction * normal, lengths(tangential)
    used = np.divide(size, bound, out=np.ones(len(size)), where=bound > 0.0)
    left = np.maximum(1.0 - used, 0.0)  # what slips meets its bound to round-off only
    return np.where(normal > 0.0, left, 1.0)


def barrier(gap: Reals, thickness: float | Reals) -> Reals:
    """(3, p) potential (m^2), push (m) and stiffness, each times N/m, that keep layers from meeting: of the gap (p,)
    between surfaces `thickness` (m, one or (p,)) from it, b = -gap^2 ln(1 + gap / thickness) where gap < 0 (Li et al.
    2020, IPC), to third order nothing at gap = 0."""
    g = np.minimum(gap, 0.0)
    d = np.maximum(g + thickness, 1e-300)
    log = np.log(d / thickness)
    potential, push = -(g**2) * log, 2.0 * g * log + g**2 / d
    return np.array([potential, push, -2.0 * log - 4.0 * g / d + (g / d) ** 2])
