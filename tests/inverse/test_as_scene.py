"""What a user's scene of statics with the written files does, and what is said where it ends elsewhere."""

import json

import numpy as np
import pytest
from inverse_shells import folded_skirt
from mpi4py import MPI
from test_adjoint import wave
from test_cli_inverse import run, scene
from test_direct import heavy_strip

import voile
from voile.inverse.target import Target
from voile.inverse.verify import as_scene
from voile.mesh import write_obj
from voile.problem.problem import Problem
from voile.solver.path import StaticsOptions


def test_the_proof_as_a_scene_is_that_scene_with_its_coarser_levels(tmp_path):
    """Of 550 vertices, on another rest shape than the target, whose levels lead to folds of their own."""
    shape = folded_skirt(50, 10, young=5e6)
    target = Target(Problem(shape, MPI.COMM_SELF), shape, [], 0.5e-3, 1e-3)
    z = wave(target, 1.0, 2e-3)
    proof = as_scene(target, z, StaticsOptions(nested=True))
    assert proof.stable and any("nested" in method for method in proof.path.methods)
    write_obj(tmp_path / "target.obj", shape.points, shape.triangles)
    write_obj(tmp_path / "rest.obj", shape.points + target.problem.motion(z), shape.triangles)
    files = {"mesh": str(tmp_path / "target.obj"), "rest": str(tmp_path / "rest.obj")}
    fabric = {"bending": "average", "young": 5e6, "poisson": 0.3, "thickness": 1e-3, "density": 300.0}
    fix = [{"select": {"nodes": list(range(50))}}]
    gravity = {"gravity": [0.0, 0.0, -9.81]}
    found = voile.run({"shell": {**files, **fabric}, "loads": gravity, "fix": fix})
    moved = np.linalg.norm(found.positions - found.start, axis=1).max()
    assert proof.sag == pytest.approx(moved / target.problem.size(), rel=1e-6) and proof.sag > 0.01
    assert found.summary["method"] == proof.path.methods
    np.testing.assert_array_equal(target.problem.positions(target.problem.create_vector()), target.x)


def test_a_shape_that_cloth_must_be_put_into_is_told_of(tmp_path):
    """A column four times too high to stand: its nearest stable shape stands, cloth let go upright falls."""
    shape = heavy_strip(32.0, upwards=True, cells=20)[0]
    write_obj(tmp_path / "target.obj", shape.points, shape.triangles)
    held = "[[fix]]\nselect = { box = [[-1, -1, -1], [1e-9, 1, 1]] }\nclamp = true"
    scene(tmp_path, held, young=float(shape.young[0]), name="column")
    text = (tmp_path / "scene.toml").read_text().replace("[0.0, 0.0, -9.81]", "[-9.81, 0.0, 0.0]")
    (tmp_path / "scene.toml").write_text(text.replace("young =", "poisson = 0.0\nyoung ="))
    code, said = run(tmp_path)
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    found = summary["inverse"]
    assert code == 0 and found["nearest"]["sag"] < 0.1 and found["nearest"]["reached"] is False
    assert found["sag"] > 2.0 * found["nearest"]["sag"] and found["nearest"]["moved"] < 1e-6
    assert f"leaves it and ends {found['sag']:.2g} sizes from the target" in summary["reason"]
    (note,) = [note for note in summary["notes"] if "must be put into that shape" in note]
    assert f"{found['nearest']['sag']:.2g} sizes" in note and f"{found['sag']:.2g} sizes" in note
    assert f"note: {note}" in said
