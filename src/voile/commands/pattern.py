"""`voile pattern`: the pieces of a result on fabric of a given width, and on paper."""

import argparse
from pathlib import Path

from voile.commands._result import folder
from voile.errors import InputError

TEXT = (
    "a result's sewing pattern laid on fabric of a given width (layout.svg, dxf, png), and on sheets to print"
)
FILES = (".svg", ".dxf", ".png")


def arguments(parser: argparse.ArgumentParser) -> None:
    """Adds the command's arguments."""
    parser.add_argument("file", type=Path, help="a result of inverse design")
    parser.add_argument("-o", "--output", type=Path, help="folder for the files; default: the result's")
    parser.add_argument("--width", type=float, metavar="M", help="lay the pieces on fabric so wide (m)")
    parser.add_argument("--turn", action="store_true", help="pieces may lie upside down: cloth without a nap")
    parser.add_argument("--gap", type=float, default=0.005, metavar="M", help="between pieces (m; 0.005)")
    parser.add_argument("--seconds", type=float, default=10.0, help="of the search for a short layout (10)")
    parser.add_argument("--pages", metavar="PAPER", help="sheets to print and glue: a4, a3, letter or a0")


def run(args: argparse.Namespace) -> None:
    """Writes the files, prints their names and what the layout takes."""
    from voile.files import made
    from voile.post.export import PATTERNS
    from voile.post.nesting import efficiency, nested
    from voile.post.pattern_pages import write_pages
    from voile.results import read_pattern

    if args.width is None and args.pages is None:
        raise InputError("nothing to do; allowed: --width, --pages or both")
    pattern = read_pattern(args.file)
    out = args.output or folder(args.file)
    if args.width is not None:
        pattern = nested(pattern, args.width, args.gap, args.turn, args.seconds)
        for ending in FILES:
            PATTERNS[ending](made(out) / f"layout{ending}", pattern)
            print(out / f"layout{ending}")
        used, sizes = 100 * efficiency(pattern), pattern.fabric or ()
        fabric = " x ".join(f"{size:.3f}" for size in sizes)
        count = len(pattern.pieces)
        print(f"{count} piece{'s' * (count != 1)} on {fabric} m of fabric, {used:.1f} % used")
    if args.pages is not None:
        pages = write_pages(out / "pages", pattern, args.pages)
        print(
            f"{pages[0]}\n{len(pages) - 1} sheets, page-cover.svg first: print at 100 %, measure its square"
        )
