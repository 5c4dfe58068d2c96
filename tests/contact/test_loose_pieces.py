"""Pieces of a shell that nothing but other pieces hold."""

import numpy as np
import pytest
from protocols import plate

import voile


@pytest.mark.parametrize("shift", [0.0, 0.25])
def test_a_loose_sheet_rests_on_a_held_one_or_falls_past_it(shift):
    """No obstacle is near: the supports carry both weights, or the run says that there is no equilibrium."""
    points, triangles = plate(0.2, 0.2, 0.034)
    points -= points.min(axis=0)
    border = np.flatnonzero(((points[:, :2] < 1e-9) | (points[:, :2] > 0.2 - 1e-9)).any(axis=1))
    loose = points * [0.5, 0.5, 1.0] + [0.05 + shift, 0.05, 0.003]
    both = np.vstack([points, loose]), np.vstack([triangles, triangles + len(points)])
    scene = {
        "shell": {"mesh": both, "young": 1e6, "thickness": 1e-3, "density": 200.0},
        "loads": {"gravity": [0.0, 0.0, -9.81]},
        "fix": [{"select": {"nodes": border.tolist()}}],
        "contact": {"self_contact": True, "self_friction": 0.3},
    }
    if shift:
        with pytest.raises(voile.NotConverged, match="the shell slides or falls"):
            voile.run(voile.load(scene))
        return
    summary = voile.run(voile.load(scene)).summary
    assert summary["stable"] and summary["contact"]["self_contacts"] > 0
    assert summary["supports"][0]["force"][2] == pytest.approx(0.05 * 0.2 * 9.81, rel=1e-6)
