"""`voile section`: forces and moments across cuts of a stored result."""

import argparse
import csv
import io
from pathlib import Path

from voile.errors import InputError, printable

TEXT = "force and moment across a cut of a stored result"
SUCH = "'point=[0,0,1]' 'normal=[0,0,-1]'"
PARTS = ("force", "moment", "about")


def arguments(parser: argparse.ArgumentParser) -> None:
    """Adds the command's arguments."""
    parser.add_argument("file", type=Path, help="a result folder, or the result.vtkhdf in it")
    parser.add_argument(
        "key",
        nargs="*",
        metavar="KEY=VALUE",
        help=f"keys of [[section]], such as {SUCH}; default: the scene's own sections",
    )
    parser.add_argument(
        "--step", type=int, help="which stored step, from 0; negative from the end (default: all of them)"
    )
    parser.add_argument("--scene", type=Path, help="the run's scene file, where it has moved")
    parser.add_argument("-o", "--output", type=Path, help="a CSV file in place of the printed table")


def run(args: argparse.Namespace) -> None:
    """Prints the forces and moments, a line per step and cut, or writes them."""
    from voile import api
    from voile.files import replace
    from voile.keys.overrides import parts_of
    from voile.post.info import exerted

    keys = dict(parts_of(key, "", SUCH) for key in args.key)
    with api.read(args.file, args.scene and api.load(args.scene)) as result:
        count = result.n_steps
        if args.step is not None and not -count <= args.step < count:
            raise InputError(
                f"{result.path}: no step {args.step}; allowed: 0 to {count - 1}, or -1 for the last"
            )
        steps = range(count) if args.step is None else [args.step % count]
        found = [(k, result.values[k], cut) for k in steps for cut in result.sections(k, **keys)]
    if args.output is None:
        for step, value, cut in found:
            print(printable(f"step {step}, {value:.6g}: {cut['name']}: {exerted(cut)}"))
        return
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow(["step", "value", "name", *(f"{part}_{axis}" for part in PARTS for axis in "xyz")])
    for step, value, cut in found:
        table.writerow([step, value, cut["name"], *(number for part in PARTS for number in cut[part])])
    replace(args.output, text.getvalue().encode())
    print(args.output)
