"""Contacts tied as they are: active ones stay closed and stick, whatever they carry."""

from dataclasses import dataclass

import numpy as np

from voile.arrays import Flags, Ints, Reals
from voile.contact.natural_map import NaturalMap
from voile.contact.pairs import dot
from voile.problem.matrix import Blocks
from voile.problem.terms import Hessian, Point, Term

STIFF = 100.0  # of a tied contact, over the shell's own at a vertex


@dataclass
class Springs:
    """Of p contacts with one partner: vertices and their weights (p, s), the reactions (p, 3) N that they carry at the
    relative positions rest (p, 3) m; own (p,) marks those counted on this rank."""

    partner: int
    vertex: Ints
    weight: Reals
    reaction: Reals
    rest: Reals
    own: Flags

    def extension(self, x: Reals) -> Reals:
        """(p, 3) m from rest at positions x (n, 3)."""
        found: Reals = np.einsum("ps,psi->pi", self.weight, x[self.vertex]) - self.rest
        return found


class TiedContact(Term):
    """Linear springs in place of all active contacts: closed and without slip they carry the present reactions."""

    def __init__(self, contact: NaturalMap, x: Reals, t: float):
        """Those active at positions x (n, 3)."""
        self.contact, self.stiffness = contact, STIFF * contact.stiffness
        self.springs: list[Springs] = []
        pairs = contact.pairs(x, t)
        s = contact.history  # with the layers that are near now
        for p in pairs:
            g, normal, wide = p.geometry, s.normal[p.index][p.row], contact.partners[p.index].gather(x)
            reaction = normal[:, None] * g.gradient + s.friction[p.index][p.row]
            here = np.einsum("ps,psi->pi", g.weight, wide[g.vertex])
            rest = here - p.slip - (g.gap / p.gradient_norm)[:, None] * p.unit
            active = normal > 0.0
            counted = contact.counted(p)[active]
            self.springs.append(
                Springs(p.index, g.vertex[active], g.weight[active], reaction[active], rest[active], counted)
            )

    @property
    def active(self) -> bool:
        """Whether any contact on this rank is."""
        return any(len(s.own) for s in self.springs)

    def energies(self, at: Point) -> dict[str, float]:
        total = 0.0
        for s in self.springs:
            extension = s.extension(self.contact.partners[s.partner].gather(at.positions))
            total += float(
                (0.5 * self.stiffness * dot(extension, extension) - dot(s.reaction, extension))[s.own].sum()
            )
        return {"contact": total}

    def forces(self, at: Point) -> Reals:
        total = np.zeros_like(at.positions)
        for s in self.springs:
            partner = self.contact.partners[s.partner]
            force = s.reaction - self.stiffness * s.extension(partner.gather(at.positions))
            wide = np.zeros((len(partner.free), 3))
            np.add.at(wide, s.vertex, s.weight[:, :, None] * force[:, None])
            total += partner.restrict(wide)
        return at.over_dofs(total)

    def blocks(self, at: Point, which: Hessian) -> Blocks:
        for s in self.springs:
            count, size = s.weight.shape
            block = np.einsum("ps,pt,ij->psitj", s.weight, s.weight, self.stiffness * np.eye(3))
            stencil = s.vertex[:, 0] if size == 1 else s.vertex
            yield stencil, block.reshape(count, 3 * size, 3 * size)
