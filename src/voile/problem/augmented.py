"""Contact as terms of the potential: its augmented Lagrangian, and layers that no step carries through another."""

from dataclasses import dataclass

from voile.arrays import Reals
from voile.contact.contact import Contact
from voile.problem.matrix import Blocks
from voile.problem.terms import Point, Term


@dataclass
class AugmentedContact(Term):
    """The augmented Lagrangian of contact with frozen reactions (see contact.contact). softness: its stiffness over
    that of the laws."""

    contact: Contact
    softness: float = 1.0

    def energies(self, at: Point) -> dict[str, float]:
        return {"contact": self.contact.energy(at.positions, at.time, self.softness)}

    def forces(self, at: Point) -> Reals:
        return at.over_dofs(self.contact.force(at.positions, at.time, self.softness))

    def blocks(self, at: Point, kind: str) -> Blocks:
        return self.contact.blocks(at.positions, at.time, kind == "safe", self.softness)

    def freeze(self, at: Point) -> None:
        """Friction bounds, normals and weights become those of the reactions and the point."""
        self.contact.freeze(at.positions, at.time)

    def update(self, at: Point) -> None:
        """The reactions become those at the point, and what is frozen follows them."""
        self.contact.adopt(at.positions, at.time, self.softness)


@dataclass
class ImpenetrableLayers(Term):
    """No potential, but no step on which a layer of the shell passes through another."""

    contact: Contact

    def longest_step(self, at: Point, step: Reals, most: float) -> float:
        motion = most * step[: len(at.u)].reshape(-1, 3)
        return most * self.contact.free_share(at.positions, at.positions + motion)
