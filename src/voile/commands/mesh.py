"""`voile mesh`: meshes that voile refuses, mended; and surfaces made symmetric."""

import argparse
import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

from voile.errors import InputError
from voile.files import replace

if TYPE_CHECKING:
    from voile.mesh import RawMesh

TEXT = "repair FILE: a mesh without what cannot be simulated; mirror FILE: one half and its mirror image"
UNITS = ("m", "cm", "mm", "inch")
REPAIR = ("unit", "weld", "fill_holes", "drop_pieces", "keep_flaps")
MIRROR = ("across", "at", "keep")


def arguments(parser: argparse.ArgumentParser) -> None:
    """Adds the command's arguments."""
    parser.add_argument("action", choices=("repair", "mirror"))
    parser.add_argument("file", type=Path, help="a mesh in any format that voile reads")
    parser.add_argument(
        "-o", "--output", type=Path, help="an OBJ file; default: FILE-repaired.obj or -mirrored.obj"
    )
    mend = parser.add_argument_group("repair")
    mend.add_argument("--unit", choices=UNITS, help="of the file; its lengths become metres")
    mend.add_argument(
        "--weld", type=float, help="share of the size below which border vertices are one (1e-6; 0: none)"
    )
    mend.add_argument("--fill-holes", type=int, metavar="N", help="close border loops of N edges at most")
    mend.add_argument("--drop-pieces", type=int, metavar="N", help="drop pieces of fewer than N triangles")
    mend.add_argument(
        "--keep-flaps",
        action="store_true",
        default=None,
        help="keep small parts that hang by a vertex or two",
    )
    fold = parser.add_argument_group("mirror")
    fold.add_argument("--across", choices=("x", "y", "z"), help="axis across which left and right are")
    fold.add_argument("--at", type=float, help="where the plane is, in the file's unit; default: found")
    fold.add_argument("--keep", choices=("+", "-"), help="the half to keep (+)")


def run(args: argparse.Namespace) -> None:
    """Writes the mesh and its report, prints what was changed. Raises InputError where it cannot be read then."""
    from voile.mesh import read_mesh, read_raw

    mends = args.action == "repair"
    out = args.output or args.file.with_name(f"{args.file.stem}-{'repaired' if mends else 'mirrored'}.obj")
    _check(args, out)
    raw = read_raw(args.file)
    mesh, told = _mended(args, raw) if mends else _mirrored(args, raw)
    _write(out, mesh, f"{'repaired' if mends else 'mirrored'} from {args.file.name}")
    report = {
        "file": str(args.file),
        "output": str(out),
        "read": {"vertices": len(raw.points), "triangles": len(raw.triangles)},
        "written": {"vertices": len(mesh.points), "triangles": len(mesh.triangles)},
        **told,
    }
    beside = out.with_suffix(".json")
    replace(beside, json.dumps(report, indent=1).encode())
    read, written = report["read"], report["written"]
    print(
        f"{out}: {written['vertices']} vertices, {written['triangles']} triangles "
        f"({read['vertices']}, {read['triangles']} in {args.file})"
    )
    for line in _lines(told):
        print(line)
    print(beside)
    read_mesh(out)  # what could not be mended is said as the reader says it


def _mended(args: argparse.Namespace, raw: "RawMesh") -> tuple["RawMesh", dict[str, Any]]:
    from voile.mesh.mending import size_of
    from voile.mesh.repair import WELD, RepairOptions, repair

    weld = WELD if args.weld is None else args.weld
    options = RepairOptions(
        weld, args.fill_holes or 0, args.drop_pieces or 0, args.unit, bool(args.keep_flaps)
    )
    done = repair(raw, options)
    if done.mesh.vertex_groups:
        done.left.append(f"OBJ has no names for vertices: {', '.join(done.mesh.vertex_groups)} are left out")
    left = [*raw.notes, *done.left]
    return done.mesh, {"changed": done.changed, "left": left, "size": size_of(done.mesh)}


def _mirrored(args: argparse.Namespace, raw: "RawMesh") -> tuple["RawMesh", dict[str, Any]]:
    from voile.mesh import read_mesh
    from voile.mesh.mirror import mirror, plane_of

    read_mesh(args.file)  # says what must be repaired first
    axis = "xyz".index(args.across)
    place = plane_of(raw, axis) if args.at is None else args.at
    mesh, figures = mirror(raw, axis, place, -1 if args.keep == "-" else 1)
    lost = [] if raw.texture is None else ["texture coordinates are dropped"]
    return mesh, {"plane": {args.across: place}, "other_half": figures, "left": lost}


def _write(out: Path, m: "RawMesh", comment: str) -> None:
    from voile.mesh import METRES, Stitches, write_obj

    stitches = None
    if m.stitch_vertices is not None and m.stitch_weight is not None and len(m.stitch_weight):
        slave, first, second = m.stitch_vertices.T
        stitches = Stitches(slave, first, second, m.stitch_weight)
    write_obj(
        out, m.points, m.triangles, m.texture, m.texture_triangles, (m.group, m.group_names), stitches,
        comment=f"{METRES}\n{comment}" if m.in_metres else comment,
    )  # fmt: skip


def _check(args: argparse.Namespace, out: Path) -> None:
    if args.action == "mirror" and args.across is None:
        raise InputError("mesh mirror without --across; allowed: --across x, y or z")
    for name in REPAIR if args.action == "mirror" else MIRROR:
        if getattr(args, name) is not None:
            raise InputError(f"--{name.replace('_', '-')} is no option of mesh {args.action}")
    if out.suffix.lower() != ".obj":
        raise InputError(
            f"-o {out}: allowed: a file named .obj, which keeps groups, texture coordinates and stitches"
        )
    if args.weld is not None and not 0 <= args.weld < 0.1:
        raise InputError(f"--weld {args.weld:g}; allowed: 0 to 0.1, a share of the mesh's size")
    for name in ("fill_holes", "drop_pieces"):
        if (getattr(args, name) or 0) < 0:
            raise InputError(f"--{name.replace('_', '-')} {getattr(args, name)}; allowed: 0 or more")
    if out.exists() and args.file.exists() and out.samefile(args.file):
        raise InputError(f"-o {out}: is the file it is made from; allowed: another one")


def _lines(told: dict[str, Any]) -> list[str]:
    if "plane" in told:
        ((axis, place),) = told["plane"].items()
        apart, rms = told["other_half"]["apart"], told["other_half"]["rms"]
        lines = [
            f"  mirrored over {axis} = {place:.6g}; the other half was {apart:.3g} off at most, rms {rms:.3g}"
        ]
    else:
        lines = [f"  {often} {what}" for what, often in told["changed"].items()] or ["  nothing to change"]
    return lines + [f"  left: {line}" for line in told["left"]]
