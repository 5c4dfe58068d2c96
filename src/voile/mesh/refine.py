"""Uniform refinement: every triangle becomes four, by the midpoints of its edges.

Vertices keep their indices, midpoints follow in the order of the coarser mesh's edges. The triangles of t are 4 t to
4 t + 2, at its corners, and 4 t + 3 in its middle; they keep t's group. Start shape, rest shape and texture
coordinates are refined alike, so corners correspond as before.
"""

from dataclasses import replace

import numpy as np

from voile.arrays import Flags, Ints
from voile.errors import InputError
from voile.mesh.refine_seams import refine_stitches
from voile.mesh.surface import Surface
from voile.mesh.topology import Topology, boundary_loops, build_topology

MOST_TRIANGLES = 10**8  # their half edges fit in 32 bits, and no machine's memory holds many more


def refine(surface: Surface, times: int, where: str, smooth: bool = False) -> Surface:
    """The surface with every triangle split into 4^times, at the middles of its edges or, where `smooth`, of curves
    above them (mesh.smooth). Raises InputError, naming the key `where`, for too many."""
    count = len(surface.triangles)
    if count * 4**times > MOST_TRIANGLES:
        most = int(np.log(MOST_TRIANGLES / count) / np.log(4.0))
        raise InputError(
            f"{where} = {times} makes {count} triangles of {surface.source} {count} x 4^{times}; "
            f"allowed: at most {most}, {MOST_TRIANGLES:.0e} triangles"
        )
    for _ in range(times):
        surface = _refined(surface, smooth)
    return surface


def _refined(coarse: Surface, smooth: bool) -> Surface:
    topology = build_topology(coarse.triangles)
    fine = replace(coarse, coarser=coarse, ends=topology.edges, smooth=smooth)
    texture, texture_triangles = coarse.texture, coarse.texture_triangles
    if texture is not None and texture_triangles is not None:
        laid = build_topology(texture_triangles)
        texture_triangles = _quarters(texture_triangles, len(texture) + laid.triangle_edges)
        texture = np.concatenate([texture, texture[laid.edges].mean(axis=1)])
    count, new = coarse.input_vertices, len(topology.edges)
    return replace(
        fine,
        points=fine.carry(coarse.points, levels=1),
        triangles=_quarters(coarse.triangles, len(coarse.points) + topology.triangle_edges),
        group=np.repeat(coarse.group, 4),
        vertex_groups={name: _carried(fine, vertices) for name, vertices in coarse.vertex_groups.items()},
        texture=texture,
        texture_triangles=texture_triangles,
        stitches=coarse.stitches and refine_stitches(coarse.stitches, coarse.points, topology),
        input_vertex=np.concatenate([coarse.input_vertex, count + np.arange(new)]),
        input_vertices=count + new,
        input_triangle=(4 * coarse.input_triangle[:, None] + np.arange(4)).ravel(),
        input_triangles=4 * coarse.input_triangles,
    )


def _carried(fine: Surface, vertices: Ints) -> Ints:
    """Vertices of a refined surface from those of the coarser one, see carry_nodes."""
    assert fine.coarser is not None
    chosen = np.zeros(len(fine.coarser.points), dtype=bool)
    chosen[vertices] = True
    return np.flatnonzero(carry_nodes(fine, chosen))


def _quarters(triangles: Ints, middle: Ints) -> Ints:
    """(4m, 3) int32 triangles of (m, 3) triangles and the vertices in the middle of their edges (m, 3), each opposite
    the corner of its column."""
    (a, b, c), (p, q, r) = triangles.T, middle.T
    parts = [[a, r, q], [r, b, p], [q, p, c], [p, q, r]]
    return np.ascontiguousarray(np.array(parts).transpose(2, 0, 1).reshape(-1, 3), dtype=np.int32)


def surface_loops(surface: Surface, topology: Topology) -> list[Ints]:
    """The surface's boundary loops, longest first; those of a refined one in the order of the mesh file's."""
    if surface.coarser is None:
        return boundary_loops(surface.triangles, topology, surface.points)
    loops = surface_loops(surface.coarser, build_topology(surface.coarser.triangles))
    return [
        np.column_stack([loop, midpoints(surface, loop, np.roll(loop, -1))]).ravel().astype(np.int32)
        for loop in loops
    ]


def midpoints(surface: Surface, start: Ints, end: Ints) -> Ints:
    """(k,) vertices of a refined surface between vertices (k,), (k,) that are neighbours in the coarser one."""
    assert surface.coarser is not None and surface.ends is not None
    count = len(surface.coarser.points)
    ends = surface.ends.astype(np.int64)
    low, high = np.minimum(start, end).astype(np.int64), np.maximum(start, end)
    found: Ints = count + np.searchsorted(ends[:, 0] * count + ends[:, 1], low * count + high)
    return found


def carry_nodes(surface: Surface, chosen: Flags) -> Flags:
    """(n,) which vertices of a refined surface are chosen, where the coarser one's are `chosen`: a midpoint is if both
    ends of its edge are, so that chosen lines and areas stay chosen along their length and inside.

    Not so the edge that cuts a corner off: two sides of its triangle are on the boundary and the triangle beyond is
    not chosen as a whole. There a line around the border is meant, not the corner's area.
    """
    coarse = surface.coarser
    assert coarse is not None and surface.ends is not None
    topology = build_topology(coarse.triangles)
    whole = chosen[coarse.triangles].all(axis=1)
    border = topology.across < 0
    ear = whole & (border.sum(axis=1) == 2)
    beyond = np.where(border, False, whole[topology.across // 3])
    cuts = topology.triangle_edges[ear[:, None] & ~border & ~beyond]
    between = chosen[surface.ends].all(axis=1)
    between[cuts] = False
    return np.concatenate([chosen, between])
