"""Keys of supports."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from voile.keys import Array, Axes, Boolean, Rejected, Table, Text, Vector3, key, vector
from voile.scene.loads import SELECT, SELECTED
from voile.scene.moves import Move

PARALLEL = 1e-6  # sine of an angle at which two directions span no plane


@dataclass(frozen=True, kw_only=True)
class Fix:
    name: str = key(Text(), "title in the table of reactions; default: fix and its index", default="")
    select: dict[str, Any] = key(SELECT, SELECTED)
    axes: str = key(Axes(), "axes along which the selection is held", default="xyz")
    frame: tuple[Vector3, ...] | None = key(
        Array(vector(nonzero=True), least=1),
        "directions of axes of its own, for axes and move: x, and a second one in the plane of x and y, needed only to "
        "tell y from z; default: the global axes",
        default=None,
    )
    clamp: bool = key(
        Boolean(),
        "also hold the directors: no rotation there (of a rest shape in place: from its own angle)",
        default=False,
    )
    move: Move | None = key(Table(Move), "prescribed motion along the held axes", default=None)

    def check(self, given: set[str]) -> None:
        move = self.move
        if self.frame is not None:
            self._check_frame()
        for name, unit in (("displacement", "m"), ("velocity", "m/s")) if move else ():
            for axis, part in zip("xyz", getattr(move, name), strict=True):
                if part != 0.0 and axis not in self.axes:
                    raise Rejected(
                        f'{part:g} {unit} along {axis}, but axes = "{self.axes}" leaves {axis} free; '
                        "allowed: motion along the held axes",
                        ("move", name),
                    )
        if move and (move.path or any(move.rotation) or any(move.angular_velocity)) and len(self.axes) < 3:
            raise Rejected(f'axes = "{self.axes}"; allowed with a rotation or a path: "xyz"', ("move",))

    def _check_frame(self) -> None:
        x, *more = self.frame or ()
        if len(more) > 1:
            raise Rejected(f"{len(more) + 1} directions; allowed: one or two", ("frame",))
        if more and np.linalg.norm(np.cross(x, more[0])) < PARALLEL * np.linalg.norm(x) * np.linalg.norm(
            more[0]
        ):
            raise Rejected("the two directions are parallel; allowed: any two that are not", ("frame",))
        vague = self.axes not in ("x", "yz", "zy") and set(self.axes) != set("xyz")
        if self.move and not more:
            vague |= any(self.move.displacement[1:]) or any(self.move.velocity[1:])
        if not more and vague:
            raise Rejected(
                "one direction leaves y and z open; allowed: a second one, or axes x, yz or xyz and motion along x",
                ("frame",),
            )
        if self.move and (self.move.path or any(self.move.rotation) or any(self.move.angular_velocity)):
            raise Rejected("allowed without rotation or path, which are along global axes", ("frame",))
