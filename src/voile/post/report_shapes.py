"""The shapes, fields and obstacles of a page, with as many steps and vertices as it has room for.

Steps are followed by the last one once for each mode, displaced by it.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from voile.arrays import Ints, Reals, diagonal
from voile.post import contact, swing
from voile.post.camera import VIEWS, look, outermost, parse_scene, upright
from voile.post.edges import boundary_edges
from voile.post.film import SCALED_BY
from voile.post.quantities import available, quantity
from voile.post.render import colour_scale, magnitude, progress
from voile.post.report_arrays import Arrays, levels, places
from voile.results import Result

SIZE = (1200, 900)  # pixels that the camera is framed for: 4 to 3, as page.css says
HIDDEN = ("start", "rest", "input_vertex", "group")  # fields that colours tell nothing of
MODE = "mode"  # the field of all modes
FEW_STEPS = 16  # a page without room for so many (or all, if fewer) rather has fewer vertices
FEW_VERTICES = 500  # fewer show no shape
ROOM = 0.92  # of what there is place for, aimed at: a page a little too large is made anew
GROWTHS = 3  # times that more steps are tried
ARROW_LEVELS = 32767
FINEST_BODY = 20_000  # triangles of an obstacle: some 150 kB, and finer than a picture of the shape shows
MOST_FRAMES = 400_000  # those of one that deforms, of all steps together: about 1 MB


@dataclass(frozen=True)
class Part:
    """What of the mesh a page shows: vertices (k,) of the result, triangles (j, 3) of theirs, and the triangle (j,) of
    the result whose values each of them shows."""

    vertices: Ints
    triangles: Ints
    owners: Ints


@dataclass(frozen=True)
class Shown:
    """What viewer.js reads: data for JSON, and the arrays as text; steps: which of the result's they are, whose number
    without modes is `count`."""

    meta: dict[str, Any]
    arrays: str
    steps: Ints
    count: int
    part: Part

    @cached_property
    def size(self) -> int:
        """Bytes in a page."""
        return len(self.arrays) + len(json.dumps(self.meta, separators=(",", ":")))


def shown(result: Result, room: float, field: str | None = None) -> Shown:
    """The shapes in `room` bytes: every step on the whole mesh where they fit, else fewer steps, evenly spread, else
    also fewer vertices. What is left may still be larger. Colours: what the file tells, and `field`, which may have to
    be computed."""
    names = [name for name in available(result) if name not in HIDDEN]
    names = [name for name in dict.fromkeys([*names, *filter(None, [field])]) if not swing.is_mode(name)]
    part = Part(np.arange(result.n_points), result.triangles, np.arange(result.n_cells))
    count = min(result.n_steps, FEW_STEPS)
    page = _encode(result, part, names, count)
    while page.size > room and len(part.vertices) > FEW_VERTICES:
        before = len(part.vertices)
        part = _thinned(result, part, ROOM * room / page.size)
        if len(part.vertices) > 0.98 * before:
            break
        page = _encode(result, part, names, count)
    for _ in range(GROWTHS):
        more = min(result.n_steps, int(ROOM * page.count * room / page.size))
        if more <= page.count:
            break
        longer = _encode(result, part, names, more)
        if longer.size > room:
            break
        page = longer
    return page


def _thinned(result: Result, part: Part, share: float) -> Part:
    """About a share of the vertices, those taken out that the last shape needs least (Schroeder et al. 1992)."""
    from scipy.spatial import cKDTree

    kept, triangles = _decimated(result.points()[part.vertices], part.triangles, share)
    vertices, start = part.vertices[kept], result.start
    middles = cKDTree(start[result.triangles].mean(axis=1))
    _, owners = middles.query(start[vertices][triangles].mean(axis=1))
    return Part(vertices, triangles, owners)


def _decimated(points: Reals, triangles: Ints, share: float) -> tuple[Ints, Ints]:
    """Vertices (k,) that stay and triangles (j, 3) of theirs, about a share of those that there were."""
    import pyvista

    surface = pyvista.PolyData.from_regular_faces(points, triangles)
    surface.point_data["vertex"] = np.arange(len(points))
    thin = surface.decimate_pro(1 - share, preserve_topology=True, boundary_vertex_deletion=True)
    return np.asarray(thin["vertex"]), thin.regular_faces


def _encode(result: Result, part: Part, names: list[str], count: int) -> Shown:
    modes = swing.modes_of(result)
    steps = np.unique(np.linspace(0, result.n_steps - 1, count).round().astype(int))
    count, steps = len(steps), np.append(steps, np.full(len(modes), result.n_steps - 1))
    scene, arrays = parse_scene(result.scene_text), Arrays()
    points = np.array([result.points(int(k)) for k in steps])
    for k, mode in enumerate(modes, count):
        points[k] = swing.displaced(result, mode)
    flat, grid = places(points[:, part.vertices])
    fields = [_field(result, part, name, steps, arrays) for name in names]
    if modes:
        fields.append(_mode_field(result, part, modes, count, arrays))
    said = [progress(result, scene, int(k)) for k in steps[:count]]
    meta: dict[str, Any] = {
        "vertices": len(part.vertices),
        "triangles": arrays.add(part.triangles.reshape(1, -1).astype("<u4")),
        "numbers": arrays.add(part.vertices.reshape(1, -1).astype("<u4")),
        "points": {"data": arrays.add(flat), **grid},
        "boundary": arrays.add(boundary_edges(part.triangles).reshape(1, -1).astype("<u4")),
        "start": _mesh(arrays, result.start[None, part.vertices], part.triangles),
        "rest": _rest(result, part, arrays),
        "steps": [*said, *(swing.figure(result, mode) for mode in modes)],
        "fields": fields,
        "reactions": _reactions(result, part, steps, arrays),
        "bodies": _bodies(result, steps, arrays),
        "colours": {"body": contact.BODY, "mark": contact.MARK, "arrow": contact.ARROW},
        **_cameras(result, steps, points, upright(scene)),
    }
    meta["maps"] = {field["map"]: _colours(field["map"]) for field in meta["fields"]}
    return Shown(meta, arrays.text(), steps, count, part)


def opening(result: Result, field: str | None) -> dict[str, Any]:
    """With which `field` and at which `step` of a page's it opens; None: the first mode, strain without."""
    modes = swing.modes_of(result)
    name = field or (modes[0] if modes else "strain")
    if not swing.is_mode(name):
        return {"field": name}
    return {"field": MODE, "first": modes.index(name) - len(modes)}


def _mesh(arrays: Arrays, points: Reals, triangles: Ints) -> dict[str, Any]:
    """A mesh with its points at every step (steps, n, 3) m, or (1, n, 3) where no step changes it."""
    flat, grid = places(points)
    return {"data": arrays.add(flat), **grid, "triangles": arrays.add(triangles.reshape(1, -1).astype("<u4"))}


def _rest(result: Result, part: Part, arrays: Arrays) -> dict[str, Any] | None:
    """The rest shape; none where it has vertices of its own and the page's mesh has fewer."""
    if np.array_equal(result.rest_triangles, result.triangles):
        return _mesh(arrays, result.rest[None, part.vertices], part.triangles)
    if len(part.triangles) < result.n_cells:
        return None
    return _mesh(arrays, result.rest[None], result.rest_triangles)


def _field(result: Result, part: Part, name: str, steps: Ints, arrays: Arrays) -> dict[str, Any]:
    """A field at the steps: colour scale as in films, smallest and largest at each step."""
    rows, extremes = [], []
    for k in steps:
        q = quantity(result, name, int(k))
        values = magnitude(q)
        finite = values[np.isfinite(values)]
        extremes.append([float(finite.min()), float(finite.max())] if len(finite) else None)
        rows.append(values[part.vertices if q.location == "point" else part.owners])
    some = np.unique(np.linspace(0, len(steps) - 1, SCALED_BY).round().astype(int))
    (low, high), colours = colour_scale(np.concatenate([rows[k] for k in some]))
    found: dict[str, Any] = {"name": name, "title": q.title, "unit": q.unit, "location": q.location}
    found["extremes"] = extremes
    if name == "contact":
        low, high, colours = 0.0, len(contact.STATES) - 1.0, "contact"
        found["states"] = list(contact.STATES)
    data = arrays.add(levels(np.array(rows), low, high))
    return {**found, "low": low, "high": high, "map": colours, "data": data}


def _mode_field(result: Result, part: Part, modes: list[str], count: int, arrays: Arrays) -> dict[str, Any]:
    """How far each shape is displaced by its mode; nowhere at the `count` steps."""
    rows = np.zeros((count + len(modes), len(part.vertices)))
    for k, mode in enumerate(modes, count):
        rows[k] = np.linalg.norm(result.field(mode)[part.vertices], axis=1)
    (low, high), colours = colour_scale(rows)
    found: dict[str, Any] = {"name": MODE, "title": "displacement by the mode, largest 1", "unit": ""}
    found |= {"location": "point", "extremes": [[float(row.min()), float(row.max())] for row in rows]}
    return {**found, "low": low, "high": high, "map": colours, "data": arrays.add(levels(rows, low, high))}


def _colours(name: str) -> list[str]:
    """The colours of a map from low to high."""
    if name == "contact":
        return list(contact.STATES.values())
    from matplotlib import colormaps
    from matplotlib.colors import to_hex

    return [to_hex(colour) for colour in colormaps[name](np.linspace(0, 1, 256))]


def _reactions(result: Result, part: Part, steps: Ints, arrays: Arrays) -> dict[str, Any] | None:
    """Arrows along the forces on the shell: (steps, 3 k), all x first, as shares of the longest arrow (m)."""
    if "reaction" not in result.point_fields:
        return None
    forces = np.array([result.field("reaction", int(k))[part.vertices] for k in steps])
    size = np.linalg.norm(forces, axis=2)
    if not size.max() > 0:
        return None
    usual = np.percentile(size[size > contact.FAINT * size.max()], 95)
    length = np.minimum(size / usual, 1.0) * (size > contact.FAINT * size.max())
    arrows = forces / np.where(size > 0, size, 1.0)[..., None] * length[..., None]
    whole = np.round(arrows * ARROW_LEVELS).astype("<i2").transpose(0, 2, 1).reshape(len(steps), -1)
    longest = contact.LONGEST * float(np.ptp(result.points(), axis=0).max())
    return {"data": arrays.add(whole.view("<u2")), "longest": longest / ARROW_LEVELS}


def _bodies(result: Result, steps: Ints, arrays: Arrays) -> list[dict[str, Any]]:
    """The obstacles, placed anew at every step, and shaped where they deform; marks make turning show."""
    placements = np.array([result.placements(int(k)) for k in steps])
    found = []
    for k, (body, marks) in enumerate(zip(result.bodies, contact.turning_marks(result, steps), strict=True)):
        matrices = placements[:, k].reshape(len(steps), 16)
        still = np.array_equal(matrices, np.broadcast_to(matrices[0], matrices.shape))
        deforms, triangles = body.frames is not None, body.triangles
        points = np.array([body.shape(at) for at in result.values[steps if deforms else steps[:1]]])
        finest = min(FINEST_BODY, MOST_FRAMES // len(points)) if deforms else FINEST_BODY
        if len(triangles) > finest:
            kept, triangles = _decimated(points[0], triangles, finest / len(triangles))
            points, marks = points[:, kept], None if marks is None else marks[kept]
        shape = {"name": body.name, "friction": body.friction, **_mesh(arrays, points, triangles)}
        shape["placements"] = matrices[: 1 if still else None].tolist()
        if marks is not None:
            shape["marks"] = arrays.add(levels(marks[None], *(np.abs(marks).max() * np.array([-1.0, 1.0]))))
        found.append(shape)
    return found


def _cameras(result: Result, steps: Ints, shapes: Reals, up: Reals) -> dict[str, Any]:
    """Where to look from to see shapes (steps, n, 3) m; the first is the view that pictures have."""
    seen = [
        outermost(contact.framed(x, contact.surfaces(result, int(k))))
        for k, x in zip(steps, shapes, strict=True)
    ]
    points = np.concatenate([outermost(result.start), *seen])
    views = {}
    for name in (None, *VIEWS):
        camera = look(points, up, name, SIZE)
        views[name or "default"] = {
            "position": camera.position.tolist(), "focus": camera.focus.tolist(), "angle": camera.angle,
        }  # fmt: skip
    return {"views": views, "up": up.tolist(), "size": diagonal(points)}
