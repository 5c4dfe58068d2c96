"""Dry friction against theory: dragged sheet, capstan and its way back, stick and slip of a buckled strip."""

import numpy as np
import protocols
import pytest

from voile.contact.obstacles import Motion, Plane
from voile.validate.references.elastica import slip_onset


@pytest.mark.parametrize("friction", [0.1, 0.4, 1.5])
def test_dragged_sheet(friction):
    """A pull of mu N from the first step on; all work but the stretch's is lost as mu N times the path."""
    path, balance, pulls = protocols.dragged(friction, 8, 3)
    assert path.converged, path.reason
    assert pulls == pytest.approx(len(pulls) * [friction], rel=1e-8)
    work, gain, lost = balance.totals()
    assert work - gain == pytest.approx(lost, rel=1e-8)
    assert lost > 0.99 * work


@pytest.mark.parametrize(
    ("degrees", "friction"),
    [
        (30, 1.0),
        (180, 0.3),
        *(pytest.param(d, m, marks=pytest.mark.slow) for d in (90, 360, 540) for m in (0.1, 0.5)),
        *(pytest.param(d, m, marks=pytest.mark.slow) for d in (45, 270) for m in (0.2, 0.7)),
        pytest.param(540, 1.0, marks=pytest.mark.slow),
    ],
)
def test_capstan(degrees, friction):
    """T_pull = T_hold exp(mu phi) when all of the strip slips."""
    strip = protocols.capstan(degrees, friction, max(60, degrees))
    assert strip.path.converged, strip.path.reason
    assert strip.pulled[-1] == pytest.approx(np.exp(friction * np.radians(degrees)), rel=0.01)


@pytest.mark.parametrize(("degrees", "friction"), [(90, 0.5), pytest.param(180, 1.0, marks=pytest.mark.slow)])
def test_capstan_turns_around(degrees, friction):
    """Let back, the ratio goes through one to exp(-mu phi); what the ends' work does not store is lost by friction."""
    ratio = np.exp(friction * np.radians(degrees))
    strip = protocols.capstan(degrees, friction, 60, steps=20, back=1.0 - 0.5 / ratio)
    assert strip.path.converged, strip.path.reason
    assert strip.pulled[-1] == pytest.approx(ratio, rel=0.01)
    assert strip.back[-1] == pytest.approx(1.0 / ratio, rel=0.01)
    assert (np.diff(strip.back) < 1e-3 * ratio).all()
    work, gain, lost = strip.balance.totals()
    assert work - gain == pytest.approx(lost, rel=0.01)


@pytest.mark.skipif(not protocols.CURVES.exists(), reason=f"{protocols.CURVES} is not there")
def test_elastica_onset():
    for row in protocols.slips():
        assert slip_onset(row["friction"]) == pytest.approx(row["lowering_at_slip"], rel=1e-5)


@pytest.mark.parametrize(
    "friction",
    [0.05, *(pytest.param(f, marks=pytest.mark.slow) for f in (0.07, 0.1, 0.15, 0.2, 0.25, 0.3, 0.35))],
)
def test_stick_slip(friction):
    """The elastica's onset of slip within 1 %; the strip snaps to a stable equilibrium.

    Beyond mu = 0.36 that curve dips below the plane, where the strip lies on it instead."""
    expected = slip_onset(friction)
    slip = protocols.lowered_strip(friction, 1.06 * expected, 40, 25)
    assert slip.path.converged and slip.path.stable, slip.path.reason
    assert slip.before > 0.99 * expected and slip.after < 1.01 * expected
    assert slip.after - slip.before < 0.002 * expected
    assert any(step.method.startswith("snap") for step in slip.path.steps)


def test_long_steps_do_not_leave_the_branch():
    """With mu = 0.5 the tip holds until the strip's belly comes to lie on the plane; Newton's method alone jumps off
    at a lowering of 0.26, with |T|/N = 0.29."""
    slip = protocols.lowered_strip(0.5, 0.304, 40, 32)
    assert slip.path.converged and slip.path.stable, slip.path.reason
    assert np.isnan(slip.after) and np.isnan(slip.landed)
    assert not any(step.method.startswith("snap") for step in slip.path.steps)


@pytest.mark.parametrize("steps", [1, 4, 10])
def test_a_sheet_lies_still_on_a_plane_that_moves(steps):
    """Nothing supports it: friction carries it along, the first load step, which knows no reactions yet, included."""
    points, triangles = protocols.plate(0.3, 0.3, 0.05)
    shell = protocols.shell_of(points, triangles, young=1e6, thickness=1e-3, density=300.0)
    motion = Motion(
        displacement=np.array([0.2, 0.0, 0.1]),
        rotation=np.array([0.0, 0.0, 1.0]),
        center=np.array([1.0, 0.5, 0.0]),
    )
    floor = Plane(name="floor", friction=0.4, point=np.zeros(3), normal=protocols.UP, motion=motion)
    path, problem = protocols.solve(shell, floor, steps)
    assert path.converged and path.stable
    assert np.abs(problem.positions(path.state) - motion.place(points, 1.0)).max() < 1e-6
    report = path.steps[-1].contact
    assert report["slip"] == 0 and report["stick"] == len(points)


def test_without_friction_a_plane_slides_away_under_a_sheet():
    points, triangles = protocols.plate(0.3, 0.3, 0.05)
    shell = protocols.shell_of(points, triangles, young=1e6, thickness=1e-3, density=300.0)
    motion = Motion(displacement=np.array([0.2, 0.0, 0.0]))
    floor = Plane(name="floor", point=np.zeros(3), normal=protocols.UP, motion=motion)
    path, problem = protocols.solve(shell, floor, 2)
    assert path.converged
    assert np.abs(problem.positions(path.state) - points).max() < 1e-6
