"""Contacts that stay closed and stick, whatever they carry: what a disturbed shell first settles around."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from voile.contact.natural_map import NaturalMap
from voile.contact.pairs import dot

STIFF = 100.0  # of a kept contact, over the shell's own at a vertex


@dataclass
class Springs:
    """Of p contacts with one partner: vertices and their weights (p, s), the reactions (p, 3) N that they carry at the
    relative positions home (p, 3) m; own (p,) marks those counted on this rank."""

    partner: int
    vertex: np.ndarray
    weight: np.ndarray
    reaction: np.ndarray
    home: np.ndarray
    own: np.ndarray

    def away(self, x: np.ndarray) -> np.ndarray:
        """(p, 3) m from home at positions x (n, 3)."""
        return np.einsum("ps,psi->pi", self.weight, x[self.vertex]) - self.home


class Kept:
    """Linear springs in place of all contacts that bear: closed and without slip they carry the present reactions."""

    def __init__(self, contact: NaturalMap, x: np.ndarray, t: float):
        """What bears at positions x (n, 3)."""
        self.contact, self.stiffness = contact, STIFF * contact.stiffness
        self.springs: list[Springs] = []
        pairs = contact.pairs(x, t)
        s = contact.state  # with the layers that are near now
        for p in pairs:
            g, normal, wide = p.geometry, s.normal[p.index][p.row], contact.partners[p.index].widen(x)
            reaction = normal[:, None] * g.gradient + s.friction[p.index][p.row]
            here = np.einsum("ps,psi->pi", g.weight, wide[g.vertex])
            home = here - p.slip - (g.gap / p.steepness)[:, None] * p.unit
            bears = normal > 0.0
            parts = (g.vertex, g.weight, reaction, home, contact.counted(p))
            self.springs.append(Springs(p.index, *(part[bears] for part in parts)))

    @property
    def bears(self) -> bool:
        """Whether anything bears on this rank."""
        return any(len(s.own) for s in self.springs)

    def energy(self, x: np.ndarray) -> float:
        """J, of those that count on this rank."""
        total = 0.0
        for s in self.springs:
            away = s.away(self.contact.partners[s.partner].widen(x))
            total += float((0.5 * self.stiffness * dot(away, away) - dot(s.reaction, away))[s.own].sum())
        return total

    def force(self, x: np.ndarray) -> np.ndarray:
        """(n, 3) on the shell (N)."""
        total = np.zeros_like(x)
        for s in self.springs:
            partner = self.contact.partners[s.partner]
            force = s.reaction - self.stiffness * s.away(partner.widen(x))
            wide = np.zeros((len(partner.free), 3))
            np.add.at(wide, s.vertex, s.weight[:, :, None] * force[:, None])
            total += partner.narrow(wide)
        return total

    def blocks(self) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Hessian, as that of `Contact.blocks`."""
        for s in self.springs:
            count, size = s.weight.shape
            block = np.einsum("ps,pt,ij->psitj", s.weight, s.weight, self.stiffness * np.eye(3))
            stencil = s.vertex[:, 0] if size == 1 else s.vertex
            yield stencil, block.reshape(count, 3 * size, 3 * size)
