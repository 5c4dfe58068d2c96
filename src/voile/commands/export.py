"""`voile export`: a result's shapes and patterns in other formats."""

import argparse
from pathlib import Path

from voile.commands._result import folder
from voile.errors import InputError
from voile.signals import ends_at_once

TEXT = "a shape as obj, ply, vtu or glb, a sewing pattern as svg, dxf or png"


def arguments(parser: argparse.ArgumentParser) -> None:
    """Adds the command's arguments."""
    parser.add_argument("file", type=Path, help="a result folder, or the result.vtkhdf in it")
    parser.add_argument("output", type=Path, nargs="?", help="its ending says the format")
    parser.add_argument(
        "-o", dest="named", metavar="OUTPUT", type=Path, help="the same, as other commands have it"
    )
    parser.add_argument("--to", metavar="FORMAT", help="written beside the result, as shape or pattern")
    parser.add_argument(
        "--step",
        type=int,
        default=-1,
        help="which stored step, from 0; negative from the end (default: the last)",
    )


def run(args: argparse.Namespace) -> None:
    """Writes the file, and prints its name."""
    ends_at_once()
    from voile.post.export import PATTERNS, export

    given = [f"output {path}" for path in (args.output, args.named) if path] + [f"--to {args.to}"] * bool(
        args.to
    )
    if len(given) != 1:
        raise InputError(
            f"{' and '.join(given) or 'no output'}; allowed: an output file, or --to with a format"
        )
    name = "pattern" if f".{args.to}" in PATTERNS else "shape"
    out = args.output or args.named or folder(args.file) / f"{name}.{args.to}"
    print(export(args.file, out, args.step))
