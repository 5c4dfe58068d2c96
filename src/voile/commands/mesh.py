"""`voile mesh repair`: meshes that voile refuses, mended."""

import argparse
import json
from pathlib import Path

from voile.errors import InputError

TEXT = "repair FILE: a mesh without what cannot be simulated, and a report of what was changed"
UNITS = ("m", "cm", "mm", "inch")


def arguments(parser: argparse.ArgumentParser) -> None:
    """Adds the command's arguments."""
    parser.add_argument("action", choices=("repair",))
    parser.add_argument("file", type=Path, help="a mesh in any format that voile reads")
    parser.add_argument("-o", "--output", type=Path, help="an OBJ file; default: FILE-repaired.obj")
    parser.add_argument("--unit", choices=UNITS, help="of the file; its lengths become metres")
    parser.add_argument(
        "--weld", type=float, help="share of the size below which border vertices are one (1e-6; 0: none)"
    )
    parser.add_argument(
        "--fill-holes", type=int, default=0, metavar="N", help="close border loops of N edges at most"
    )
    parser.add_argument(
        "--drop-pieces", type=int, default=0, metavar="N", help="drop pieces of fewer than N triangles"
    )
    parser.add_argument(
        "--keep-flaps", action="store_true", help="keep small parts that hang by a vertex or two"
    )


def run(args: argparse.Namespace) -> None:
    """Writes the mesh and its report, prints what was changed. Raises InputError where it cannot be read then."""
    from voile.mesh import METRES, Stitches, read_mesh, read_raw, write_obj
    from voile.mesh.repair import WELD, RepairOptions, repair, size_of

    out = args.output or args.file.with_name(f"{args.file.stem}-repaired.obj")
    _check(args, out)
    raw = read_raw(args.file)
    weld = WELD if args.weld is None else args.weld
    options = RepairOptions(weld, args.fill_holes, args.drop_pieces, args.unit, args.keep_flaps)
    done = repair(raw, options)
    m = done.mesh
    stitches = None
    if m.stitch_vertices is not None and m.stitch_weight is not None:
        slave, first, second = m.stitch_vertices.T
        stitches = Stitches(slave, first, second, m.stitch_weight)
    comment = f"repaired from {args.file.name}"
    write_obj(
        out, m.points, m.triangles, m.texture, m.texture_triangles, (m.group, m.group_names), stitches,
        comment=f"{METRES}\n{comment}" if m.in_metres else comment,
    )  # fmt: skip
    if m.vertex_groups:
        done.left.append(f"OBJ has no names for vertices: {', '.join(m.vertex_groups)} are left out")
    report = {
        "file": str(args.file),
        "output": str(out),
        "read": {"vertices": len(raw.points), "triangles": len(raw.triangles)},
        "written": {"vertices": len(m.points), "triangles": len(m.triangles), "size": size_of(m)},
        "changed": done.changed,
        "left": [*raw.notes, *done.left],
    }
    told = out.with_suffix(".json")
    try:
        told.write_text(json.dumps(report, indent=1), encoding="utf-8")
    except OSError as error:
        raise InputError(f"{told}: cannot be written: {error.strerror}") from error
    for line in _lines(report):
        print(line)
    print(told)
    read_mesh(out)  # what could not be mended is said as the reader says it


def _check(args: argparse.Namespace, out: Path) -> None:
    if out.suffix.lower() != ".obj":
        raise InputError(
            f"-o {out}: allowed: a file named .obj, which keeps groups, texture coordinates and stitches"
        )
    if args.weld is not None and not 0 <= args.weld < 0.1:
        raise InputError(f"--weld {args.weld:g}; allowed: 0 to 0.1, a share of the mesh's size")
    for name in ("fill_holes", "drop_pieces"):
        if getattr(args, name) < 0:
            raise InputError(f"--{name.replace('_', '-')} {getattr(args, name)}; allowed: 0 or more")
    if out.exists() and args.file.exists() and out.samefile(args.file):
        raise InputError(f"-o {out}: is the file to repair; allowed: another one")


def _lines(report: dict) -> list[str]:
    read, written = report["read"], report["written"]
    lines = [
        f"{report['output']}: {written['vertices']} vertices, {written['triangles']} triangles "
        f"({read['vertices']}, {read['triangles']} in {report['file']})"
    ]
    lines += [f"  {often} {what}" for what, often in report["changed"].items()] or ["  nothing to change"]
    return lines + [f"  left: {line}" for line in report["left"]]
