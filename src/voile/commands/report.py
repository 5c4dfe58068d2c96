"""`voile report`: one page of a run."""

import argparse
from pathlib import Path

from voile.commands._result import folder
from voile.signals import ends_at_once

TEXT = "one self-contained page of a run: 3D view, plots, figures, pattern, notes"


def arguments(parser: argparse.ArgumentParser) -> None:
    """Adds the command's arguments."""
    parser.add_argument("file", type=Path, help="a result folder, or the result.vtkhdf in it")
    parser.add_argument("-o", "--output", type=Path, help="default: report.html beside the result")
    parser.add_argument(
        "--field", help="colours it opens with, as for render (default: strain, or the first mode)"
    )
    parser.add_argument("--size", type=float, metavar="MB", help="of the page, at most (default: 5)")


def run(args: argparse.Namespace) -> None:
    """Writes the page, and prints what it leaves out and its name."""
    ends_at_once()
    from voile import api
    from voile.post.report import MEGABYTES, report

    size = MEGABYTES if args.size is None else args.size
    with api.read(args.file) as result:
        made = report(
            result, args.output or folder(args.file) / "report.html", field=args.field, megabytes=size
        )
    for what, (shown, there) in (("steps", made.steps), ("vertices", made.vertices)):
        if shown < there:
            print(f"note: {shown} of {there} {what} in {size:g} MB; --size gives more room")
    if made.size > 1e6 * size:
        print(f"note: {made.size / 1e6:.1f} MB: the shape cannot be thinner")
    print(made.path)
