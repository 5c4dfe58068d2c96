"""What an obstacle is: the interface that each shape in `obstacles.py` implements, in one class."""

import dataclasses
from dataclasses import dataclass, field
from typing import Any, ClassVar, Self

import numpy as np

from voile.arrays import Ints, Reals
from voile.contact.motion import Motion
from voile.contact.surfaces import Triangles

SHAPES: dict[str, type["Obstacle"]] = {}  # by the scene's word, in the order of their classes


@dataclass(frozen=True)
class Start:
    """Where points are when a step starts: the rows, all by default, of points (n, 3) m at a time (s). A body that
    deforms is asked of them which of its places they are near."""

    points: Reals
    time: float
    rows: slice | Ints = field(default_factory=lambda: slice(None))


@dataclass(frozen=True, kw_only=True)
class Obstacle:
    """A rigid body with Coulomb's coefficient of friction and, in time, restitution (0 to 1); lengths in m.

    A shape is one subclass, named for scenes by `shape=`: its fields made by `voile.keys.key` are the keys of its scene
    table. It defines `derivatives` and `surface`, and `distance` where that is cheaper without derivatives.
    """

    shape: ClassVar[str]
    flat: ClassVar[bool] = False  # its normals are all the same
    turned: ClassVar[float] = 0.5  # cosine of the turn between normals of different sides
    name: str = "obstacle"
    friction: float = 0.0
    restitution: float = 0.0
    motion: Motion = field(default_factory=Motion)

    def __init_subclass__(cls, shape: str, **other: Any) -> None:
        super().__init_subclass__(**other)
        cls.shape = shape
        SHAPES[shape] = cls

    # ---- in scenes ----

    @classmethod
    def scene_keys(cls) -> dict[str, dataclasses.Field[Any]]:
        """The keys of the shape's scene table."""
        return {f.name: f for f in dataclasses.fields(cls) if f.metadata}

    @classmethod
    def check(cls, table: Any) -> None:
        """Raises Rejected, with the key's path, for values in the scene's table that do not go together."""

    @classmethod
    def build(cls, values: dict[str, Any], **common: Any) -> Self:
        """The body of a scene table's values; common: name, friction, restitution, motion."""
        for name, value in values.items():
            common[name] = np.array(value, dtype=float) if isinstance(value, tuple) else value
        return cls(**common)

    # ---- in its own frame ----

    def derivatives(self, p: Reals) -> tuple[Reals, Reals, Reals]:
        """Signed distance (n,), its gradient (n, 3) and Hessian (n, 3, 3) at points (n, 3) of the body's frame."""
        raise NotImplementedError

    def distance(self, p: Reals) -> Reals:
        """(n,) signed distance at points of the body's frame, positive outside."""
        return self.derivatives(p)[0]

    def surface(self, bounds: Reals) -> Triangles:
        """For pictures: points (n, 3) m on the surface at t = 0 and triangles (m, 3), normals outwards.

        bounds (2, 3) m: lowest and highest corner of what must lie near the patch shown of an unbounded shape.
        """
        raise NotImplementedError

    def about(self) -> str:
        """How exact the distance is."""
        return "exact distance"

    # ---- in space, as placed at time t ----

    @property
    def moves(self) -> bool:
        """Whether it is ever elsewhere than at t = 0."""
        return self.motion.moves

    @property
    def blurred(self) -> str:
        """What its distance does not see of it; empty where it sees all."""
        return ""

    @property
    def finest(self) -> float:
        """How thin it is where it is not convex (m)."""
        return np.inf

    @property
    def ends(self) -> float:
        """Time after which it stays as it is."""
        return self.motion.ends

    def way(self, points: Reals, began: float, moved: Reals, ended: float) -> tuple[Reals, Reals]:
        """Begin and end (n, 3) of ways from `points`, at the time `began`, to `moved`, at `ended`, as the body sees
        them."""
        return self.motion.unplace(points, began), self.motion.unplace(moved, ended)

    def derivatives_on_way(self, points: Reals, start: Start) -> tuple[Reals, Reals, Reals]:
        """`derivatives` at points of such ways from a start."""
        return self.derivatives(points)

    def gap(self, points: Reals, t: float, start: Start | None = None) -> Reals:
        """(n,) signed distance of points (n, 3). start: of the step that t is in, without one as they are."""
        return self.distance(self.motion.unplace(points, t) if self.motion.moves else points)

    def gap_derivatives(
        self, points: Reals, t: float, start: Start | None = None
    ) -> tuple[Reals, Reals, Reals]:
        """gap (n,), its gradient (n, 3) and its Hessian (n, 3, 3)."""
        if not self.motion.moves:
            return self.derivatives(points)
        gap, normal, curvature = self.derivatives(self.motion.unplace(points, t))
        turn = self.motion.turn(t)
        return gap, normal @ turn.T, turn @ curvature @ turn.T

    def carry(self, points: Reals, start: float, end: float) -> Reals:
        """(n, 3) where points fixed to the body go from time start to end."""
        if not self.motion.moves:
            return points
        return self.motion.place(self.motion.unplace(points, start), end)
