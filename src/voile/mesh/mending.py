"""A mesh on its way to being mended, and what the steps of `repair` share."""

from dataclasses import dataclass, field, replace

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from voile.arrays import Flags, Ints, triangle_sides
from voile.errors import InputError
from voile.mesh.raw import RawMesh


@dataclass
class Repair:
    """A mended mesh; what was changed, each with how often; what was left, a line each."""

    mesh: RawMesh
    changed: dict[str, int] = field(default_factory=dict)
    left: list[str] = field(default_factory=list)

    def count(self, what: str, often: int) -> None:
        if often:
            self.changed[what] = self.changed.get(what, 0) + int(often)

    def keep(self, what: str, triangles: Ints | Flags) -> None:
        """Drops the triangles (m,) that are False. Raises InputError where none is left."""
        self.count(what, np.count_nonzero(~triangles))
        m = self.mesh
        if not triangles.any():
            raise InputError(
                f"{m.source}: no triangle is left to repair ({what}); a surface mesh of triangles is needed"
            )
        texture = None if m.texture_triangles is None else m.texture_triangles[triangles]
        self.mesh = replace(
            m, triangles=m.triangles[triangles], group=m.group[triangles], texture_triangles=texture
        )

    def merge(self, into: Ints) -> None:
        """Every vertex becomes the one that it is merged `into` (n,)."""
        m = self.mesh
        sewn = None if m.stitch_vertices is None else into[m.stitch_vertices]
        named = {name: np.unique(into[v]) for name, v in m.vertex_groups.items()}
        self.mesh = replace(m, triangles=into[m.triangles], stitch_vertices=sewn, vertex_groups=named)


def keep_stitches(work: Repair, what: str, good: Flags) -> None:
    """Drops the stitches (s,) that are False, counted as `what`."""
    m = work.mesh
    if m.stitch_vertices is None or m.stitch_weight is None:
        return
    work.count(what, np.count_nonzero(~good))
    work.mesh = replace(m, stitch_vertices=m.stitch_vertices[good], stitch_weight=m.stitch_weight[good])


def size_of(mesh: RawMesh) -> float:
    """Largest extent of what its triangles use, m."""
    return float(np.ptp(mesh.points[np.unique(mesh.triangles)], axis=0).max())


def half_edges(triangles: Ints) -> tuple[Ints, Ints]:
    """Edges (e, 2), smaller vertex first, and the one (3m,) of each half edge from corner i to i + 1."""
    edges, of = np.unique(triangle_sides(triangles), axis=0, return_inverse=True)
    return edges, of.ravel()


def joined(pairs: Ints, count: int) -> Ints:
    """(n,) the smallest vertex that each is joined to by pairs (p, 2)."""
    graph = sparse.coo_matrix((np.ones(len(pairs)), tuple(pairs.T)), shape=(count, count))
    label = connected_components(graph, directed=False)[1]
    found: Ints = np.unique(label, return_index=True)[1][label]
    return found
