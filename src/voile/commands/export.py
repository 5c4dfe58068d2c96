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
    parser.add_argument(
        "--to", metavar="FORMAT", help="alone: written beside the result, as shape or pattern"
    )
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

    given = [path for path in (args.output, args.named) if path]
    if len(given) > 1 or not (given or args.to):
        told = " and ".join(f"output {path}" for path in given) or "no output"
        raise InputError(f"{told}; allowed: an output file, or --to with a format")
    ending = f".{args.to}"
    name = "pattern" if ending in PATTERNS else "shape"
    out = given[0] if given else folder(args.file) / f"{name}{ending}"
    if args.to and out.suffix.lower() != ending:
        raise InputError(f"output {out} and --to {args.to}; allowed: an output that ends in {ending}")
    print(export(args.file, out, args.step))
