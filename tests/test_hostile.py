"""What strangers' scenes, meshes and results say cannot run code, or write outside the output folder."""

import json
import subprocess
import sys

import meshio
import numpy as np
import pytest
from campaign_sources import SCENE as DYNAMICS
from campaign_sources import STRIP, small_pattern

from voile.mesh import read_mesh
from voile.results import write_pattern

NAMES = (
    "../../outside",
    "$(touch outside)",
    "`touch outside`",
    "/tmp/outside",
    "{0.__class__}",
    "%n%s",
    "<script>",
)
SCENE = """
[scene]
name = "../../outside $(touch outside) {{0.__class__}} <script>"
[shell]
mesh = "strip.obj"
young = 1e6
thickness = 1e-3
density = 300.0
[[fix]]
name = "../../outside"
select = {{ box = [[-0.01, -1, -1], [0.01, 1, 1]] }}
[[fix]]
select = {{ group = {group} }}
move = {{ displacement = [0.0, 0.0, 0.001] }}
[[obstacle]]
shape = "sphere"
center = [0.1, 0.0, -5.0]
radius = 0.1
"""
# Runs commands with Python's audit events watched: imports of all that they need come first.
WATCHED = """
import json, os, sys
import av, h5py, matplotlib.pyplot, meshio, pyvista, scipy.optimize, ezdxf, PIL.Image
matplotlib.pyplot.figure().savefig(os.devnull, format="png")
pyvista.Plotter(off_screen=True).screenshot(return_img=True)
import voile.cli
from voile.commands import all_commands
FORBIDDEN = "subprocess.Popen os.system os.exec os.spawn os.posix_spawn pickle.find_class socket.connect".split()
found, allowed = [], os.path.realpath(sys.argv[1])

def watch(event, arguments):
    told = event == "pickle.find_class" and arguments[0].split(".")[0] in ("voile", "numpy", "pathlib")  # between ranks
    if event in FORBIDDEN and not told:
        found.append([event, repr(arguments)])
    if event == "open" and isinstance(arguments[0], str) and arguments[2] & (os.O_WRONLY | os.O_RDWR | os.O_CREAT):
        path = os.path.realpath(arguments[0])
        if not path.startswith((allowed, "/dev/", "/proc/")):
            found.append([event, path])
    if event in ("os.rename", "os.mkdir", "os.symlink", "os.link", "os.remove"):
        path = os.path.realpath(arguments[1 if event in ("os.rename", "os.link", "os.symlink") else 0])
        if not path.startswith(allowed):
            found.append([event, path])

from voile.petsc_options import start_petsc
start_petsc()
sys.addaudithook(watch)
codes = [voile.cli.main(command) for command in json.loads(sys.argv[2])]
print(json.dumps({"codes": codes, "found": found}))
"""


def test_names_in_files_are_but_names(tmp_path):
    pytest.importorskip("av")
    inside, out = tmp_path / "scenes" / "inside", tmp_path / "scenes" / "inside" / "out"
    inside.mkdir(parents=True)
    vertices, faces = STRIP.split("\nf ", 1)
    parts = ("f " + faces).splitlines()
    lines = [f"g {NAMES[k % len(NAMES)]}\n{face}" for k, face in enumerate(parts)]
    (inside / "strip.obj").write_text(f"mtllib ../../outside\n{vertices}\n" + "\n".join(lines))
    (inside / "scene.toml").write_text(SCENE.format(group=json.dumps(NAMES[len(parts) % len(NAMES) - 1])))
    pattern = small_pattern()
    for piece, name in zip(pattern.pieces, NAMES, strict=False):
        object.__setattr__(piece, "name", name)
    out.mkdir()
    write_pattern(out, pattern)
    before = sorted(tmp_path.rglob("*"))
    commands = [["run", inside / "scene.toml", "-o", out], ["info", out]]
    commands += [
        ["export", out, out / f"a.{kind}"] for kind in ("obj", "ply", "vtu", "glb", "svg", "dxf", "png")
    ]
    commands += [["render", out], ["report", out], ["pattern", out, "--pages", "a4"]]
    words = json.dumps([[str(word) for word in command] for command in commands])
    done = subprocess.run(
        [sys.executable, "-c", WATCHED, out, words], capture_output=True, text=True, timeout=300, cwd=inside
    )
    assert done.returncode == 0, done.stderr
    said = json.loads(done.stdout.splitlines()[-1])
    assert said == {"codes": [0] * len(commands), "found": []}, done.stderr
    assert [path for path in sorted(tmp_path.rglob("*")) if out not in path.parents] == [
        path for path in before if out not in path.parents
    ]
    page = (out / "report.html").read_text()
    assert "<script>" not in page.split("<h2>Scene</h2>")[1].split("</pre>")[0]


@pytest.mark.parametrize(
    ("task", "load"),
    [
        ("dynamics", "pressure = 1e300"),
        ("statics", "gravity = [0, 0, -1e160]"),  # its square is no number
        ("modes", "gravity = [0, 0, -1e160]"),
        # the square of what it moves over the mass
        ("inverse", "gravity = [0, 0, -1e155]\n[[fix]]\nselect = { nodes = [2, 3] }"),
    ],
)
def test_loads_beyond_all_numbers_say_so_in_one_line(tmp_path, task, load):
    (tmp_path / "strip.obj").write_text(STRIP)
    scene = DYNAMICS.replace('"dynamics"', f'"{task}"').partition("clamp")[0] + f"[loads]\n{load}\n"
    (tmp_path / "scene.toml").write_text(scene)
    command = [sys.executable, "-m", "voile.cli", "run", "scene.toml", "-o", "out"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=100)
    assert done.returncode == 3 and done.stderr.count("\n") == 1, done.stderr
    assert done.stderr.startswith("voile: scene.toml: ")


def test_a_child_looks_at_hdf5_meshes_first(tmp_path, monkeypatch):
    """HDF5 itself crashes on some; what a child tells then is in tests/contact/test_friction_files.py."""
    mesh = meshio.Mesh(np.eye(3), [("triangle", np.array([[0, 1, 2]]))])
    meshio.write(tmp_path / "mesh.xdmf", mesh)
    sent = []
    monkeypatch.setattr("voile.mesh.guards.send_ahead", sent.append)
    read_mesh(tmp_path / "mesh.xdmf")
    assert sent == [tmp_path / "mesh.h5"]
