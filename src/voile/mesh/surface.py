"""The shell's mid-surface as read from a file, and its rest shape."""

from __future__ import annotations

import contextlib
import io
import warnings
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from voile.arrays import Flags, Ints, Reals
from voile.errors import InputError
from voile.mesh.checks import check_coordinates, check_triangles, flat_triangles, orient, sew
from voile.mesh.guards import check_xdmf, ending, refuse_references
from voile.mesh.joints import part_sheets
from voile.mesh.obj import read_obj
from voile.mesh.raw import RawMesh, fan
from voile.mesh.smooth import smooth_middles
from voile.mesh.stitches import Stitches

if TYPE_CHECKING:
    import meshio

_GROUP_DATA = ("gmsh:physical", "groups", "group", "medit:ref", "cell_tags", "gmsh:geometrical")


@dataclass(frozen=True)
class Surface:
    """An edge-manifold, consistently oriented triangle mesh; several components, pinch vertices are allowed.

    points (n, 3) float64 in metres; triangles (m, 3) int32; group (m,) int32 index into group_names;
    vertex_groups: vertices (k,) of the file's named points and lines; texture (nt, 2) float64 in metres and
    texture_triangles (m, 3) int32, None without texture coordinates;
    stitches in the numbering of points, None without; input_vertex (n,) int64, the index of each vertex in the file,
    which has input_vertices of them, increasing up to the copies of those on joints, which follow; input_triangle (m,)
    int64, increasing, and input_triangles likewise (polygons count as their fans); notes: repairs, a line each; source:
    the file.
    A refined surface (mesh.refine) has a coarser one, whose vertices come first, then the middles of its edges: ends
    (e, 2) of them, on a smooth surface where it is `smooth`. Its input_vertex counts those on from the file's.
    """

    points: Reals
    triangles: Ints
    group: Ints
    group_names: tuple[str, ...]
    texture: Reals | None
    texture_triangles: Ints | None
    stitches: Stitches | None
    input_vertex: Ints
    input_vertices: int
    input_triangle: Ints
    input_triangles: int
    notes: tuple[str, ...]
    source: str
    coarser: Surface | None = None
    ends: Ints | None = None
    smooth: bool = False

    @property
    def coarsest(self) -> Surface:
        """The surface as it is in the file."""
        return self.coarser.coarsest if self.coarser else self

    @property
    def first_copies(self) -> Ints:
        """(n,) the vertex itself, of copies on joints (mesh.joints) the first."""
        if self.coarser is None or self.ends is None:
            first, which = np.unique(self.input_vertex, return_index=True, return_inverse=True)[1:]
            return first[which]
        before = self.coarser.first_copies
        ends = np.sort(before[self.ends], axis=1)
        first, which = np.unique(
            ends[:, 0] * len(before) + ends[:, 1], return_index=True, return_inverse=True
        )[1:]
        return np.concatenate([before, len(before) + first[which]])

    def carry(self, points: Reals, levels: int | None = None) -> Reals:
        """Points (n, 3) of this surface from those of the one `levels` refinements before, by default the file's."""
        if self.coarser is None or self.ends is None or levels == 0:
            return points
        points = self.coarser.carry(points, None if levels is None else levels - 1)
        coarse = self.coarser.triangles
        middles = smooth_middles(points, coarse) if self.smooth else points[self.ends].mean(axis=1)
        return np.concatenate([points, middles])

    vertex_groups: dict[str, Ints] = field(default_factory=dict)


@dataclass(frozen=True)
class Rest:
    """Rest shape: points (nr, 3) in metres and triangles (m, 3) int32, corner by corner those of the surface.

    flat: the points are plane panels (z = 0), whose numbering may differ from the surface's along seams.
    """

    points: Reals
    triangles: Ints
    flat: bool


def read_mesh(
    path: str | Path | RawMesh, scale: float = 1.0, seams: bool = True, joints: bool = False
) -> Surface:
    """Read a surface: OBJ with groups (`g`, else `o`), texture and stitches, what meshio reads, or arrays.

    `scale` turns the file's unit of length into metres, for points and texture coordinates alike.
    Polygons are split into triangle fans. Clashing orientations are repaired, unused vertices and triangles
    that vanish in a seam dropped, each with a note; without `seams` stitches are passed over. With `joints` sheets
    that meet along edges of more than two triangles are sewn together there (mesh.joints).
    Raises InputError naming file, line, vertex or triangle if the file or the mesh cannot be used.
    """
    raw = read_raw(path, scale)
    if not seams:
        raw.stitch_vertices = raw.stitch_weight = None
    with _mendable(raw):
        check_coordinates(raw)
        check_triangles(raw)
        raw, origin = part_sheets(raw) if joints else (raw, np.arange(len(raw.points)))
        flip = orient(raw)
    used = np.zeros(len(raw.points), dtype=bool)
    used[raw.triangles] = True
    keep = sew(raw, used)
    vertices, triangles = np.flatnonzero(used), np.flatnonzero(keep)
    new = (np.cumsum(used) - 1).astype(np.int32)
    texture_triangles = raw.texture_triangles
    stitches = None
    if raw.stitch_vertices is not None and raw.stitch_weight is not None:
        slave, first, second = new[raw.stitch_vertices].T.copy()
        stitches = Stitches(slave, first, second, raw.stitch_weight)
    return Surface(
        points=np.ascontiguousarray(raw.points[vertices]),
        triangles=_flipped(new[raw.triangles], flip)[triangles],
        group=raw.group.astype(np.int32)[triangles],
        group_names=raw.group_names,
        texture=raw.texture,
        texture_triangles=None if texture_triangles is None else _flipped(texture_triangles, flip)[triangles],
        stitches=stitches,
        input_vertex=origin[vertices].astype(np.int64),
        input_vertices=int(origin.max()) + 1,
        input_triangle=triangles.astype(np.int64),
        input_triangles=len(keep),
        notes=(*raw.notes, *_repairs(flip, keep, used)),
        source=raw.source,
        vertex_groups={name: new[v[used[v]]] for name, v in raw.vertex_groups.items() if used[v].any()},
    )


def _repairs(flip: Flags, keep: Flags, used: Flags) -> list[str]:
    notes = []
    if flip.any():
        notes.append(f"{flip.sum()} of {len(flip)} triangles flipped for a consistent orientation")
    if not keep.all():
        names = ", ".join(str(t) for t in np.flatnonzero(~keep)[:8]) + (", ..." if (~keep).sum() > 8 else "")
        notes.append(f"{(~keep).sum()} of {len(keep)} triangles dropped, their seams join them away: {names}")
    if not used.all():
        notes.append(f"{(~used).sum()} of {len(used)} vertices dropped, they belong to no triangle")
    return notes


def read_rest(
    spec: str | Path | RawMesh | None, surface: Surface, relative_to: str | Path, scale: float = 1.0
) -> Rest:
    """Rest shape: `surface` itself (None), its texture coordinates ("flat"), or a file or arrays of the same triangles.

    A file is found from the folder `relative_to` and takes `scale`, the metres per unit of its points;
    texture coordinates were scaled with their mesh in read_mesh, `scale` does not touch them again.
    Raises InputError without texture coordinates, at the first triangle that differs from the surface's, and
    at one without area.
    """
    if spec is None:
        return Rest(surface.points, surface.triangles, flat=False)
    if spec == "flat":
        if surface.texture is None or surface.texture_triangles is None:
            raise InputError(
                f"{surface.source}: rest = 'flat' needs texture coordinates (OBJ 'vt') at every corner of "
                "every face; there are none"
                + "".join(f" ({note})" for note in surface.notes if note.startswith("texture"))
            )
        points = np.column_stack([surface.texture, np.zeros(len(surface.texture))])
        rest, source = (
            Rest(points, surface.texture_triangles, flat=True),
            f"{surface.source}, texture coordinates",
        )
    else:
        raw = read_raw(spec if isinstance(spec, RawMesh) else Path(relative_to) / spec, scale)
        file = surface.coarsest
        check_coordinates(raw)
        _check_same_triangles(raw, file)
        points = surface.carry(raw.points[file.input_vertex])
        rest, source = Rest(points, surface.triangles, flat=False), raw.source
    degenerate = flat_triangles(rest.points, rest.triangles)
    if len(degenerate):
        where = degenerate[0]
        corners = rest.points[rest.triangles[where]].tolist()
        raise InputError(
            f"{source}: triangle {where} has no area in the rest shape, its corners are {corners}"
        )
    return rest


def _check_same_triangles(raw: RawMesh, surface: Surface) -> None:
    """Corners are compared as sets: where a face starts, and which way it turns, is the surface's to say."""
    if len(raw.triangles) != surface.input_triangles:
        raise InputError(
            f"{raw.source}: {len(raw.triangles)} triangles, but {surface.source} has "
            f"{surface.input_triangles}; a rest shape needs the same triangles in the same order"
        )
    expected = surface.input_vertex[surface.triangles]
    found = raw.triangles[surface.input_triangle]
    differs = (np.sort(found, axis=1) != np.sort(expected, axis=1)).any(axis=1)
    if differs.any():
        t = int(np.argmax(differs))
        corners = ", ".join(str(v) for v in expected[t])
        raise InputError(
            f"{raw.source}: {raw.triangle(surface.input_triangle[t])} is not that of {surface.source} "
            f"(vertices {corners}); a rest shape needs the same triangles in the same order"
        )


def _flipped(triangles: Ints, flip: Flags) -> Ints:
    """Triangles (m, 3) int32 with the last two corners swapped where `flip`."""
    return np.ascontiguousarray(np.where(flip[:, None], triangles[:, [0, 2, 1]], triangles), dtype=np.int32)


def read_body(path: str | Path | RawMesh, scale: float = 1.0) -> tuple[Reals, Ints]:
    """Points (n, 3) m and triangles (m, 3) of a body, which may have holes, pieces and double edges; triangles
    without area are dropped. Raises InputError for a file that cannot be read or has no others."""
    raw = read_raw(path, scale)
    check_coordinates(raw)
    if not len(raw.triangles):
        raise InputError(f"{path}: no triangles")
    flat = flat_triangles(raw.points, raw.triangles)
    if len(flat) == len(raw.triangles):
        raise InputError(f"{path}: none of its {len(flat)} triangles has an area")
    return raw.points, np.delete(raw.triangles, flat, axis=0)


@contextlib.contextmanager
def _mendable(raw: RawMesh) -> Iterator[None]:
    """Offers `voile mesh repair` where a file has triangles, but some cannot be used."""
    try:
        yield
    except InputError as error:
        if not len(raw.triangles) or not Path(raw.source).is_file():
            raise
        raise InputError(f"{error} ('voile mesh repair {raw.source}' mends it)") from None


def read_raw(path: str | Path | RawMesh, scale: float = 1.0) -> RawMesh:
    """A mesh as its file says it, scaled to metres. Raises InputError for a file that is no mesh."""
    if not (np.isfinite(scale) and scale > 0):
        raise InputError(f"{path}: scale = {scale}, allowed: a positive number (metres per unit of the file)")
    if isinstance(path, RawMesh):
        return replace(path, points=path.points * scale)
    path = Path(path)
    if not path.is_file():
        raise InputError(f"{path}: no such mesh file")
    if path.stat().st_size == 0:
        raise InputError(f"{path}: the mesh file is empty")
    raw = read_obj(path) if path.suffix.lower() == ".obj" else _read_meshio(path)
    if raw.in_metres and scale != 1.0:
        raw.notes = (*raw.notes, f"{path.name} says that it is in metres: scale = {scale:g} is not applied")
        scale = 1.0
    raw.points = raw.points * scale
    raw.texture = None if raw.texture is None else raw.texture * scale
    return raw


def _read_meshio(path: Path) -> RawMesh:
    """Any other format: triangles, quads and polygons; points, lines and their data are passed over."""
    import meshio

    if path.suffix.lower() in (".xdmf", ".xmf"):
        check_xdmf(path)
    refuse_references(path)
    said = io.StringIO()
    try:
        with (
            contextlib.redirect_stdout(said),
            contextlib.redirect_stderr(said),
            warnings.catch_warnings(),
            np.errstate(all="ignore"),
            ending(path),
        ):
            warnings.simplefilter("ignore")  # what is wrong is said below, once
            return _of_meshio(path, meshio.read(path))
    except InputError:
        raise
    except (
        Exception,
        SystemExit,
    ) as error:  # its readers raise anything at a broken file, or leave the program
        reason = said.getvalue().strip() if isinstance(error, SystemExit) else str(error)
        raise InputError(f"{path}: cannot be read as a mesh: {' '.join(reason.split())}") from error


def _of_meshio(path: Path, mesh: meshio.Mesh) -> RawMesh:
    points = np.asarray(mesh.points, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] not in (2, 3):
        raise InputError(f"{path}: points of shape {points.shape}, allowed: 2 or 3 coordinates a point")
    points = np.column_stack([points, np.zeros((len(points), 3 - points.shape[1]))])
    triangles, tags, names, polygons = [], [], _group_names(mesh), 0
    for block, (cells, tag) in enumerate(zip(mesh.cells, _group_tags(mesh), strict=True)):
        if cells.dim < 2 and cells.type not in ("polygon",):
            continue
        if cells.type not in ("triangle", "quad") and not cells.type.startswith("polygon"):
            raise InputError(
                f"{path}: cell block {block} holds '{cells.type}' cells, allowed: triangle, quad, polygon "
                "(vertices and lines are passed over)"
            )
        corners = np.array([len(cell) for cell in cells.data], dtype=np.int64)
        storage = np.concatenate([np.asarray(cell, dtype=np.int64) for cell in cells.data])
        at, cell = fan(corners)
        polygons += int(np.count_nonzero(corners > 3))
        triangles.append(storage[at])
        tags.append(np.asarray(tag)[cell])
    tag = np.concatenate(tags) if tags else np.zeros(0, dtype=np.int64)
    used, group = np.unique(tag, return_inverse=True)
    return RawMesh(
        source=str(path),
        points=points,
        triangles=np.concatenate(triangles) if triangles else np.zeros((0, 3), dtype=np.int64),
        group=group,
        group_names=tuple(names.get(int(i), str(i)) for i in used),
        vertex_groups=_vertex_groups(mesh),
        polygons=polygons,
    )


def _vertex_groups(mesh: meshio.Mesh) -> dict[str, Ints]:
    """Vertices of the physical points and lines that a Gmsh file names, and of the point sets of other formats."""
    found = {name: [np.asarray(members, dtype=np.int64).ravel()] for name, members in mesh.point_sets.items()}
    names = {tuple(int(i) for i in key): name for name, key in mesh.field_data.items() if np.size(key) == 2}
    for block, tags in zip(mesh.cells, mesh.cell_data.get("gmsh:physical", ()), strict=False):
        for tag in np.unique(tags) if block.dim < 2 else ():
            name = names.get((int(tag), block.dim))
            if name:
                found.setdefault(name, []).append(np.asarray(block.data)[np.asarray(tags) == tag].ravel())
    return {name: np.unique(np.concatenate(parts)).astype(np.int64) for name, parts in found.items()}


def _group_tags(mesh: meshio.Mesh) -> list[Ints]:
    """Integer group tag of every cell, block by block: from cell sets, else the first known cell data."""
    sets = {name: s for name, s in mesh.cell_sets.items() if not name.startswith("gmsh:")}
    tags: list[Ints] = [np.zeros(len(block.data), dtype=np.int64) for block in mesh.cells]
    if sets:
        for number, members in enumerate(sets.values(), 1):
            for tag, member in zip(tags, members, strict=True):
                if member is not None:
                    tag[np.asarray(member, dtype=np.int64)] = number
        return tags
    for key in _GROUP_DATA:
        if key in mesh.cell_data:
            return [np.asarray(data, dtype=np.int64).ravel() for data in mesh.cell_data[key]]
    return tags


def _group_names(mesh: meshio.Mesh) -> dict[int, str]:
    """Names of the tags of _group_tags where the file gives any."""
    sets = [name for name in mesh.cell_sets if not name.startswith("gmsh:")]
    if sets:
        return {0: "default", **dict(enumerate(sets, 1))}
    if not any(key in mesh.cell_data for key in _GROUP_DATA):
        return {0: "default"}
    return {int(tag): name for name, (tag, dimension) in mesh.field_data.items() if int(dimension) == 2}
