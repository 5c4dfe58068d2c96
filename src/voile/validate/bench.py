"""Runs the scenes of protocols: a dict and arrays in, what a user's run leaves out.

Scenes, meshes and results stay in the bench's folder, where `voile run` and `voile render` take them.
"""

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import voile
from voile.arrays import Ints, Reals
from voile.errors import NotConverged
from voile.files import made, replace
from voile.mesh import write_obj
from voile.results import Result, read_result, read_summary
from voile.results.history import read_history
from voile.scene.plain import plain, toml


class Mesh(NamedTuple):
    """points (n, 3) m, triangles (m, 3); groups: (m,) index and names."""

    points: Reals
    triangles: Ints
    groups: tuple[Ints, tuple[str, ...]] | None = None


@dataclass
class Outcome:
    """What a run left in its folder."""

    folder: Path

    @cached_property
    def summary(self) -> dict[str, Any]:
        return read_summary(self.folder / "summary.json")

    @cached_property
    def result(self) -> Result:
        return read_result(self.folder)

    @cached_property
    def history(self) -> dict[str, Reals]:
        return read_history(self.folder)

    @property
    def converged(self) -> bool:
        return bool(self.summary["converged"])

    def positions(self, step: int = -1) -> Reals:
        """(n, 3) m."""
        return self.result.points(step)

    @property
    def displacements(self) -> Reals:
        """(n, 3) m, from the start to the end."""
        return self.positions() - self.result.start


@dataclass
class Bench:
    """folder: of one protocol; quick: smaller meshes, fewer points; change: alters each scene before it runs (tests
    prove by it that a wrong number is noticed); notes: for the report."""

    folder: Path
    quick: bool = False
    change: Callable[[dict[str, Any]], None] | None = None
    notes: list[str] = field(default_factory=list)

    def run(self, name: str, scene: dict[str, Any]) -> Outcome:
        """Runs a scene whose files may be given as `Mesh`. Raises NotConverged."""
        outcome = self.attempt(name, scene)
        if not outcome.converged:
            raise NotConverged(f"{name}: {outcome.summary['reason']}")
        return outcome

    def attempt(self, name: str, scene: dict[str, Any]) -> Outcome:
        """The same, of a scene that may be known not to reach its end."""
        made(self.folder)
        scene = {key: dict(table) if isinstance(table, dict) else table for key, table in scene.items()}
        if self.change:
            self.change(scene)
        for key, value in scene["shell"].items():
            if isinstance(value, Mesh):
                file = f"{name}-{key}.obj"
                write_obj(self.folder / file, value.points, value.triangles, groups=value.groups)
                scene["shell"][key] = file
        path, folder = self.folder / f"{name}.toml", self.folder / f"{name}-result"
        replace(path, toml(plain(scene)).encode())
        solve(path, folder)
        return Outcome(folder)


def solve(path: Path, folder: Path) -> None:
    """Runs a scene file as a user does; how it ended stands in its summary."""
    with suppress(NotConverged):
        voile.run(path, folder)
