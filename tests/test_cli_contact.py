"""Scenes with obstacles from outside: bad input, what is explained and stored, a shell that nothing stops, ranks."""

import time

import h5py
import numpy as np
import pytest
from command_line import voile as program
from mesh_helpers import generator

import voile
from voile.cli import main
from voile.contact.obstacles import Box
from voile.post.contact import surfaces
from voile.results import read_result, read_summary

# A stiff sheet of 0.2 m, its edge x = 0 held, over a cylinder across its middle.
SCENE = """
[shell]
mesh = "sheet.obj"
young = 1e7
thickness = 1e-3
density = 300.0
[loads]
gravity = [0.0, 0.0, -9.81]
[[fix]]
select = { box = [[-0.01, -1, -1], [0.01, 1, 1]] }
[[obstacle]]
shape = "cylinder"
center = [0.12, 0.0, -0.0515]
axis = [0, 1, 0]
radius = 0.05
friction = 0.3
"""
OBSTACLE = SCENE[SCENE.index("[[obstacle]]") :]
BODY = '[[obstacle]]\nshape = "mesh"\nfile = "body.obj"\ntranslate = [0.1, 0.1, -0.11]\n'
CELLS = 8


def obj(points, triangles) -> str:
    lines = ["v {:.17g} {:.17g} {:.17g}".format(*p) for p in points]
    return "\n".join([*lines, *("f {} {} {}".format(*t + 1) for t in triangles)]) + "\n"


@pytest.fixture
def scene(tmp_path):
    """scene(text): writes scene.toml, the sheet and body.obj, a cube of 0.2 m."""
    x, y = (a.ravel() for a in np.meshgrid(*2 * [np.linspace(0.0, 0.2, CELLS + 1)], indexing="ij"))
    first = (np.arange(CELLS)[:, None] * (CELLS + 1) + np.arange(CELLS)).ravel()
    right, both = first + CELLS + 1, first + CELLS + 2
    triangles = np.concatenate([np.column_stack(t) for t in ((first, right, both), (first, both, first + 1))])
    cube = Box(center=np.zeros(3), sizes=np.full(3, 0.1)).surface(np.zeros((2, 3)))

    def write(text: str = SCENE):
        (tmp_path / "sheet.obj").write_text(obj(np.column_stack([x, y, 0 * x]), triangles))
        (tmp_path / "body.obj").write_text(obj(*cube))
        (tmp_path / "scene.toml").write_text(text)
        return tmp_path / "scene.toml"

    write.cube = cube
    return write


def refused(capsys, *words: str) -> None:
    """One line on standard error that holds the words."""
    said = capsys.readouterr().err
    assert said.startswith("voile: ") and said.count("\n") == 1, said
    for word in words:
        assert word in said, said


# ---- bad input ----

# Line in SCENE's obstacle | put in its place | what the message holds.
BAD = """
radius = 0.05 | # | obstacle.0 | the key "radius" is missing; shape = "cylinder" needs
axis = [0, 1, 0] | # | the key "axis" is missing
radius = 0.05 | radius = 0 | obstacle.0.radius: 0 is not allowed; allowed: a finite number > 0 in m
radius = 0.05 | radius = -0.05 | obstacle.0.radius: -0.05 is not allowed
radius = 0.05 | radius = nan | obstacle.0.radius: nan
friction = 0.3 | friction = -0.3 | obstacle.0.friction: -0.3 is not allowed; allowed: a finite number >= 0
friction = 0.3 | friction = inf | obstacle.0.friction: inf
friction = 0.3 | frction = 0.3 | did you mean "friction"
axis = [0, 1, 0] | axis = [0, 0, 0] | obstacle.0.axis
center = [0.12, 0.0, -0.0515] | center = [0.12, 0.0] | obstacle.0.center: [0.12, 0.0] has length 2
"cylinder" | "cylindre" | obstacle.0.shape: 'cylindre' is not allowed | "cylinder"
"cylinder" | "mesh" | obstacle.0
friction = 0.3 | friction = 0.3; tube = 0.1 | obstacle.0.tube: not a key of shape = "cylinder"
friction = 0.3 | friction = 0.3; [contact]; offset = -1e-3 | contact.offset: -0.001 is not allowed
"""


@pytest.mark.parametrize("row", BAD.strip().split("\n"))
def test_bad_obstacles(row, scene, capsys):
    old, new, *words = row.split(" | ")
    assert SCENE.count(old) == 1
    assert main(["explain", str(scene(SCENE.replace(old, new.replace("; ", "\n"))))]) == 2
    refused(capsys, "scene.toml", *words)


def test_a_start_deep_inside_says_how_deep_where_and_what_to_do(scene, capsys):
    path = scene(SCENE.replace("-0.0515]", "-0.02]"))
    assert main(["explain", str(path)]) == 2
    refused(capsys, "scene.toml: obstacle.0: the shell starts 0.02988 m deep inside cylinder 0 at vertex", "(0.125, ",
            "27 vertices deeper than 0.01414 m", "move the obstacle or the shell apart", "obstacle.move")  # fmt: skip


def test_bodies_that_cannot_be_read(scene, tmp_path, capsys):
    path = scene(SCENE.replace(OBSTACLE, BODY))
    points, triangles = scene.cube
    bodies = {
        "": "the mesh file is empty",
        "v 0 0 zero\n": "body.obj, line 1",
        "v 0 0 0\nv 1 0 0\nv 0 1 0\n": "no triangles",
        obj(points * np.nan, triangles): "body.obj",
        obj(points, triangles[:, ::-1]): "inside out",
        obj(points * [1, 1, 0], triangles): "encloses no volume",
    }
    for text, message in bodies.items():
        (tmp_path / "body.obj").write_text(text)
        assert main(["explain", str(path)]) == 2
        refused(capsys, "body.obj", message)
    (tmp_path / "body.obj").unlink()
    assert main(["explain", str(path)]) == 2
    refused(capsys, "body.obj: no such mesh file")


def test_a_resolution_too_fine_for_memory(scene, capsys):
    path = scene(SCENE.replace(OBSTACLE, BODY + "resolution = 1e-4\n"))
    assert main(["explain", str(path)]) == 2
    refused(
        capsys, "body.obj: a resolution of 0.0001 m needs", "nodes; allowed: 3e+07, that is a resolution of"
    )


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("q", [0.0, np.nan, 0.0], "q[1] is not finite"),
        ("mu", [np.nan], "mu[0] is not finite"),
        ("mu", [-0.1], "friction must not be negative"),
        ("mu", [0.1, 0.2], "q has 3 entries, mu 2"),
        ("W/data", [1.0, np.inf, 1.0], "W has entries that are not finite"),
        ("W/indices", [0, 1, 7], "malformed problem"),
        ("W/shape", [6, 6], "entries; "),
    ],
)
def test_friction_problems_that_are_none(name, value, message, tmp_path, capsys):
    parts = {
        "W/data": np.ones(3),
        "W/indices": np.arange(3),
        "W/indptr": np.arange(4),
        "W/shape": np.array([3, 3]),
        "q": np.array([-1.0, 0.0, 0.0]),
        "mu": np.array([0.3]),
    }
    path = tmp_path / "p.h5"
    with h5py.File(path, "w") as file:
        for key, values in (parts | {name: np.array(value)}).items():
            file[key] = values
    assert main(["friction", str(path)]) == 2
    refused(capsys, str(path), message)
    path.write_bytes(b"garbage" * 100)
    assert main(["friction", str(path)]) == 2
    refused(capsys, f"{path}: not an HDF5 file")


# ---- what is explained and stored ----


def test_explain_says_how_exact_obstacles_are_and_how_near(scene, capsys):
    path = scene(SCENE + BODY + "resolution = 0.005\n")
    assert main(["explain", str(path)]) == 0
    lines = capsys.readouterr().out.splitlines()
    about = [line for line in lines if line.startswith("obstacle ")]
    assert "cylinder 0: exact distance; starts 0.00124 m off" in about[0]  # hypot(5, 51.5) - 50.5 mm
    assert "mesh 1: 12 triangles as a smooth distance field: spacing 0.005 m, largest error" in about[1]
    assert "starts 0.00" in about[1]
    assert any("+ contact" in line and "0.0005 m from the mid-surface" in line for line in lines)
    assert main(["explain", str(path), "--set", "contact.offset=0.002"]) == 0
    assert "9 vertices touch it at the start" in capsys.readouterr().out


def test_results_hold_the_obstacles_where_they_are_at_each_step(scene, tmp_path):
    moved = (
        OBSTACLE
        + "move = { displacement = [0.0, 0.0, 0.02], rotation = [0, 0.5, 0], center = [0.12, 0, 0] }\n"
    )
    path = scene(SCENE.replace(OBSTACLE, moved) + "[statics]\nload_steps = 2\n")
    done = program("run", path, "-o", tmp_path / "out")
    assert done.returncode == 0, done.stderr
    with read_result(tmp_path / "out") as result:
        assert [(body.name, body.friction) for body in result.bodies] == [("cylinder 0", 0.3)]
        last = result.n_steps - 1
        start, end = result.bodies[0].points, surfaces(result, last)[0][0]
        touching = result.points()[result.field("contact") > 0]
        reaction = result.field("reaction")
    assert np.allclose(np.hypot(start[:, 0] - 0.12, start[:, 2] + 0.0515), 0.05, atol=1e-12)
    axis = np.array([-np.sin(0.5), -np.cos(0.5)]) * 0.0515 + [0.12, 0.02]  # of the turned and lifted cylinder
    assert np.allclose(np.hypot(end[:, 0] - axis[0], end[:, 2] - axis[1]), 0.05, atol=1e-12)
    assert len(touching) and np.allclose(
        np.hypot(touching[:, 0] - axis[0], touching[:, 2] - axis[1]), 0.0505, atol=1e-9
    )
    total = read_summary(tmp_path / "out" / "summary.json")["contact"]["obstacles"][0]
    assert (
        np.allclose(total["force"], reaction.sum(axis=0), rtol=1e-9, atol=1e-12) and total["force"][2] > 0.0
    )


# ---- nothing in the way ----


def test_an_unsupported_shell_that_meets_nothing_is_said_to_fall_at_once(scene, tmp_path):
    held = SCENE[SCENE.index("[[fix]]") : SCENE.index("[[obstacle]]")]
    plane = '[[obstacle]]\nshape = "plane"\npoint = [0, 0, -100]\nnormal = [0, 0, 1]\n'
    path = scene(SCENE.replace(held, "").replace(OBSTACLE, plane))
    began = time.perf_counter()
    done = program("run", path, "-o", tmp_path / "out")
    assert done.returncode == 3 and done.stderr.count("\n") == 1, done.stderr
    assert "no equilibrium within its own size" in done.stderr and "-1.000) past plane 0" in done.stderr
    assert time.perf_counter() - began < 30.0  # 1.5 s where nothing else runs
    assert not read_summary(tmp_path / "out" / "summary.json")["converged"]


# ---- several ranks ----


@pytest.mark.mpi
def test_two_ranks_find_the_same_contact(scene, tmp_path, run_on):
    path, found = scene(), []
    for ranks in (1, 2):
        out = tmp_path / str(ranks)
        run_on(ranks, path, out)
        summary = read_summary(out / "summary.json")
        assert summary["ranks"] == ranks
        with read_result(out) as result:
            fields = [result.points(), *(result.field(name) for name in ("reaction", "gap", "contact"))]
            found.append((*fields, summary["contact"]["obstacles"][0], surfaces(result, -1)[0]))
    one, two = found
    weight = 300.0 * 1e-3 * 0.2**2 * 9.81
    assert one[3].any() and np.array_equal(one[3], two[3])
    assert np.abs(two[0] - one[0]).max() < 1e-8 * 0.2
    assert np.abs(two[1] - one[1]).max() < 1e-8 * weight
    assert np.abs(two[2] - one[2]).max() < 1e-8 * 0.2
    assert np.allclose(two[4]["force"], one[4]["force"], rtol=0, atol=1e-8 * weight)
    assert np.allclose(two[4]["moment"], one[4]["moment"], rtol=0, atol=1e-8 * weight * 0.2)
    assert two[4]["area"] == pytest.approx(one[4]["area"], rel=1e-12)
    assert all(np.array_equal(a, b) for a, b in zip(one[5], two[5], strict=True))


def test_a_shell_that_starts_inside_a_body_comes_out():
    """A fine cone of stiff cloth, its upper rim 17 mm, 4 % of its size, inside a ball. Steps without friction had to be
    shorter than 1 %: none was possible, and the run ended with exit code 3."""
    points, triangles, *_ = generator("skirt").skirt(0.63, 1.26, 0.27, top=0.0, size=0.0145)
    result = voile.run(
        {
            "shell": {"mesh": (points, triangles), "young": 1e6, "thickness": 3e-3, "density": 300.0},
            "obstacle": [{"shape": "sphere", "center": [0.0, -0.02, 0.0], "radius": 0.12, "friction": 0.3}],
            "contact": {"self_contact": True},
        }
    )
    assert result.summary["stable"] and result.summary["contact"]["max_penetration"] < 1e-10
