"""How a total over a selection of vertices is shared among them."""

import numpy as np

from voile.arrays import Array, Flags, Ints, Reals, sums
from voile.errors import InputError
from voile.mesh.surface import Surface
from voile.mesh.topology import Topology

SHARES = ("length", "area", "vertices")


def shares(
    surface: Surface, topology: Topology, vertices: Ints, by: str | None, where: str
) -> tuple[Reals, str]:
    """(n,) parts of 1 on the selected vertices (k,), zero elsewhere, and how they are shared; see `portions`."""
    found, by = portions(surface, topology, vertices, by, where)
    return found / found.sum(), by


def portions(
    surface: Surface, topology: Topology, vertices: Ints, by: str | None, where: str
) -> tuple[Reals, str]:
    """(n,) what each of the selected vertices (k,) has of their length (m), area (m^2) or number, zero elsewhere, and
    which of them it is.

    by length: an edge with both ends selected gives half its length to each (boundary edges only, where they reach all
    that is selected); by area: a triangle with all corners selected gives a third of its area to each; by vertices:
    alike. None: by area where such triangles reach all that is selected, else by length where edges do, else alike.
    Lengths and areas are those of the start shape. Copies on joints count as one, the first. Raises InputError, naming
    the key `where`, where `by` does not reach what is selected.
    """
    inside = np.zeros(len(surface.points), dtype=bool)
    inside[surface.first_copies[vertices]] = True
    found = {name: _weights(surface, topology, inside, name) for name in SHARES if by in (None, name)}
    if by is None:
        by = next(name for name in ("area", "length", "vertices") if _reaches(found[name], inside))
    elif not _reaches(found[by], inside):
        missing = int(surface.input_vertex[np.flatnonzero(inside & (found[by] == 0.0))[0]])
        what = "edge with both ends" if by == "length" else "triangle with all corners"
        raise InputError(
            f'{where} = "{by}": vertex {missing} is on no {what} selected; allowed there: "vertices"'
        )
    return found[by], by


def _reaches(weight: Array, inside: Flags) -> bool:
    return bool((weight[inside] > 0.0).all())


def _weights(surface: Surface, topology: Topology, inside: Flags, by: str) -> Reals:
    x, n = surface.points, len(surface.points)
    if by == "vertices":
        return inside.astype(float)
    if by == "area":
        t = surface.first_copies[surface.triangles]
        t = t[inside[t].all(axis=1)]
        twice = np.linalg.norm(np.cross(x[t[:, 1]] - x[t[:, 0]], x[t[:, 2]] - x[t[:, 0]]), axis=1)
        return sums(t.ravel(), np.repeat(twice / 6.0, 3), n)

    def along(edges: Ints) -> Reals:
        length = np.linalg.norm(x[edges[:, 1]] - x[edges[:, 0]], axis=1)
        return sums(edges.ravel(), np.repeat(length / 2.0, 2), n)

    return along(edges_of(surface, topology, inside))


def edges_of(surface: Surface, topology: Topology, inside: Flags) -> Ints:
    """(k, 2) edges with both ends inside, a mask (n,): those of the boundary where they reach all of it. Copies on
    joints count as one, the first, which the mask has."""
    whole = np.sort(surface.first_copies[topology.edges], axis=1)

    def within(edges: Ints) -> Ints:
        found: Ints = np.unique(edges[inside[edges].all(axis=1)], axis=0)
        return found

    edges, rim = within(whole), within(whole[topology.boundary_edges])
    reached = np.zeros(len(inside), dtype=bool)
    reached[rim] = True
    found: Ints = rim if (reached >= inside).all() else edges
    return found
