"""Garments as a designer models them on their bodies: the targets, and the rest shapes that make them stand."""

import json
import math
import subprocess
import sys

import numpy as np
import pytest
from mesh_helpers import areas, generator, loops_of

from voile.mesh import build_topology, read_mesh, write_obj

pytest.importorskip("gmsh", reason="the garments' meshes need gmsh (pip install gmsh)")
worn = generator("worn")
SIZES = {"hat": 0.02, "sock": 0.012, "t-shirt": 0.03}  # m
TOPOLOGY = {"hat": (1, 1), "sock": (1, 1), "t-shirt": (4, -2)}  # boundary loops, Euler characteristic


def write_scene(folder, garment: str, young: float, thickness: float, friction: float, size: float) -> None:
    """scene.toml and target.obj of a garment on its body."""
    write_obj(folder / "target.obj", *worn.worn(garment, size))
    lines = ['[scene]\ntask = "inverse"\n[shell]\nmesh = "target.obj"\nbending = "average"']
    lines += [f"young = {young:g}", f"thickness = {thickness:g}", "density = 300.0"]
    for body in worn.BODIES[garment]:
        lines += ["[[obstacle]]", *(f"{key} = {json.dumps(value)}" for key, value in body.items())]
        lines += [f"friction = {friction:g}"]
    lines += ["[inverse]", "contact_tolerance = 0.002", ""]
    (folder / "scene.toml").write_text("\n".join(lines))


def run(folder) -> tuple[subprocess.CompletedProcess[str], dict]:
    command = [sys.executable, "-m", "voile.cli", "run", "scene.toml", "-o", "out"]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=300)
    summary = folder / "out" / "summary.json"
    return done, json.loads(summary.read_text()) if summary.is_file() else {}


@pytest.mark.parametrize("garment", TOPOLOGY)
def test_garments_are_manifolds_near_their_bodies(tmp_path, garment):
    points, triangles = worn.worn(garment, SIZES[garment])
    write_obj(tmp_path / "out.obj", points, triangles)
    surface = read_mesh(tmp_path / "out.obj")
    assert surface.notes == ()  # consistently oriented, no unused vertex
    topology = build_topology(surface.triangles)
    euler = len(surface.points) - len(topology.edges) + len(surface.triangles)
    assert (len(loops_of(surface)), euler) == TOPOLOGY[garment]
    corners = surface.points[surface.triangles]
    longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    assert (areas(surface.points, surface.triangles) > 0.01 * longest**2).all()
    bodies = [worn._body(spec) for spec in worn.BODIES[garment]]
    gaps = np.array([body.gap(surface.points, 0.0) for body in bodies])
    assert gaps.min() > -0.0005
    assert (gaps.min(axis=0) < 0.002).mean() > 0.15


@pytest.mark.parametrize(
    "garment",
    ["hat", pytest.param("sock", marks=pytest.mark.slow), pytest.param("t-shirt", marks=pytest.mark.slow)],
)
def test_friction_alone_holds_garments(tmp_path, garment):
    write_scene(tmp_path, garment, young=1e7, thickness=1e-3, friction=0.3, size=SIZES[garment])
    done, summary = run(tmp_path)
    assert done.returncode == 0, done.stderr
    found = summary["inverse"]
    assert found["stable"] and found["load_fraction"] == 1.0
    assert found["sag"] < 1e-12
    assert found["sag_disturbed"] < 1e-4 and found["disturbance"] > 1e-5
    assert found["reactions"]["least_margin"] >= 0.0
    assert math.copysign(1.0, summary["contact"]["max_penetration"]) == 1.0  # no -0.0


@pytest.mark.slow
def test_a_thick_soft_t_shirt_settles_after_a_disturbance(tmp_path):
    write_scene(tmp_path, "t-shirt", young=1e6, thickness=3e-3, friction=0.5, size=0.012)
    done, summary = run(tmp_path)
    assert done.returncode == 0, done.stderr
    assert summary["inverse"]["stable"]
    assert summary["inverse"]["sag_disturbed"] < 1e-4  # a thickness is 3e-3 of the size
