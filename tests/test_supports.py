"""The table of what supports exert: force and moment per [[fix]], against the loads that they balance."""

from pathlib import Path

import numpy as np
import pytest

from voile.cli import main
from voile.post.series import Recorded
from voile.results import read_result, read_summary

WIDTH, LENGTH, GRAVITY = 0.1, 0.4, 9.81
SCENE = """
[scene]
task = "statics"
[shell]
mesh = "strip.obj"
young = 1e9
thickness = 1e-3
density = 1000.0
[loads]
gravity = [0.0, 0.0, -9.81]
[[loads.force]]
select = { box = [[0.399, -1, -1], [1, 1, 1]] }
value = [0.01, 0.02, -0.03]
[[fix]]
name = "wall"
select = { box = [[-1, -1, -1], [0.001, 1, 1]] }
clamp = true
"""


def strip(nx: int = 16, ny: int = 4) -> str:
    """OBJ of a strip along x, centred about y = 0."""
    xs, ys = np.linspace(0.0, LENGTH, nx + 1), np.linspace(-WIDTH / 2, WIDTH / 2, ny + 1)
    lines = [f"v {x:.17g} {y:.17g} 0" for x in xs for y in ys]
    for i in range(nx):
        for j in range(ny):
            a = i * (ny + 1) + j + 1
            b = a + ny + 1
            lines += (
                [f"f {a} {b} {b + 1}", f"f {a} {b + 1} {a + 1}"]
                if (i + j) % 2
                else [f"f {a} {b} {a + 1}", f"f {b} {b + 1} {a + 1}"]
            )
    return "\n".join(lines) + "\n"


def run(folder: Path, text: str, *options: str) -> list[dict]:
    """Runs a scene of the strip; its table."""
    (folder / "strip.obj").write_text(strip())
    (folder / "scene.toml").write_text(text)
    assert main(["run", str(folder / "scene.toml"), "-o", str(folder / "out"), *options]) == 0
    return read_summary(folder / "out" / "summary.json")["supports"]


def test_a_path_keeps_the_forces_of_every_step(tmp_path):
    """The strip is drawn out: E h w times the stress of the model's strain, at all load factors; nu = 0."""
    text = (
        SCENE.replace("thickness", "poisson = 0.0\nthickness").partition("[loads]")[0]
        + "[loads]\ngravity = [0, 0, 0]\n"
    )
    text += SCENE[SCENE.index("[[fix]]") :].replace("clamp = true", "")
    text += (
        "[[fix]]\nselect = { box = [[0.399, -1, -1], [1, 1, 1]] }\nmove = { displacement = [0.004, 0, 0] }\n"
    )
    table = run(tmp_path, text + "[statics]\nload_factors = [0.25, 0.5, 1.0]\n")
    with read_result(tmp_path / "out") as result:
        wall, pulled = (Recorded(result, False).series(f"support_{k}")[0] for k in (0, 1))
        last = [result.figures()[f"support_1_{axis}"][-1] for axis in "xyz"]
    stretch = 1.0 + 0.01 * pulled.at
    force = 1e9 * 1e-3 * WIDTH * 0.5 * (stretch**2 - 1.0) * stretch
    assert pulled.unit == "N" and pulled.at.tolist() == [0.25, 0.5, 1.0] and last == table[1]["force"]
    assert np.allclose(pulled.values[:, 0], force, rtol=1e-7)
    assert np.allclose(pulled.values + wall.values, 0.0, atol=1e-6 * force.min())


def loads(folder: Path) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(n, 3) positions at the end, weight and the end force by vertex."""
    result = read_result(folder / "out")
    x, start, t = result.points(-1), result.start, result.triangles
    corner = start[t]
    area = 0.5 * np.linalg.norm(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]), axis=1)
    mass = np.bincount(t.ravel(), np.repeat(area / 3.0, 3), len(x))  # 1 kg/m^2
    weight = mass[:, None] * np.array([0.0, 0.0, -GRAVITY])
    end = start[:, 0] > LENGTH - 1e-3
    share = np.where(end, 1.0, 0.0)
    share[end & (np.abs(start[:, 1]) > WIDTH / 2 - 1e-6)] = 0.5
    return x, weight, share[:, None] / share.sum() * np.array([0.01, 0.02, -0.03])


@pytest.mark.parametrize(
    "model", ["koiter/tan", "koiter/theta", "koiter/average", "discrete-shells", "membrane"]
)
def test_a_clamp_balances_force_and_moment_of_the_loads(tmp_path, model):
    """A cantilever bent by a third of its length; the membrane hangs down. Balance to the tolerance of the run."""
    name, _, bending = model.partition("/")
    text = SCENE if name != "membrane" else SCENE.replace("clamp = true", "")
    options = ["--set", f"shell.model={name}"] + (["--set", f"shell.bending={bending}"] if bending else [])
    (wall,) = run(tmp_path, text, *options)
    x, weight, end = loads(tmp_path)
    total = weight + end
    assert wall["name"] == "wall"
    np.testing.assert_allclose(wall["force"], -total.sum(axis=0), atol=1e-7)
    turned = -np.cross(x - np.array(wall["about"]), total).sum(axis=0)
    assert np.linalg.norm(turned) > (1e-2 if name != "membrane" else 1e-5)
    np.testing.assert_allclose(wall["moment"], turned, atol=2e-8)


def test_supports_share_by_table_and_axis_and_are_printed(tmp_path, capsys):
    """A beam on two supports, of which the second slides; a third table holds what is held already."""
    second = "[[fix]]\nselect = { box = [[0.399, -1, -1], [1, 1, 1]] }\naxes = 'z'\n"
    third = "[[fix]]\nselect = { box = [[-1, -1, -1], [0.001, 0, 1]] }\n"
    text = SCENE.replace("clamp = true\n", second + third).replace("value = [0.01, 0.02", "value = [0.0, 0.0")
    wall, roller, again = run(tmp_path, text)
    assert roller["name"] == "fix 1" and not np.any(again["force"])
    assert roller["force"][:2] == [0.0, 0.0]
    half = 0.5 * GRAVITY * LENGTH * WIDTH
    assert wall["force"][2] == pytest.approx(half, rel=2e-2)  # the roller comes nearer as the beam sags
    assert wall["force"][2] + roller["force"][2] == pytest.approx(2 * half + 0.03, abs=1e-7)
    capsys.readouterr()
    assert main(["info", str(tmp_path / "out")]) == 0
    shown = capsys.readouterr().out
    assert "supports" not in shown.split("wall")[1].split("\n")[0] and "N m about (" in shown


def test_two_ranks_find_the_same_table(tmp_path, run_on):
    one = run(tmp_path, SCENE)
    run_on(2, tmp_path / "scene.toml", tmp_path / "two")
    two = read_summary(tmp_path / "two" / "summary.json")["supports"]
    for mine, other in zip(one, two, strict=True):
        for key in ("force", "moment", "about"):
            np.testing.assert_allclose(mine[key], other[key], atol=1e-7)


def test_contact_carries_its_part(tmp_path):
    """What the table does not carry rests on a plane."""
    floor = "[[obstacle]]\nshape = 'plane'\npoint = [0, 0, -0.02]\nnormal = [0, 0, 1]\n"
    (wall,) = run(tmp_path, SCENE.replace("value = [0.01, 0.02, -0.03]", "value = [0.0, 0.0, 0.0]") + floor)
    contact = read_summary(tmp_path / "out" / "summary.json")["contact"]
    weight = GRAVITY * LENGTH * WIDTH
    assert contact["active"] > 0 and 0.1 * weight < wall["force"][2] < 0.9 * weight
    assert wall["force"][2] + contact["obstacles"][0]["force"][2] == pytest.approx(weight, rel=1e-6)
