"""The air's drag, Rayleigh damping, loads and supports in time, against exact motions."""

import numpy as np
import pytest
from moving import STEADY, cloth, move
from test_problem import sheet

from voile.contact.motion import Spell, Track
from voile.contact.obstacles import Plane
from voile.problem.damping import Air, Damping
from voile.problem.load import History
from voile.solver.stepping.schemes import SchemeOptions

G = 9.81
POINTS, TRIANGLES = sheet(4, 2)
AREAL = 0.3  # kg/m^2 of `cloth`


@pytest.mark.parametrize("wind", [pytest.param(0.0, marks=pytest.mark.slow), 2.0])
def test_a_sheet_falls_through_air_as_fast_as_it_drags(wind):
    drag, h = 0.6, 1e-3
    air = Air(np.array([5.0, 0.0, wind]), drag)  # what blows along the sheet does nothing
    run = move(cloth(POINTS, TRIANGLES), "generalized-alpha", h, 0.5, air=air)
    end = np.sqrt(AREAL * G / drag)
    if wind == 0.0:
        exact = end * np.tanh(G / end * 0.5)
        np.testing.assert_allclose(run.velocities[-1][:, 2], -exact, rtol=1e-4)
    np.testing.assert_allclose(run.velocities[-1][:, :2], 0.0, atol=1e-9)
    long = move(cloth(POINTS, TRIANGLES), "implicit-euler", 0.05, 5.0, air=air)
    assert long.velocities[-1][:, 2].mean() == pytest.approx(wind - end, rel=1e-3)  # it flutters on


def test_mass_damping_slows_what_flies():
    rate, h = 3.0, 1e-3
    run = move(
        cloth(POINTS, TRIANGLES, gravity=np.zeros(3)),
        "generalized-alpha",
        h,
        0.5,
        velocity=np.array([1.0, 0.0, 2.0]),
        damping=Damping(mass=rate),
    )
    np.testing.assert_allclose(
        run.velocities[-1], np.tile([1.0, 0.0, 2.0], (15, 1)) * np.exp(-0.5 * rate), rtol=1e-5, atol=1e-9
    )


def test_stiffness_damping_fades_a_vibration_by_its_frequency():
    """A mode's amplitude falls by exp(-b omega^2 t / 2)."""
    points, triangles = sheet(8, 2, 1.0, 0.2)
    fabric = {"young": 1e8, "poisson": 0.0, "thickness": 0.02, "density": 1000.0}
    shell = cloth(points, triangles, np.flatnonzero(points[:, 0] < 1e-9), gravity=np.zeros(3), **fabric)
    omega = 3.516 * np.sqrt(1e8 * 0.02**2 / 12.0 / 1000.0)
    kick = np.zeros_like(points)
    kick[:, 2] = 1e-3 * points[:, 0] ** 2 * (3.0 - points[:, 0])
    period, b = 2.0 * np.pi / omega, 0.02 / omega
    run = move(shell, "generalized-alpha", period / 100.0, 4.1 * period, kick, damping=Damping(stiffness=b))
    tip = np.abs(np.array([x[-1, 2] for x in run.positions]))
    first, last = tip[:100].max(), tip[-100:].max()
    waited = run.times[len(tip) - 100 + int(tip[-100:].argmax())] - run.times[int(tip[:100].argmax())]
    assert np.log(first / last) == pytest.approx(b * omega**2 * waited / 2.0, rel=0.05)


def test_loads_follow_their_history():
    laws = dict.fromkeys(STEADY, History(np.array([0.0, 0.2, 0.4]), np.array([0.0, 1.0, 1.0])))
    run = move(
        cloth(POINTS, TRIANGLES, load_laws=laws), "moreau-jean", 0.01, 0.4, asked=SchemeOptions(theta=0.5)
    )
    np.testing.assert_allclose(run.velocities[-1][:, 2], -G * (0.1 + 0.2), rtol=2e-5)


def test_supports_move_in_time():
    left = np.flatnonzero(POINTS[:, 0] < 1e-9)
    shift, begin, end = np.array([0.0, 0.0, 0.1]), 0.1, 0.3
    spell = Spell(displacement=shift, begin=begin, end=end)
    table = Track(
        times=np.array([0.0, 0.1, 0.3, 1.0]), rows=np.outer([0.0, 0.0, 1.0, 1.0], [*shift, 0, 0, 0])
    )
    ends = []
    for motion in (spell, table):
        shell = cloth(POINTS, TRIANGLES, left, gravity=np.zeros(3), moves=((left, motion),))
        run = move(shell, "implicit-euler", 0.01, 0.4, damping=Damping(mass=2.0))
        ends.append(run.end)
        held = np.array([x[left[0], 2] for x in run.positions])
        np.testing.assert_allclose(held, np.interp(run.times, [begin, end], [0.0, 0.1]), atol=1e-14)
        assert run.velocities[20][left, 2] == pytest.approx(0.5, rel=1e-9)
    np.testing.assert_allclose(ends[0], ends[1], atol=1e-12)


def test_a_sheet_sticks_to_a_belt_once_it_is_as_fast():
    """A plane that moves at 1 m/s takes a sheet along: it slips for v / (mu g), then they move as one."""
    belt = Plane(
        point=np.zeros(3),
        normal=np.array([0.0, 0.0, 1.0]),
        friction=0.5,
        motion=Spell(displacement=np.array([0.8, 0, 0]), end=0.8),
    )
    run = move(cloth(POINTS, TRIANGLES), "implicit-euler", 2e-3, 0.5, obstacles=[belt])
    speed = np.array([v[:, 0].mean() for v in run.velocities])
    t = np.array(run.times)
    np.testing.assert_allclose(speed, np.minimum(0.5 * G * t, 1.0), atol=1e-10)
    np.testing.assert_allclose(run.velocities[-1], np.tile([1.0, 0.0, 0.0], (15, 1)), atol=1e-11)
