"""Extreme friction, stiffness, thickness, starts and steps: an equilibrium that keeps the laws, or one line why not."""

import protocols
import pytest

CASES = protocols.extremes()
COSTLY = ("mu = 10", "mu = 0", "thickness 1e-6 of the size")
SLOW = {name for name in CASES if name.endswith(COSTLY)}
# Off the sphere a sheet slides without friction, and may with next to none: rounding decides which way it tips.
ENDS = {"sphere, mu = 0": "the shell slides", "sphere, mu = 0.001": "the shell slides"}


@pytest.mark.parametrize("name", [pytest.param(n, marks=pytest.mark.slow) if n in SLOW else n for n in CASES])
def test_extremes(name):
    path, problem = CASES[name]()[:2]
    if not path.converged:
        assert path.reason.startswith(ENDS[name]) and "\n" not in path.reason
        return
    assert path.stable and name != "sphere, mu = 0"
    report = path.steps[-1].contact
    assert report["active"] > 0
    assert report["max_penetration"] < 1e-10 * problem.size()
    assert report["friction_error"] < 1e-7
