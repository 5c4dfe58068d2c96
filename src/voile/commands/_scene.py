"""What the commands that read a scene share."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from voile.scene import Scene
    from voile.wiring import Model


def scene_arguments(parser: argparse.ArgumentParser) -> None:
    """The scene file and overrides of its keys."""
    parser.add_argument("scene", type=Path, help="a TOML file; voile schema prints its keys")
    parser.add_argument(
        "--set", action="append", default=[], metavar="KEY=VALUE", help="override a scene key"
    )


def load(args: argparse.Namespace) -> "tuple[Scene, Model]":
    """The scene and the model built from it. Raises InputError."""
    from voile import api

    scene = api.load(args.scene, args.set)
    return scene, api.modelled(scene, args.petsc)
