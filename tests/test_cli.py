"""The command line from outside: exit codes, one message each, what stays on the disk."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from command_line import refused, voile
from scipy.spatial import Delaunay

from voile.results import read_result, read_summary

VOILE = [sys.executable, "-m", "voile.cli"]
SCENE = """
[shell]
mesh = "mesh.obj"
young = 1e5
thickness = 1e-3
density = 300.0
[loads]
gravity = [0.0, 0.0, -9.81]
[[fix]]
select = { box = [[-0.01, -1, -1], [0.01, 1, 1]] }
clamp = true
"""
HELD = SCENE[SCENE.index("[[fix]]") :]


def cells(
    shift: float = 0.0, first: int = 0, size: float = 0.1, count: int = 4, upright: bool = False
) -> str:
    """A square of count x count cells as OBJ, its first corner at (shift, 0, 0), vertices from first + 1."""
    n = count + 1
    xs = np.linspace(0.0, size, n)
    lines = [f"v {shift + x:.17g} " + (f"0 {y:.17g}" if upright else f"{y:.17g} 0") for x in xs for y in xs]
    for i in range(count):
        for j in range(count):
            a = first + i * n + j + 1
            lines += [f"f {a} {a + n} {a + n + 1}", f"f {a} {a + n + 1} {a + 1}"]
    return "\n".join(lines) + "\n"


def two_panels(gap: float = 0.0, sewn: bool = True) -> str:
    """Two squares side by side, the last column of the first sewn to the first column of the second (stitches count
    vertices from 0)."""
    seam = "".join(f"stitch {25 + j} {20 + j} {20 + j} 0\n" for j in range(5))
    return cells() + cells(0.1 + gap, 25) + (seam if sewn else "")


@pytest.fixture
def scene(tmp_path):
    """scene(text, obj): writes scene.toml and mesh.obj."""

    def write(text: str = SCENE, mesh: str | None = None) -> Path:
        (tmp_path / "mesh.obj").write_text(cells() if mesh is None else mesh)
        (tmp_path / "scene.toml").write_text(text)
        return tmp_path / "scene.toml"

    return write


def program(*args) -> subprocess.CompletedProcess[str]:
    """As `voile`, a program of its own."""
    command = [*VOILE, *map(str, args)]
    return subprocess.run(command, capture_output=True, text=True, timeout=120, stdin=subprocess.DEVNULL)


# ---- bad input ----

# Text in SCENE | put in its place | what the message holds.
BAD = """
mesh.obj | none.obj | none.obj: no such mesh file
young = 1e5 | yuong = 1e5 | scene.toml, line 4: shell.yuong: unknown key | did you mean "young"
young = 1e5 | young = "1e5 Pa" | line 4: shell.young: | is text; allowed: a finite number > 0 in Pa
young = 1e5 | young = 0.0 | line 4: shell.young: 0.0 is not allowed
young = 1e5 | young = -1 | line 4: shell.young: -1 is not allowed
thickness = 1e-3 | thickness = 0 | line 5: shell.thickness: 0 is not allowed; allowed: a finite number > 0 in m
thickness = 1e-3 | thickness = -1e-3 | line 5: shell.thickness: -0.001 is not allowed
density = 300.0 | density = 0 | line 6: shell.density: 0 is not allowed
density = 300.0 | density = -1 | line 6: shell.density: -1 is not allowed
density = 300.0 | density = 1; poisson = 0.5 | shell.poisson: 0.5 | allowed: a finite number > -1 and < 0.5
density = 300.0 | density = 1; poisson = -1.0 | shell.poisson: -1.0 is not allowed
density = 300.0 | density = 1; bending = "tna" | shell.bending: 'tna' is not allowed | "tan"
density = 300.0 | density = 1; rest = "flat" | rest = 'flat' needs texture coordinates
density = 300.0 | density = 1; rest = "none.obj" | none.obj: no such mesh file
{ box = [[-0.01, -1, -1], [0.01, 1, 1]] } | { box = [[5, 5, 5], [6, 6, 6]] } | fix.0.select: | selects no vertex of
{ box = [[-0.01, -1, -1], [0.01, 1, 1]] } | { nodes = [25] } | fix.0.select.nodes: vertex 25, allowed: 0 to 24
{ box = [[-0.01, -1, -1], [0.01, 1, 1]] } | { group = "hem" } | fix.0.select.group: no group 'hem'
{ box = [[-0.01, -1, -1], [0.01, 1, 1]] } | { boundary = 1 } | fix.0.select.boundary: loop 1, allowed: 0 to 0
{ box = [[-0.01, -1, -1], [0.01, 1, 1]] } | { nodes = [0] } | fix.0.select: clamp = true needs at least one edge
gravity = [0.0, 0.0, -9.81] | gravity = [0.0, -9.81] | loads.gravity: [0.0, -9.81] has length 2
[loads] | [load] | unknown key (did you mean "loads"?)
[loads] | [contact]; self_contact = true; offset = 0; [loads] | contact.offset: 0; allowed with self_contact: above 0
[loads] | [contact]; self_friction = 0.3; [loads] | self_friction: 0.3; allowed without contact.self_contact = true: 0
[loads] | [[obstacle]]; shape = "plane"; point = [0, 0, 9]; normal = [0, 0, 1]; [loads] | deep inside plane 0
[loads] | [[obstacle]]; shape = "sphere"; center = [0, 0, 9]; radius = 0; [loads] | obstacle.0.radius: 0
[loads] | [[obstacle]]; shape = "plane"; point = [0, 0, -9]; [loads] | the key "normal" is missing
"""


@pytest.mark.parametrize("row", BAD.strip().split("\n"))
def test_bad_input_is_refused_before_anything_is_written(row, scene, tmp_path):
    old, new, *words = row.split(" | ")
    assert SCENE.count(old) == 1
    path = scene(SCENE.replace(old, new.replace("; ", "\n")))
    refused(voile("run", path, "-o", tmp_path / "out"), *words)
    assert not (tmp_path / "out").exists()


MESHES = {
    "empty": ("", "mesh.obj: the mesh file is empty"),
    "not a number": ("v 0 0 zero\n", "mesh.obj, line 1"),
    "missing vertex": ("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 4\n", "mesh.obj, line 4"),
    "no faces": ("v 0 0 0\nv 1 0 0\nv 0 1 0\n", "mesh.obj"),
    "no area": ("v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n", "mesh.obj"),
    "not finite": ("v 0 0 nan\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "mesh.obj"),
}


@pytest.mark.parametrize("name", MESHES)
def test_unreadable_meshes(name, scene, tmp_path):
    text, message = MESHES[name]
    refused(voile("run", scene(mesh=text), "-o", tmp_path / "out"), message)


def test_a_mesh_that_is_no_mesh(scene, tmp_path):
    path = scene(SCENE.replace("mesh.obj", "mesh.vtu"))
    (tmp_path / "mesh.vtu").write_bytes(b"\x00\x01 not a mesh")
    refused(voile("run", path, "-o", tmp_path / "out"), "mesh.vtu: cannot be read as a mesh")
    (tmp_path / "mesh.vtu").unlink()
    (tmp_path / "mesh.vtu").mkdir()
    refused(voile("explain", path), "mesh.vtu")


def test_a_rest_shape_of_other_triangles(scene, tmp_path):
    path = scene(SCENE.replace("density", 'rest = "rest.obj"\ndensity'))
    (tmp_path / "rest.obj").write_text(cells(count=3))
    refused(voile("run", path), "rest.obj: 18 triangles, but", "has 32")
    (tmp_path / "rest.obj").write_text(cells().replace("f 1 6 7", "f 1 6 8"))
    refused(voile("run", path), "rest.obj", "a rest shape needs the same triangles in the same order")


def test_scene_files_and_overrides(scene, tmp_path):
    refused(voile("run", tmp_path / "none.toml"), "none.toml: no such file")
    path = scene()
    refused(voile("explain", path, "--set", "shell.young=-1"), "--set shell.young=-1: shell.young: -1")
    assert "discrete-shells" in voile("explain", path, "--set", "shell.model=discrete-shells").stdout


def test_an_unknown_command_is_refused():
    done = program("solve")
    assert done.returncode == 2 and "invalid choice: 'solve'" in done.stderr


# ---- rigid motions left ----

HORIZONTAL, UPRIGHT = cells(), cells(upright=True)
FREE = {
    "no support": (HORIZONTAL, "", "the shell is free to move rigidly: translation along x, y, z"),
    "one vertex": (HORIZONTAL, "[[fix]]\nselect.nodes = 0", "rotation about the direction of gravity, z"),
    "a vertical edge": (
        UPRIGHT,
        "[[fix]]\nselect.box = [[-1, -1, -1], [0.01, 1, 1]]",
        "rotation about the direction of gravity, z",
    ),
    "one axis": (HORIZONTAL, "[[fix]]\nselect.all = true\naxes = 'z'", "translation along x, y"),
    "two axes": (HORIZONTAL, "[[fix]]\nselect.nodes = [0, 4, 20]\naxes = 'xz'", "translation along y"),
    "a loose panel": (
        two_panels(0.01, sewn=False),
        HELD,
        "the piece with vertex 25 (25 vertices) is free to move rigidly: translation along x, y, z",
    ),
}
GUIDED = "[[fix]]\nselect.nodes = [0, 4]\n[[fix]]\nselect.nodes = 20\naxes = 'z'"
HOLDING = {
    "a horizontal edge": (UPRIGHT, "[[fix]]\nselect.box = [[-1, -1, 0.09], [1, 1, 1]]"),
    "two corners": (HORIZONTAL, "[[fix]]\nselect.nodes = [0, 4]"),
    "two corners and a guide": (HORIZONTAL, GUIDED),
    "a sewn panel": (two_panels(), HELD),
}


@pytest.mark.parametrize("name", FREE)
def test_what_supports_leave_free_is_named(name, scene, tmp_path):
    mesh, supports, message = FREE[name]
    path = scene(SCENE.replace(HELD, supports), mesh)
    refused(voile("run", path, "-o", tmp_path / "out"), "fix: ", message, "add supports ([[fix]])")


def test_without_a_load_nothing_may_turn(scene):
    hinge = SCENE.replace(HELD, "[[fix]]\nselect.nodes = [0, 4]").replace("-9.81", "0.0")
    refused(voile("explain", scene(hinge)), "rotation about y, and there is no load to hold it")


@pytest.mark.parametrize("name", HOLDING)
def test_sufficient_supports_are_accepted(name, scene):
    mesh, supports = HOLDING[name]
    done = voile("explain", scene(SCENE.replace(HELD, supports), mesh))
    assert done.returncode == 0, done.stderr


# ---- output ----


def test_an_output_folder_that_cannot_be_written(scene, tmp_path):
    (tmp_path / "file").write_text("mine")
    for out in (tmp_path / "file", tmp_path / "file" / "below", Path("/proc/none")):
        refused(voile("run", scene(), "-o", out), f"{out}: cannot write results there")
    assert (tmp_path / "file").read_text() == "mine"


def test_bad_input_leaves_an_old_result(scene, tmp_path):
    out = tmp_path / "out"
    assert voile("run", scene(), "-o", out).returncode == 0
    before = {file.name: file.read_bytes() for file in out.iterdir() if file.is_file()}
    assert set(before) == {"result.vtkhdf", "summary.json", ".voile-run"}
    refused(voile("run", scene(SCENE.replace("young = 1e5", "young = 0")), "-o", out), "shell.young")
    assert {file.name: file.read_bytes() for file in out.iterdir() if file.is_file()} == before


def test_damaged_results(scene, tmp_path):
    out = tmp_path / "out"
    assert voile("run", scene(), "-o", out).returncode == 0
    file = out / "result.vtkhdf"
    whole = file.read_bytes()
    for damaged in (whole[: len(whole) // 2], whole[:100], b"", b"not HDF5" * 100):
        file.write_bytes(damaged)
        for command in (["info", out], ["render", out], ["export", out, out / "a.obj"]):
            refused(voile(*command), str(file))
    left = {path.name for path in out.iterdir()} - {"restart"}  # of a run that takes long
    assert left == {"result.vtkhdf", "summary.json", ".voile-run"}
    refused(voile("info", tmp_path / "none"), "none: no such result file")


# ---- not converged, PETSc options ----

FEW = SCENE + "[statics]\nmax_steps = 5\n"


def test_what_did_not_converge_says_so(scene, tmp_path):
    out = tmp_path / "out"
    assert voile("run", scene(FEW), "-o", out).returncode == 0
    old = read_summary(out / "summary.json")
    done = program("run", scene(FEW), "-o", out, "--", "-snes_max_it", 1)
    assert done.returncode == 3 and done.stderr.count("\n") == 1
    assert "max_steps = 5 load steps ended at load factor 0" in done.stderr and str(out) in done.stderr
    summary = read_summary(out / "summary.json")
    assert "-0.0" not in map(str, old["energy"].values())
    assert old["converged"] and not summary["converged"] and "max_steps" in summary["reason"]
    assert summary["stable"] is None
    with read_result(out) as result:
        assert np.isfinite(result.points()).all() and result.scalars()["converged"] == 0.0
    assert (out / "result.previous.vtkhdf").exists()


def test_the_last_good_state_is_kept(scene, tmp_path):
    text = SCENE.replace("1e5", "1e9") + "[statics]\nload_steps = 4\nmax_steps = 1\n"
    done = voile("run", scene(text), "-o", tmp_path / "out", "--set", "output.every=3")
    assert done.returncode == 3 and "max_steps = 1" in done.stderr
    summary = read_summary(tmp_path / "out" / "summary.json")
    assert not summary["converged"] and summary["load_factor"] == 0.25
    with read_result(tmp_path / "out") as result:
        assert result.values[-1] == 0.25 and result.scalars()["converged"] == 1.0


def test_every_second_step_and_the_last_are_kept(scene, tmp_path):
    path, reached = scene(SCENE + "[statics]\nload_steps = 16\n"), []
    for every in (1, 2):
        out = tmp_path / f"every{every}"
        assert voile("run", path, "-o", out, "--set", f"output.every={every}").returncode == 0
        with read_result(out) as result:
            reached.append(list(result.values))
    full, half = reached
    assert len(full) % 2 == 1 and full[-1] == 1.0  # the last is not a second one
    assert half == [*full[1::2], full[-1]]


def test_petsc_options_reach_the_solver(scene, tmp_path):
    own, other = tmp_path / "own", tmp_path / "other"
    stiff = SCENE.replace("young = 1e5", "young = 1e9")
    assert voile("run", scene(stiff), "-o", own).returncode == 0
    options = ("-snes_type", "newtonls", "-snes_converged_reason")
    done = program("run", scene(stiff), "-o", other, "--", *options)
    assert done.returncode == 0, done.stderr
    assert "CONVERGED_FNORM_ABS" in done.stdout
    a, b = (read_summary(out / "summary.json") for out in (own, other))
    assert sum(a["energy"].values()) == pytest.approx(sum(b["energy"].values()), rel=1e-9)


# ---- the other commands ----


def test_results_are_shown_and_exported(scene, tmp_path):
    out = tmp_path / "out"
    assert voile("run", scene(), "-o", out).returncode == 0
    info = voile("info", out)
    assert (
        info.returncode == 0 and "25 vertices, 32 triangles" in info.stdout and "newton_iter" in info.stdout
    )
    for kind in ("obj", "ply", "vtu", "glb"):
        assert voile("export", out, tmp_path / f"shape.{kind}").returncode == 0
        assert (tmp_path / f"shape.{kind}").stat().st_size > 500
    refused(voile("export", out, tmp_path / "shape.stl"), "unknown format '.stl'; allowed: ")
    refused(voile("export", out, tmp_path / "none" / "shape.obj"), "cannot be written")
    refused(voile("export", out, tmp_path / "shape.obj", "--step", 99), "no step 99; allowed: 0 to")
    assert voile("render", out, "-o", tmp_path / "shape.png").returncode == 0
    assert (tmp_path / "shape.png").read_bytes().startswith(b"\x89PNG")
    refused(voile("render", out, "--field", "colour"), "colour")
    refused(voile("render", out, "--step", 99), "99")


def test_explain_says_what_is_modelled(scene, tmp_path):
    done = voile("explain", scene())
    assert done.returncode == 0 and "+ director angles" in done.stdout and "- seams" in done.stdout
    done = voile("explain", scene(), "--set", "shell.model=membrane")
    assert "- bending" in done.stdout and "- director angles" in done.stdout
    average = ("--set", "shell.bending=average")
    assert "repeated cells" in voile("explain", scene(), *average).stdout
    points = np.random.default_rng(0).random((25, 2)) * 0.1
    points[0], points[1] = 0.0, (0.0, 0.05)
    irregular = "".join(f"v {x} {y} 0\n" for x, y in points)
    irregular += "".join("f {} {} {}\n".format(*t + 1) for t in Delaunay(points).simplices)
    assert "repeated cells" not in voile("explain", scene(mesh=irregular), *average).stdout
    assert not list(tmp_path.glob("*result*"))


def test_schema_is_json():
    done = voile("schema")
    assert done.returncode == 0 and json.loads(done.stdout)["properties"]["shell"]["required"]


# ---- several ranks ----


@pytest.mark.mpi
@pytest.mark.parametrize("change", ["young = -1", 'young = 1e5\nrest = "none.obj"'])
def test_bad_input_on_two_ranks_is_said_once(change, scene, tmp_path, crews):
    path = scene(SCENE.replace("young = 1e5", change))
    done = crews(2).run("voile", ["run", path, "-o", tmp_path / "out"], 60)
    assert done.returncode == 2
    assert done.stderr.count("voile: ") == 1 and "Traceback" not in done.stderr
    assert not (tmp_path / "out").exists()


@pytest.mark.mpi
def test_other_failures_on_two_ranks(scene, tmp_path, mpirun, crews):
    """The output folder is a file (found after the scene was read); no convergence, which mpirun hands on."""
    (tmp_path / "file").write_text("mine")
    done = crews(2).run("voile", ["run", scene(), "-o", tmp_path / "file"], 60)
    assert done.returncode == 2 and done.stderr.count("voile: ") == 1
    command = [*VOILE, "run", str(scene(FEW)), "-o", str(tmp_path / "out"), "--", "-snes_max_it", "1"]
    done = mpirun(2, command, 60)
    assert done.returncode == 3 and done.stderr.count("voile: ") == 1


HANGING = SCENE.replace(HELD, "[[fix]]\nselect.nodes = [0, 4]")
SEWN = SCENE.replace("clamp = true", "clamp = false")
RIGHT = "[[loads.moment]]\nselect = { box = [[0.099, -1, -1], [1, 1, 1]] }\nvalue = 4e-5"
ROLLED = SCENE.replace("-9.81]", "0.0]\n" + RIGHT)
SCENES = {
    "hanging cloth": (HANGING, HORIZONTAL),
    "sewn panels": (SEWN, two_panels(0.02)),
    "rolled sheet": (ROLLED, None),
}


@pytest.mark.mpi
@pytest.mark.parametrize("name", SCENES)
def test_ranks_agree(name, scene, tmp_path, run_on, rank_counts):
    path, found = scene(*SCENES[name]), []
    for ranks in rank_counts:
        out = tmp_path / str(ranks)
        run_on(ranks, path, out)
        summary = read_summary(out / "summary.json")
        assert summary["ranks"] == ranks and summary["stable"]
        with read_result(out) as result:
            found.append((sum(summary["energy"].values()), result.points(), result.triangles))
    energy, points, triangles = found[0]
    size = np.linalg.norm(np.ptp(points, axis=0))
    for other_energy, other_points, other_triangles in found[1:]:
        assert other_energy == pytest.approx(energy, rel=1e-9)
        assert np.abs(other_points - points).max() <= 1e-7 * size
        assert (other_triangles == triangles).all()
    if name == "sewn panels":
        for _, x, _ in found:
            assert np.abs(x[25:30] - x[20:25]).max() <= 1e-15
