"""What the commands that read a scene share."""

import argparse
from pathlib import Path

from voile.errors import InputError


def scene_arguments(parser: argparse.ArgumentParser) -> None:
    """The scene file and overrides of its keys."""
    parser.add_argument("scene", type=Path)
    parser.add_argument(
        "--set", action="append", default=[], metavar="KEY=VALUE", help="override a scene key"
    )


def load(args: argparse.Namespace):
    """The scene and the model built from it. Raises InputError."""
    from voile import blas
    from voile.petsc_options import check_words
    from voile.wiring import build_model

    check_words(args.petsc)
    scene = _read(args)
    model = build_model(scene)
    if blas.used().note:
        model.notes.append(blas.used().note)
    return scene, model


def _read(args: argparse.Namespace):
    from voile.scene import read_scene, unsupported

    scene = read_scene(args.scene, args.set)
    missing = unsupported(scene)
    if missing:
        raise InputError(f"{args.scene}: this version cannot run {'; '.join(missing)}")
    return scene
