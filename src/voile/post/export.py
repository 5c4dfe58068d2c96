"""`voile export`: one step of a result as a file that other programs read."""

from __future__ import annotations

import json
import os
import struct
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from voile.arrays import Ints, Reals, area_vectors
from voile.errors import InputError
from voile.files import replace
from voile.post.contact import surfaces
from voile.post.pattern_dxf import write_dxf
from voile.post.pattern_picture import draw_pattern
from voile.post.pattern_svg import write_svg
from voile.post.quantities import quantity
from voile.results import Result, read_pattern, read_result

if TYPE_CHECKING:
    import pyvista

FORMATS = (".obj", ".ply", ".vtu", ".glb")
PATTERNS = {".svg": write_svg, ".dxf": write_dxf, ".png": draw_pattern}


def export(path: str | os.PathLike[str], out: str | os.PathLike[str], step: int = -1) -> Path:
    """Write a step of the result `path` to `out`, the format by its extension; returns `out`.

    obj: the shape with its groups; ply: the shape in double precision; vtu: the shape with every stored field
    and displacement, strain, curvature, and the obstacles in a file of their own, NAME-obstacles.vtu; glb: the
    shape and the obstacles with vertex normals, for viewers and web pages (single precision); svg, dxf, png: the sewing
    pattern, whatever the step, the last coloured by its distortion. Raises InputError for another extension, a result
    without pattern for those three, a step that is not there, or a file that cannot be written.
    """
    out = Path(out)
    kind = out.suffix.lower()
    if kind in PATTERNS:
        PATTERNS[kind](out, read_pattern(path))
        return out
    if kind not in FORMATS:
        raise InputError(
            f"{out}: unknown format {kind or 'without extension'!r}; allowed: {_list((*FORMATS, *PATTERNS))}"
        )
    with read_result(path) as result:
        if not -result.n_steps <= step < result.n_steps:
            raise InputError(
                f"{result.path}: no step {step}; allowed: 0 to {result.n_steps - 1}, or -1 for the last"
            )
        writers: dict[str, Callable[[Result, Path, int], None]] = {
            ".obj": Result.write_obj,
            ".ply": write_ply,
            ".vtu": write_vtu,
            ".glb": write_glb,
        }
        writers[kind](result, out, step)
    return out


def write_ply(result: Result, out: Path, step: int) -> None:
    """Binary little-endian PLY of a step, in double precision."""
    points, triangles = result.points(step), result.triangles
    head = (
        f"ply\nformat binary_little_endian 1.0\ncomment {result.path.name}, step {step}\n"
        f"element vertex {len(points)}\nproperty double x\nproperty double y\nproperty double z\n"
        f"element face {len(triangles)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    faces = np.empty(len(triangles), dtype=[("n", "u1"), ("v", "<i4", 3)])
    faces["n"], faces["v"] = 3, triangles
    replace(out, head.encode("ascii") + points.astype("<f8").tobytes() + faces.tobytes())


def write_vtu(result: Result, out: Path, step: int) -> None:
    """VTK XML unstructured grids: a step with all fields, and its obstacles, numbered, in NAME-obstacles.vtu."""
    grids = {out: grid(result, step)}
    if result.bodies:
        grids[out.with_stem(f"{out.stem}-obstacles")] = _obstacles(result, step)
    for path, content in grids.items():
        replace(path, _vtu(content))


def _vtu(grid: pyvista.UnstructuredGrid) -> bytes:
    """Made in memory: VTK only prints that it cannot write."""
    from vtkmodules.vtkIOXML import vtkXMLUnstructuredGridWriter

    writer = vtkXMLUnstructuredGridWriter()
    writer.SetInputData(grid)
    writer.SetDataModeToBinary()
    writer.WriteToOutputStringOn()
    writer.Write()
    return bytes(writer.GetOutputString(), "ascii")


def _obstacles(result: Result, step: int) -> pyvista.UnstructuredGrid:
    import pyvista

    shapes = surfaces(result, step)
    first = np.cumsum([0, *(len(points) for points, _ in shapes)])
    triangles = np.concatenate([t + n for (_, t), n in zip(shapes, first[:-1], strict=True)])
    points = np.concatenate([points for points, _ in shapes])
    shape = pyvista.UnstructuredGrid({pyvista.CellType.TRIANGLE: triangles}, points)
    shape.cell_data["obstacle"] = np.repeat(np.arange(len(shapes)), [len(t) for _, t in shapes])
    return shape


def grid(result: Result, step: int) -> pyvista.UnstructuredGrid:
    """The step as a PyVista grid with every stored field and displacement, strain and curvature."""
    import pyvista

    shape = pyvista.UnstructuredGrid({pyvista.CellType.TRIANGLE: result.triangles}, result.points(step))
    for name in (*result.point_fields, *result.cell_fields, "displacement", "strain", "curvature"):
        q = quantity(result, name, step)
        (shape.point_data if q.location == "point" else shape.cell_data)[name] = q.values
    return shape


def write_glb(result: Result, out: Path, step: int) -> None:
    """Binary glTF 2.0 of a step: a mesh for the shape and one for each obstacle, with normals and two-sided materials,
    no textures.

    Written here because VTK writes the JSON form only. Layout: Khronos glTF 2.0 specification, section 4.4.
    """
    shapes = [(result.path.stem, result.points(step), result.triangles)]
    shapes += [
        (body.name, points, triangles)
        for body, (points, triangles) in zip(result.bodies, surfaces(result, step), strict=True)
    ]
    parts: list[bytes] = []
    accessors: list[dict[str, Any]] = []
    for _, points, triangles in shapes:
        parts += [
            points.astype("<f4").tobytes(),
            _vertex_normals(points, triangles).astype("<f4").tobytes(),
            triangles.astype("<u4").tobytes(),
        ]
        low, high = (f(points.astype("<f4"), axis=0).tolist() for f in (np.min, np.max))
        vertices = {"componentType": 5126, "count": len(points), "type": "VEC3"}
        corners = {"componentType": 5125, "count": triangles.size, "type": "SCALAR"}
        accessors += [{"min": low, "max": high, **vertices}, vertices, corners]
    starts = np.concatenate([[0], np.cumsum([len(p) for p in parts])]).tolist()
    document = {
        "asset": {"version": "2.0", "generator": "voile"},
        "scene": 0,
        "scenes": [{"nodes": list(range(len(shapes)))}],
        "nodes": [{"mesh": k, "name": name} for k, (name, _, _) in enumerate(shapes)],
        "meshes": [{"primitives": [_primitive(k)]} for k in range(len(shapes))],
        "materials": [_material([0.62, 0.70, 0.82, 1.0]), _material([0.54, 0.54, 0.51, 1.0])],
        "accessors": [{"bufferView": k, **accessor} for k, accessor in enumerate(accessors)],
        "bufferViews": [
            {
                "buffer": 0,
                "byteOffset": starts[k],
                "byteLength": len(part),
                "target": (34962, 34962, 34963)[k % 3],
            }
            for k, part in enumerate(parts)
        ],
        "buffers": [{"byteLength": starts[-1]}],
    }
    replace(out, _glb(document, b"".join(parts)))


def _primitive(k: int) -> dict[str, Any]:
    """The k-th mesh: accessors 3k to 3k + 2, the shape's material or the obstacles'."""
    return {
        "attributes": {"POSITION": 3 * k, "NORMAL": 3 * k + 1},
        "indices": 3 * k + 2,
        "material": min(k, 1),
    }


def _material(colour: list[float]) -> dict[str, Any]:
    surface = {"baseColorFactor": colour, "metallicFactor": 0.0, "roughnessFactor": 0.9}
    return {"doubleSided": True, "pbrMetallicRoughness": surface}


def _glb(document: dict[str, Any], body: bytes) -> bytes:
    """The container: a header, then JSON and binary chunks."""
    text = json.dumps(document, separators=(",", ":")).encode("utf-8")
    text += b" " * (-len(text) % 4)  # every chunk is a multiple of four bytes; the arrays are already
    chunks = (
        struct.pack("<II", len(text), 0x4E4F534A) + text + struct.pack("<II", len(body), 0x004E4942) + body
    )
    return struct.pack("<III", 0x46546C67, 2, 12 + len(chunks)) + chunks


def _vertex_normals(points: Reals, triangles: Ints) -> Reals:
    """(n, 3) unit normals, weighted by area; (0, 0, 1) where a vertex has none."""
    area = area_vectors(points, triangles)
    normals = np.zeros_like(points)
    for corner in range(3):
        np.add.at(normals, triangles[:, corner], area)
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    return np.where(length > 0, normals / np.where(length > 0, length, 1), [0.0, 0.0, 1.0])


def _list(extensions: tuple[str, ...]) -> str:
    return ", ".join(e[1:] for e in extensions)
