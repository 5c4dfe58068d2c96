"""`voile plot`: curves of a run."""

import argparse
from pathlib import Path

from voile.commands._result import folder

TEXT = "quantities of a result against time or load, as PNG"


def arguments(parser: argparse.ArgumentParser) -> None:
    """Adds the command's arguments."""
    parser.add_argument("file", type=Path, help="a result folder, or the result.vtkhdf in it")
    parser.add_argument(
        "quantity", nargs="*", help="energies (default), contact_force, ...; FIELD:VERTEX at a vertex"
    )
    parser.add_argument(
        "-o", "--output", type=Path, help="default: the quantities' names .png beside the result"
    )


def run(args: argparse.Namespace) -> None:
    """Draws the curves, and prints the picture's name."""
    from voile.post.plot import plot

    names = args.quantity or ["energies"]
    default = folder(args.file) / ("-".join(names).replace(":", "-") + ".png")
    print(plot(args.file, args.output or default, names))
