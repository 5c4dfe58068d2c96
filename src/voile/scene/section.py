"""Keys of section forces."""

from dataclasses import dataclass
from typing import Any

from voile.keys import Rejected, Text, Vector3, key, vector
from voile.scene.loads import SELECT, SELECTED


@dataclass(frozen=True, kw_only=True)
class Section:
    name: str = key(Text(), "title in the summary; default: section and its index", default="")
    select: dict[str, Any] | None = key(
        SELECT, f"what lies inside; {SELECTED}; default: by point and normal", default=None
    )
    point: Vector3 | None = key(vector("m"), "of a plane that cuts the start shape", default=None)
    normal: Vector3 | None = key(vector(nonzero=True), "of the plane, towards what lies inside", default=None)
    about: Vector3 | None = key(
        vector("m"),
        "point about which the moment counts; default: centroid of the vertices inside next to the cut, as they are",
        default=None,
    )

    def check(self, given: set[str]) -> None:
        plane = self.point is not None and self.normal is not None
        if (self.select is None) != plane or (self.select and (self.point or self.normal)):
            raise Rejected("allowed: select, or point and normal")
