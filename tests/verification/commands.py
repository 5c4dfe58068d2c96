"""Scenes run as the command line runs them."""

from pathlib import Path

from voile.cli import main
from voile.results import Result, read_result


def run(folder: Path, scene: str, *sets: str) -> Result:
    """The result of a scene file with overrides "key=value", in folder/out."""
    options = [word for each in sets for word in ("--set", each)]
    assert main(["run", scene, "-o", str(folder / "out"), *options]) == 0
    return read_result(folder / "out")
