"""Short campaigns with damaged files (scripts/campaign runs long ones)."""

import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = Path(__file__).parents[1] / "scripts" / "campaign"


@pytest.mark.parametrize(("what", "count"), [("results", 40), ("meshes", 36), ("scenes", 40)])
def test_no_damage_hurts(what, count):
    done = subprocess.run(
        [sys.executable, SCRIPT, what, "--count", str(count), "--seed", "1"],
        capture_output=True,
        text=True,
        timeout=900,
    )
    assert done.returncode == 0, done.stdout + done.stderr
