"""Contact as terms of the potential: its augmented Lagrangian, and layers that no step carries through another."""

from dataclasses import dataclass, field

from voile.arrays import Reals
from voile.contact.contact import Contact
from voile.contact.history import History
from voile.contact.pairs import Pairs
from voile.problem.matrix import Blocks
from voile.problem.terms import Hessian, Point, Term


@dataclass
class AugmentedContact(Term):
    """The augmented Lagrangian of contact with frozen reactions (see contact.contact). softness: its stiffness over
    that of the laws."""

    contact: Contact
    softness: float = 1.0
    _last: tuple[Point, History, list[Pairs]] | None = field(default=None, init=False, repr=False)

    def energies(self, at: Point) -> dict[str, float]:
        return {"contact": self.contact.energy(at.positions, at.time, self.softness)}

    def forces(self, at: Point) -> Reals:
        return at.over_dofs(self.contact.force_of(self._pairs(at), at.positions))

    def blocks(self, at: Point, which: Hessian) -> Blocks:
        return self.contact.blocks_of(self._pairs(at), which.safe)

    def _pairs(self, at: Point) -> list[Pairs]:
        """Those at a point, where forces and several Hessians are asked for."""
        contact = self.contact
        if self._last is None or self._last[0] is not at or self._last[1] is not contact.history:
            found = contact.frozen_pairs(at.positions, at.time, self.softness)
            self._last = at, contact.history, found
        return self._last[2]

    def freeze(self, at: Point) -> None:
        """Friction bounds, normals and weights become those of the reactions and the point."""
        self._last = None
        self.contact.freeze(at.positions, at.time)

    def update(self, at: Point) -> None:
        """The reactions become those at the point, and what is frozen follows them."""
        self._last = None
        self.contact.adopt(at.positions, at.time, self.softness)


@dataclass
class ImpenetrableLayers(Term):
    """No potential, but no step on which a layer of the shell passes through another."""

    contact: Contact

    def longest_step(self, at: Point, step: Reals, most: float) -> float:
        motion = most * step[: len(at.u)].reshape(-1, 3)
        return most * self.contact.free_share(at.positions, at.positions + motion)
