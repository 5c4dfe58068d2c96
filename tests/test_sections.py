"""Section forces across cuts: exactly what balances the loads beyond, and closed forms."""

import numpy as np
import pytest
from test_cli import SCENE, cells
from test_python import sheet

import voile
from voile.cli import main
from voile.errors import InputError

LENGTH, WIDTH, THICKNESS, YOUNG, DENSITY = 0.1, 0.1, 1e-3, 1e7, 300.0
TIP = np.array([0.002, -0.001, -0.003])


def cantilever(**more) -> dict:
    points, triangles = sheet(8, LENGTH)
    end = np.flatnonzero(points[:, 0] > LENGTH - 1e-9).tolist()
    return {
        "shell": {"mesh": (points, triangles), "young": YOUNG, "thickness": THICKNESS, "density": DENSITY},
        "loads": {"gravity": [0, 0, 0], "force": [{"select": {"nodes": end}, "value": TIP.tolist()}]},
        "fix": [{"select": {"box": [[-0.001, -1, -1], [0.001, 1, 1]]}, "clamp": True}],
        "section": [
            {"name": "outer", "point": [0.04, 0, 0], "normal": [1, 0, 0], "about": [0.04, 0.05, 0.0]},
            {"name": "inner", "point": [0.04, 0, 0], "normal": [-1, 0, 0], "about": [0.04, 0.05, 0.0]},
            {"name": "tip", "select": {"nodes": end}},
        ],
        "statics": {"tolerance": 1e-10},
        **more,
    }


@pytest.mark.parametrize("model", ["tan", "average"])
def test_a_cantilever_carries_its_end_force_and_moment(model):
    """From both sides of the cut, the clamped one too; the arms are those of the bent strip."""
    scene = cantilever()
    scene["shell"]["bending"] = model
    result = voile.run(scene)
    outer, inner, tip = result.summary["sections"]
    end = result.positions[result.start[:, 0] > LENGTH - 1e-9]
    weights = np.full(len(end), 1.0)
    weights[[0, -1]] = 0.5
    arm = (weights / weights.sum()) @ end - outer["about"]
    assert abs(arm[2]) > 0.05 * LENGTH
    for found, sign in ((outer, -1.0), (inner, 1.0)):
        assert np.allclose(found["force"], sign * TIP, rtol=0.0, atol=1e-8 * np.linalg.norm(TIP))
        spread = np.cross(end - outer["about"], np.outer(weights / weights.sum(), TIP)).sum(axis=0)
        assert np.allclose(found["moment"], sign * spread, rtol=0.0, atol=1e-7 * np.linalg.norm(TIP) * LENGTH)
    assert np.allclose(tip["force"], -TIP, rtol=0.0, atol=1e-8 * np.linalg.norm(TIP))
    assert np.allclose(tip["about"], end.mean(axis=0))


def test_a_cut_through_vertices_carries_the_weight_beyond_it():
    """The stiff strip's own weight beyond each column of vertices, the wall among them, and its moment."""
    at = LENGTH * np.array([0.0, 0.5, 0.875])
    scene = cantilever(
        loads={"gravity": [0, 0, -9.81]},
        section=[{"point": [x, 0, 0], "normal": [2, 0, 0], "about": [x, WIDTH / 2, 0]} for x in at],
    )
    scene["shell"]["young"] = 1e12
    for x, found in zip(at, voile.run(scene).summary["sections"], strict=True):
        weight = DENSITY * THICKNESS * WIDTH * (LENGTH - x) * 9.81
        assert np.allclose(found["force"], [0, 0, weight], rtol=0.0, atol=1e-8 * weight)
        cell = LENGTH / 8  # vertices carry the weight: cell^2/4 more of (L - x)^2/2 at their arms
        assert abs(found["moment"][1]) == pytest.approx(
            weight * (LENGTH - x) / 2, rel=(cell / (LENGTH - x)) ** 2
        )


def test_a_cylinder_under_pressure_carries_p_r_round_itself():
    """Half of it, its rims guided: p times its projection, through two lines; 64 facets."""
    radius, length, pressure, around = 0.1, 0.2, 500.0, 64
    places, triangles = _tube(around, 8)
    angle = 2.0 * np.pi * places[:, 0]
    points = np.column_stack([radius * np.cos(angle), radius * np.sin(angle), length * places[:, 1]])
    rims = np.flatnonzero((places[:, 1] == 0.0) | (places[:, 1] == 1.0)).tolist()
    scene = {
        "shell": {"mesh": (points, triangles), "young": 1e9, "poisson": 0.0, "thickness": THICKNESS, "density": 1.0},
        "loads": {"gravity": [0, 0, 0], "pressure": pressure},
        "fix": [
            {"select": {"nodes": rims}, "axes": "z"},
            {"select": {"nodes": [0, around // 2]}, "axes": "y"},
            {"select": {"nodes": [around // 4]}, "axes": "x"},
        ],
        "section": [{"point": [0, 1e-6, 0], "normal": [0, 1, 0]}],
    }  # fmt: skip
    (half,) = voile.run(scene).summary["sections"]
    assert abs(half["force"][1]) == pytest.approx(2.0 * pressure * radius * length, rel=3e-3)
    assert np.allclose(np.delete(half["force"], 1), 0.0, atol=1e-3 * abs(half["force"][1]))


def test_forces_cross_seams_and_ranks(tmp_path, run_on):
    """A strip sewn of two pieces: the cut at the seam carries the weight below it."""
    lines, n = [], 5
    for top in (0.0, -0.1):
        lines += [f"v {0.1 * i / (n - 1)} 0 {top - 0.1 * j / (n - 1)}" for j in range(n) for i in range(n)]
    for side in (0, 1):
        base = 1 + side * n * n
        lines.append(f"g piece{side}")
        for j in range(n - 1):
            for i in range(n - 1):
                a = base + j * n + i
                lines += [f"f {a} {a + n} {a + 1}", f"f {a + 1} {a + n} {a + n + 1}"]
    lines += [f"stitch {n * n + i} {n * (n - 1) + i} {n * (n - 1) + i} 0" for i in range(n)]
    (tmp_path / "two.obj").write_text("\n".join(lines) + "\n")
    text = "[scene]\ntask = 'statics'\n[shell]\nmesh = 'two.obj'\nyoung = 1e6\nthickness = 1e-3\ndensity = 1000.0\n"
    text += "[loads]\ngravity = [0, 0, -9.81]\n[[fix]]\nselect = { box = [[-1, -1, -1e-6], [1, 1, 1]] }\nclamp = true\n"
    text += "[[section]]\nname = 'lower'\nselect = { group = 'piece1' }\n"
    (tmp_path / "scene.toml").write_text(text)
    for ranks in (1, 2):
        run_on(ranks, tmp_path / "scene.toml", tmp_path / str(ranks))
        result = voile.read(tmp_path / str(ranks))
        (lower,), (stored,) = result.summary["sections"], result.sections()
        for part in ("force", "moment", "about"):
            assert np.allclose(stored[part], lower[part], rtol=0.0, atol=1e-9 * np.linalg.norm(lower[part]))
        cell = 0.1 / (n - 1)
        below = 1000.0 * 1e-3 * 9.81 * 0.1 * (0.1 + cell / 2)  # a vertex carries half a cell on both sides
        assert np.allclose(lower["force"], [0, 0, below], atol=1e-6 * below)


@pytest.mark.parametrize("model", ["tan", "average"])
def test_stored_steps_tell_what_crosses_any_cut(model):
    """Of load steps, what the load factor says; of what a turning clamp and a plane move, what the run told."""
    scene = cantilever(statics={"tolerance": 1e-10, "load_steps": 3})
    scene["shell"]["bending"] = model
    result = voile.run(scene)
    for step, factor in enumerate(result.times):
        found = result.section(step, point=[0.06, 0, 0], normal=[1, 0, 0])
        assert np.allclose(found["force"], -factor * TIP, rtol=0.0, atol=1e-8 * np.linalg.norm(TIP))
    plane = {"shape": "plane", "point": [0, 0, -0.005], "normal": [0, 0, 1], "friction": 0.3}
    scene |= {
        "scene": {"task": "dynamics"},
        "dynamics": {"time_step": 4e-3, "duration": 0.04},
        "obstacle": [plane],
    }
    scene["loads"], scene["statics"] = {"gravity": [0, 0, -9.81]}, {}
    scene["fix"][0]["move"] = {"rotation": [0, 0.5, 0], "center": [0, 0, 0]}
    scene["section"].append({"point": [0.05, 0, 0], "normal": [1, 0, 0]})
    result = voile.run(scene)
    assert (result.field("contact") > 0).any()
    for told, stored in zip(result.summary["sections"], result.sections(), strict=True):
        force = np.linalg.norm(told["force"])
        for part, size in (("force", force), ("moment", force * LENGTH), ("about", LENGTH)):
            assert np.allclose(stored[part], told[part], rtol=0.0, atol=1e-9 * size)


@pytest.mark.parametrize("scale", [1.0, 0.1])
def test_a_run_with_arrays_is_asked_later(tmp_path, capsys, scale):
    """The result has its shell."""
    scene = cantilever()
    points, triangles = (np.array(a) for a in scene["shell"]["mesh"])
    scene["shell"] |= {
        "mesh": (points / scale, triangles),
        "rest": (points / scale, triangles),
        "scale": scale,
    }
    run = voile.run(scene, tmp_path / "result")
    with run:
        told, stress = run.section(point=[0.06, 0, 0], normal=[1, 0, 0]), run.field("von_mises")
    with voile.read(tmp_path / "result") as result:
        found = result.section(point=[0.06, 0, 0], normal=[1, 0, 0])
        assert np.allclose(found["force"], told["force"], rtol=1e-9)
        assert np.allclose(result.field("von_mises"), stress, rtol=1e-9)
    assert main(["section", str(tmp_path / "result"), "point=[0.06,0,0]", "normal=[1,0,0]"]) == 0
    assert "section 0: force (" in capsys.readouterr().out


def test_the_command_tells_sections_wherever_the_scene_is(tmp_path, capsys):
    """Beside its run; moved; changed since; and refused with a message where it is not to be had."""
    old, new, table = tmp_path / "old", tmp_path / "new", tmp_path / "table.csv"
    old.mkdir()
    (old / "mesh.obj").write_text(cells())
    (old / "scene.toml").write_text(SCENE)
    assert main(["run", str(old / "scene.toml"), "-o", str(tmp_path / "result")]) == 0
    cut = ["section", str(tmp_path / "result"), "point=[0.05,0,0]", "normal=[1,0,0]"]
    assert main([*cut, "-o", str(table)]) == 0
    rows = np.genfromtxt(table, delimiter=",", names=True)
    weight = 300.0 * 1e-3 * 9.81 * 0.1 * 0.05
    assert np.allclose(rows["force_z"], weight * rows["value"], rtol=1e-5) and rows["value"][-1] == 1.0
    old.rename(new)
    capsys.readouterr()
    for words, told in (
        ([], "mesh.obj: no such mesh file"),
        (["--scene", str(new / "scene.toml"), "--step", "99"], "no step 99; allowed: 0 to"),
        (["--scene", str(new / "scene.toml"), "name"], "name: allowed: key=value, such as 'point=[0,0,1]'"),
        (["point=[0,0"], "point=[0,0: the value is not TOML"),
    ):
        assert main([*cut, *words]) == 2
        error = capsys.readouterr().err
        assert told in error and "--set" not in error
    assert main([*cut, "--scene", str(new / "scene.toml"), "--step", "-1"]) == 0
    assert "1: section 0: force (" in capsys.readouterr().out
    (new / "mesh.obj").write_text(cells(size=0.2))
    assert main([*cut, "--scene", str(new / "scene.toml")]) == 2
    assert "is not that of the run" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("section", "message"),
    [
        ({}, "select, or point and normal"),
        ({"point": [0, 0, 0]}, "select, or point and normal"),
        ({"select": {"all": True}, "point": [0, 0, 0], "normal": [1, 0, 0]}, "select, or point and normal"),
        ({"select": {"all": True}}, "some, not all"),
        ({"point": [5, 0, 0], "normal": [1, 0, 0]}, "has 0 of 81"),
    ],
)
def test_sections_that_cut_nothing(section, message):
    with pytest.raises(InputError, match=message):
        voile.run(cantilever(section=[section]))


def _tube(around: int, along: int) -> tuple[np.ndarray, np.ndarray]:
    """Places (turn, height) in 0 to 1 and triangles of a tube."""
    places = np.array([(i / around, j / along) for j in range(along + 1) for i in range(around)])
    triangles = []
    for j in range(along):
        for i in range(around):
            a, b = j * around + i, j * around + (i + 1) % around
            triangles += [(a, b, b + around), (a, b + around, a + around)]
    return places, np.array(triangles)
