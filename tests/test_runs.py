"""Every run of runs/ against its expected.toml, through the command line."""

import subprocess
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest

from voile.results import read_result, read_summary

ROOT = Path(__file__).parents[1]
RUNS = sorted(path.parent.name for path in (ROOT / "runs").glob("*/expected.toml"))


@pytest.mark.parametrize("name", RUNS)
def test_run_meets_its_expectations(name, tmp_path):
    expected = tomllib.loads((ROOT / "runs" / name / "expected.toml").read_text())
    generator, *arguments, mesh = expected["mesh"]
    generate = [sys.executable, str(ROOT / "meshes" / generator), *arguments, str(tmp_path / mesh)]
    subprocess.run(generate, check=True, timeout=60)
    (tmp_path / "scene.toml").write_text((ROOT / "runs" / name / "scene.toml").read_text())
    run = [sys.executable, "-m", "voile.cli", "run", "scene.toml", "-o", "out"]
    done = subprocess.run(run, cwd=tmp_path, capture_output=True, text=True, timeout=300)
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
