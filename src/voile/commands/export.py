"""`voile export`: a result's shapes and patterns in other formats."""

import argparse
from pathlib import Path

from voile.commands._result import folder

TEXT = "a shape as obj, ply, vtu or glb, a sewing pattern as svg, dxf or png"


def arguments(parser: argparse.ArgumentParser) -> None:
    """Adds the command's arguments."""
    parser.add_argument("file", type=Path)
    where = parser.add_mutually_exclusive_group(required=True)
    where.add_argument("output", type=Path, nargs="?")
    where.add_argument("--to", metavar="FORMAT", help="written beside the result, as shape or pattern")
    parser.add_argument("--step", type=int, default=-1)


def run(args: argparse.Namespace) -> None:
    """Writes the file, and prints its name."""
    from voile.post.export import PATTERNS, export

    name = "pattern" if f".{args.to}" in PATTERNS else "shape"
    print(export(args.file, args.output or folder(args.file) / f"{name}.{args.to}", args.step))
