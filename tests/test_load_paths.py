"""How totals are shared, where load steps end, and what a run says of its path."""

import re

import numpy as np
import pytest
from mpi4py import MPI

import voile
from voile.cli import main
from voile.mesh import build_topology, read_mesh, shares
from voile.post.quantities import quantity
from voile.problem.problem import Problem
from voile.problem.rest import field_vector
from voile.problem.shell import Shell
from voile.results import read_result, read_summary

LENGTH, WIDTH, YOUNG, THICKNESS = 0.4, 0.1, 1e8, 1e-3
PULLED = f"""
[shell]
mesh = "strip.obj"
model = "membrane"
young = {YOUNG}
thickness = {THICKNESS}
density = 300.0
[loads]
gravity = [0.0, 0.0, 0.0]
[[loads.force]]
select = {{ box = [[0.399, -1, -1], [1, 1, 1]] }}
value = [2.0, 0.0, 0.0]
[[fix]]
select = {{ box = [[-1, -1, -1], [0.001, 1, 1]] }}
axes = "x"
[[fix]]
select = {{ box = [[-1, -1, -1], [0.001, -0.049, 1]] }}
[[fix]]
select = {{ all = true }}
axes = "z"
"""
ARCH = """
[shell]
mesh = "strip.obj"
bending = "average"
young = 1e9
thickness = 1e-3
density = 1e3
[loads]
gravity = [0.0, 0.0, -9.81]
[[fix]]
select = { box = [[-1, -1, -1], [0.001, 1, 1]] }
[[fix]]
select = { box = [[0.399, -1, -1], [1, 1, 1]] }
"""


def write(folder, text: str, nx: int = 8, ny: int = 4, rise: float = 0.0, power: float = 1.0) -> str:
    """A scene of a strip along x, risen as a sine, its columns unevenly wide for power > 1; the scene's path."""
    xs = np.linspace(0.0, LENGTH, nx + 1)
    ys = WIDTH * (np.linspace(0.0, 1.0, ny + 1) ** power - 0.5)
    z = rise * np.sin(np.pi * xs / LENGTH)
    lines = [f"v {x:.17g} {y:.17g} {h:.17g}" for x, h in zip(xs, z, strict=True) for y in ys]
    for i in range(nx):
        for j in range(ny):
            a = i * (ny + 1) + j + 1
            b = a + ny + 1
            lines += [f"f {a} {b} {b + 1}", f"f {a} {b + 1} {a + 1}"]
    (folder / "strip.obj").write_text("\n".join(lines) + "\n")
    (folder / "scene.toml").write_text(text)
    return str(folder / "scene.toml")


def run(folder, scene: str, *sets: str, code: int = 0) -> dict:
    """Runs a scene; its summary."""
    options = [word for each in sets for word in ("--set", each)]
    assert main(["run", scene, "-o", str(folder / "out"), *options]) == code
    return read_summary(folder / "out" / "summary.json")


def test_a_force_on_an_edge_pulls_evenly(tmp_path):
    """Uniform tension, on columns of unequal width: F/w = 20 N/m, strain 2e-4 + second order. Sharing alike strains the
    corners too much."""
    scene = write(
        tmp_path, PULLED.replace("[0.001, 0.001, 1]", "[0.001, 1, 1]").replace("-0.001", "0.0499"), 8, 4, 0, 2
    )
    strains = {}
    for share in ("default", "vertices"):
        run(tmp_path, scene, *([] if share == "default" else ["loads.force.0.share=vertices"]))
        strains[share] = quantity(read_result(tmp_path / "out"), "strain").values
    exact = 2.0 / WIDTH / (YOUNG * THICKNESS)
    np.testing.assert_allclose(
        strains["default"], exact, rtol=5e-4
    )  # Green's strain and a dead force: 3/2 strain
    assert np.ptp(strains["default"]) < 1e-6 * exact
    assert strains["vertices"].max() > 1.2 * exact


def test_shares_of_lines_patches_and_points(tmp_path):
    write(tmp_path, PULLED, 4, 4, power=2.0)
    surface = read_mesh(tmp_path / "strip.obj")
    topology = build_topology(surface.triangles)
    end = np.flatnonzero(surface.points[:, 0] > LENGTH - 1e-9)
    part, by = shares(surface, topology, end, None, "here")
    assert by == "length" and part.sum() == pytest.approx(1.0) and not part[: end[0]].any()
    y = surface.points[end, 1]
    gaps = np.diff(y)
    np.testing.assert_allclose(part[end] * WIDTH, 0.5 * (np.append(0, gaps) + np.append(gaps, 0)), rtol=1e-12)
    part, by = shares(surface, topology, np.arange(25), None, "here")
    assert by == "area" and part @ surface.points[:, 0] == pytest.approx(LENGTH / 2)
    assert part @ surface.points[:, 1] == pytest.approx(0.0, abs=1e-15)
    part, by = shares(surface, topology, np.array([0, 12]), None, "here")
    assert by == "vertices" and part[[0, 12]].tolist() == [0.5, 0.5]
    part, _ = shares(surface, topology, end, "vertices", "here")
    np.testing.assert_allclose(part[end], 0.2)
    border = np.flatnonzero(np.isin(np.arange(25) // 5, [0, 4]) | np.isin(np.arange(25) % 5, [0, 4]))
    part, by = shares(surface, topology, border, None, "here")  # corner triangles are no patch
    assert by == "length" and part[4] * 2 * (LENGTH + WIDTH) == pytest.approx((LENGTH / 4 + gaps[-1]) / 2)


@pytest.mark.parametrize(
    ("sets", "message"),
    [
        (["loads.force.0.share=area"], 'loads.force.0.share = "area": vertex 40 is on no triangle'),
        (["loads.force.0.share=even"], 'allowed: "length", "area", "vertices"'),
        (["statics.load_factors=[0.5, 0.2, 1]"], "load_factors.1: 0.2 is not above the one before"),
        (["statics.load_factors=[0.5]"], "load_factors: ends at 0.5; allowed: the last one 1"),
        (
            ["statics.load_factors=[1]", "statics.load_steps=3"],
            "load_steps: allowed without statics.load_factors",
        ),
        (["statics.load_factors=[0, 1]"], "0 is not allowed"),
    ],
)
def test_bad_values_are_refused(tmp_path, capsys, sets, message):
    scene = write(tmp_path, PULLED)
    options = [word for each in sets for word in ("--set", each)]
    assert main(["run", scene, "-o", str(tmp_path / "out"), *options]) == 2
    assert message in capsys.readouterr().err


def test_load_steps_end_where_they_are_asked_to(tmp_path):
    wanted = [0.01, 0.3, 0.31, 1.0]
    scene = write(tmp_path, PULLED)
    run(tmp_path, scene, f"statics.load_factors={wanted}")
    result = read_result(tmp_path / "out")
    assert result.values.tolist() == wanted
    moved = [(result.points(k) - result.start)[:, 0].max() for k in range(4)]
    np.testing.assert_allclose(moved, np.array(wanted) * moved[-1], rtol=1e-3)


def test_a_snap_under_load_is_told(tmp_path, capsys):
    """A hinged shallow arch, six thicknesses high, snaps through under its own weight."""
    scene = write(tmp_path, ARCH, 24, 2, rise=6e-3)
    summary = run(tmp_path, scene, "statics.nested=false", "statics.load_steps=40")
    assert summary["stable"] and summary["converged"]
    notes = [note for note in summary["notes"] if "snaps or buckles" in note]
    assert len(notes) == 1
    start, end = map(float, re.findall(r"factors (\S+) and (\S+) ", notes[0])[0])
    assert 0.2 < start < end <= 1.0 and f"note: {notes[0]}" in capsys.readouterr().out
    calm = run(tmp_path, scene, "statics.nested=false", "statics.load_steps=40", "loads.gravity=[0,0,9.81]")
    assert not calm["notes"]


def test_a_buckled_strip_that_is_bent_on_does_not_snap(tmp_path):
    """Pushed together by a third of its length, it moves ever less in a step, also where no short step leads on."""
    text = ARCH.replace("average", "tan") + "move = { displacement = [-0.133, 0.0, 0.0] }\n"
    summary = run(tmp_path, write(tmp_path, text, 30, 2), "loads.gravity=[0,0,0]")
    assert summary["stable"] and "descent" in summary["method"] and summary["notes"] == []


def test_an_end_that_is_not_stable_is_told(tmp_path, capsys):
    """A standing strip far above its buckling weight, whose symmetry nothing perturbs."""
    text = (
        ARCH[: ARCH.rindex("[[fix]]")]
        .replace("-9.81]", "0.0]")
        .replace("[0.0, 0.0, 0.0]", "[-9.81, 0.0, 0.0]")
    )
    summary = run(
        tmp_path,
        write(tmp_path, text + "clamp = true\n", 8, 2),
        "statics.perturbation=0",
        "shell.density=3000",
    )
    assert summary["stable"] is False and summary["smallest_eigenvalue"] < 0.0
    (note,) = summary["notes"]
    assert "not stable, its smallest eigenvalue is -" in note and note in capsys.readouterr().out


def test_options_go_between_the_arguments_of_export(tmp_path, capsys):
    run(tmp_path, write(tmp_path, PULLED), "statics.load_factors=[0.5, 1]")
    result, out = str(tmp_path / "out"), tmp_path / "a.obj"
    assert main(["export", result, "--step", "0", str(out)]) == 0
    assert out.is_file()
    assert main(["export", result]) == 2 and "no output; allowed" in capsys.readouterr().err
    named = str(tmp_path / "named.obj")
    assert main(["export", result, "-o", named]) == 0 and capsys.readouterr().out.split() == [named]
    assert main(["export", result, named, "-o", named]) == 2 and " and output " in capsys.readouterr().err
    assert main(["export", result, str(out), "--to", "ply"]) == 2
    assert "allowed: an output that ends in .ply" in capsys.readouterr().err
    assert main(["export", result, "--to", "obj", "-o", named]) == 0 and capsys.readouterr().out.split() == [
        named
    ]


def test_a_run_that_tests_no_stability_says_so(tmp_path, capsys):
    scene, out = write(tmp_path, PULLED + "[statics]\nload_steps = 1\nstability = false\n"), tmp_path / "out"
    assert main(["run", scene, "-o", str(out)]) == 0
    said = "whether the end state is stable was not tested (statics.stability = false)"
    assert f"note: {said}" in capsys.readouterr().out
    assert read_summary(out / "summary.json")["notes"][-1] == said


def cloth(cells: int, length: float) -> tuple[np.ndarray, np.ndarray]:
    """A square in z = 0, its points and triangles."""
    x, y = np.meshgrid(*[np.linspace(0.0, length, cells + 1)] * 2, indexing="ij")
    k = np.arange(x.size).reshape(x.shape)
    a, b, c, d = k[:-1, :-1].ravel(), k[1:, :-1].ravel(), k[1:, 1:].ravel(), k[:-1, 1:].ravel()
    triangles = np.concatenate([np.column_stack([a, b, c]), np.column_stack([a, c, d])])
    return np.column_stack([x.ravel(), y.ravel(), 0 * x.ravel()]), triangles


def gathered(points: np.ndarray, triangles: np.ndarray, near: list[int], far: list[int]) -> dict:
    """Cloth that a band gathers at its free end, under pressure up to there, which has no potential."""
    return {
        "shell": {"mesh": (points, triangles), "young": 2e6, "thickness": 1e-3, "density": 300.0},
        "loads": {"gravity": [0.0, 0.0, -9.81], "pressure": 3.0},
        "fix": [{"select": {"nodes": near}, "clamp": True}],
        "band": [{"select": {"nodes": far}, "stiffness": 50.0, "rest": 0.8}],
    }


def test_what_acts_from_the_start_comes_to_rest_before_loads_without_a_potential():
    points, triangles = cloth(6, 0.5)
    near, far = (np.flatnonzero(points[:, 0] == x).tolist() for x in (0.0, 0.5))
    result = voile.run(voile.load(gathered(points, triangles, near, far)))
    assert result.summary["stable"]
    rim = result.positions[far]
    assert np.linalg.norm(np.diff(rim, axis=0), axis=1).sum() < 0.5 * 0.95


def test_every_method_is_tried_before_load_steps_without_a_potential_get_too_short():
    """A membrane falls from level, where it has no stiffness; pressure tilts it by sin(angle) = p / (rho h g)."""
    points, triangles = cloth(3, 0.5)
    edge = np.flatnonzero(points[:, 0] == 0.0).tolist()
    scene = {
        "shell": {
            **{"mesh": (points, triangles), "model": "membrane"},
            **{"young": 1e8, "thickness": 1e-3, "density": 300.0},
        },
        "loads": {"gravity": [0.0, 0.0, -9.81], "pressure": 0.5},
        "fix": [{"select": {"nodes": edge}}],
    }
    end = voile.run(voile.load(scene)).positions[points[:, 0] == 0.5]
    assert end[:, 2].max() < -0.49
    angle = np.arctan2(end[:, 0], -end[:, 2])
    assert np.abs(np.sin(angle)) == pytest.approx(0.5 / 2.943, rel=1e-5)


def test_the_energy_of_pressure_that_changes_within_free_cloth_does_not_depend_on_numbers():
    points, triangles = cloth(5, 0.4)
    x, y = points[:, 0], points[:, 1]
    bent = points + 0.03 * np.column_stack([np.sin(9 * y), np.cos(7 * x), np.sin(8 * x + 5 * y)])
    random, found = np.random.default_rng(0), []
    one, there = np.ones(len(triangles)), x[triangles].mean(axis=1) < 0.2
    for order, among in (
        (np.arange(len(points)), np.arange(len(one))),
        (random.permutation(len(points)), random.permutation(len(one))),
    ):
        start, now = np.empty_like(points), np.empty_like(points)
        start[order], now[order] = points, bent
        corners = order[np.roll(triangles[among], len(found), axis=1)].astype(np.int32)
        shell = Shell(
            points=start, triangles=corners, model="koiter/tan/stvk", rest_points=start, rest_triangles=corners,
            flat=False, thickness=1e-3 * one, young=1e6 * one, poisson=0.3 * one, density=300.0 * one,
            fixed=np.zeros_like(start, dtype=bool), motion=np.zeros_like(start), gravity=np.zeros(3), pressure=3.0,
            patch_pressure=-5.0 * there[among],
        )  # fmt: skip
        problem = Problem(shell, MPI.COMM_SELF)
        assert not problem.conservative
        at = problem.point(field_vector(problem, (now - start)[problem.part.vertex]))
        found.append(problem.loads.energies(at)["pressure"])
    assert found[0] == pytest.approx(found[1], rel=1e-12)


@pytest.mark.parametrize("order", [1, -1])
def test_moments_turn_their_edge_towards_the_normals(order):
    """By M L^2 / 2 E I for a little one (docs/loads.md)."""
    along, across = np.meshgrid(np.linspace(0.0, 1.0, 11), [0.0, 0.05], indexing="ij")
    points = np.column_stack([along.ravel(), across.ravel(), np.zeros(along.size)])
    cells = [[2 * i + k for k in corner] for i in range(10) for corner in ((0, 2, 3), (0, 3, 1))]
    ends = [{"box": [[x - 1e-6, -1, -1], [x + 1e-6, 1, 1]]} for x in (0.0, 1.0)]
    scene = {
        "shell": {
            "mesh": (points, np.array(cells)[:, ::order]),
            **{"young": 1e8, "poisson": 0.0, "thickness": 1e-2, "density": 1.0},
        },
        "loads": {"gravity": [0, 0, 0], "moment": [{"select": ends[1], "value": 1e-3}]},
        "fix": [{"select": ends[0], "clamp": True}],
    }
    tip = voile.run(voile.load(scene)).positions[-1, 2]
    assert tip == pytest.approx(order * 1e-3 / (2.0 * 1e8 * 0.05 * 1e-6 / 12.0), rel=1e-2)
