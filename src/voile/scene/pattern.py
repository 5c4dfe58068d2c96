"""Keys of the sewing pattern that task = inverse writes."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from voile.errors import InputError
from voile.keys import Array, Choice, Grain, Number, Rejected, Tables, Text, key
from voile.mesh import is_called
from voile.scene.loads import SELECT, SELECTED

AXES = ("x", "y", "z")


@dataclass(frozen=True, kw_only=True)
class PatternPanel:
    panel: str = key(Text(filled=True), "name of a panel, or of the group whose panels are meant")
    grain: tuple[float, ...] | str = key(
        Grain("tube", "long"),
        "where its grain line points: a direction in space; tube: the axis of a panel that is sewn to itself, as a "
        "sleeve; long: its long axis",
    )


@dataclass(frozen=True, kw_only=True)
class PatternSeam:
    between: tuple[str, ...] = key(
        Array(Text(filled=True), least=1),
        "the two panels (or groups) that the seam joins; one: its free border; default: that of all panels",
        default=(),
    )
    select: dict[str, Any] | None = key(
        SELECT, f"of free borders: the part between these vertices, as a hem; {SELECTED}", default=None
    )
    allowance: float | None = key(
        Number("m", least=0),
        "from the sew line to the cut line; default: inverse.seam_allowance",
        default=None,
    )
    ease: float = key(
        Number("m"),
        "by how much the first panel's side is longer, to be gathered in; below 0: the second's",
        default=0.0,
    )

    def check(self, given: set[str]) -> None:
        if len(self.between) > 2:
            raise Rejected(f"{list(self.between)}; allowed: one or two names", ("between",))
        if self.ease and len(self.between) < 2:
            raise Rejected("of a free border; allowed: between two panels", ("ease",))
        if self.select and len(self.between) > 1:
            raise Rejected("of a seam between two panels; allowed: of free borders", ("select",))
        if not self.between and self.select is None:
            raise Rejected("missing; allowed: between, select or both", ("between",))
        if not given & {"allowance", "ease"}:
            raise Rejected("says nothing of the seam; allowed: with allowance or ease", ("between",))


@dataclass(frozen=True, kw_only=True)
class Pattern:
    """What is asked of the pattern beside inverse.seams and inverse.seam_allowance."""

    symmetric: bool | str = key(
        Choice(False, *AXES),
        "axis across which left and right panels are made mirror images, exactly; the mesh must mirror itself",
        default=False,
    )
    panel: tuple[PatternPanel, ...] = key(Tables(PatternPanel), "grain of single panels", default=())
    seam: tuple[PatternSeam, ...] = key(Tables(PatternSeam), "allowance and ease of single seams", default=())


def check_names(scene: Any, groups: Sequence[str], size: float) -> None:
    """Raises InputError for lengths of a scene's pattern beyond the shell's size (m), and for names that no panel of a
    mesh of these groups can have."""
    lengths = {"inverse.seam_allowance": scene.inverse.seam_allowance}
    known = groups if len(groups) > 1 else ("panel",)
    names = [(f"pattern.panel.{k}.panel", rule.panel) for k, rule in enumerate(scene.pattern.panel)]
    for k, rule in enumerate(scene.pattern.seam):
        names += [(f"pattern.seam.{k}.between", name) for name in rule.between]
        lengths |= {
            f"pattern.seam.{k}.allowance": rule.allowance or 0.0,
            f"pattern.seam.{k}.ease": abs(rule.ease),
        }
    for where, length in lengths.items():
        if length > size:
            raise InputError(
                f"{scene.path}: {where}: {length:g} m; allowed: at most the shell's size, {size:.4g} m"
            )
    for where, name in names:
        if not any(is_called(name, group) for group in known):
            listed = (
                ", ".join(known) if len(known) > 1 else "panel-1, panel-2 and so on (the mesh has one group)"
            )
            raise InputError(f"{scene.path}: {where} = {name!r} is no panel; allowed: {listed}")
