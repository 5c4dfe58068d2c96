"""What supports exert in time: force and moment per [[fix]] in every step, against momentum."""

import numpy as np
import pytest
from test_supports import GRAVITY, LENGTH, WIDTH, strip

from voile.cli import main
from voile.post.series import Recorded
from voile.results import read_result, read_summary
from voile.results.history import read_history

MASS = 1000.0 * 1e-3 * WIDTH * LENGTH
SCENE = """
[scene]
task = "dynamics"
[shell]
mesh = "strip.obj"
young = 1e6
thickness = 1e-3
density = 1000.0
[loads]
gravity = [0.0, 0.0, -9.81]
[[fix]]
name = "wall"
select = { box = [[-1, -1, -1], [0.001, 1, 1]] }
clamp = true
move = { velocity = [0.0, 0.3, 0.5], from = 0.02, until = 0.06 }
[[fix]]
select = { box = [[0.399, -1, -1], [1, 1, 1]] }
axes = "y"
[dynamics]
time_step = 0.002
duration = 0.1
tolerance = 1e-9
[output]
every = 1
"""


@pytest.fixture
def scene(tmp_path):
    (tmp_path / "strip.obj").write_text(strip())
    return tmp_path / "scene.toml"


@pytest.mark.parametrize("scheme", ["implicit-euler", 'moreau-jean"\ntheta = 0.5\nkeeps = "energy'])
def test_forces_change_the_momentum(scene, tmp_path, scheme):
    """By h times the weight and what supports exert, to the residual; its moments by implicit Euler's steps."""
    scene.write_text(SCENE.replace("[dynamics]", f'[dynamics]\nscheme = "{scheme}"'))
    assert main(["run", str(scene), "-o", str(tmp_path / "out")]) == 0
    history, summary = read_history(tmp_path / "out"), read_summary(tmp_path / "out" / "summary.json")
    weight = np.array([0.0, 0.0, -GRAVITY * MASS])
    forces = history["support_0"] + history["support_1"]
    gained = np.diff(history["momentum"], axis=0, prepend=0.0) / history["time_step"][:, None]
    assert np.abs(gained - weight - forces).max() < 1e-8 * GRAVITY * MASS
    assert np.abs(forces[:, 2]).max() > GRAVITY * MASS  # as the wall is started
    for k, support in enumerate(summary["supports"]):
        assert support["force"] == history[f"support_{k}"][-1].tolist()
        assert support["moment"] == history[f"support_{k}_moment"][-1].tolist()
    with read_result(tmp_path / "out") as result:
        recorded = Recorded(result, True)
        assert recorded.series("support_1")[0].unit == "N"
        assert recorded.series("support_0_moment")[0].unit == "N m"
        if scheme != "implicit-euler":
            return
        ends = [np.isclose(result.start[:, 0], at) for at in (0.0, LENGTH)]
        mass = lumped(result)
        for k in range(1, 51):
            x, v = result.points(k), [result.field("velocity", step) for step in (k - 1, k)]
            turned = np.cross(x, mass[:, None] * (v[1] - v[0]) / 0.002).sum(axis=0)
            given = np.cross(mass @ x, [0.0, 0.0, -GRAVITY])
            for number, end in enumerate(ends):
                given += history[f"support_{number}_moment"][k - 1]
                given += np.cross(x[end].mean(axis=0), history[f"support_{number}"][k - 1])
            assert np.abs(turned - given).max() < 1e-7 * GRAVITY * MASS * LENGTH


def lumped(result) -> np.ndarray:
    """(n,) kg, a third of each triangle."""
    mass = np.zeros(result.n_points)
    a, b, c = result.start[result.triangles].transpose(1, 0, 2)
    area = 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)
    np.add.at(mass, result.triangles, area[:, None] / 3.0)
    return mass


def test_a_sheet_at_rest_hangs_by_its_weight(scene, tmp_path):
    """Drawn tight by itself; what it swings and stretches at first is damped away."""
    text = SCENE.partition("[[fix]]\nselect")[0].replace("[0.0, 0.0, -9.81]", "[9.81, 0.0, 0.0]")
    text = "\n".join(line for line in text.split("\n") if not line.startswith("move"))
    text += "[dynamics]\ntime_step = 0.05\nduration = 5.0\ntolerance = 1e-10\ndamping = { mass = 5.0 }\n"
    scene.write_text(text)
    assert main(["run", str(scene), "-o", str(tmp_path / "out")]) == 0
    history = read_history(tmp_path / "out")
    assert history["support_0"][-1] == pytest.approx([-GRAVITY * MASS, 0.0, 0.0], abs=1e-8 * GRAVITY * MASS)
    assert np.abs(history["support_0_moment"][-1]).max() < 1e-9 * GRAVITY * MASS * LENGTH


@pytest.mark.parametrize(
    "scheme",
    ["implicit-euler", "bdf2", "generalized-alpha", 'moreau-jean"\ntheta = 0.5\nkeeps = "nothing'],
)
def test_a_clamp_that_turns_works_by_its_moment(scene, tmp_path, scheme):
    """About the edge that it holds, which does not move; damping counts."""
    text = SCENE.partition("[[fix]]\nselect")[0].replace(
        "velocity = [0.0, 0.3, 0.5], from = 0.02, until = 0.06",
        "angular_velocity = [0.0, 3.0, 0.0], center = [0.0, 0.0, 0.0]",
    )
    text += f'[dynamics]\nscheme = "{scheme}"\ntime_step = 0.002\nduration = 0.05\ntolerance = 1e-9\n'
    scene.write_text(text + "damping = { stiffness = 0.002 }\n")
    assert main(["run", str(scene), "-o", str(tmp_path / "out")]) == 0
    history = read_history(tmp_path / "out")
    work = np.diff(history["supports_work"], prepend=0.0)
    by_moment = 3.0 * history["time_step"] * history["support_0_moment"][:, 1]
    assert work == pytest.approx(by_moment, abs=1e-9 * np.abs(work).max())


@pytest.mark.mpi
def test_ranks_find_the_same_forces(scene, tmp_path, run_on, rank_counts):
    scene.write_text(SCENE.replace("0.1\n", "0.04\n"))
    found = []
    for ranks in rank_counts:
        run_on(ranks, scene, tmp_path / str(ranks))
        found.append(read_history(tmp_path / str(ranks)))
    for name in ("support_0", "support_0_moment", "support_1", "support_1_moment"):
        largest = np.abs(found[0]["support_0"]).max()
        for other in found[1:]:
            np.testing.assert_allclose(other[name], found[0][name], rtol=0, atol=1e-9 * largest)
