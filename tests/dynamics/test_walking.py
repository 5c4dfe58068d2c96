"""A skirt on a form that walks, from meshes/ and a scene file, by both solvers."""

import sys
from pathlib import Path

import numpy as np
import pytest

from voile.cli import main
from voile.mesh import write_obj
from voile.results import read_result
from voile.results.history import read_history

sys.path.insert(0, str(Path(__file__).parents[2] / "meshes"))
from fitted_skirt import fitted_skirt
from walker import walker

SCENE = """
[scene]
task = "dynamics"
[shell]
mesh = "skirt.obj"
model = "projective"
young = 5e4
thickness = 1e-3
density = 300.0
[[obstacle]]
shape = "mesh"
frames = "body_%03d.obj"
frame_time = 0.05
friction = 0.3
[dynamics]
time_step = 0.01
duration = 0.3
tolerance = 1e-7
iterations = 500
"""


@pytest.fixture(scope="module")
def scene(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("walking")
    write_obj(folder / "skirt.obj", *fitted_skirt(level=0.38, length=0.62, flare=0.36, size=0.07))
    frames, triangles = walker(size=0.045, duration=0.3, frame_time=0.05, period=0.4, swing=50.0)
    for k, points in enumerate(frames):
        write_obj(folder / f"body_{k:03d}.obj", points, triangles)
    (folder / "scene.toml").write_text(SCENE)
    return folder / "scene.toml"


def test_a_skirt_on_a_form_that_walks(scene):
    ends = []
    for solver in ("newton", "local-global"):
        out = scene.parent / solver
        assert main(["run", str(scene), "-o", str(out), "--set", f'dynamics.solver="{solver}"']) == 0
        history = read_history(out)
        assert history["obstacles_work"][-1] > 0.0 and history["active"].max() > 20
        assert history["max_penetration"].max() < 1e-9
        largest = max(np.abs(history[name]).max() for name in ("kinetic", "gravity", "stretching"))
        assert np.abs(history["balance_error"]).max() < 1e-8 * largest
        with read_result(out) as result:
            ends.append(result.points())
    assert np.linalg.norm(ends[0] - ends[1], axis=1).max() < 1e-5
