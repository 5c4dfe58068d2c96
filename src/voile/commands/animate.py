"""`voile animate`: a film of a run."""

import argparse
import sys
from pathlib import Path

from voile.commands._result import folder
from voile.signals import ends_at_once

TEXT = "a film of a run over time or load: mp4, gif or webp"


def arguments(parser: argparse.ArgumentParser) -> None:
    """Adds the command's arguments."""
    parser.add_argument("file", type=Path, help="a result folder, or the result.vtkhdf in it")
    parser.add_argument("-o", "--output", type=Path, help="default: film.mp4 beside the result")
    parser.add_argument("--field", default="strain", help="colours, as for render")
    parser.add_argument("--fps", type=float, help="frames a second (default: 25; along a load path 5 steps)")
    parser.add_argument("--speed", type=float, help="seconds of the run in a second of film (default: 1)")
    parser.add_argument("--view", help="as for render")


def run(args: argparse.Namespace) -> None:
    """Draws the frames, and prints the film's name."""
    ends_at_once()
    from voile import api
    from voile.post.film import animate

    def tell(frame: int, count: int) -> None:
        if sys.stderr.isatty():
            print(f"\r\033[Kframe {frame} of {count}", end="", file=sys.stderr, flush=True)

    with api.read(args.file) as result:
        film = animate(
            result,
            args.output or folder(args.file) / "film.mp4",
            field=args.field,
            fps=args.fps,
            speed=args.speed,
            view=args.view,
            on_frame=tell,
        )
    if sys.stderr.isatty():
        print("\r\033[K", end="", file=sys.stderr, flush=True)
    if not film.ended:
        print("note: the run has not ended; the film shows its steps so far")
    print(film.path)
