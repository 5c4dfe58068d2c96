"""inverse.estimate through the command line: several observations, contact, unknown rest shapes, ranks, refusals."""

import json

import numpy as np
import pytest
from inverse_shells import hanging_sheet
from test_cli_inverse import run
from test_estimate import DRUM, UPWARDS, YOUNG, draped, sheet, simulated  # noqa: F401, a fixture

from voile.mesh import read_mesh, write_obj

SCENE = """
[scene]
task = "inverse"
[shell]
mesh = "{mesh}"
{rest}
bending = "average"
young = {young}
thickness = 1.0e-3
density = 300.0
[loads]
gravity = [0.0, 0.0, {gravity}]
[[fix]]
select = {{ {held} }}
{more}
"""
HELD = "box = [[-1, -1, -1], [0.061, 1, 1]]"
DRUM_TEXT = f"""
[[obstacle]]
shape = "cylinder"
center = {DRUM.center.tolist()}
axis = {DRUM.axis.tolist()}
radius = {DRUM.radius}
friction = {DRUM.friction}
[contact]
offset = 0.0
[statics]
load_steps = 1
"""


def write(folder, name, mesh, *, rest="rest.obj", young=2 * YOUNG, gravity=-9.81, held=HELD, more=""):
    rest = f'rest = "{rest}"' if rest else ""
    text = SCENE.format(mesh=mesh, rest=rest, young=young, gravity=gravity, held=held, more=more)
    (folder / name).write_text(text)


@pytest.fixture
def hanging(tmp_path):
    """The folder with a hanging sheet observed as it hangs and upside down."""
    of = hanging_sheet(young=YOUNG)
    write_obj(tmp_path / "rest.obj", of.points, of.triangles)
    write_obj(tmp_path / "hangs.obj", simulated(of), of.triangles)
    write_obj(tmp_path / "stands.obj", simulated(hanging_sheet(young=YOUNG, **UPWARDS)), of.triangles)
    write(tmp_path, "second.toml", "stands.obj", gravity=9.81)
    (tmp_path / "statics.toml").write_text(
        (tmp_path / "second.toml").read_text().replace("inverse", "statics")
    )
    return tmp_path


def estimated(folder):
    return json.loads((folder / "out" / "summary.json").read_text())["inverse"]


@pytest.mark.parametrize("ranks", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_known_start_on_an_obstacle_gives_the_modulus(tmp_path, draped, run_on, ranks):  # noqa: F811
    of = sheet()
    write_obj(tmp_path / "start.obj", of.points, of.triangles)
    write_obj(tmp_path / "seen.obj", draped, of.triangles)
    more = DRUM_TEXT + '[inverse]\nestimate = ["young"]\nobserved = "seen.obj"\n'
    nodes = f"nodes = {np.flatnonzero(of.fixed.all(axis=1)).tolist()}"
    write(tmp_path, "scene.toml", "start.obj", rest="start.obj", young=3e7, held=nodes, more=more)
    run_on(ranks, tmp_path / "scene.toml", tmp_path / "out", 200)
    found = estimated(tmp_path)["estimate"]["young"]
    assert found["value"] == pytest.approx(2e7, rel=1e-5) and found["deviation"] < 1e-3 * 2e7


def test_modulus_and_rest_shape_come_from_two_scenes(hanging):
    inverse = '[inverse]\nestimate = ["young"]\nalso = ["second.toml"]\n'
    write(hanging, "scene.toml", "hangs.obj", rest="", more=inverse)
    code, said = run(hanging)
    assert code == 2 and "second.toml: shell.rest" in said
    write(hanging, "second.toml", "stands.obj", rest="", gravity=9.81)
    code, said = run(hanging)
    assert code == 0, said
    found = estimated(hanging)
    assert found["estimate"]["young"]["value"] == pytest.approx(YOUNG, rel=1e-5)
    assert found["observations"] == 2
    rest = read_mesh(hanging / "out" / "rest.obj").points
    np.testing.assert_allclose(rest, hanging_sheet().points, atol=1e-7)


def test_scenes_of_another_fabric_are_told_of(hanging):
    text = (hanging / "second.toml").read_text().replace("density = 300.0", "density = 310.0")
    (hanging / "second.toml").write_text(text.replace(f"young = {2 * YOUNG}", "young = 1e6"))  # a guess
    write(
        hanging, "scene.toml", "hangs.obj", more='[inverse]\nestimate = ["young"]\nalso = ["second.toml"]\n'
    )
    code, said = run(hanging)
    assert code == 0, said
    (note,) = json.loads((hanging / "out" / "summary.json").read_text())["notes"]
    assert note.endswith(
        "second.toml: shell.density = 310.0 there, 300.0 here: another fabric, taken as given"
    )


@pytest.mark.parametrize(
    ("more", "said"),
    [
        ("clamp = true", "fix.0.clamp holds directors as they are in the mesh"),
        ("move = { displacement = [0.0, 0.0, 0.1] }", "fix.0.move leads away from the mesh"),
        (f"{DRUM_TEXT}".replace("[contact]", "[obstacle.move]\ndisplacement = [0.0, 0.0, 0.1]\n[contact]"),
         "obstacle.0.move leads away"),
    ],
)  # fmt: skip
def test_what_needs_the_shape_before_is_refused_without_it(hanging, more, said):
    write(hanging, "scene.toml", "hangs.obj", more=f'{more}\n[inverse]\nestimate = ["young"]\n')
    code, answer = run(hanging)
    assert code == 2 and said in answer and "inverse.observed" in answer


@pytest.mark.parametrize(
    ("rest", "inverse", "said"),
    [
        ("", 'estimate = ["young"]', "needs shell.rest"),
        ("", 'estimate = ["friction"]\nalso = ["second.toml"]', "needs shell.rest; allowed without"),
        ("rest.obj", 'estimate = ["friction"]', "touches nothing without [[obstacle]]"),
        ("rest.obj", 'estimate = ["young", "density"]', "cannot tell young and density apart"),
        ("rest.obj", 'estimate = ["young"]\nalso = ["third.toml"]', "third.toml: no such file"),
        ("rest.obj", 'estimate = ["young"]\nalso = ["statics.toml"]', 'allowed in inverse.also: "inverse"'),
    ],
)
def test_what_the_data_cannot_determine_is_refused(hanging, rest, inverse, said):
    write(hanging, "scene.toml", "hangs.obj", rest=rest, more=f"[inverse]\n{inverse}\n")
    code, answer = run(hanging)
    assert code == 2 and said in answer and answer.count("voile:") == 1


def test_an_estimate_ends_when_its_time_is_over(hanging):
    write(hanging, "scene.toml", "hangs.obj", more='[inverse]\nestimate = ["young"]\n')
    code, said = run(hanging, "--set", "inverse.max_seconds=1e-6")
    assert code == 3 and "estimation: inverse.max_seconds ended it" in said and said.count("voile:") == 1
    assert not json.loads((hanging / "out" / "summary.json").read_text())["converged"]
