"""What a scene's tables attach to a mesh, as arrays: dead forces, masses, springs, bands and ties."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from voile.arrays import Ints, Reals
from voile.errors import InputError
from voile.mesh.select import select
from voile.mesh.shares import edges_of, portions, shares
from voile.mesh.surface import Surface
from voile.mesh.topology import Topology


@dataclass(frozen=True)
class Attached:
    """The mesh, its boundary loops, and the scene's path for messages."""

    surface: Surface
    topology: Topology
    loops: Sequence[Ints]
    path: str

    def total(self, key: str, tables: Sequence[tuple[Any, Any]]) -> Reals | None:
        """(n,) or (n, 3) sum over tables, each with its value: a total over its selection, or per length or area of
        it; None without tables."""
        found = [
            np.multiply.outer(self._amounts(f"{key}.{k}", t), value) for k, (t, value) in enumerate(tables)
        ]
        return np.sum(found, axis=0) if found else None

    def patches(self, tables: Sequence[Any]) -> Reals | None:
        """(m,) pressure of the triangles of groups; None without."""
        total = np.zeros(len(self.surface.triangles))
        names = self.surface.group_names
        for k, table in enumerate(tables):
            if table.group not in names:
                raise InputError(
                    f"{self.path}: loads.patch.{k}.group = {table.group!r} is not a group of triangles of "
                    f"{self.surface.source}; there are: {', '.join(names) or 'none'}"
                )
            total[self.surface.group == names.index(table.group)] += table.pressure
        return total if tables else None

    def springs(self, tables: Sequence[Any]) -> Reals | None:
        """(n, 3) stiffness of elastic supports along each axis."""
        axes = [np.array([axis in table.axes for axis in "xyz"], dtype=float) for table in tables]
        return self.total("spring", [(t, t.stiffness * along) for t, along in zip(tables, axes, strict=True)])

    def bars(self, bands: Sequence[Any], ties: Sequence[Any]) -> Reals | None:
        """(b, 4) two vertices, stiffness and length of bands' edges and of ties."""
        rows = [self._band(k, band) for k, band in enumerate(bands)]
        rows += [self._tie(k, tie) for k, tie in enumerate(ties)]
        return np.concatenate(rows) if rows else None

    def _amounts(self, key: str, table: Any) -> Reals:
        where = f"{self.path}: {key}"
        vertices = select(self.surface, self.loops, table.select, f"{where}.select")
        if table.per == "total":
            return shares(self.surface, self.topology, vertices, table.share, f"{where}.share")[0]
        return portions(self.surface, self.topology, vertices, table.per, f"{where}.per")[0]

    def _band(self, k: int, band: Any) -> Reals:
        where, x = f"{self.path}: band.{k}.select", self.surface.points
        inside = np.zeros(len(x), dtype=bool)
        inside[self.surface.first_copies[select(self.surface, self.loops, band.select, where)]] = True
        edges = edges_of(self.surface, self.topology, inside)
        if not len(edges):
            raise InputError(f"{where}: no edge has both ends selected")
        length = band.rest * np.linalg.norm(x[edges[:, 1]] - x[edges[:, 0]], axis=1)
        return np.column_stack([edges, band.stiffness / length, length])

    def _tie(self, k: int, tie: Any) -> Reals:
        where, x = f"{self.path}: tie.{k}.nodes", self.surface.points
        if tie.nodes[0] == tie.nodes[1]:
            raise InputError(f"{where}: vertex {tie.nodes[0]} twice; allowed: two vertices")
        ends = [int(select(self.surface, self.loops, {"nodes": [node]}, where)[0]) for node in tie.nodes]
        apart = float(np.linalg.norm(x[ends[1]] - x[ends[0]]))
        return np.array([[*ends, tie.stiffness, apart if tie.length is None else tie.length]])
