"""The semismooth Newton equations of Signorini's and Coulomb's laws for the reactions of all contacts."""

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from voile.arrays import Ints, Reals
from voile.contact.directions import lengths
from voile.contact.natural_map import NaturalMap
from voile.contact.pairs import Pairs, outer, times, within


class Equations:
    """Reactions f = a - D dx of the pairs with one partner for a step dx of their vertices, with constraints (gap and,
    for those that stick, slip) kept by a penalty and corrected by `advance`."""

    def __init__(self, contact: NaturalMap, p: Pairs, firmness: float):
        self.pairs, self.mu = p, p.friction
        s = contact.history
        self.partner, self.history = contact.partners[p.index], s
        self.penalty = firmness * contact.penalty
        fresh = not s.normal[p.index].any()  # no reactions yet: all that touches may carry one, and sticks
        self.active = p.gap <= contact.reach(p.index) if fresh else p.lam_n > 0.0
        self.normal = s.normal[p.index][p.row].copy()
        self.friction = within(p.unit, s.friction[p.index][p.row])
        size = np.maximum(lengths(p.lam_t), 1e-300)
        self.stick = self.active & (fresh | (size <= p.bound)) & (self.mu > 0.0)
        self.slips = self.active & ~self.stick
        along = p.lam_t / size[:, None]
        self.along = (self.mu * p.gradient_norm)[:, None] * along  # friction per lam_n
        self.tangential = np.eye(3) - outer(p.unit, p.unit)
        self.sideways = self.tangential - outer(along, along)
        share = np.where(self.slips & (self.mu > 0.0), np.minimum(p.share, 1.0 - 1e-5), 0.0)
        self.turning = p.along * share / (1.0 - share)  # N/m: friction's direction follows the slip's
        self.pressed = np.maximum(p.lam_n, 0.0)

    @property
    def symmetric(self) -> bool:
        return self.mu == 0.0 or not self.slips.any()

    def spread(self, total: Reals) -> None:
        """Adds a, the reactions without a step, to the vertices' forces (n, 3), N."""
        p = self.pairs
        normal = np.where(self.active, self.normal - self.penalty * p.gap, 0.0)
        stuck = self.friction - self.penalty * p.slip
        moved = normal[:, None] * self.along - self.turning[:, None] * times(self.sideways, p.slip)
        p.spread(normal, self._chosen(stuck, moved), total)

    def blocks(self) -> Reals:
        """(p, 3s, 3s) D, N/m."""
        p = self.pairs
        moved = self.penalty * outer(p.gradient + self.along, p.gradient)
        moved += self.turning[:, None, None] * self.sideways
        return self._over_vertices(moved) + self._turned()

    def _turned(self) -> Reals:
        """(p, 3s, 3s) what slips: its tangent plane, and with it friction, follows the normal."""
        p, g = self.pairs, self.pairs.geometry
        count, s = g.weight.shape
        curvature = np.where(g.weight[:, :, None, None] > 0.0, g.curvature.reshape(count, s, 3, 3 * s), 0.0)
        normal = curvature.sum(
            axis=1
        )  # on one side the weights sum to 1, whose gradients are the gap's there
        size = np.where(self.slips, self.pressed / p.gradient_norm, 0.0)
        turned = np.einsum("p,pi,pij->pj", size, self.along, normal)
        found: Reals = np.einsum("ps,pi,pj->psij", g.weight, p.unit, turned).reshape(g.curvature.shape)
        return found

    def held(self) -> Reals:
        """(p, 3s, 3s) symmetric stiffness of the constraints, N/m: what slips may go on the way it slips."""
        p = self.pairs
        moved = self.penalty * (outer(p.gradient, p.gradient) + (self.mu > 0.0) * self.sideways)
        return self._over_vertices(moved)

    def _over_vertices(self, moved: Reals) -> Reals:
        """Blocks of what sticks, slips (`moved`, (p, 3, 3)) or is open, with the gap's curvature."""
        p = self.pairs
        stuck = self.penalty * (outer(p.gradient, p.gradient) + self.tangential)
        which = np.where(self.stick[:, None, None], stuck, moved)
        block = np.where(self.active[:, None, None], which, 0.0)
        curved = np.where(self.active, self.pressed, 0.0)
        return p.over_vertices(block, p.geometry.weight) - curved[:, None, None] * p.curvature

    def _chosen(self, stuck: Reals, moved: Reals) -> Reals:
        """(p, 3) friction of what sticks and slips; none where open."""
        return np.where(self.stick[:, None], stuck, np.where(self.slips[:, None], moved, 0.0))

    def advance(self, dx: Reals) -> None:
        """Takes the penalty's share of the reactions after the step dx (n, 3) into the multipliers."""
        p = self.pairs
        opening, relative = p.motion(dx)
        slid = within(p.unit, p.slip + relative)
        self.normal = np.where(self.active, self.normal - self.penalty * (p.gap + opening), 0.0)
        turned = self.normal[:, None] * self.along - self.turning[:, None] * times(self.sideways, slid)
        self.friction = self._chosen(self.friction - self.penalty * slid, turned)

    def hold(self, doubted: Ints) -> Ints:
        """What a step makes pull stays closed for one more, with its trial reaction, unless it is among the contacts
        doubted then (codes); the codes of those that do. A step that turns a membrane stretches it to second order, and
        that outweighs the reactions around: what opens for it closes in the next one, and so on."""
        p = self.pairs
        code = self.partner.codes(p.row, self.history)
        pulls = self.active & (self.normal < 0.0) & ~np.isin(code, doubted)
        self.normal = np.where(pulls, self.pressed, self.normal)
        return code[pulls]


@dataclass
class Linearised:
    """Equations of all pairs that may carry a reaction. firmness: share of the whole penalty. doubted: codes of
    contacts per partner that pull and are kept closed, see `Equations.hold`."""

    contact: NaturalMap
    parts: list[Equations]
    firmness: float = 1.0
    doubted: dict[int, Ints] = field(default_factory=dict)

    @property
    def symmetric(self) -> bool:
        return all(part.symmetric for part in self.parts)

    def states(self) -> list[tuple[bytes, ...]]:
        """Which pairs are active and stick, to recognise a cycle."""
        return [(e.pairs.row[e.active].tobytes(), e.pairs.row[e.stick].tobytes()) for e in self.parts]

    def force(self) -> Reals:
        """(n, 3) reactions without a step, N."""
        total = np.zeros((len(self.contact.movable), 3))
        for e in self.parts:
            self.contact.collect(e.pairs, e.spread, total)
        return total

    def blocks(self) -> Iterator[tuple[Ints, Reals]]:
        """Their derivative by the step, per partner (stencils, blocks N/m) as of `Contact.blocks`."""
        for e in self.parts:
            yield e.pairs.stencil, e.blocks()

    def held(self) -> Iterator[tuple[Ints, Reals]]:
        """What the constraints add to the tangent that decides stability, as `blocks`."""
        for e in self.parts:
            yield e.pairs.stencil, e.held()

    def advance(self, dx: Reals) -> None:
        """Corrects the multipliers after the step dx (n, 3)."""
        for e in self.parts:
            e.advance(self.contact.partners[e.pairs.index].gather(dx))

    def reactions(self, share: float) -> None:
        """The present reactions move by a share (0 to 1) of the way to those of the step."""
        s = self.contact.history
        normal = [np.zeros_like(a) for a in s.normal]
        friction = [np.zeros_like(a) for a in s.friction]
        none = np.zeros(0, dtype=np.int64)
        if not self.contact.itself:  # at the border of a patch on another layer that cycles
            self.doubted = {e.pairs.index: e.hold(self.doubted.get(e.pairs.index, none)) for e in self.parts}
        for e in self.parts:
            normal[e.pairs.index][e.pairs.row], friction[e.pairs.index][e.pairs.row] = e.normal, e.friction
        s.normal = [old + share * (new - old) for old, new in zip(s.normal, normal, strict=True)]
        s.friction = [old + share * (new - old) for old, new in zip(s.friction, friction, strict=True)]
