"""Drapes that buckle on their way: friction keeps the way, which must not hang on the number of ranks."""

import numpy as np
import pytest
from protocols import plate

from voile.mesh.obj import write_obj
from voile.results import read_result

SCENE = """
[shell]
mesh = "sheet.obj"
young = 1e6
thickness = 1e-3
density = 300.0
[loads]
gravity = [0.0, 0.0, -9.81]
"""
BODIES = {
    "sphere": 'shape = "sphere"\ncenter = [0.0, 0.0, -0.1605]\nradius = 0.16',
    "cone": 'shape = "cone"\napex = [0.0, 0.0, -0.001]\naxis = [0.0, 0.0, -1.0]\nhalf_angle = 0.9',
    "torus": 'shape = "torus"\ncenter = [0.0, 0.0, -0.051]\naxis = [0.0, 0.0, 1.0]\nradius = 0.15\ntube = 0.05',
}
CORNERS = "[[fix]]\nselect = { box = [[-1, -1, -1], [-0.2, -0.2, 1]] }\n"
SLOW = pytest.mark.slow


@pytest.mark.mpi
@pytest.mark.parametrize(
    ("body", "more"),
    [
        pytest.param("sphere", "", id="sphere"),
        pytest.param("sphere", CORNERS, id="corner held", marks=SLOW),
        pytest.param("cone", "", id="cone", marks=SLOW),
        pytest.param("torus", "", id="torus", marks=SLOW),
    ],
)
def test_a_symmetric_sheet_falls_into_the_same_folds(tmp_path, run_on, rank_counts, body, more):
    """The same shape to 1e-8 m and the same forces to 1e-6 of them all on 1, 2 and 4 ranks."""
    cells = 12 if len(rank_counts) > 2 or body != "sphere" else 6
    points, triangles = plate(0.5, 0.5, 0.5 / cells)
    write_obj(tmp_path / "sheet.obj", points - [0.25, 0.25, 0.0], triangles)
    scene = tmp_path / "scene.toml"
    scene.write_text(f"{SCENE}{more}[[obstacle]]\n{BODIES[body]}\nfriction = 0.5\n")
    found = []
    for ranks in rank_counts:
        out = tmp_path / str(ranks)
        run_on(ranks, scene, out, 300)
        with read_result(out) as result:
            found.append((result.points(), result.field("reaction")))
    (first, force), *others = found
    assert np.ptp(first[:, 2]) > 0.1  # it does fall
    for points, reaction in others:
        assert np.abs(points - first).max() < 1e-8
        assert np.abs(reaction - force).max() < 1e-6 * np.abs(force).sum()
