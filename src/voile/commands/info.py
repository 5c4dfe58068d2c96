"""`voile info`: figures of a result."""

import argparse
from pathlib import Path

from voile.errors import printable

TEXT = "figures of a result"


def arguments(parser: argparse.ArgumentParser) -> None:
    """Adds the command's arguments."""
    parser.add_argument("file", type=Path, help="a result folder, or the result.vtkhdf in it")


def run(args: argparse.Namespace) -> None:
    """Prints the figures."""
    from voile.post import info

    print(printable(info(args.file)))
