"""Scenes to begin with: they run, in seconds, and nothing is overwritten."""

import os
import re
import shlex
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from voile.cli import main
from voile.commands.new import TEMPLATES
from voile.results import read_summary
from voile.scene import read_scene

ROOT = Path(__file__).parents[1]
STORED = ROOT / "src" / "voile" / "templates"


def test_every_template_is_offered():
    assert {folder.name for folder in STORED.iterdir()} == set(TEMPLATES)


TOLD = {"drape", "pattern"}  # the tutorial runs them, which test_docs.py proves


@pytest.mark.parametrize(
    "template", [pytest.param(t, marks=pytest.mark.slow) if t in TOLD else t for t in TEMPLATES]
)
def test_a_new_scene_runs(tmp_path, monkeypatch, capsys, template):
    """As the command says: copied with its name, explained, solved, with a page."""
    monkeypatch.chdir(tmp_path)
    assert main(["new", "my skirt", "--template", template]) == 0
    scene = tmp_path / "my skirt" / "scene.toml"
    assert capsys.readouterr().out.startswith("my skirt/scene.toml\nvoile explain")
    assert sorted(p.name for p in scene.parent.iterdir()) == sorted(
        p.name for p in (STORED / template).iterdir()
    )
    assert read_scene(scene).scene.name == "my skirt"
    assert scene.read_text().count("#") > 8
    assert main(["explain", str(scene)]) == 0
    shorter = ["--set", "dynamics.duration=0.1"] if template == "dynamics" else []
    assert main(["run", str(scene), "-o", "result", *shorter]) == 0
    summary = read_summary("result/summary.json")
    assert summary["converged"]
    if template in ("inverse", "pattern"):
        assert summary["inverse"]["sag"] < 1e-6 and summary["stable"]
        assert Path("result/rest.obj").is_file()
    if template == "pattern":
        assert Path("result/pattern.svg").is_file()
    assert sorted(p.name for p in tmp_path.iterdir()) == ["my skirt", "result"]


@pytest.mark.parametrize("template", TEMPLATES)
def test_meshes_are_the_generators(tmp_path, template):
    """The scene's header says which command made its mesh; that command makes it again."""
    text = (STORED / template / "scene.toml").read_text()
    made = [shlex.split(line) for line in re.findall("^# Mesh: python (.*)$", text, re.MULTILINE)]
    assert {words[-1] for words in made} == {p.name for p in (STORED / template).glob("*.obj")}
    for program, *options, name in made:
        subprocess.run(
            [sys.executable, ROOT / program, *options, tmp_path / name],
            check=True,
            capture_output=True,
            timeout=60,
        )
        assert _numbers(tmp_path / name) == pytest.approx(_numbers(STORED / template / name), abs=1e-12)


def _numbers(path):
    return [float(word) for word in re.findall(r"-?\d[\d.e+-]*", path.read_text())]


def test_nothing_is_overwritten(tmp_path, capsys):
    for name, make in (
        ("file", Path.touch),
        ("folder", Path.mkdir),
        ("link", lambda p: p.symlink_to("nowhere")),
    ):
        make(tmp_path / name)
        before = sorted(tmp_path.rglob("*"))
        assert main(["new", str(tmp_path / name)]) == 2
        error = capsys.readouterr().err
        assert "exists already and stays as it is" in error and error.count("\n") == 1
        assert sorted(tmp_path.rglob("*")) == before


def test_names_that_cannot_be(tmp_path, capsys):
    for name, message in (
        (tmp_path / "none" / "a", "cannot be written: No such file"),
        (tmp_path / "a\nb", "printable characters"),
        ("/", "a folder's name"),
    ):
        assert main(["new", str(name)]) == 2
        error = capsys.readouterr().err
        assert message in error and error.count("\n") == 1
    with pytest.raises(SystemExit, match="2"):
        main(["new", str(tmp_path / "a"), "--template", "hat"])
    assert "'hat'" in capsys.readouterr().err
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize("name", ['say "hi"', r"back\1slash", "Jupe plissée 👗"])
def test_odd_names_are_titles(tmp_path, name):
    assert main(["new", str(tmp_path / name)]) == 0
    assert tomllib.loads((tmp_path / name / "scene.toml").read_text())["scene"]["name"] == name
