"""Lengths of steps: cut before what they would lead through, chosen by their error, ended at rest."""

import numpy as np
import pytest
from mesh_helpers import plate_mesh
from moving import cloth, move
from mpi4py import MPI
from test_contact_in_time import on_slope
from test_problem import sheet

from voile.contact.crossing import entries
from voile.contact.motion import Spell
from voile.contact.obstacles import Box, MeshBody, Plane, Sphere, Torus
from voile.problem.contact import with_obstacles
from voile.problem.damping import Air, Damping
from voile.problem.problem import Problem
from voile.solver.methods.method import Outcome
from voile.solver.path_in_time import TimeOptions
from voile.solver.stepping.newton_step import NewtonStep
from voile.solver.stepping.schemes import SCHEMES, SchemeOptions
from voile.solver.stepping.time_path import Stepper


def thin_plate(**motion) -> Box:
    """1 mm thick, around z = 0."""
    return Box(center=np.zeros(3), sizes=np.array([1.0, 1.0, 5e-4]), friction=0.3, **motion)


@pytest.mark.parametrize("scheme", ["implicit-euler", "generalized-alpha", "moreau-jean"])
def test_a_fast_sheet_stays_above_a_thin_plate(scheme):
    points, triangles = sheet(4, 4, 0.2, 0.2)
    points += np.array([-0.1, -0.1, 0.2])
    run = move(
        cloth(points, triangles, rest_points=points),
        scheme,
        0.01,
        0.05,
        np.array([0.0, 0.0, -30.0]),
        [thin_plate()],
        offset=5e-4,
        tolerance=1e-6,
    )
    assert run.path.converged and run.path.attempts > run.path.count
    assert min(x[:, 2].min() for x in run.positions) > 1e-3 - 1e-9
    assert max(np.diff(run.times)) <= 0.01 + 1e-12


def test_a_fast_sheet_stays_above_a_thin_mesh():
    """A plate of 1 mm and 12 triangles, whose field is as fine as it needs by itself."""
    points, triangles = sheet(3, 3, 0.1, 0.1)
    points += np.array([-0.05, -0.05, 0.1])
    corners, faces = plate_mesh(0.16, 1e-3)
    body = MeshBody.around(np.roll(corners, 1, axis=1), faces, friction=0.3)
    shell = cloth(points, triangles, rest_points=points, model="koiter/tan/neo-hookean")
    run = move(shell, "implicit-euler", 5e-3, 0.02, np.array([0.0, 0.0, -30.0]), [body], 5e-4, tolerance=1e-6)
    assert run.path.converged
    assert min(x[:, 2].min() for x in run.positions) > 1e-3 - 2e-4


@pytest.mark.parametrize("until", [0.03 + 2e-5, 1.0])
def test_a_run_that_goes_on_in_tiny_steps_ends(monkeypatch, until):
    """Where from 0.03 s on only tiny steps converge; not where they lead back to longer ones."""
    solve, ends = NewtonStep.solve, [0.0]

    def reluctant(self, problem, y, tolerance):
        if 0.03 < problem.time < until and problem.time - ends[-1] > 3e-6:
            return Outcome(False, "", "not so fast")
        outcome = solve(self, problem, y, tolerance)
        ends.append(problem.time if outcome.converged else ends[-1])
        return outcome

    monkeypatch.setattr(NewtonStep, "solve", reluctant)
    path = move(cloth(*sheet(2, 2, 0.2, 0.2)), "implicit-euler", 0.01, 0.06).path
    assert path.converged == (until < 0.06)
    if not path.converged:
        assert 0.03 < path.time < 0.03 + 51 * 3e-6 and path.reason.startswith("not so fast; at time 0.03")
        assert "51 steps in a row were shorter than 0.001 of dynamics.time_step" in path.reason


def test_a_blunt_field_is_blamed():
    points, triangles = sheet(3, 3, 0.1, 0.1)
    points += np.array([-0.05, -0.05, 0.1])
    corners, faces = plate_mesh(0.16, 1e-3)
    body = MeshBody.around(np.roll(corners, 1, axis=1), faces, 0.014)
    shell = cloth(points, triangles, rest_points=points, model="koiter/tan/neo-hookean")
    run = move(shell, "implicit-euler", 5e-3, 0.02, np.array([0.0, 0.0, -30.0]), [body], 5e-4, tolerance=1e-6)
    assert not run.path.converged and "give it a resolution of 0.00095 m" in run.path.reason


def test_a_fast_plate_takes_a_sheet_along():
    points, triangles = sheet(3, 3, 0.2, 0.2)
    points += np.array([-0.1, -0.1, 0.2])
    rises = Spell(displacement=np.array([0.0, 0.0, 1.0]), end=0.01)  # at 100 m/s
    run = move(
        cloth(points, triangles, rest_points=points),
        "implicit-euler",
        2e-3,
        0.01,
        0.0,
        [thin_plate(motion=rises)],
        5e-4,
    )
    assert run.path.converged
    heights = [x[:, 2].min() - 100.0 * t for x, t in zip(run.positions, run.times, strict=True)]
    assert min(heights) > 1e-3 - 1e-9


def test_ways_across_bodies_are_seen():
    ball = Sphere(center=np.zeros(3), radius=0.1)
    points, triangles = sheet(1, 1)
    contact = with_obstacles(Problem(cloth(points, triangles), MPI.COMM_SELF), [ball], 0.0).contact
    start = np.array([[-1.0, 0.0, 0.05], [-1.0, 0.0, 0.2], [0.0, 0.0, 0.1], [0.0, 0.0, 0.1]])
    end = np.array(
        [[1.0, 0.0, 0.05], [1.0, 0.0, 0.2], [0.02, 0.0, np.sqrt(0.01 - 0.02**2)], [0.0, 0.0, -0.1]]
    )
    assert contact.crosses(start, 0.0, end, 1.0).tolist() == [True, False, False, True]


def test_ways_round_an_edge_are_no_ways_through():
    """Over an edge of a box from face to face, and off the top through the air; then to the face below."""
    points, triangles = sheet(1, 1)
    contact = with_obstacles(Problem(cloth(points, triangles), MPI.COMM_SELF), [thin_plate()], 0.0).contact
    top = np.array([0.98, 0.0, 5e-4])
    end = np.array([[1.0, 0.0, 2e-4], [1.3, 0.0, -0.1], [1.3, 0.0, 0.1], [0.98, 0.0, -5e-4]])
    start = np.array([top, top, top, top])
    start[1, 2] = 0.4
    assert contact.crosses(start, 0.0, end, 1.0).tolist() == [False, False, False, True]


@pytest.mark.parametrize("friction", [0.0, 0.3])
def test_a_sheet_slides_over_an_edge_in_whole_steps(friction):
    """As long as a turn by a right angle was taken for a way through, 15 and 11 of its steps were cut."""
    points, triangles = sheet(8, 4, 0.2, 0.1)
    points += np.array([-0.15, -0.05, 1e-3])
    body = Box(center=np.array([-0.5, 0.0, -0.1]), sizes=np.array([0.5, 0.5, 0.1]), friction=friction)
    shell = cloth(points, triangles, rest_points=points, young=1e5)
    along = np.array([1.0, 0.0, 0.0])
    run = move(shell, "implicit-euler", 5e-3, 0.3, along, [body], 5e-4, tolerance=1e-6)
    assert run.path.converged and run.path.attempts == run.path.count == 60
    assert run.end[:, 0].min() > 0.1 and run.end[:, 2].max() < -0.1  # it has fallen off


def test_steps_follow_their_local_error():
    points, triangles = sheet(6, 3)
    shell = cloth(points, triangles, np.flatnonzero(points[:, 0] < 1e-9), young=1e5)
    exact = move(shell, "generalized-alpha", 1e-3, 0.3).end
    away, counts = [], []
    for accuracy in (1e-3, 1e-5):
        run = move(shell, "generalized-alpha", 0.05, 0.3, accuracy=accuracy)
        assert run.path.converged and max(np.diff(run.times)) <= 0.05 + 1e-12
        away.append(np.abs(run.end - exact).max())
        counts.append(run.path.count)
    assert away[0] < 0.03 and away[1] < 0.1 * away[0] and counts[0] < counts[1] < 150


def test_a_run_ends_at_rest():
    run, *_ = on_slope(0.0, 0.0, "implicit-euler", 1e-2, 5.0, 1.0, friction=0.3, stop_at_rest=1e-3)
    assert run.path.reason.startswith("at rest") and run.times[-1] == pytest.approx(
        1.0 / (0.3 * 9.81), abs=0.02
    )


def test_a_run_at_rest_goes_on_with_no_step():
    """As one does that was killed after its last step."""
    run, *_ = on_slope(0.0, 0.0, "implicit-euler", 1e-2, 5.0, 1.0, friction=0.3, stop_at_rest=1e-3)
    options = TimeOptions(SCHEMES["implicit-euler"](SchemeOptions()), 1e-2, 5.0, 1e-9, stop_at_rest=1e-3)
    count, run.path.converged = run.path.count, False
    Stepper(run.problem, options, run.solver, run.path).follow()
    assert run.path.count == count and run.path.converged and run.path.reason.startswith("at rest")


@pytest.mark.parametrize("pushed", ["pressure", "wind"])
def test_a_sail_comes_to_rest_without_weight(pushed):
    """Its time is that in which pressure or air move it. With weight alone it had minutes, and the run went on."""
    points, triangles = sheet(4, 4, 0.4, 0.4)
    rim = (np.abs(points[:, :2] - 0.2).max(axis=1) > 0.2 - 1e-9)[:, None]
    air = Air(np.array([0.0, 0.0, 5.0]), 0.6) if pushed == "wind" else None
    loads = {"gravity": np.zeros(3), "pressure": 0.0 if air else 15.0}
    shell = cloth(points, triangles, fixed=np.repeat(rim, 3, axis=1), **loads)
    run = move(
        shell,
        "implicit-euler",
        1e-2,
        3.0,
        stop_at_rest=1e-5,
        air=air,
        damping=Damping(mass=20.0),
        tolerance=1e-6,
    )
    assert run.path.reason.startswith("at rest") and 0.1 < run.times[-1] < 1.5 and run.end[:, 2].max() > 0.01


def test_what_falls_from_rest_is_not_at_rest():
    points, triangles = sheet(2, 2)
    run = move(cloth(points, triangles), "implicit-euler", 1e-3, 0.05, stop_at_rest=0.1)
    assert run.times[-1] == 0.05


def test_extremes_converge():
    """Steps of 1e-6 to 1 s, stiffness over 12 decades, any friction, thin and thick, one triangle: a sheet lands."""
    flat, triangles = sheet(2, 2, 0.2, 0.2)
    one = np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.0, 0.1, 0.0]]), np.array([[0, 1, 2]], dtype=np.int32)
    cases = [(h, {}, 0.3, (flat, triangles)) for h in (1e-6, 1e-4, 1e-2, 1.0)]
    cases += [(1e-3, {"young": young}, 0.3, (flat, triangles)) for young in (1e-1, 1e11)]
    cases += [(1e-3, {"thickness": thickness}, 0.3, (flat, triangles)) for thickness in (2e-7, 0.1)]
    cases += [(1e-3, {}, friction, (flat, triangles)) for friction in (0.0, 10.0)]
    cases += [(1e-3, {}, 0.3, one)]
    for h, fabric, friction, (rest, corners) in cases:
        ground = Plane(point=np.zeros(3), normal=np.array([0.0, 0.0, 1.0]), friction=friction)
        shell = cloth(rest + np.array([0.0, 0.0, 1e-3]), corners, rest_points=rest, **fabric)
        run = move(shell, "implicit-euler", h, 10 * h, np.array([0.5, 0.0, -1.0]), [ground], tolerance=1e-6)
        assert run.path.converged, (h, fabric, friction, run.path.reason)
        assert min(x[:, 2].min() for x in run.positions) > -1e-12


class Counted:
    """A gap that counts how often it is asked."""

    def __init__(self, body):
        self.body, self.asked = body, 0

    def __call__(self, points, rows):
        self.asked += 1
        return self.body.derivatives(points)[:2]


@pytest.mark.parametrize("hover", [1e-9, 1e-6, 1e-3])
def test_ways_of_what_hovers_take_few_places(hover):
    """Along a plane, and over a ball, which the second way enters at a flat angle."""
    ground = Counted(Plane(point=np.zeros(3), normal=np.array([0.0, 0.0, 1.0])))
    begin, end = np.array([[0.0, 0.0, hover]]), np.array([[0.3, 0.0, hover]])
    assert not entries(begin, end, ground, np.inf, 1e-10).any() and ground.asked == 1
    ball = Counted(Sphere(center=np.zeros(3), radius=0.2))
    begin, end = np.array([[0.0, 0.0, 0.2 + hover]] * 2), np.array([[0.0, 0.02, 0.203], [0.0, 0.02, 0.19]])
    entered = entries(begin, end, ball, np.inf, 1e-10).any(axis=1)
    assert entered.tolist() == [False, True] and ball.asked < 60


def test_ways_through_thin_things_are_seen():
    """A box of 1 um across the way, anywhere; and a thin tube of a torus, of which nothing is known but its radius."""
    rng = np.random.default_rng(5)
    sheetlike = Counted(Box(center=np.zeros(3), sizes=np.array([1.0, 1.0, 1e-6])))
    begin = rng.uniform(-0.4, 0.4, (200, 3))
    end = rng.uniform(-0.4, 0.4, (200, 3))
    across = begin[:, 2] * end[:, 2] < 0.0
    assert (
        entries(begin, end, sheetlike, np.inf, 1e-12).any(axis=1) == across
    ).all() and sheetlike.asked < 60
    ring = Torus(center=np.zeros(3), axis=np.array([0.0, 0.0, 1.0]), radius=0.3, tube=1e-3)
    counted = Counted(ring)
    passing = entries(begin, end, counted, ring.finest, 1e-12).any(axis=1)
    share = np.linspace(0.0, 1.0, 20001)[:, None]
    sampled = [ring.distance(a + share * (b - a)).min() < -1e-9 for a, b in zip(begin, end, strict=True)]
    assert (passing >= sampled).all() and passing.sum() <= sum(sampled) + 1 and counted.asked < 500
