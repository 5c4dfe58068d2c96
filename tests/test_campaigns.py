"""Short campaigns with damaged files and killed runs (scripts/campaign and scripts/fuzz run long ones)."""

import subprocess
import sys
from pathlib import Path

import pytest

SCRIPTS = Path(__file__).parents[1] / "scripts"
# count, seed; that of kills ends load steps on one rank and on two
CASES = {
    "results": (20, 1),
    "patterns": (40, 1),
    "meshes": (36, 1),
    "scenes": (40, 1),
    "tears": (2, 1),
    "kills": (2, 36),
}


def ran(*words):
    return subprocess.run([sys.executable, *words], capture_output=True, text=True, timeout=900)


@pytest.mark.parametrize("what", CASES)
def test_no_damage_hurts(what):
    count, seed = CASES[what]
    done = ran(SCRIPTS / "campaign", what, "--count", str(count), "--seed", str(seed))
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.parametrize("what", ["obj", "friction", "pattern"])
def test_readers_take_whatever_they_are_given(what, tmp_path):
    pytest.importorskip("atheris")
    done = ran(SCRIPTS / "fuzz", what, "--runs", "300", "--corpus", tmp_path)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "DONE" in done.stderr and not list(tmp_path.glob("crash*"))
