"""`voile schema`: the scene file's JSON schema."""

import argparse
import json

TEXT = "JSON schema of the scene file"


def arguments(parser: argparse.ArgumentParser) -> None:
    """There are none."""


def run(args: argparse.Namespace) -> None:
    """Prints the schema."""
    from voile.scene import json_schema

    print(json.dumps(json_schema(), indent=2))
