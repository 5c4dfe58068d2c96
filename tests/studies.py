"""A coarse strip, clamped at one end and heavy, that the tests of `voile study` vary."""

import csv
import json
from collections.abc import Callable
from pathlib import Path

from command_line import voile
from mesh_helpers import generator

from voile.mesh import write_obj

TIP = -0.700199715514355  # drop of the elastica's tip, gamma = 10 (runs/cantilever)
SCENE = """
[shell]
mesh = "strip.obj"
young = 1.0e6
poisson = 0.0
thickness = 1.0e-3
density = 1000.0
[loads]
gravity = [0.0, 0.0, -8.333333333333333e-4]
[[fix]]
select = { box = [[-1e-6, -1.0, -1.0], [1e-6, 1.0, 1.0]] }
clamp = true
[statics]
load_steps = 1
"""
POINT = """
[[point]]
name = "tip"
select = { box = [[0.999999, -1.0, -1.0], [1.000001, 1.0, 1.0]] }
axis = "z"
"""
HEAD = '[study]\nscene = "scene.toml"\nrepeats = 1\n'
THREE = f'{HEAD}measure = "tip"\nreference = {TIP}\n[vary]\nrefine = [0, 1, 2]\n{POINT}'
# Columns that two runs may not share.
TIMES = {"seconds", "wall_seconds", "cpu_seconds", "memory_mib", "repeats", "front"}


def write_strip(folder: Path, size: float = 0.1) -> None:
    points, triangles = generator("strip").strip(length=1.0, width=0.1, size=size)
    write_obj(folder / "strip.obj", points, triangles)


def place(folder: Path) -> Callable[[str], Path]:
    """write(text): writes study.toml beside the scene of the strip, which this writes now."""
    write_strip(folder)
    (folder / "scene.toml").write_text(SCENE)

    def write(text: str) -> Path:
        (folder / "study.toml").write_text(text)
        return folder / "study.toml"

    return write


def done(path, out, *options):
    run = voile("study", path, "-o", out, *options)
    assert run.returncode == 0, run.stderr
    return json.loads((out / "study.json").read_text())


def table(out, *, timeless=False):
    with open(out / "study.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    return [{k: v for k, v in row.items() if not (timeless and k in TIMES)} for row in rows]
