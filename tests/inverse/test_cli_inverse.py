"""task = inverse through the command line: files, figures, ranks, and what is refused."""

import json
import signal
import subprocess
import sys

import numpy as np
import pytest
from command_line import voile
from inverse_shells import folded_skirt, grid
from test_direct import sheet_with_flap, tube
from test_panels import cone_skirt

from voile import read as voile_result
from voile.cli import main
from voile.inverse import solve
from voile.mesh import Stitches, read_mesh, write_obj
from voile.results import read_pattern, read_result
from voile.solver.fronts import Fronts
from voile.solver.linear import LinearSolver

ROD = """
[[obstacle]]
shape = "cylinder"
center = [0.0, 0.0, 0.0]
axis = [0.0, 0.0, 1.0]
radius = 0.0995
friction = {friction}
"""
SCENE = """
[scene]
name = "{name}"
task = "inverse"
[shell]
mesh = "target.obj"
bending = "{bending}"
young = {young}
thickness = 1.0e-3
density = 300.0
[loads]
gravity = [0.0, 0.0, -9.81]
{held}
[inverse]
{inverse}
"""


def scene(folder, held, *, bending="tan", young=1e7, inverse="", name="test"):
    text = SCENE.format(held=held, bending=bending, young=young, inverse=inverse, name=name)
    (folder / "scene.toml").write_text(text)


def command(*options):
    return [sys.executable, "-m", "voile.cli", "run", "scene.toml", "-o", "out", *options]


def run(folder, *options):
    done = voile(*command(*options)[3:], cwd=folder)
    return done.returncode, done.stdout + done.stderr


@pytest.fixture
def on_a_rod(tmp_path):
    """A tube held by friction, as a scene in a folder."""
    write_obj(tmp_path / "target.obj", *tube())
    scene(tmp_path, ROD.format(friction=0.5))
    return tmp_path


def test_every_factorisation_of_the_search_and_its_proofs_is_counted(on_a_rod, monkeypatch, capsys):
    made = []

    def counted(factor):
        return lambda *words: made.append(1) or factor(*words)

    for kind in (Fronts, LinearSolver):
        monkeypatch.setattr(kind, "factor", counted(kind.factor))
    monkeypatch.chdir(on_a_rod)
    assert main(["run", "scene.toml", "-o", "out"]) == 0, capsys.readouterr()
    summary = json.loads((on_a_rod / "out" / "summary.json").read_text())
    assert summary["factorisations"] == len(made) > 5
    assert summary["newton_iterations"] > 3 and summary["linear_solves"] > 3


def test_friction_holds_the_target_and_the_rest_shape_drapes_again(on_a_rod):
    assert "Newton in the rest shape" in voile("explain", "scene.toml", cwd=on_a_rod).stdout
    code, said = run(on_a_rod)
    assert code == 0, said
    summary = json.loads((on_a_rod / "out" / "summary.json").read_text())
    found = summary["inverse"]
    assert summary["converged"] and summary["stable"] and summary["task"] == "inverse"
    assert found["sag"] < 1e-8 and found["sag_disturbed"] < 1e-6
    assert found["reactions"]["least_margin"] > 0.0 and found["reactions"]["least_friction"] < 0.5
    target = read_mesh(on_a_rod / "target.obj").points
    rest = read_mesh(on_a_rod / "out" / "rest.obj").points
    with read_result(on_a_rod / "out") as result:
        np.testing.assert_array_equal(result.points(0), target)
        np.testing.assert_allclose(result.rest, rest, atol=1e-15)
        reaction, normal, friction, margin = (
            result.field(name, 0) for name in ("reaction", "normal_reaction", "friction", "margin")
        )
        weight = reaction[:, 2].sum()
    bears = np.linalg.norm(normal, axis=1) > 0.0
    assert (friction == 0.5 * bears).all() and (margin[~bears] == 1.0).all()
    tangential, size = np.linalg.norm(reaction - normal, axis=1), np.linalg.norm(normal, axis=1)
    np.testing.assert_allclose(margin[bears], 1.0 - (tangential / (0.5 * size))[bears], atol=1e-9)
    axis = normal[bears] / size[bears, None]  # radial
    np.testing.assert_allclose(np.cross(axis, target[bears] * [1.0, 1.0, 0.0]), 0.0, atol=1e-9)
    assert margin.min() == pytest.approx(found["reactions"]["least_margin"], rel=1e-12)
    assert weight == pytest.approx(found["reactions"]["force"][2], rel=1e-12)
    # the program's own statics with the rest shape found stays at the target
    (on_a_rod / "scene.toml").write_text(
        (on_a_rod / "scene.toml")
        .read_text()
        .replace('task = "inverse"', "")
        .replace('"target.obj"', '"target.obj"\nrest = "out/rest.obj"')
        .replace("[inverse]", "[statics]\nload_steps = 1")
    )
    done = voile("run", "scene.toml", "-o", "again", cwd=on_a_rod)
    assert done.returncode == 0, done.stderr
    with read_result(on_a_rod / "again") as again:
        assert np.abs(again.points(-1) - target).max() < 2e-3  # it closes the gap of half a millimetre


def test_a_soft_skirt_on_a_rod_ends_in_the_nearest_stable_shape(tmp_path):
    """Friction included: simulations from that shape, from the target and from beside it end there."""
    shape = folded_skirt(24, 4)
    write_obj(tmp_path / "target.obj", shape.points, shape.triangles)
    held = ROD.format(friction=0.9).replace("0.0995", "0.1495")
    scene(tmp_path, held, bending="average", young=2e7)
    code, said = run(tmp_path)
    assert code == 0, said
    found = json.loads((tmp_path / "out" / "summary.json").read_text())["inverse"]
    assert found["nearest"]["sag"] < 2e-3 and found["nearest"]["moved"] < 1e-10
    assert found["sag"] == pytest.approx(found["nearest"]["sag"], rel=1e-6)
    assert found["sag_disturbed"] == pytest.approx(found["nearest"]["sag"], rel=1e-6)
    assert "nearest stable answer found" in said and "leaves it" not in said
    with read_result(tmp_path / "out") as result:
        assert list(result.values) == [0.0, 0.5, 1.0]
        area = 0.5 * np.linalg.norm(
            np.cross(*np.diff(result.rest[result.rest_triangles], axis=1).swapaxes(0, 1)), axis=1
        )
        weight = 9.81 * 300.0 * 1e-3 * area.sum()
        for step in (1, 2):
            reaction = result.field("reaction", step).sum(axis=0)
            np.testing.assert_allclose(reaction, [0.0, 0.0, weight], atol=1e-7 * weight)
        moved = np.linalg.norm(result.points(1) - result.points(0), axis=1).max()
        assert moved == pytest.approx(
            found["nearest"]["sag"] * np.linalg.norm(np.ptp(result.start, axis=0)), rel=1e-6
        )


def test_a_rest_shape_is_kept_before_it_is_proved(on_a_rod, monkeypatch):
    def stopped(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr(solve, "simulate", stopped)
    assert main(["run", str(on_a_rod / "scene.toml"), "-o", str(on_a_rod / "out")]) == 3
    rest, target = (read_mesh(on_a_rod / name).points for name in ("out/rest.obj", "target.obj"))
    assert 1e-6 < np.abs(rest - target).max() < 1e-3
    assert (on_a_rod / "out" / "pattern.dxf").stat().st_size > 1000


def test_ranks_find_the_same_rest_shape(on_a_rod, run_on, rank_counts):
    assert run(on_a_rod)[0] == 0
    one = read_mesh(on_a_rod / "out" / "rest.obj").points
    for ranks in rank_counts[1:]:
        run_on(ranks, on_a_rod / "scene.toml", on_a_rod / "out", 200)
        np.testing.assert_allclose(read_mesh(on_a_rod / "out" / "rest.obj").points, one, atol=1e-9)


def test_a_target_that_no_friction_holds_is_refused_with_the_least_that_would_do(on_a_rod):
    scene(on_a_rod, ROD.format(friction=0.0))
    code, said = run(on_a_rod)
    assert code == 3 and "no reactions in the cones" in said and said.count("voile:") == 1
    summary = json.loads((on_a_rod / "out" / "summary.json").read_text())
    assert not summary["converged"] and summary["reason"] in said and "the least friction" in said


def test_what_round_off_leaves_of_stiff_cloth_is_told_and_asked_for(on_a_rod):
    """Loads on E = 1e13 Pa strain less than the last places of the positions can tell."""
    scene(on_a_rod, ROD.format(friction=0.5), young=1e13)
    code, said = run(on_a_rod)
    assert code == 0, said
    summary = json.loads((on_a_rod / "out" / "summary.json").read_text())
    (note,) = [note for note in summary["notes"] if "double precision" in note]
    assert "inverse.tolerance" in note
    assert summary["residual_norm"] <= summary["residual_tolerance"] and summary["inverse"]["sag"] < 1e-12


def test_a_target_deep_inside_its_obstacle_is_refused(on_a_rod):
    scene(on_a_rod, ROD.format(friction=0.5).replace("0.0995", "0.11"))
    code, said = run(on_a_rod)
    assert code == 2 and "m deep inside" in said and "vertex" in said


def test_a_target_that_sinks_a_little_is_solved_and_told_of(on_a_rod):
    scene(on_a_rod, ROD.format(friction=0.5).replace("0.0995", "0.1012"))
    code, said = run(on_a_rod)
    assert code == 0, said
    summary = json.loads((on_a_rod / "out" / "summary.json").read_text())
    (note,) = [note for note in summary["notes"] if "inside cylinder 0" in note]
    assert any("off what it touches: simulations here keep the gaps" in note for note in summary["notes"])
    assert "the target is up to 0.0017 m" in note and "vertex" in note
    assert summary["inverse"]["sag"] < 1e-8
    text = (on_a_rod / "scene.toml").read_text()
    text = text.replace('task = "inverse"', 'task = "statics"').replace(
        "[inverse]", "[statics]\nload_steps = 1"
    )
    (on_a_rod / "scene.toml").write_text(text.replace("[shell]", '[shell]\nrest = "found/rest.obj"'))
    (on_a_rod / "out").rename(on_a_rod / "found")
    code, said = run(on_a_rod)
    assert code == 0, said
    closed = voile_result(str(on_a_rod / "out"))
    moved = np.linalg.norm(closed.positions - closed.start, axis=1).max()
    sag = moved / np.linalg.norm(np.ptp(closed.start, axis=0))
    assert summary["inverse"]["sag_closed"] == pytest.approx(sag, rel=1e-6) and sag > 1e-4
    assert "a scene of statics closes gaps and ends" in summary["reason"]


def test_estimating_with_an_unknown_rest_shape_is_refused(on_a_rod):
    scene(on_a_rod, "[[fix]]\nselect = { all = true }", inverse='estimate = ["young"]')
    code, said = run(on_a_rod)
    assert code == 2 and "needs shell.rest" in said


@pytest.mark.parametrize("ranks", [1, 2])
def test_flaps_that_turn_freely_are_left_out_and_told_of(tmp_path, run_on, ranks):
    points, triangles, fixed, _ = sheet_with_flap(2)
    write_obj(tmp_path / "target.obj", points, triangles)
    held = f"[[fix]]\nselect = {{ nodes = {np.flatnonzero(fixed[:, 0]).tolist()} }}"
    scene(tmp_path, held, bending="average", young=1e10)
    run_on(ranks, tmp_path / "scene.toml", tmp_path / "out")
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert summary["converged"] and any("hang by one or two vertices" in note for note in summary["notes"])
    n = len(points) - 2
    with read_result(tmp_path / "out") as result:
        np.testing.assert_allclose(result.rest[n:], points[n:], atol=1e-6)
        assert np.isfinite(result.rest).all()


def test_soft_cloth_is_told_unstable_and_its_last_stable_rest_shape_is_kept(tmp_path):
    """A standing strip buckles under its own weight; the direct method ends there with the mode in the results."""
    points, triangles = grid(20, 2, 0.3, 0.03)
    write_obj(tmp_path / "target.obj", points, triangles)
    held = "[[fix]]\nselect = { box = [[-1, -1, -1], [0.016, 1, 1]] }\nclamp = true"
    scene(tmp_path, held, young=2e7, inverse='method = "direct"')
    text = (tmp_path / "scene.toml").read_text().replace("[0.0, 0.0, -9.81]", "[-9.81, 0.0, 0.0]")
    (tmp_path / "scene.toml").write_text(text)
    code, said = run(tmp_path)
    assert code == 3 and "stability is lost" in said
    found = json.loads((tmp_path / "out" / "summary.json").read_text())["inverse"]
    assert 0.0 < found["load_fraction"] <= found["critical_fraction"] < 1.0
    with read_result(tmp_path / "out") as result:
        mode = result.field("mode", 0)
    assert np.abs(mode).max() == pytest.approx(1.0) and np.abs(mode[:, 2]).max() > 0.9
    assert (tmp_path / "out" / "rest.obj").is_file()


def hanging_cone(folder, **more):
    """A cone skirt pinned at its waist, as a scene; its height (m)."""
    shape, _ = cone_skirt(young=1e7)
    write_obj(folder / "target.obj", shape.points, shape.triangles)
    scene(folder, "[[fix]]\nselect = { box = [[-1, -1, -0.03], [1, 1, 1]] }", **more)
    return float(np.ptp(shape.points[:, 2]))


def draped_from_pattern(folder) -> np.ndarray:
    """(n, 3) m where rest.obj comes to rest with its texture coordinates as rest shape."""
    text = (folder / "scene.toml").read_text().split("[inverse]")[0]
    text = text.replace('task = "inverse"', "").replace('"target.obj"', '"out/rest.obj"\nrest = "flat"')
    (folder / "scene.toml").write_text(text)
    done = voile("run", "scene.toml", "-o", "again", cwd=folder)
    assert done.returncode == 0, done.stderr
    with read_result(folder / "again") as draped:
        return draped.points(-1)


def test_panels_are_cut_sewn_and_draped_again(tmp_path):
    height = hanging_cone(tmp_path, inverse='developable = "panels"\nseam_allowance = 0.01\niterations = 6')
    code, said = run(tmp_path)
    assert code == 0, said
    out = tmp_path / "out"
    found = json.loads((out / "summary.json").read_text())["inverse"]
    assert found["pattern"]["seam_mismatch"] < found["pattern"]["seam_tolerance"]
    assert {"pattern.svg", "pattern.dxf", "pattern.png", "rest.obj"} <= {path.name for path in out.iterdir()}
    sewn = read_mesh(out / "rest.obj")
    assert sewn.stitches is not None and sewn.texture is not None
    assert np.linalg.norm(draped_from_pattern(tmp_path) - sewn.points, axis=1).max() < 0.01 * height


def test_panels_whose_seams_bend_hang_nearer_to_the_target(tmp_path, run_on):
    """Than with free seams, and so does their pattern, sewn and draped again, on one rank and on two."""
    height, sags = hanging_cone(tmp_path, inverse='developable = "panels"\niterations = 8'), []
    for bends in ("false", "true"):
        code, said = run(tmp_path, "--set", f"shell.seam_bending={bends}", "--set", "shell.young=3e6")
        assert code == 0, said
        summary = json.loads((tmp_path / "out" / "summary.json").read_text())
        sags.append(summary["inverse"]["sag"])
        assert any("shell.seam_bending = false" in note for note in summary["notes"]) == (bends == "false")
    assert sags[0] > 1e-2 and sags[1] < 1e-4
    text = (tmp_path / "scene.toml").read_text()
    (tmp_path / "scene.toml").write_text(
        text.replace("young = 10000000.0", "young = 3e6").replace("[shell]", "[shell]\nseam_bending = true")
    )
    draped = draped_from_pattern(tmp_path)
    sewn = read_mesh(tmp_path / "out" / "rest.obj").points
    assert np.linalg.norm(draped - sewn, axis=1).max() < 2e-3 * height
    run_on(2, tmp_path / "scene.toml", tmp_path / "out")
    with read_result(tmp_path / "out") as result:
        np.testing.assert_allclose(result.points(-1), draped, atol=1e-10)


@pytest.mark.parametrize("number", [pytest.param(signal.SIGTERM, marks=pytest.mark.slow), signal.SIGINT])
def test_a_run_that_is_told_to_end_keeps_what_it_has(tmp_path, number):
    hanging_cone(tmp_path, young=3e6, inverse='developable = "panels"\niterations = 500')
    running = subprocess.Popen(
        command(), cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, bufsize=1
    )
    for line in running.stdout:
        if line.startswith("adjoint"):
            break
    running.send_signal(number)
    _, said = running.communicate(timeout=60)
    assert running.returncode == 3 and "stopped by a signal; what was computed is kept" in said
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert summary["converged"] is False and summary["reason"] == "stopped by a signal"
    assert (tmp_path / "out" / "rest.obj").is_file()


def test_given_seams_and_a_dart_make_the_panels(tmp_path):
    """A cone skirt of 24 by 8 cells cut along two rulings, a dart halfway up between them."""
    hanging_cone(tmp_path, inverse="seams = [[0, 192], [12, 204], [198, 102]]")
    code, said = run(tmp_path)
    assert code == 0, said
    panels, cut = json.loads((tmp_path / "out" / "summary.json").read_text())["inverse"]["pattern"], []
    assert len(panels["panels"]) == 2 and panels["distortion"] < 0.01
    pattern = read_pattern(tmp_path / "out")
    for seam in pattern.seams:
        length, pieces = seam.lengths[0], set(seam.pieces)
        cut.append((len(pieces), round(length / 0.2163, 2)))  # over the slant height
    assert sorted(cut) == [(1, 0.5), (2, 1.0), (2, 1.0)]
    assert (tmp_path / "out" / "pattern.png").is_file()


@pytest.mark.parametrize(
    "seams, said",
    [
        ("[[0, 999]]", "inverse.seams.0: vertex 999, allowed: 0 to 215"),
        ("[[0, 192], [5, 5]]", "inverse.seams.1: no way over inner edges leads from vertex 5 to 5"),
        ("[[0]]", "has length 1; allowed"),
    ],
)
def test_seams_that_are_none_are_refused(tmp_path, seams, said):
    hanging_cone(tmp_path, inverse=f"seams = {seams}")
    code, answer = run(tmp_path)
    assert code == 2 and said in answer and answer.count("voile:") == 1


def test_a_developable_rest_shape_flattens_exactly(tmp_path):
    height = hanging_cone(tmp_path, inverse='developable = "constraint"\niterations = 4')
    code, said = run(tmp_path)
    assert code == 0, said
    found = json.loads((tmp_path / "out" / "summary.json").read_text())["inverse"]
    assert found["largest_defect"] < 1e-8 and found["sag"] < 1e-3
    assert "developable rest shape with a stable equilibrium" in said
    assert found["pattern"]["distortion"] < 1e-6
    assert [step["share"] for step in found["developability"]] == [0.0, 0.5, 0.8, 0.9, 0.95, 1.0]
    assert (tmp_path / "out" / "developability.png").read_bytes()[:4] == b"\x89PNG"
    target = read_mesh(tmp_path / "target.obj").points
    away = np.linalg.norm(draped_from_pattern(tmp_path) - target, axis=1).max()
    print(f"draped from the flat pattern: {away / height:.2g} of the height away")
    assert away < 0.01 * height


@pytest.mark.parametrize("gap, code", [(1e-3, 0), (8e-3, 2)])
def test_a_target_whose_seams_gape_is_told_of_or_refused(tmp_path, gap, code):
    """Two halves of a sheet that hangs from one edge, a gap between them: 0.2 or 1.6 % of the size."""
    points, triangles = grid(6, 4, 0.3, 0.2)
    points = points[:, [0, 2, 1]]
    right = points + np.array([0.3 + gap, 0.0, 0.0])
    start = np.flatnonzero(points[:, 0] < 1e-9)
    end = np.flatnonzero(points[:, 0] > 0.3 - 1e-9)
    first = end.astype(np.int32)
    stitches = Stitches(len(points) + start.astype(np.int32), first, first, np.zeros(len(end)))
    both = np.concatenate([points, right])
    write_obj(
        tmp_path / "target.obj", both, np.concatenate([triangles, triangles + len(points)]), stitches=stitches
    )
    scene(tmp_path, "[[fix]]\nselect = { box = [[-1, -1, 0.1999], [1, 1, 1]] }", young=1e8)
    found, said = run(tmp_path)
    assert found == code, said
    worst = f"up to {gap:.4g} m (vertex {len(points) + start[0]} from {first[0]})"
    if code:
        assert "the target's seams do not close: 5 of 5 sewn vertices" in said and worst in said
    else:
        (note,) = json.loads((tmp_path / "out" / "summary.json").read_text())["notes"]
        assert worst in note and "sag counts from the closed shape" in note
