"""The examples from papers give what their page says."""

import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "examples"))
import cantilever
import drape
import snap


def test_cantilevers_fall_on_one_curve():
    found = cantilever.study(cells=24)
    for name in cantilever.STRIPS:
        error = np.abs(found[name] / found["elastica"] - 1.0)
        assert (error[:4] < 0.006).all() and (error < 0.08).all(), name


def test_a_roof_snaps():
    loads, sags, limits = snap.path(6.35e-3, cells=8)
    assert abs(limits[0] / snap.PUBLISHED[6.35e-3] - 1.0) < 0.05 and limits[1] < -300.0
    assert (np.diff(sags) < 0.0).any() and loads[-1] == snap.LOAD  # the path turns back, and arrives


def test_a_skirt_stands_as_drawn(tmp_path):
    assert 0.02 < drape.naive()[1] < 0.06
    found = drape.designed(tmp_path / "drape")
    proof = found.summary["inverse"]
    assert found.summary["stable"] and max(proof["sag"], proof["sag_disturbed"]) < 1e-9
    assert (tmp_path / "drape" / "pattern.svg").exists()
