"""Keys of loads, and of what is attached to a shell: springs, bands, ties, masses. Selections of vertices."""

from dataclasses import dataclass
from typing import Any

from voile.keys import (
    Array,
    Axes,
    Boolean,
    Box,
    Choice,
    Integer,
    Number,
    Rejected,
    Selection,
    Tables,
    Text,
    Vector3,
    key,
    vector,
)

SELECT = Selection(
    {
        "nodes": Array(Integer(), least=1, lone=True),
        "group": Array(Text(filled=True), least=1, lone=True),
        "box": Box(),
        "boundary": Array(Integer(), least=1, lone=True),
        "all": Boolean(only_true=True),
    }
)
SELECTED = (
    "vertices: nodes (indices in the mesh file, from 0), group (of triangles, or of a Gmsh file's lines and points), "
    "box [[min], [max]] in m, boundary (index of the loop, 0 the longest), all = true; several keys select what "
    "satisfies them all"
)


SHARES = ("length", "area", "vertices")
SHARE_MEANING = (
    "how a total is shared: by the length of the edges or the area of the triangles that the selection holds, or alike "
    "on all vertices; default: by area of a patch, by length along a line, else alike"
)
PER = ("total", "length", "area")
PER_MEANING = "total over the selection, or per length of its edges or area of its triangles, at the start"


@dataclass(frozen=True, kw_only=True)
class Shared:
    """A value over a selection."""

    select: dict[str, Any] = key(SELECT, SELECTED)
    per: str = key(Choice(*PER), PER_MEANING, default="total")
    share: str | None = key(Choice(*SHARES), SHARE_MEANING, default=None)

    def check(self, given: set[str]) -> None:
        if self.per != "total" and self.share not in (None, self.per):
            raise Rejected(
                f'"{self.share}"; allowed with per = "{self.per}": none, or "{self.per}"', ("share",)
            )


@dataclass(frozen=True, kw_only=True)
class Force(Shared):
    value: Vector3 = key(vector("N, N/m or Pa, see per"), "dead force")


@dataclass(frozen=True, kw_only=True)
class Moment:
    select: dict[str, Any] = key(SELECT, SELECTED)
    value: float = key(Number("N m"), "moment about the selection's boundary edges, total, shared by length")


@dataclass(frozen=True, kw_only=True)
class Patch:
    group: str = key(Text(filled=True), "group of the mesh that it acts on")
    pressure: float = key(Number("Pa"), "along the normal, which it follows, beside loads.pressure")


@dataclass(frozen=True, kw_only=True)
class Loads:
    gravity: Vector3 = key(vector("m/s^2"), "acceleration of gravity", default=(0.0, -9.81, 0.0))
    pressure: float = key(Number("Pa"), "pressure along the normal, which it follows", default=0.0)
    wind: Vector3 = key(vector("m/s"), "dynamics: velocity of the air", default=(0.0, 0.0, 0.0))
    drag: float = key(
        Number("kg/m^3", least=0),
        "dynamics: force per area over the square of the air's normal velocity, relative to the shell",
        default=0.0,
    )
    history: tuple[tuple[float, ...], ...] = key(
        Array(Array(Number(), length=2)),
        "dynamics: (t, factor) on gravity, pressures, forces and moments, from t = 0 s on, linear between, the last "
        "one from then on",
        default=(),
    )
    force: tuple[Force, ...] = key(Tables(Force), "dead forces", default=())
    patch: tuple[Patch, ...] = key(Tables(Patch), "pressures on groups", default=())
    moment: tuple[Moment, ...] = key(Tables(Moment), "end moments", default=())

    def check(self, given: set[str]) -> None:
        if self.history and self.history[0][0] > 0.0:
            raise Rejected(
                f"begins at t = {self.history[0][0]:g} s; allowed: a first row at t = 0 s", ("history",)
            )
        for index, row in enumerate(self.history):
            if index and row[0] <= self.history[index - 1][0]:
                raise Rejected(f"t = {row[0]:g} s is not after the time before", ("history", index))


@dataclass(frozen=True, kw_only=True)
class Spring(Shared):
    stiffness: float = key(
        Number("N/m, N/m^2 or N/m^3, see per", above=0), "of an elastic support to where the shell starts"
    )
    axes: str = key(Axes(), "axes along which it acts", default="xyz")


@dataclass(frozen=True, kw_only=True)
class Band:
    select: dict[str, Any] = key(SELECT, SELECTED)
    stiffness: float = key(
        Number("N", above=0),
        "of an elastic band along the selection's edges: force over extension of its length",
    )
    rest: float = key(Number(above=0), "its length at rest over that of the edges at the start", default=1.0)


@dataclass(frozen=True, kw_only=True)
class Tie:
    nodes: tuple[int, ...] = key(
        Array(Integer(0), length=2), "two vertices (indices in the mesh file, from 0)"
    )
    stiffness: float = key(Number("N/m", above=0), "of the bar between them")
    length: float | None = key(
        Number("m", least=0), "of the bar at rest; default: their distance at the start", default=None
    )


@dataclass(frozen=True, kw_only=True)
class Mass(Shared):
    value: float = key(Number("kg, kg/m or kg/m^2, see per", above=0), "mass beside the fabric's")
