"""One place per thing: what is added in one place is known to scenes, the solver and the results."""

import json
import subprocess
import sys
from types import ModuleType

import numpy as np
import pytest

from voile import _kernels
from voile.cli import main
from voile.elastic import BENDING, MATERIALS, MODELS, has_directors, model_name, model_of
from voile.results import read_result, read_summary
from voile.scene import tasks
from voile.solver.path import Path
from voile.tasks.run import rows

# A slab between two parallel planes: keys, distance and drawing surface, and nothing else anywhere.
SLAB = """
import sys
from dataclasses import dataclass

import numpy as np

from voile.contact.directions import normalised
from voile.contact.obstacles import Obstacle, Plane
from voile.keys import Number, key, vector


@dataclass(frozen=True, kw_only=True)
class Slab(Obstacle, shape="slab"):
    point: np.ndarray = key(vector("m"), "a point of its middle plane")
    normal: np.ndarray = key(vector(nonzero=True), "outward direction, any length")
    half: float = key(Number("m", above=0), "half its thickness")

    def derivatives(self, p):
        n = normalised(self.normal)
        height = (p - self.point) @ n
        side = np.where(height < 0.0, -1.0, 1.0)
        return np.abs(height) - self.half, side[:, None] * n, np.zeros((len(p), 3, 3))

    def surface(self, bounds):
        top = self.point + self.half * normalised(self.normal)
        return Plane(point=top, normal=self.normal).surface(bounds)


from voile.cli import main

sys.exit(main())
"""
SCENE = """
[shell]
mesh = "strip.obj"
young = 1e6
thickness = 1e-3
density = 300.0
[loads]
gravity = [0.0, 0.0, -9.81]
[[fix]]
select = { box = [[-0.01, -1, -1], [0.01, 1, 1]] }
clamp = true
[[obstacle]]
"""
STRIP = """
v 0 0 0
v 0 0.05 0
v 0.05 0 0
v 0.05 0.05 0
v 0.1 0 0
v 0.1 0.05 0
v 0.15 0 0
v 0.15 0.05 0
f 1 3 4
f 1 4 2
f 3 5 6
f 3 6 4
f 5 7 8
f 5 8 6
"""
OBSTACLES = {
    "plane": "shape = 'plane'\npoint = [0, 0, -0.005]\nnormal = [0, 0, 2]\nfriction = 0.2",
    "slab": "shape = 'slab'\npoint = [0, 0, -1.005]\nnormal = [0, 0, 2]\nhalf = 1.0\nfriction = 0.2",
}


@pytest.fixture(autouse=True)
def strip(tmp_path):
    """The mesh of the scenes."""
    (tmp_path / "strip.obj").write_text(STRIP)


@pytest.fixture
def voile(tmp_path):
    """voile(*args): the command line, with the slab known to it."""
    (tmp_path / "slab.py").write_text(SLAB)

    def run(*args: str) -> subprocess.CompletedProcess[str]:
        command = [sys.executable, "slab.py", *args]
        return subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=120)

    return run


def test_a_new_obstacle_is_one_class(voile, tmp_path):
    found = {}
    for name, lines in OBSTACLES.items():
        (tmp_path / f"{name}.toml").write_text(SCENE + lines + "\n")
        done = voile("run", f"{name}.toml", "-o", name)
        assert done.returncode == 0, done.stderr
        with read_result(tmp_path / name) as result:
            found[name] = {
                "points": result.points(),
                "reaction": result.field("reaction"),
                "drawn": result.bodies[0].points,
            }
    assert found["plane"]["reaction"][:, 2].max() > 0.0
    for what, values in found["plane"].items():
        np.testing.assert_allclose(found["slab"][what], values, atol=1e-9, err_msg=what)


def test_its_keys_are_in_the_schema_and_checked(voile, tmp_path):
    keys = json.loads(voile("schema").stdout)["properties"]["obstacle"]["items"]["properties"]
    assert keys["shape"]["enum"][-1] == "slab"
    assert keys["half"] == {
        "description": "slab: half its thickness (m)",
        "type": "number",
        "exclusiveMinimum": 0,
        "maximum": 1e30,
    }
    assert keys["normal"]["description"] == "plane, slab: outward direction, any length"
    for old, new, message in (
        ("half = 1.0", "half = 0", "obstacle.0.half: 0 is not allowed; allowed: a finite number > 0 in m"),
        ("half = 1.0\n", "", 'the key "half" is missing; shape = "slab" needs point, normal, half'),
        ("half", "radius", 'obstacle.0.radius: not a key of shape = "slab"; allowed: half, normal, point'),
    ):
        (tmp_path / "bad.toml").write_text(SCENE + OBSTACLES["slab"].replace(old, new))
        done = voile("explain", "bad.toml")
        assert done.returncode == 2 and message in done.stderr, done.stderr


@pytest.mark.parametrize("material", MATERIALS)
@pytest.mark.parametrize("bending", BENDING)
@pytest.mark.parametrize("model", MODELS)
def test_the_table_of_models_says_what_the_kernels_are(model, bending, material):
    name = model_name(model, bending, material)
    corner = np.array([[0, 1, 2], [1, 3, 2]], dtype=np.int32)
    edge = np.array([[0, 1, 2], [3, 0, 4]], dtype=np.int32)  # across from each corner
    sign = np.array([[1, -1, 1], [1, -1, -1]], dtype=np.int32)
    across = np.array([[4, -1, -1], [-1, 0, -1]], dtype=np.int32)
    x = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [1.0, 1.0, 0.0]])
    kernel = _kernels.Elastic(name, corner, edge, sign, across, 5, x)
    kernel.set_rest(x, corner, True)
    kernel.set_fabric(*(np.full(2, value) for value in (1e-2, 1e6, 0.3)))
    kernel.set_weights(np.ones(2))
    folded = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.1])
    bent = kernel.energy(folded, np.zeros(5))[1]
    assert kernel.directors == has_directors(name)
    assert (bent > 0.0) == model_of(name).bends


def weigh(job) -> str:
    """A task: the shell's mass, and its start shape as result."""
    shell, problem = job.prepare()
    y = problem.create_vector()
    with job.results(job.mesh(shell, problem.directors)) as writer:
        writer.write_step(0.0, scalars={}, **rows(problem, y))
    job.summarise(problem, Path(y, converged=True, reason="weighed"), mass=problem.part.mass[::3].sum())
    return ""


def test_a_new_task_is_one_function(tmp_path, monkeypatch):
    module = ModuleType("voile.tasks.modes")
    module.run = weigh
    monkeypatch.setitem(sys.modules, module.__name__, module)
    monkeypatch.setitem(tasks.TASKS, "modes", True)
    (tmp_path / "scene.toml").write_text('[scene]\ntask = "modes"\n' + SCENE + OBSTACLES["plane"])
    assert main(["run", str(tmp_path / "scene.toml"), "-o", str(tmp_path / "out")]) == 0
    summary = read_summary(tmp_path / "out" / "summary.json")
    assert summary["mass"] == pytest.approx(0.15 * 0.05 * 1e-3 * 300.0)
    assert summary["task"] == "modes" and summary["converged"] and "contact" in summary["modelled"]
    with read_result(tmp_path / "out") as result:
        assert (result.points() == result.start).all()
        assert result.bodies[0].name == "plane 0" and set(result.point_fields) >= {"gap", "reaction"}
