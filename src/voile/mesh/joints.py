"""Sheets that meet along edges of more than two triangles come apart there, to be sewn together."""

from dataclasses import replace
from itertools import combinations

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from voile.arrays import Flags, Ints, Reals
from voile.mesh.raw import RawMesh


def part_sheets(raw: RawMesh) -> tuple[RawMesh, Ints]:
    """The mesh with at most two triangles to an edge, and the vertex (n,) of the given one that each of its vertices
    is: copies follow, each with a stitch to the first.

    At an edge of more, the two that go on into each other stay neighbours: those of one group before others, then those
    in the flattest angle. The next two likewise, if both are left; what is left alone ends there.
    """
    edges, start, ends = _half_edges(raw.triangles)
    count = np.diff(np.append(start, len(edges)))
    crowded = np.flatnonzero(count > 2)
    if not len(crowded):
        return raw, np.arange(len(raw.points))
    away = _directions(raw.points, raw.triangles)
    pairs = [edges[start[count == 2][:, None] + np.arange(2)]]
    for k in crowded:
        pairs += [
            np.array([pair]) for pair in _partners(edges[start[k] : start[k] + count[k]], raw.group, away)
        ]
    on = np.zeros(len(raw.points), dtype=bool)
    on[ends[start[crowded]]] = True
    corner, origin = _copies(raw.triangles, np.concatenate(pairs), on)
    copies = np.arange(len(raw.points), len(origin))
    sewn = np.column_stack([copies, origin[copies], origin[copies]])
    if raw.stitch_vertices is not None and raw.stitch_weight is not None:
        stitches, weight = (
            np.concatenate([raw.stitch_vertices, sewn]),
            np.append(raw.stitch_weight, 0.0 * copies),
        )
    else:
        stitches, weight = sewn, 0.0 * copies
    lines = raw.stitch_lines
    note = f"{len(crowded)} edges join more than two triangles: the sheets come apart there and are sewn together"
    parted = replace(
        raw,
        points=raw.points[origin],
        point_lines=None if raw.point_lines is None else raw.point_lines[origin],
        triangles=corner,
        stitch_vertices=stitches,
        stitch_weight=weight,
        stitch_lines=None if lines is None else np.append(lines, np.zeros(len(copies), dtype=lines.dtype)),
        notes=(*raw.notes, note),
    )
    return parted, origin


def _half_edges(triangles: Ints) -> tuple[Ints, Ints, Ints]:
    """Half edges (3m,), each opposite corner 3 t + i, in the order of their edges; where each edge starts among them;
    their ends (3m, 2), ascending."""
    ends = np.stack([np.roll(triangles, -1, axis=1), np.roll(triangles, 1, axis=1)], axis=2)
    ends = np.sort(ends, axis=2).reshape(-1, 2)
    order = np.lexsort(ends.T[::-1])
    new = np.ones(len(order), dtype=bool)
    new[1:] = (np.diff(ends[order], axis=0) != 0).any(axis=1)
    return order, np.flatnonzero(new), ends[order]


def _directions(points: Reals, triangles: Ints) -> Reals:
    """(3m, 3) unit vectors in each triangle, from each edge at right angles to its opposite corner."""
    x = points[triangles]
    along = np.roll(x, 1, axis=1) - np.roll(x, -1, axis=1)
    along /= np.linalg.norm(along, axis=2, keepdims=True)
    away = x - np.roll(x, -1, axis=1)
    away -= np.einsum("tki,tki->tk", away, along)[:, :, None] * along
    unit: Reals = (away / np.linalg.norm(away, axis=2, keepdims=True)).reshape(-1, 3)
    return unit


def _partners(half: Ints, group: Ints, away: Reals) -> list[Ints]:
    """The pairs (2,) of half edges around one edge that stay neighbours."""
    pairs: list[Ints] = []
    left = half.tolist()

    def unlike(pair: tuple[int, int]) -> tuple[bool, float]:
        one, other = pair
        angle = round(
            float(away[one] @ away[other]), 9
        )  # equal ones stay in their order, whatever round-off says
        return bool(group[one // 3] != group[other // 3]), angle

    while len(left) > 1:
        best = min(combinations(left, 2), key=unlike)
        if pairs and unlike(best)[0]:
            break
        pairs.append(np.array(best))
        left = [h for h in left if h not in best]
    return pairs


def _copies(triangles: Ints, pairs: Ints, on: Flags) -> tuple[Ints, Ints]:
    """Corners (m, 3) once the vertices marked `on` have a copy for every fan of triangles that neighbours, pairs (k, 2)
    of half edges, make; and the vertex that each was."""
    m, n = len(triangles), len(on)
    flat = triangles.ravel()
    one, other = [], []
    for turn in (1, 2):  # both ends of the shared edge
        place = 3 * (pairs // 3) + (pairs + turn) % 3
        vertex = flat[place[:, 0]]
        second = 3 * (pairs[:, 1] // 3)[:, None] + np.arange(3)
        match = second[np.arange(len(pairs)), np.argmax(flat[second] == vertex[:, None], axis=1)]
        one.append(place[:, 0])
        other.append(match)
    rows, columns = np.concatenate(one), np.concatenate(other)
    graph = sparse.coo_matrix((np.ones(len(rows), dtype=np.int8), (rows, columns)), shape=(3 * m, 3 * m))
    _, fan = connected_components(graph, directed=False)
    _, first, which = np.unique(fan, return_index=True, return_inverse=True)
    vertex = flat[first]
    number = vertex.copy()
    order = np.flatnonzero(on[vertex])
    seen = np.unique(vertex[order], return_index=True)[1]
    again = np.setdiff1d(order, order[seen])
    number[again] = n + np.arange(len(again))
    return number[which.ravel()].reshape(m, 3), np.append(np.arange(n), vertex[again])
