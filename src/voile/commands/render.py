"""`voile render`: a picture of a result."""

import argparse
from pathlib import Path

from voile.commands._result import folder
from voile.signals import ends_at_once

TEXT = "a PNG picture of a result"


def arguments(parser: argparse.ArgumentParser) -> None:
    """Adds the command's arguments."""
    parser.add_argument("file", type=Path, help="a result folder, or the result.vtkhdf in it")
    parser.add_argument("-o", "--output", type=Path, help="default: FIELD.png beside the result")
    parser.add_argument(
        "--field",
        default="strain",
        help="colours: displacement, strain, curvature or a stored field (contact, gap, margin, reaction)",
    )
    parser.add_argument(
        "--step",
        type=int,
        default=-1,
        help="which stored step, from 0; negative from the end (default: the last)",
    )
    parser.add_argument(
        "--shape", choices=("step", "rest"), default="step", help="what is drawn (default: a step)"
    )
    parser.add_argument("--view", help="front, back, left, right, top, oblique")


def run(args: argparse.Namespace) -> None:
    """Draws, and prints the picture's name."""
    ends_at_once()
    from voile import api
    from voile.post import render

    out = args.output or folder(args.file) / f"{args.field}.png"
    with api.read(args.file) as result:
        render(result, out, field=args.field, step=args.step, view=args.view, shape=args.shape)
    print(out)
