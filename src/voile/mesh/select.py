"""Selections of vertices, the `select = { ... }` tables of a scene, and lines of edges."""

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import dijkstra

from voile.arrays import Flags, Ints
from voile.errors import InputError
from voile.mesh.refine import carry_nodes, midpoints
from voile.mesh.surface import Surface
from voile.mesh.topology import Topology, build_topology


def select(surface: Surface, boundary_loops: Sequence[Ints], selection: dict[str, Any], where: str) -> Ints:
    """Vertices that satisfy every key of `selection`: (k,) int32, increasing, indices into surface.points.

    nodes: indices in the input file, from 0 (of a refined surface also what lies between, see carry_nodes);
    group: name or list of names, the vertices of those triangles, or of those points and lines of a Gmsh file;
    box: [[min], [max]] in metres on the start shape, faces included; boundary: index of a loop or list of
    them, in boundary_loops (vertex index arrays, longest first); all: true.
    Raises InputError that names `where` (the key in the scene) and what there is to select.
    """
    if not isinstance(selection, dict) or not selection:
        raise InputError(f"{where}: nothing selected, allowed keys: {', '.join(_SELECTORS)}")
    chosen = np.ones(len(surface.points), dtype=bool)
    for key, value in selection.items():
        if key not in _SELECTORS:
            raise InputError(f"{where}: unknown key '{key}', allowed: {', '.join(_SELECTORS)}")
        chosen &= _SELECTORS[key](surface, boundary_loops, value, f"{where}.{key}")
    if not chosen.any():
        low, high = surface.points.min(axis=0).tolist(), surface.points.max(axis=0).tolist()
        raise InputError(
            f"{where}: {selection} selects no vertex of {surface.source}, which spans {low} to {high}"
        )
    return np.flatnonzero(chosen).astype(np.int32)


def _mask(surface: Surface, vertices: Ints) -> Flags:
    mask = np.zeros(len(surface.points), dtype=bool)
    mask[vertices] = True
    return mask


def _integers(value: Any, where: str) -> Ints:
    """A list of integers, or one."""
    values = value if isinstance(value, list | tuple | np.ndarray) else [value]
    if not all(isinstance(v, int | np.integer) and not isinstance(v, bool) for v in values):
        raise InputError(f"{where}: {value!r}, allowed: an integer or a list of integers")
    return np.array(values, dtype=np.int64)


def inner_lines(surface: Surface, topology: Topology, lines: Sequence[Sequence[int]], where: str) -> Ints:
    """(k, 2) vertices of the edges along lines, each through vertices of the input file (from 0) on the shortest ways
    over edges inside the surface. Raises InputError that names `where` (the key in the scene)."""
    if not len(lines):
        return np.zeros((0, 2), dtype=np.int64)
    if surface.coarser:
        start, end = inner_lines(surface.coarser, build_topology(surface.coarser.triangles), lines, where).T
        middle = midpoints(surface, start, end)
        return np.column_stack([start, middle, middle, end]).reshape(-1, 2)
    inner = np.delete(topology.edges, topology.boundary_edges, axis=0)
    length = np.linalg.norm(np.diff(surface.points[inner], axis=1)[:, 0], axis=1)
    graph = sparse.csr_matrix((length, inner.T), shape=(len(surface.points),) * 2)
    edges: list[tuple[int, int]] = []
    for k, line in enumerate(lines):
        vertices = _places(surface, np.array(line, dtype=np.int64), f"{where}.{k}")
        for start, end in pairwise(vertices.tolist()):
            before = dijkstra(graph, directed=False, indices=start, return_predecessors=True)[1]
            if start == end or before[end] < 0:
                one, other = surface.input_vertex[[start, end]]
                raise InputError(
                    f"{where}.{k}: no way over inner edges leads from vertex {one} to {other} of {surface.source}; "
                    "allowed: lines inside one piece"
                )
            while end != start:
                edges.append((int(before[end]), end))
                end = int(before[end])
    return np.array(edges, dtype=np.int64)


def _nodes(surface: Surface, loops: Sequence[Ints], value: Any, where: str) -> Flags:
    if surface.coarser:
        return carry_nodes(surface, _nodes(surface.coarser, loops, value, where))
    found = _mask(surface, _places(surface, _integers(value, where), where))
    return found[surface.first_copies]


def _places(surface: Surface, nodes: Ints, where: str) -> Ints:
    """The surface's vertices that are `nodes` of its file."""
    outside = nodes[(nodes < 0) | (nodes >= surface.input_vertices)]
    if len(outside):
        raise InputError(
            f"{where}: vertex {outside[0]}, allowed: 0 to {surface.input_vertices - 1} ({surface.source})"
        )
    kept, first = np.unique(surface.input_vertex, return_index=True)  # of copies the first
    place = np.minimum(np.searchsorted(kept, nodes), len(kept) - 1)
    dropped = nodes[kept[place] != nodes]
    if len(dropped):
        raise InputError(
            f"{where}: vertex {dropped[0]} of {surface.source} belongs to no triangle and was dropped"
        )
    found: Ints = first[place]
    return found


def _group(surface: Surface, loops: Sequence[Ints], value: Any, where: str) -> Flags:
    names = value if isinstance(value, list | tuple) else [value]
    lines = surface.vertex_groups
    for name in names:
        if name not in (*surface.group_names, *lines):
            there = ", ".join(dict.fromkeys((*surface.group_names, *lines)))
            raise InputError(f"{where}: no group {name!r} in {surface.source}, allowed: {there}")
    wanted = [surface.group_names.index(name) for name in names if name in surface.group_names]
    inside = _mask(surface, surface.triangles[np.isin(surface.group, wanted)])
    for name in names:
        inside[lines.get(name, [])] = True
    return inside


def _box(surface: Surface, loops: Sequence[Ints], value: Any, where: str) -> Flags:
    try:
        box = np.array(value, dtype=float)
    except (TypeError, ValueError):
        box = np.zeros(0)
    if box.shape != (2, 3) or not (box[0] <= box[1]).all():
        raise InputError(
            f"{where}: {value!r}, allowed: [[xmin, ymin, zmin], [xmax, ymax, zmax]] in metres, min <= max"
        )
    found: Flags = ((surface.points >= box[0]) & (surface.points <= box[1])).all(axis=1)
    return found


def _boundary(surface: Surface, loops: Sequence[Ints], value: Any, where: str) -> Flags:
    indices = _integers(value, where)
    if not len(loops):
        raise InputError(f"{where}: {surface.source} is closed, it has no boundary loop")
    outside = indices[(indices < 0) | (indices >= len(loops))]
    if len(outside):
        raise InputError(
            f"{where}: loop {outside[0]}, allowed: 0 to {len(loops) - 1} "
            f"({surface.source} has {len(loops)} boundary loops, the longest first)"
        )
    return _mask(
        surface, np.concatenate([np.zeros(0, dtype=np.int64), *(loops[i] for i in indices)]).astype(np.int64)
    )


def _all(surface: Surface, loops: Sequence[Ints], value: Any, where: str) -> Flags:
    if value is not True:
        raise InputError(f"{where}: {value!r}, allowed: true")
    return np.ones(len(surface.points), dtype=bool)


_SELECTORS = {"nodes": _nodes, "group": _group, "box": _box, "boundary": _boundary, "all": _all}
