"""Every file that voile writes: whole or not at all, never through a link, one message where it cannot be."""

import os
import re
import resource
import shutil
from pathlib import Path

import pytest
from campaign_sources import STRIP, small_pattern, small_result

from voile.cli import main
from voile.results import read_pattern, write_pattern

SOURCE = Path(__file__).parents[1] / "src" / "voile"
# The outputs of a command, {out} its folder and {result} that of a run.
COMMANDS = {
    "obj": ["export", "{result}", "{out}/a.obj"],
    "ply": ["export", "{result}", "{out}/a.ply"],
    "vtu": ["export", "{result}", "{out}/a.vtu"],
    "glb": ["export", "{result}", "{out}/a.glb"],
    "svg": ["export", "{result}", "{out}/a.svg"],
    "dxf": ["export", "{result}", "{out}/a.dxf"],
    "pattern.png": ["export", "{result}", "{out}/a.png"],
    "render": ["render", "{result}", "-o", "{out}/a.png"],
    "plot": ["plot", "{result}", "-o", "{out}/a.png"],
    "mp4": ["animate", "{result}", "--fps", "20", "-o", "{out}/a.mp4"],
    "report": ["report", "{result}", "-o", "{out}/a.html"],
    "repair": ["mesh", "repair", "{strip}", "-o", "{out}/a.obj"],
    "mirror": ["mesh", "mirror", "{strip}", "--across", "x", "-o", "{out}/a.obj"],
    "layout": ["pattern", "{result}", "--width", "0.5", "--seconds", "0.1", "-o", "{out}"],
    "pages": ["pattern", "{result}", "--pages", "a4", "-o", "{out}"],
    "friction": ["friction", "{friction}", "-o", "{out}/a.h5"],
}
MADE = {"layout": "layout.svg", "pages": "pages/page-cover.svg", "vtu": "a-obstacles.vtu", "repair": "a.json"}


@pytest.fixture(scope="module")
def given(tmp_path_factory):
    """Names in commands -> what they read."""
    import h5py
    import numpy as np

    folder = tmp_path_factory.mktemp("given")
    result = small_result(folder / "run")
    write_pattern(result, small_pattern())
    (folder / "strip.obj").write_text(STRIP)
    with h5py.File(folder / "problem.h5", "w") as file:
        file["W/data"], file["W/indices"], file["W/indptr"] = np.ones(3), np.arange(3), np.arange(4)
        file["W/shape"], file["q"], file["mu"] = np.array([3, 3]), np.array([-1.0, 0.1, 0.0]), np.array([0.3])
    return {"result": result, "strip": folder / "strip.obj", "friction": folder / "problem.h5"}


@pytest.mark.parametrize("name", COMMANDS)
def test_whole_or_not_at_all(name, given, tmp_path, capsys):
    if name == "layout":
        pytest.importorskip("spyrrow")
    precious, out = tmp_path / "precious", tmp_path / "out"
    precious.write_text("precious")

    def ended(folder: Path) -> tuple[int, str]:
        code = main([word.format(**given, out=folder) for word in COMMANDS[name]])
        return code, capsys.readouterr().err

    out.mkdir()
    assert ended(out) == (0, "")
    files = sorted(path for path in out.rglob("*") if path.is_file())
    names = [str(path.relative_to(out)) for path in files]
    assert MADE.get(name, "a" + files[0].suffix) in names and not any(n.endswith("part") for n in names)
    sizes = [path.stat().st_size for path in files]

    for path in files:  # links under the names, and under temporary ones
        path.unlink()
        for link in (path, path.with_name(f".{path.name}.part")):
            os.symlink(precious, link)
    assert ended(out) == (0, "")
    assert precious.read_text() == "precious" and not list(out.rglob("*part"))
    assert all(path.is_file() and not path.is_symlink() for path in files)
    if name != "layout":  # whose search ends by the clock
        assert [path.stat().st_size for path in files] == sizes

    before = [path.read_bytes() for path in files]
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (64, limits[1]))
    try:
        code, said = ended(out)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert code == 2 and "cannot be written: File too large" in said and said.count("\n") == 1
    assert not list(out.rglob("*part"))
    assert [
        path.read_bytes() for path in files
    ] == before  # the first cannot be written: the others are not touched

    for path in files:
        path.unlink()
        path.mkdir()
    code, said = ended(out)
    assert code == 2 and "cannot be written: a folder is there" in said and said.count("\n") == 1
    shutil.rmtree(out)
    out.symlink_to("/proc")  # where nobody makes files
    code, said = ended(out)
    assert code == 2 and "cannot be written" in said and said.count("\n") == 1


def test_one_place_writes():
    """What opens files for writing goes through voile.files; beside it HDF5, which keeps its file open over steps, and
    templates, copied into a folder of their own before it gets its name."""
    writes = re.compile(
        r"\.(write_text|write_bytes|mkdir|touch)\(|(?<!av\.)open\([^)\n]*\"[wxa]b?\"|os\.replace\(|savefig\((?!fi|text)"
    )
    allowed = {"files.py", "commands/new.py", "results/writer.py", "results/folder.py"}
    found = {str(p.relative_to(SOURCE)) for p in SOURCE.rglob("*.py") if writes.search(p.read_text())}
    assert found - allowed == set()


def test_patterns_of_the_first_version_are_read(tmp_path):
    import json

    write_pattern(tmp_path, small_pattern())
    path = tmp_path / "pattern.json"
    data = json.loads(path.read_text()) | {"version": 1}
    for name in ("mirrors", "symmetrised", "fabric"):
        del data[name]
    for part in (*data["seams"], *(piece["notches"] for piece in data["pieces"])):
        del part["allowance"]
    del data["seams"][0]["ease"]
    path.write_text(json.dumps(data))
    old, new = read_pattern(tmp_path), small_pattern()
    assert old.seams[0].allowance == 0.01 and old.fabric is None and old.mirrors == ()
    for one, other in zip(old.pieces, new.pieces, strict=True):
        assert (one.points == other.points).all() and (one.notches.allowance == other.notches.allowance).all()
