"""Selections of vertices, the `select = { ... }` tables of a scene."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from voile.errors import InputError
from voile.mesh.surface import Surface


def select(
    surface: Surface, boundary_loops: Sequence[np.ndarray], selection: dict[str, Any], where: str
) -> np.ndarray:
    """Vertices that satisfy every key of `selection`: (k,) int32, increasing, indices into surface.points.

    nodes: indices in the input file, from 0; group: name or list of names, the vertices of those triangles;
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


def _mask(surface: Surface, vertices: np.ndarray) -> np.ndarray:
    mask = np.zeros(len(surface.points), dtype=bool)
    mask[vertices] = True
    return mask


def _integers(value: Any, where: str) -> np.ndarray:
    """A list of integers, or one."""
    values = value if isinstance(value, list | tuple | np.ndarray) else [value]
    if not all(isinstance(v, int | np.integer) and not isinstance(v, bool) for v in values):
        raise InputError(f"{where}: {value!r}, allowed: an integer or a list of integers")
    return np.array(values, dtype=np.int64)


def _nodes(surface: Surface, loops: Sequence[np.ndarray], value: Any, where: str) -> np.ndarray:
    nodes = _integers(value, where)
    outside = nodes[(nodes < 0) | (nodes >= surface.input_vertices)]
    if len(outside):
        raise InputError(
            f"{where}: vertex {outside[0]}, allowed: 0 to {surface.input_vertices - 1} ({surface.source})"
        )
    place = np.minimum(np.searchsorted(surface.input_vertex, nodes), len(surface.input_vertex) - 1)
    dropped = nodes[surface.input_vertex[place] != nodes]
    if len(dropped):
        raise InputError(
            f"{where}: vertex {dropped[0]} of {surface.source} belongs to no triangle and was dropped"
        )
    return _mask(surface, place)


def _group(surface: Surface, loops: Sequence[np.ndarray], value: Any, where: str) -> np.ndarray:
    names = value if isinstance(value, list | tuple) else [value]
    for name in names:
        if name not in surface.group_names:
            raise InputError(
                f"{where}: no group {name!r} in {surface.source}, allowed: {', '.join(surface.group_names)}"
            )
    wanted = [surface.group_names.index(name) for name in names]
    return _mask(surface, surface.triangles[np.isin(surface.group, wanted)])


def _box(surface: Surface, loops: Sequence[np.ndarray], value: Any, where: str) -> np.ndarray:
    try:
        box = np.array(value, dtype=float)
    except (TypeError, ValueError):
        box = np.zeros(0)
    if box.shape != (2, 3) or not (box[0] <= box[1]).all():
        raise InputError(
            f"{where}: {value!r}, allowed: [[xmin, ymin, zmin], [xmax, ymax, zmax]] in metres, min <= max"
        )
    return ((surface.points >= box[0]) & (surface.points <= box[1])).all(axis=1)


def _boundary(surface: Surface, loops: Sequence[np.ndarray], value: Any, where: str) -> np.ndarray:
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


def _all(surface: Surface, loops: Sequence[np.ndarray], value: Any, where: str) -> np.ndarray:
    if value is not True:
        raise InputError(f"{where}: {value!r}, allowed: true")
    return np.ones(len(surface.points), dtype=bool)


_SELECTORS = {"nodes": _nodes, "group": _group, "box": _box, "boundary": _boundary, "all": _all}
