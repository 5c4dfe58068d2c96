"""`voile validate`: its table, its exit codes, and the quick protocols within their bounds."""

import json
from pathlib import Path

import pytest

from voile.cli import main
from voile.validate import Bench, all_protocols, perform, protocols

MINE = """
from voile.validate.protocol import Curve, Findings, Plot, close

TEXT = "two is two"
SOURCE = "arithmetic"

def run(bench):
    value = {value}
    return Findings([close("two", value, 2.0, 0.1)], Plot("x", "y", [Curve("line", [0, 1], [0, value])]))
"""
# Whose quick form takes more than two CPU seconds on a quiet machine: they run with the slow tests.
LONG = {
    "airbag",
    "bend-twist",
    "bouncing-bar",
    "cantilever",
    "cusick-drape",
    "friction-pad",
    "lateral-buckling",
    "lifted-strip",
    "macneal-harder",
    "mylar-balloon",
    "pinched-semicylinder",
    "plates",
    "restitution",
    "rotating-sphere",
    "slit-annulus",
    "sliding-sheet",
    "stick-slip",
}
QUICK = 20.0  # CPU seconds: twice what a quiet machine may take, which beside other programs is not much


def each(name: str):
    return pytest.param(name, marks=pytest.mark.slow) if name in LONG else name


@pytest.mark.parametrize("name", [each(name) for name in all_protocols()])
def test_a_quick_protocol_holds(name, tmp_path):
    verdict = perform(all_protocols()[name], Bench(tmp_path, quick=True))
    assert not verdict.failure
    assert not [check for check in verdict.checks if not check.passed]
    assert verdict.checks and verdict.plot and verdict.seconds < QUICK


@pytest.mark.slow
@pytest.mark.parametrize("name", list(all_protocols()))
def test_a_full_protocol_holds(name, tmp_path):
    verdict = perform(all_protocols()[name], Bench(tmp_path))
    assert not verdict.failure
    assert not [check for check in verdict.checks if not check.passed]


@pytest.fixture
def folder(tmp_path: Path, monkeypatch) -> Path:
    """A folder of protocols beside the program's own."""
    monkeypatch.setattr(protocols, "__path__", [*protocols.__path__, str(tmp_path)])
    return tmp_path


@pytest.mark.parametrize(("value", "code"), [(2.1, 0), (2.3, 3)])
def test_a_new_file_is_a_new_protocol(folder, capsys, monkeypatch, value, code):
    name = f"my_own_{code}"
    (folder / f"{name}.py").write_text(MINE.format(value=value))
    out = folder / "out"
    asked = ["validate", f"my-own-{code}", "--json", str(folder / "table.json"), "-o", str(out)]
    assert main(asked) == code
    said = capsys.readouterr()
    assert ("NO" in said.out) == (code == 3) and "my-own" in said.out
    if code:
        assert "1 of 1 figures miss their bounds, in my-own-3" in said.err
    table = json.loads((folder / "table.json").read_text())
    (check,) = table["protocols"][f"my-own-{code}"]["checks"]
    assert table["passed"] == check["passed"] == (code == 0)
    assert check["value"] == value and check["deviation"] == pytest.approx(value / 2.0 - 1.0)
    assert (out / f"my-own-{code}.png").stat().st_size > 1000


def test_a_list_names_all(capsys):
    assert main(["validate", "--list"]) == 0
    said = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in said] == list(all_protocols())
    assert all(len(line.split()) > 3 for line in said)


def test_an_unknown_name_is_told_with_those_there_are(capsys, tmp_path):
    assert main(["validate", "cantilever", "cantilver", "-o", str(tmp_path / "out")]) == 2
    said = capsys.readouterr().err
    assert "'cantilver'" in said and "cantilever, capstan, " in said
    assert not (tmp_path / "out").exists()


def test_an_output_that_is_a_file_is_refused(capsys, tmp_path):
    (tmp_path / "out").write_text("")
    assert main(["validate", "catenary", "--quick", "-o", str(tmp_path / "out")]) == 2
    assert "out" in capsys.readouterr().err


def test_a_table_that_cannot_be_written_is_refused_before_anything_runs(capsys, tmp_path):
    for path in (tmp_path / "none" / "table.json", tmp_path):
        asked = ["validate", "catenary", "--quick", "--json", str(path), "-o", str(tmp_path / "out")]
        assert main(asked) == 2
        assert str(path) in capsys.readouterr().err and not (tmp_path / "out" / "catenary").exists()


def test_a_scene_that_a_protocol_ran_runs_again(tmp_path):
    assert main(["validate", "catenary", "--quick", "-o", str(tmp_path)]) == 0
    (scene,) = (tmp_path / "catenary").glob("*.toml")
    assert main(["run", str(scene), "-o", str(tmp_path / "again")]) == 0
