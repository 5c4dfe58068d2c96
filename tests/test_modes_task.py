"""task = modes from outside: what is found, stored, drawn and refused; the same on any number of ranks."""

import numpy as np
import pytest
from mesh_helpers import areas
from test_problem import sheet

from voile.cli import main
from voile.results import read_result, read_summary

SCENE = """
[scene]
name = "plate"
task = "modes"
[shell]
mesh = "plate.obj"
young = 1e9
thickness = 0.01
density = 1000.0
[loads]
gravity = [0, 0, 0]
"""
CLAMP = """
[[fix]]
select = { box = [[-1, -1, -1], [1e-6, 2, 1]] }
clamp = true
"""
HEAVY = SCENE.replace("[0, 0, 0]", "[0, 0, -9.81]")
HELD = """
[[fix]]
select = { boundary = 0 }
axes = "z"
[[fix]]
select = { box = [[-1, -1, -1], [2, 0.001, 1]] }
axes = "y"
[[fix]]
select = { nodes = [0] }
axes = "x"
"""
PUSH = """
[[loads.force]]
select = { box = [[-1, 0.999, -1], [2, 2, 1]] }
value = [0, -1.0, 0]
"""
BUCKLING = SCENE + PUSH + "[modes]\nbuckling = true\ncount = 3\n" + HELD
CELLS = 8


@pytest.fixture
def scene(tmp_path):
    points, triangles = sheet(CELLS, CELLS, 1.0, 1.0)
    lines = [
        *("v {:.17g} {:.17g} {:.17g}".format(*p) for p in points),
        *("f {} {} {}".format(*t + 1) for t in triangles),
    ]
    (tmp_path / "plate.obj").write_text("\n".join(lines) + "\n")

    def write(text):
        (tmp_path / "scene.toml").write_text(text)
        return tmp_path / "scene.toml"

    return write


def run(path, *more):
    """Exit code of a run into the folder out beside the scene."""
    return main(["run", str(path), "-o", str(path.parent / "out"), *more])


def test_a_clamped_plate(scene, tmp_path, capsys):
    assert run(scene(SCENE + CLAMP)) == 0
    assert "mode   5" in capsys.readouterr().out
    summary = read_summary(tmp_path / "out" / "summary.json")
    assert (
        summary["task"] == "modes"
        and summary["converged"]
        and summary["stable"]
        and "mass" in summary["modelled"]
    )
    found = summary["modes"]["frequencies"]
    assert len(found) == 6 and (np.diff(found) > 0.0).all()
    # Two factorisations: one to find them, one to count them.
    assert summary["factorisations"] == 2 and 0 < summary["linear_solves"] < 100
    with read_result(tmp_path / "out") as result:
        shapes = [result.field(f"mode_{k:03d}") for k in range(6)]
        assert result.scalars()["frequency_003"] == found[3]
        assert result.describe("mode_003").components == 3
        area = areas(result.start, result.triangles)
        mass = np.bincount(result.triangles.ravel(), np.repeat(area, 3))[:, None]
    for shape in shapes:
        assert abs(np.linalg.norm(shape, axis=1).max() - 1.0) < 1e-12
        assert np.abs(shape[np.abs(result_start(tmp_path)[:, 0]) < 1e-9]).max() == 0.0
    for k, shape in enumerate(shapes):  # orthogonal by the mass
        for other in shapes[:k]:
            assert abs((mass * shape * other).sum()) < 1e-8 * (mass * shape**2).sum()


def result_start(folder):
    with read_result(folder / "out") as result:
        return result.start


def test_a_free_plate_has_six_rigid_modes(scene, tmp_path):
    assert run(scene(SCENE), "--set", "modes.count=8") == 0
    found = read_summary(tmp_path / "out" / "summary.json")["modes"]["frequencies"]
    assert found[:6] == [0.0] * 6 and found[6] > 1.0
    x = result_start(tmp_path)
    x = x - x.mean(axis=0)
    rigid = np.concatenate([np.tile(np.eye(3), (len(x), 1, 1)), np.cross(np.eye(3), x[:, None])], axis=1)
    basis = np.linalg.qr(rigid.transpose(0, 2, 1).reshape(-1, 6))[0]
    with read_result(tmp_path / "out") as result:
        for k in range(6):
            shape = result.field(f"mode_{k:03d}").ravel()
            assert np.linalg.norm(shape - basis @ (basis.T @ shape)) < 1e-6 * np.linalg.norm(shape)


def test_weight_stretches_and_stiffens(scene, tmp_path):
    """About the equilibrium: a plate that hangs down swings faster, one that stands up slower."""
    found = []
    for g in (-50.0, 0.0, 50.0):
        assert run(scene(SCENE.replace("[0, 0, 0]", f"[{g}, 0, 0]") + CLAMP)) == 0
        found.append(read_summary(tmp_path / "out" / "summary.json")["modes"]["frequencies"][0])
    assert found[0] < found[1] < found[2]
    # Rayleigh's quotient is linear in the load
    squares = np.square(found)
    assert abs(squares[0] + squares[2] - 2.0 * squares[1]) < 0.1 * (squares[2] - squares[0])


def test_half_the_load(scene, tmp_path):
    """modes.load_factor: the same as half the load given."""
    squares = []
    for g, factor in ((20.0, "1.0"), (40.0, "0.5")):
        path = scene(SCENE.replace("[0, 0, 0]", f"[{g}, 0, 0]") + CLAMP)
        assert run(path, "--set", f"modes.load_factor={factor}") == 0
        squares.append(read_summary(tmp_path / "out" / "summary.json")["modes"]["frequencies"])
    np.testing.assert_allclose(squares[1], squares[0], rtol=1e-9)


def test_buckling(scene, tmp_path):
    """A little under 4 pi^2 D on so coarse a mesh, about any equilibrium below."""
    assert run(scene(BUCKLING)) == 0
    found = read_summary(tmp_path / "out" / "summary.json")["modes"]["buckling"]
    rigidity = 1e9 * 1e-6 / 12.0 / 0.91
    assert 0.9 < found[0] / (4.0 * np.pi**2 * rigidity) < 1.0
    loaded = BUCKLING.replace("-1.0, 0]", f"{-found[0]:.17g}, 0]")
    assert run(scene(loaded), "--set", "modes.load_factor=0.5") == 0
    again = read_summary(tmp_path / "out" / "summary.json")["modes"]["buckling"]
    np.testing.assert_allclose(np.array(again) * found[0], found, rtol=2e-3)


def test_pulled_plates_do_not_buckle(scene, tmp_path, capsys):
    assert run(scene(BUCKLING.replace("[0, -1.0, 0]", "[0, 0, 1.0]"))) == 3
    assert "nothing buckles" in capsys.readouterr().err
    assert read_summary(tmp_path / "out" / "summary.json")["modes"]["buckling"] == []


def test_pictures_and_films(scene, tmp_path):
    pytest.importorskip("pyvista")
    pytest.importorskip("av")
    assert run(scene(SCENE + CLAMP)) == 0
    out = str(tmp_path / "out")
    assert main(["render", out, "--field", "mode_001"]) == 0
    assert main(["render", out, "-o", str(tmp_path / "still.png")]) == 0
    assert main(["animate", out, "--field", "mode_001", "--fps", "2", "-o", str(tmp_path / "a.gif")]) == 0
    from PIL import Image

    with Image.open(tmp_path / "a.gif") as film:
        assert film.n_frames == 4
    assert main(["animate", out]) == 2  # no path
    assert main(["render", out, "--field", "mode_006"]) == 2
    assert main(["info", out]) == 0 and main(["explain", str(tmp_path / "scene.toml")]) == 0


BALL = """
[[obstacle]]
shape = "sphere"
center = [0.8, 0.5, -0.26]
radius = 0.2
friction = 0.4
"""


def test_obstacles(scene, tmp_path):
    """A plate that its weight lays on a ball rings higher than one that only hangs over it."""
    pytest.importorskip("pyvista")
    found = []
    for text in (SCENE, HEAVY):
        assert run(scene(text.replace("1e9", "1e8") + CLAMP + BALL)) == 0
        summary = read_summary(tmp_path / "out" / "summary.json")
        found.append(summary["modes"]["frequencies"][0])
        assert main(["render", str(tmp_path / "out"), "--field", "mode_000"]) == 0
        with read_result(tmp_path / "out") as result:
            touching = result.field("contact") > 0
            assert touching.sum() == summary["contact"]["active"]
            sticks = result.field("contact") == 1
            assert np.abs(result.field("mode_000")[sticks]).max(initial=0.0) < 1e-4
    assert touching.any() and found[1] > 1.5 * found[0]


def strip_on_a_box(held):
    """A strip of six cells whose last one hangs over the edge of a box, or is held up to there."""
    points, triangles = sheet(6, 1, 0.2, 0.02)
    box = {"shape": "box", "center": [0.08, 0.01, -0.0505], "sizes": [0.09, 0.05, 0.05], "friction": 0.5}
    inside = {"obstacle": [box]} if not held else {"fix": [{"select": {"box": [[-1, -1, -1], [0.17, 1, 1]]}}]}
    return {
        "scene": {"task": "modes"},
        "shell": {"mesh": (points, triangles), "young": 1e8, "thickness": 1e-3, "density": 800.0},
        "loads": {"gravity": [0.0, 0.0, -9.81]},
        "modes": {"count": 6 if held else 8},
        **inside,
    }


def test_springs_that_hold_contacts_have_no_modes():
    """Where contacts hold all but six displacements there are six modes (before: also their springs')."""
    import voile

    resting, held = (voile.run(strip_on_a_box(held)).summary for held in (False, True))
    assert resting["contact"]["stick"] == 12
    assert "only 6 modes of 8" in resting["notes"][0]
    np.testing.assert_allclose(resting["modes"]["frequencies"], held["modes"]["frequencies"], rtol=1e-5)


def test_what_contacts_hold_everywhere_does_not_vibrate():
    import voile

    scene = strip_on_a_box(False)
    scene["obstacle"][0]["sizes"] = [0.5, 0.05, 0.05]
    with pytest.raises(voile.NotConverged, match="contacts hold the shell everywhere"):
        voile.run(scene)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (SCENE + CLAMP + "[modes]\ncount = 300\n", "modes.count = 300; allowed: at most 216"),
        (SCENE + CLAMP + "[modes]\ncount = 0\n", "modes.count: 0 is not allowed"),
        (SCENE + CLAMP + '[inverse]\nmethod = "direct"\n', "inverse: allowed with task"),
        (SCENE + CLAMP + "[modes]\nbuckling = true\n", "modes.buckling = true without a load"),
        (BUCKLING.replace(HELD, ""), "needs supports that hold the shell"),
        (HEAVY, "free to move rigidly"),
        (
            HEAVY + CLAMP + BALL + "[modes]\nload_factor = 0.5\n",
            "modes.load_factor: 0.5; allowed with contact: 1",
        ),
        (HEAVY + "[modes]\nload_factor = 2\n" + CLAMP, "modes.load_factor: 2 is not allowed"),
        (
            BUCKLING + '[[obstacle]]\nshape = "plane"\npoint = [0, 0, -1]\nnormal = [0, 0, 1]\n',
            "obstacle: allowed with",
        ),
        (
            SCENE + CLAMP + "[[loads.moment]]\nselect = { all = true }\nvalue = 1.0\n",
            "loads.moment: has no potential",
        ),
        (SCENE + "pressure = 3.0\n" + CLAMP, "loads.pressure: up to a free boundary"),
    ],
)
def test_bad_scenes(scene, capsys, text, message):
    assert run(scene(text)) == 2
    err = capsys.readouterr().err
    assert message in err and err.count("\n") == 1, err


@pytest.mark.mpi
@pytest.mark.parametrize(
    "text",
    [SCENE + "[modes]\ncount = 9\n", pytest.param(HEAVY + CLAMP, marks=pytest.mark.slow), BUCKLING],
    ids=["free", "heavy", "buckling"],
)
def test_ranks_agree(scene, tmp_path, run_on, rank_counts, text):
    path, found, shapes = scene(text), [], []
    for ranks in rank_counts:
        out = tmp_path / str(ranks)
        run_on(ranks, path, out)
        (values,) = read_summary(out / "summary.json")["modes"].values()
        found.append(np.array(values))
        with read_result(out) as result:
            shapes.append(np.array([result.field(f"mode_{k:03d}") for k in range(len(values))]))
    for other, shape in zip(found[1:], shapes[1:], strict=True):
        np.testing.assert_allclose(other, found[0], rtol=1e-8)
        np.testing.assert_allclose(shape, shapes[0], rtol=0, atol=1e-6)


@pytest.mark.parametrize(("pull", "free"), [(0.5, 1.0), (0.2, 2.0 / 3.0)])
def test_what_slips_vibrates_along_its_way(pull, free):
    """A strip on a plane, held at one end and pulled at the other by a share of its weight, slips where friction (0.3)
    does not hold it, and there is a bar, held at one end: f = sqrt(E / rho) / (4 l)."""
    import voile

    length, width, thickness = 0.4, 0.02, 2e-3
    points, triangles = sheet(60, 2, length, width)
    points[:, 2] = 0.5 * thickness
    force = pull * 1000.0 * thickness * length * width * 9.81
    strip = {
        "scene": {"task": "modes"},
        "shell": {"mesh": (points, triangles), "young": 1e9, "poisson": 0.0, "thickness": thickness}
        | {"density": 1000.0},
        "loads": {
            "gravity": [0.0, 0.0, -9.81],
            "force": [{"select": {"box": [[length - 1e-9, -1, -1], [1, 1, 1]]}, "value": [force, 0.0, 0.0]}],
        },
        "fix": [{"select": {"box": [[-1, -1, -1], [1e-9, 1, 1]]}}],
        "obstacle": [{"shape": "plane", "point": [0.0] * 3, "normal": [0.0, 0.0, 1.0], "friction": 0.3}],
        "modes": {"count": 2},
    }
    result = voile.run(strip)
    exact = np.array([1.0, 3.0]) * np.sqrt(1e9 / 1000.0) / (4.0 * free * length)
    np.testing.assert_allclose(result.summary["modes"]["frequencies"], exact, rtol=0.02)
    states = np.bincount(result.field("contact"), minlength=3)
    contact = result.summary["contact"]
    assert [contact["stick"], contact["slip"]] == list(states[1:]) and contact["slip"]
    assert (contact["stick"] > 0) == (free < 1.0)
