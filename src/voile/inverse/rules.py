"""What a pattern maker asks of panels and seams, by name; a group's name stands for all panels of it."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from voile.arrays import Ints, Reals
from voile.errors import InputError
from voile.mesh import is_called


@dataclass(frozen=True)
class PanelRule:
    """grain: direction in space (3,), "tube" or "long" (see grain.py), of the panels called `panel`."""

    panel: str
    grain: tuple[float, ...] | str


@dataclass(frozen=True)
class SeamRule:
    """Seams between the two panels named, or the free border of one, or of all: allowance (m), None the pattern's; ease
    (m): by how much the first one's side is longer; vertices (k,): of the surface, between which a free border is
    meant, None for all of it."""

    between: tuple[str, ...]
    allowance: float | None = None
    ease: float = 0.0
    vertices: Ints | None = None


@dataclass(frozen=True)
class Rules:
    """All that is asked for; symmetric: the axis (0 to 2) across which panels mirror each other, else None."""

    panels: tuple[PanelRule, ...] = ()
    seams: tuple[SeamRule, ...] = ()
    symmetric: int | None = None


NO_RULES = Rules()


class Named(Protocol):
    """What rules look for: panels' names, and the seams between them (indices)."""

    @property
    def names(self) -> tuple[str, ...]: ...

    @property
    def seams(self) -> Sequence[Any]: ...


def check_rules(panels: Named, rules: Sequence[PanelRule], seams: Sequence[SeamRule]) -> None:
    """Raises InputError for the first rule that no panel or seam answers to."""
    known = ", ".join(panels.names)
    wanted = [(f"pattern.panel.{k}.panel", rule.panel) for k, rule in enumerate(rules)]
    wanted += [(f"pattern.seam.{k}.between", name) for k, rule in enumerate(seams) for name in rule.between]
    for key, name in wanted:
        if not any(is_called(panel, name) for panel in panels.names):
            raise InputError(f"{key}: no panel {name!r}; allowed: {known}")
    for k, rule in enumerate(seams):
        if len(rule.between) == 2 and not any(sides(panels, seam, rule) for seam in panels.seams):
            one, other = rule.between
            raise InputError(
                f"pattern.seam.{k}.between: no seam joins {one!r} and {other!r}; seams join "
                + "; ".join(sorted({" and ".join(panels.names[p] for p in s.panels) for s in panels.seams}))
            )


def sides(panels: Named, seam: Any, rule: SeamRule) -> tuple[int, int] | None:
    """The sides (0 or 1) of a seam that the first and second name of a rule mean; None if it is not meant."""
    if len(rule.between) == 2:
        names = [panels.names[k] for k in seam.panels]
        for order in ((0, 1), (1, 0)):
            if all(is_called(names[side], rule.between[k]) for k, side in enumerate(order)):
                return order
    return None


def allowances(panels: Any, seams: Sequence[SeamRule], allowance: float) -> tuple[list[Reals], list[float]]:
    """From the sew line to the cut line, m: along each panel's outline, (b,) for the edge from each point to the next,
    and at each seam. The last rule that means an edge counts."""
    at_seam = [allowance] * len(panels.seams)
    for k, seam in enumerate(panels.seams):
        for rule in seams:
            if rule.allowance is not None and sides(panels, seam, rule):
                at_seam[k] = rule.allowance
    along: dict[frozenset[int], float] = {}
    for seam, width in zip(panels.seams, at_seam, strict=True):
        for run in seam.sides:
            along |= {
                frozenset(ends): width for ends in zip(run[:-1].tolist(), run[1:].tolist(), strict=True)
            }
    found = []
    for name, outline in zip(panels.names, panels.outlines, strict=True):
        border = _borders(name, panels.vertex[outline], seams, allowance)
        pairs = zip(outline.tolist(), np.roll(outline, -1).tolist(), strict=True)
        widths = zip(pairs, border.tolist(), strict=True)
        found.append(np.array([along.get(frozenset(ends), width) for ends, width in widths]))
    return found, at_seam


def _borders(name: str, around: Ints, seams: Sequence[SeamRule], allowance: float) -> Reals:
    """(b,) allowance of each edge of a panel's outline, given by surface vertices (b,), were it free."""
    found = np.full(len(around), allowance)
    for rule in seams:
        if (
            rule.allowance is None
            or len(rule.between) > 1
            or not all(is_called(name, n) for n in rule.between)
        ):
            continue
        meant = np.ones(len(around), dtype=bool)
        if rule.vertices is not None:
            ends = np.isin(around, rule.vertices)
            meant = ends & np.roll(ends, -1)
        found[meant] = rule.allowance
    return found
