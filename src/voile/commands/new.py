"""`voile new`: a commented scene to begin with."""

import argparse
import json
import re
import shutil
import tempfile
from importlib import resources
from pathlib import Path

from voile.errors import InputError
from voile.files import reason

TEXT = "a folder with a commented scene and its meshes, to begin with"
TEMPLATES = {
    "hanging": "a sheet hung by two corners (statics)",
    "drape": "a cloth on a ball: contact and friction (statics)",
    "dynamics": "a cloth falls on a turning ball",
    "inverse": "the rest shape for which a skirt hangs as designed",
    "pattern": "the sewing pattern of a skirt on a dress form",
}


def arguments(parser: argparse.ArgumentParser) -> None:
    """Adds the command's arguments."""
    parser.add_argument("name", type=Path, help="the folder to make")
    parser.add_argument(
        "--template",
        choices=tuple(TEMPLATES),
        default="hanging",
        help="; ".join(f"{name}: {what}" for name, what in TEMPLATES.items()) + " (default: hanging)",
    )


def run(args: argparse.Namespace) -> None:
    """Writes the folder, and prints what to do with it."""
    make(args.name, args.template)
    scene = args.name / "scene.toml"
    print(f"{scene}\nvoile explain {scene}\nvoile run {scene} -o {args.name}/result")


def make(folder: Path, template: str) -> None:
    """Copies a template under the folder's name, all or nothing. Raises InputError where there is something already."""
    name = folder.name
    if not name or not name.isprintable():
        raise InputError(f"{str(folder)!r}: a folder's name of printable characters expected")
    if folder.exists() or folder.is_symlink():
        raise InputError(f"{folder}: exists already and stays as it is; choose another name")
    try:
        with tempfile.TemporaryDirectory(dir=folder.parent, prefix=f".{name}.") as part:
            made = Path(part) / name
            with resources.as_file(resources.files("voile") / "templates" / template) as source:
                made.mkdir()
                for file in source.iterdir():
                    shutil.copyfile(file, made / file.name)
            scene = made / "scene.toml"
            # a function: nothing in the name is taken for a reference
            title = f"name = {json.dumps(name, ensure_ascii=False)}"
            text = re.sub(
                r"^name = .*$", lambda _: title, scene.read_text(encoding="utf-8"), count=1, flags=re.M
            )
            scene.write_text(text, encoding="utf-8")
            made.rename(folder)
    except OSError as error:
        raise InputError(f"{folder}: cannot be written: {reason(error)}") from None
