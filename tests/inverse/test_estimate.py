"""Parameters from observed equilibria: exact data, noisy data, and data that cannot tell."""

from dataclasses import replace

import numpy as np
import pytest
from inverse_shells import folded_skirt, grid, hanging_sheet, shell, strip
from mpi4py import MPI

from voile.contact.obstacles import Cylinder, Motion, Plane
from voile.errors import InputError, NotConverged
from voile.inverse.estimate import Estimation
from voile.inverse.observation import Observation, UnknownRest
from voile.problem.contact import with_obstacles
from voile.problem.problem import Problem
from voile.solver.path import StaticsOptions, require
from voile.solver.statics import solve_statics

YOUNG, DENSITY, FRICTION = 2e8, 300.0, 0.4
UPWARDS = {"gravity": np.array([0.0, 0.0, 9.81])}


def simulated(of, obstacles=(), steps=1, tolerance=1e-12):
    """(n, 3) where a shell comes to rest."""
    problem = Problem(of, MPI.COMM_SELF)
    problem = with_obstacles(problem, list(obstacles), 0.0)
    path = require(solve_statics(problem, StaticsOptions(load_steps=steps, tolerance=tolerance)))
    return problem.positions(path.state)


def seen(of, points, noise=0.0, seed=0) -> Problem:
    """The problem of a shell observed at `points`, with normal noise of `noise` sizes."""
    size = np.linalg.norm(np.ptp(points, axis=0))
    disturbance = noise * size * np.random.default_rng(seed).standard_normal(points.shape)
    return Problem(replace(of, points=points + disturbance * ~of.fixed), MPI.COMM_SELF)


@pytest.fixture(scope="module")
def observed():
    """A sheet draped with YOUNG."""
    return simulated(hanging_sheet(young=YOUNG))


def estimation(observed, names, noise=0.0, seed=0, **guess):
    of = hanging_sheet(**{"young": YOUNG, **guess})
    return Estimation([Observation(seen(of, observed, noise, seed))], names)


@pytest.mark.parametrize("share", [0.1, pytest.param(0.2, marks=pytest.mark.slow), 10.0])
def test_a_poor_guess_of_folded_cloth_does_not_stay_on_another_branch(share):
    """Without another look from the observed shape these guesses end 11 % too high to 25 % too low."""
    drape = simulated(folded_skirt(young=2e6))
    found = Estimation([Observation(seen(folded_skirt(young=share * 2e6), drape))], ("young",)).solve()
    assert found.values["young"] == pytest.approx(2e6, rel=1e-9)


@pytest.mark.parametrize(
    ("name", "guess", "exact"),
    [
        ("young", 10 * YOUNG, YOUNG),
        ("young", 0.3 * YOUNG, YOUNG),
        ("density", 600.0, DENSITY),
        ("thickness", 2e-3, 1e-3),
        ("poisson", 0.1, 0.3),
    ],
)
def test_exact_drape_gives_back_each_parameter(observed, name, guess, exact):
    found = estimation(observed, (name,), **{name: guess}).solve()
    assert found.values[name] == pytest.approx(exact, rel=1e-6)
    assert found.deviations[name] < 1e-4 * exact and found.misfit < 1e-9


def test_noise_leaves_the_estimate_within_its_own_deviation(observed):
    """Over several seeds the error over the predicted deviation is that of a unit normal variable."""
    ratios = []
    for seed in range(6):
        found = estimation(observed, ("young",), noise=1e-3, seed=seed, young=2 * YOUNG).solve()
        ratios.append((found.values["young"] - YOUNG) / found.deviations["young"])
        assert found.deviations["young"] < 0.05 * YOUNG
    assert np.sqrt(np.mean(np.square(ratios))) < 2.0
    assert np.abs(ratios).max() < 3.0


def test_two_parameters_that_leave_different_traces_are_both_found(observed):
    found = estimation(observed, ("young", "thickness"), young=1.5 * YOUNG, thickness=0.9e-3).solve()
    assert found.values["young"] == pytest.approx(YOUNG, rel=1e-3)
    assert found.values["thickness"] == pytest.approx(1e-3, rel=1e-3)


def test_differences_of_simulations_agree_with_tangents(observed):
    of = estimation(observed, ("young", "poisson"), young=2 * YOUNG)
    p, states = of.start, of._simulate(of.start)
    by_tangents, by_differences = of._by_tangents(p, states)[0], of._by_differences(p)[0]
    assert np.abs(by_differences - by_tangents).max() < 1e-5 * np.abs(by_tangents).max()


# ---- several observations ----


def test_modulus_and_density_scale_together_and_are_refused(observed):
    with pytest.raises(InputError, match="cannot tell young and density apart"):
        estimation(observed, ("young", "density"), young=3 * YOUNG).solve()


def test_a_second_observation_under_a_known_load_tells_modulus_and_density_apart(observed):
    exact, guess = {"young": YOUNG, "density": DENSITY}, {"young": 3 * YOUNG, "density": 500.0}
    force = np.zeros(observed.shape)
    force[-1] = [0.0, 0.02, 0.05]
    loaded = simulated(hanging_sheet(force=force, **exact))
    observations = [
        Observation(seen(hanging_sheet(**guess), observed)),
        Observation(seen(hanging_sheet(force=force, **guess), loaded)),
    ]
    found = Estimation(observations, ("young", "density")).solve()
    for name, value in exact.items():
        assert found.values[name] == pytest.approx(value, rel=1e-6)
        assert found.deviations[name] < 1e-4 * value


def test_modulus_and_rest_shape_are_found_together_from_two_observations(observed):
    """The sheet as it hangs gives the rest shape for any modulus; as it stands upside down, the modulus."""
    other = simulated(hanging_sheet(young=YOUNG, **UPWARDS))
    guess = hanging_sheet(young=2 * YOUNG)
    guess = replace(guess, points=observed, rest_points=observed)  # the rest shape that is given is not used
    upside_down = replace(guess, points=other, rest_points=other, **UPWARDS)
    unknown = UnknownRest(Problem(guess, MPI.COMM_SELF), guess)
    found = Estimation(
        [Observation(Problem(upside_down, MPI.COMM_SELF))], ("young",), unknown=unknown
    ).solve()
    assert found.values["young"] == pytest.approx(YOUNG, rel=1e-6)
    np.testing.assert_allclose(found.rest, hanging_sheet().points, atol=1e-8)


# ---- with contact ----

DRUM = Cylinder(
    name="drum", friction=FRICTION, center=np.array([0.12, 0, -0.05]), axis=np.array([0, 1.0, 0]), radius=0.04
)


def sheet(**more):
    """A sheet held along one edge, above a drum that lies across."""
    points, triangles = grid(10, 4, 0.3, 0.12)
    points = points @ np.array([[0.98, 0.2, 0.0], [-0.2, 0.98, 0.0], [0.0, 0.0, 1.0]])
    fixed = np.zeros(points.shape, dtype=bool)
    fixed[:10] = True
    return shell(points, triangles, fixed, **{"young": 2e7, **more})


@pytest.fixture(scope="module")
def draped():
    return simulated(sheet(), [DRUM], tolerance=1e-9)


def on_the_drum(draped, names, noise=0.0, seed=0, friction=FRICTION, **guess):
    drum = replace(DRUM, friction=friction)
    problem = seen(sheet(**guess), draped, noise, seed)
    return Estimation([Observation(problem, obstacles=(drum,))], names, 1e-9)


@pytest.mark.parametrize("factor", [pytest.param(0.3, marks=pytest.mark.slow), 3.0])
def test_exact_drape_on_an_obstacle_with_friction_gives_back_the_modulus(draped, factor):
    found = on_the_drum(draped, ("young",), young=factor * 2e7).solve()
    assert found.values["young"] == pytest.approx(2e7, rel=1e-5)
    assert found.deviations["young"] < 1e-4 * 2e7 and found.misfit < 1e-9


def test_noise_on_an_obstacle_leaves_the_estimate_within_its_own_deviation(draped):
    """The start of the way is known. From the noisy shape itself friction would hold what noise has strained."""
    size, ratios = np.linalg.norm(np.ptp(draped, axis=0)), []
    for seed in range(3):
        noise = 1e-3 * size * np.random.default_rng(seed).standard_normal(draped.shape)
        problem = Problem(sheet(young=1.5 * 2e7), MPI.COMM_SELF)
        found = Estimation([Observation(problem, draped + noise, (DRUM,))], ("young",), 1e-9).solve()
        ratios.append((found.values["young"] - 2e7) / found.deviations["young"])
        assert found.deviations["young"] < 0.05 * 2e7
    assert np.sqrt(np.mean(np.square(ratios))) < 2.0
    assert np.abs(ratios).max() < 3.0


def test_friction_is_refused_where_nothing_slips(draped):
    with pytest.raises(InputError, match="does not depend on friction near 0.9"):
        on_the_drum(draped, ("friction",), friction=0.9).solve()
    with pytest.raises(InputError, match="touches nothing"):
        Estimation([Observation(seen(sheet(), draped))], ("friction",))


@pytest.mark.parametrize(
    "guess, ends", [(0.2, "does not depend on friction near 0.8"), (0.01, "slides or falls")]
)
def test_a_guess_of_friction_under_which_the_shell_slides_is_doubled(guess, ends):
    """A sheet on an incline of 30 degrees (tangent 0.577); what holds there does not depend on friction."""
    points, triangles = grid(4, 4, 0.2, 0.2)
    turn = np.radians(30.0)
    normal = np.array([-np.sin(turn), 0.0, np.cos(turn)])
    lying = points @ np.array([[np.cos(turn), 0.0, np.sin(turn)], [0.0, 1.0, 0.0], normal])
    incline = Plane(name="incline", friction=guess, point=np.zeros(3), normal=normal)
    of = shell(lying, triangles, np.zeros(lying.shape, dtype=bool), young=1e8)
    with pytest.raises((InputError, NotConverged), match=ends):
        Estimation([Observation(seen(of, lying), obstacles=(incline,))], ("friction",), 1e-9).solve()


@pytest.mark.parametrize("guess", [0.15, pytest.param(0.5, marks=pytest.mark.slow)])
def test_friction_is_found_from_where_slip_has_led(guess):
    """A cantilever onto whose end a floor rises and goes away sideways: its start and its end are observed."""
    rise = Motion(displacement=np.array([0.05, 0.0, 0.12]))

    def floor(friction):
        return Plane(
            name="floor", friction=friction, point=np.array([0, 0, -0.15]), normal=np.array([0, 0, 1.0]), motion=rise
        )  # fmt: skip

    def cantilever():
        return strip(6, 0.3, 0.05, bending="tan", young=1e8)

    end = simulated(cantilever(), [floor(FRICTION)], 5, tolerance=1e-9)
    problem = Problem(cantilever(), MPI.COMM_SELF)
    found = Estimation([Observation(problem, end, (floor(guess),), steps=5)], ("friction",), 1e-9).solve()
    assert found.values["friction"] == pytest.approx(FRICTION, rel=1e-5)


def test_first_guesses_that_no_search_can_start_from_are_refused(observed):
    with pytest.raises(InputError, match="first guess of poisson is 0; allowed: above 0"):
        of = hanging_sheet()
        Estimation([Observation(seen(replace(of, poisson=0.0 * of.poisson), observed))], ("poisson",))
    with pytest.raises(InputError, match="young differs from part to part"):
        of = hanging_sheet()
        young = of.young * np.linspace(1.0, 2.0, len(of.young))
        Estimation([Observation(seen(replace(of, young=young), observed))], ("young",))
