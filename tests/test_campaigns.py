"""Short campaigns with damaged files and killed runs (scripts/campaign and scripts/fuzz run long ones)."""

import subprocess
import sys
from pathlib import Path

import pytest

SCRIPTS = Path(__file__).parents[1] / "scripts"
CASES = {"results": 40, "patterns": 40, "meshes": 36, "scenes": 40, "tears": 2}


def ran(*words):
    return subprocess.run([sys.executable, *words], capture_output=True, text=True, timeout=900)


@pytest.mark.parametrize(("what", "count"), CASES.items())
def test_no_damage_hurts(what, count):
    done = ran(SCRIPTS / "campaign", what, "--count", str(count), "--seed", "1")
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.parametrize("what", ["obj", "friction", "pattern"])
def test_readers_take_whatever_they_are_given(what, tmp_path):
    pytest.importorskip("atheris")
    done = ran(SCRIPTS / "fuzz", what, "--runs", "300", "--corpus", tmp_path)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "DONE" in done.stderr and not list(tmp_path.glob("crash*"))
