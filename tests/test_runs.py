"""Every run of runs/ against its expected.toml, through the command line."""

import subprocess
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest
from command_line import voile

from voile.results import read_result, read_summary

ROOT = Path(__file__).parents[1]
RUNS = {path.parent.name: tomllib.loads(path.read_text()) for path in (ROOT / "runs").glob("*/expected.toml")}


def run(name: str, folder: Path, *options: str) -> subprocess.CompletedProcess[str]:
    """Generates the meshes of a run and runs its scene; result in folder/out."""
    for generator, *arguments, mesh in RUNS[name]["meshes"]:
        generate = [sys.executable, str(ROOT / "meshes" / generator), *arguments, str(folder / mesh)]
        subprocess.run(generate, check=True, timeout=60)
    (folder / "scene.toml").write_text((ROOT / "runs" / name / "scene.toml").read_text())
    return voile("run", "scene.toml", "-o", "out", *options, cwd=folder)


@pytest.mark.parametrize(
    "name",
    [pytest.param(name, marks=[pytest.mark.slow] * RUNS[name].get("slow", False)) for name in sorted(RUNS)],
)
def test_run_meets_its_expectations(name, tmp_path):
    expected = RUNS[name]
    done = run(name, tmp_path)
    assert done.returncode == 0, done.stderr
    result, summary = read_result(tmp_path / "out"), read_summary(tmp_path / "out" / "summary.json")
    assert expected["expect"]
    for item in expected["expect"]:
        if "summary" in item:
            assert summary[item["summary"]] == item["value"], item["source"]
            continue
        low, high = np.array(item["box"])
        chosen = ((result.start >= low) & (result.start <= high)).all(axis=1)
        moved = (result.points(-1) - result.start)[chosen, "xyz".index(item["displacement"])]
        assert len(moved)
        assert abs(moved.mean() - item["value"]) <= item["tolerance"], item["source"]


@pytest.mark.slow
def test_a_skirt_with_too_little_friction_slides_off_the_form(tmp_path):
    done = run("skirt-on-form", tmp_path, "--set", "obstacle.0.friction=0.02")
    assert done.returncode == 3, done.stderr
    assert "the shell slides" in done.stderr and "moves along (" in done.stderr
