"""`voile explain`: what a scene will model."""

import argparse

from voile.commands._scene import load, scene_arguments
from voile.errors import printable

TEXT = "what a scene will model and why; solves nothing"


def arguments(parser: argparse.ArgumentParser) -> None:
    """Adds the command's arguments."""
    scene_arguments(parser)


def run(args: argparse.Namespace) -> None:
    """Prints the terms, unknowns, solver and memory of a scene."""
    from voile.explain import explain
    from voile.petsc_options import start_petsc

    start_petsc()
    print(printable(explain(*load(args))))
