"""Impact and dry friction in time against exact motions of a rigid sheet on a plane."""

import numpy as np
import pytest
from moving import Recorded, cloth, move
from scipy.spatial.transform import Rotation
from test_problem import sheet

import voile
from voile.cli import main
from voile.contact.motion import Spell
from voile.contact.obstacles import Plane, Sphere
from voile.mesh import write_obj
from voile.solver.stepping.schemes import SCHEMES, SchemeOptions

G = 9.81


def on_slope(angle: float, height: float, scheme: str, h: float, duration: float, along: float = 0.0, **more):
    """A sheet parallel to a plane that falls along x by `angle`, `height` (m) above it, at a speed along it: the run,
    mean ways (k,) and speeds (k,) along the slope."""
    laws = {name: more.pop(name, 0.0) for name in ("friction", "restitution")}
    turn = Rotation.from_euler("y", angle).as_matrix()
    flat, triangles = sheet(3, 3, 0.2, 0.2)
    rest = (flat - flat.mean(axis=0)) @ turn.T
    plane = Plane(point=np.zeros(3), normal=turn[:, 2], **laws)
    points = rest + np.array([0.0, 0.0, height])
    shell = cloth(points, triangles, rest_points=rest)
    run: Recorded = move(shell, scheme, h, duration, along * turn[:, 0], [plane], **more)
    assert run.path.converged
    way = np.array([(x - points).mean(axis=0) @ turn[:, 0] for x in run.positions])
    speed = np.array([v.mean(axis=0) @ turn[:, 0] for v in run.velocities])
    return run, way, speed


@pytest.mark.parametrize("scheme", SCHEMES)
def test_a_plate_falls_on_a_slope(scheme):
    """Ly et al. 2020, figure 5: a perfectly plastic impact with friction, then a constant acceleration."""
    angle, mu, height, h = np.pi / 4, 0.1, 0.2, 1e-3
    run, _, speed = on_slope(angle, height, scheme, h, 0.25, friction=mu)
    t, impact = np.array(run.times), np.sqrt(2.0 * height / G)
    share = np.sin(angle) - mu * np.cos(angle)
    touches = np.array([step.contact["active"] for step in run.steps]) > 0
    first = int(np.argmax(touches))
    assert touches[first:].all() and abs(t[first] - impact) <= h
    after = slice(first + 1, None)  # it lands in one step and is stopped in the next
    np.testing.assert_allclose(speed[after], G * share * t[after], rtol=1e-3)
    assert (speed[-1] - speed[first + 5]) / (t[-1] - t[first + 5]) == pytest.approx(G * share, rel=1e-6)
    assert np.ptp(run.velocities[-1], axis=0).max() < 1e-9
    assert run.solver.counts.factorisations < 1.2 * run.path.count


@pytest.mark.parametrize("scheme", SCHEMES)
def test_a_sliding_sheet_stops_and_then_does_not_move_at_all(scheme):
    mu, speed, h = 0.3, 1.0, 2e-3
    run, way, _ = on_slope(0.0, 0.0, scheme, h, 0.5, speed, friction=mu)
    still = np.array([np.abs(v).max() < 1e-12 for v in run.velocities])
    stop = int(np.argmax(still))
    assert still[stop:].all() and run.times[stop] == pytest.approx(speed / (mu * G), abs=h)
    assert way[-1] == pytest.approx(speed**2 / (2.0 * mu * G), abs=speed * h)
    assert max(np.abs(x - run.positions[stop]).max() for x in run.positions[stop:]) < 1e-14
    assert run.steps[-1].contact["slip"] == 0


@pytest.mark.parametrize("share", [1.00001, 0.99999])
def test_a_slope_at_the_angle_of_friction(share):
    angle = 0.4
    run, _, speed = on_slope(
        angle, 0.0, "implicit-euler", 1e-2, 0.5, friction=share * np.tan(angle), tolerance=1e-12
    )
    if share > 1.0:
        assert np.abs(run.velocities).max() < 1e-12
    else:
        exact = G * np.sin(angle) * (1.0 - share)
        np.testing.assert_allclose(speed, exact * np.array(run.times), rtol=1e-6)


def test_restitution_lifts_a_sheet_to_its_square():
    height, e = 0.2, 0.5
    rises = []
    for h in (2e-3, 1e-3):
        run, *_ = on_slope(0.0, height, "moreau-jean", h, 0.4, restitution=e, friction=0.3)
        t, z = np.array(run.times), np.array([x[:, 2].mean() for x in run.positions])
        rises.append(z[t > np.sqrt(2.0 * height / G) + h].max() - e**2 * height)
        assert z.min() >= 0.0
    assert 0.0 <= -rises[1] < 1e-3 and -rises[1] < 0.6 * -rises[0] + 1e-4  # as the fall, of first order


@pytest.mark.parametrize("e", [0.5, 0.8])
def test_rebounds_are_of_second_order(e):
    """Free flight at theta = 1/2 is exact on parabolas, and so is what leaves the plane; the next step is Euler's."""
    height, h = 0.2, 4.1e-3
    run, *_ = on_slope(0.0, height, "moreau-jean", h, 0.35, restitution=e, asked=SchemeOptions(theta=0.5))
    t, impact = np.array(run.times), np.sqrt(2.0 * height / G)
    after, speed = t > impact, e * G * impact
    exact = speed * (t - impact) - 0.5 * G * (t - impact) ** 2
    z, v = (np.array([row[:, 2].mean() for row in rows]) for rows in (run.positions, run.velocities))
    assert abs(z[after][0] - exact[after][0]) < 1e-11
    np.testing.assert_allclose(z[after][1:], exact[after][1:] - 0.5 * G * h**2, atol=1e-9)
    np.testing.assert_allclose(v[after], speed - G * (t[after] - impact), atol=1e-9)


def test_an_impact_rubs_with_no_more_than_its_share():
    """A tilted throw: the tangential impulse is mu times the normal one, or what stops it."""
    for speed, mu in ((2.0, 0.3), (0.1, 0.3)):
        run, _, along = on_slope(0.0, 0.05, "moreau-jean", 1e-3, 0.15, speed, friction=mu, restitution=0.5)
        before = int(np.argmax([step.contact["active"] > 0 for step in run.steps])) - 1
        normal = run.velocities[before + 2][:, 2].mean() - run.velocities[before][:, 2].mean() + 2e-3 * G
        assert along[before] - along[before + 2] == pytest.approx(min(mu * normal, speed), rel=1e-9)


def test_a_turning_ball_takes_a_sheet_along_by_friction():
    """A drape on a ball at 3 rad/s: at mu = 0.5 it turns with it, at 0.05 it slips and follows."""
    points, triangles = sheet(6, 6, 0.24, 0.24)
    points -= points.mean(axis=0)
    near = np.hypot(points[:, 0], points[:, 1]) < 0.07
    center, rate, duration = np.array([0.0, 0.0, -0.1]), 3.0, 0.4
    turns = Spell(rotation=np.array([0.0, 0.0, rate * duration]), center=center, end=duration)
    found = []
    for friction in (0.05, 0.5):
        ball = Sphere(center=center, radius=0.1, friction=friction, motion=turns)
        shell = cloth(points, triangles, young=5e4, model="koiter/tan/neo-hookean")
        run = move(shell, "implicit-euler", 5e-3, duration, 0.0, [ball], tolerance=1e-6)
        assert run.path.converged and max(step.contact["max_penetration"] for step in run.steps) < 1e-12
        x, v = run.end[near], run.velocities[-1][near]
        found.append((x[:, 0] * v[:, 1] - x[:, 1] * v[:, 0]).sum() / (x[:, :2] ** 2).sum())
        assert run.path.books.totals["obstacles_work"] > 0.0
        assert run.solver.counts.factorisations < 5 * run.path.count
    assert 0.1 < found[0] < 0.8 * rate and found[1] == pytest.approx(rate, rel=0.02)


def test_layers_may_touch_from_the_start_on(tmp_path):
    points, triangles = sheet(4, 4, 0.1, 0.1)
    both = np.concatenate([points, points + np.array([0.0, 0.0, 0.95e-3])])
    write_obj(tmp_path / "sheets.obj", both, np.concatenate([triangles, triangles + len(points)]))
    scene = tmp_path / "scene.toml"
    scene.write_text(
        '[scene]\ntask = "dynamics"\n[shell]\nmesh = "sheets.obj"\nmodel = "projective"\n'
        "young = 1e5\nthickness = 1e-3\ndensity = 300.0\n[contact]\nself_contact = true\n"
        "[loads]\ngravity = [0.0, 0.0, -9.81]\n"
        "[dynamics]\ntime_step = 0.005\nduration = 0.02\n"
    )
    for solver in ("newton", "local-global"):
        assert (
            main(["run", str(scene), "-o", str(tmp_path / solver), "--set", f'dynamics.solver="{solver}"'])
            == 0
        )


@pytest.mark.parametrize("solver", ["newton", "local-global"])
def test_what_has_stopped_does_not_move_at_all(solver):
    """Not even by the tolerance of its steps: they begin where the obstacle carries what sticks."""
    points, triangles = sheet(4, 4, 0.2, 0.2)
    scene = {
        "scene": {"task": "dynamics"},
        "shell": {
            "mesh": (points, triangles),
            "model": "projective",
            "young": 1e6,
            "thickness": 1e-3,
            "density": 300.0,
            "velocity": [0.5, 0.0, 0.0],
        },
        "loads": {"gravity": [0.0, 0.0, -G]},
        "obstacle": [
            {"shape": "plane", "point": [0.0, 0.0, 0.0], "normal": [0.0, 0.0, 1.0], "friction": 0.45}
        ],
        "contact": {"offset": 0.0},
        "dynamics": {"time_step": 2e-3, "duration": 0.4, "solver": solver},
    }
    result = voile.run(scene)
    stopped = result.times > 0.2
    shapes = [result.points(k) for k in np.flatnonzero(stopped)]
    assert max(np.abs(x - shapes[0]).max() for x in shapes) < 1e-14


def test_a_tilted_sheet_lands_row_by_row():
    """Each step closes rows and stretches what it turns, to second order; nothing opens for that alone (E h is 8 times
    a vertex's inertia: with it the semismooth method cycled in half of these steps)."""
    points, triangles = sheet(24, 24, 0.25, 0.25)
    x, tilt = points[:, 0] - points[:, 0].min(), np.radians(5.0)
    tilted = np.column_stack([np.cos(tilt) * x, points[:, 1], 0.02 + np.sin(tilt) * x])
    shell = cloth(tilted, triangles, rest_points=points, young=1e4, poisson=0.3, model="projective//")
    plane = Plane(point=np.zeros(3), normal=np.array([0.0, 0.0, 1.0]), friction=0.5)
    run = move(shell, "implicit-euler", 5e-3, 0.1, obstacles=[plane], tolerance=1e-5)
    assert run.path.converged and {step.method for step in run.steps} <= {"prediction", "semismooth"}
    landing = [step.iterations for step in run.steps if step.contact["active"]]
    assert len(landing) > 5 and np.mean(landing) < 6.0
    counts = run.solver.counts  # three solves of an iteration, one of those in the middle of a step
    assert counts.solves < 2.5 * counts.factorisations


def test_layers_that_start_too_near_keep_their_distance():
    """Two sheets, half a thickness apart, fall and land together: nothing throws them apart."""
    lower, triangles = sheet(4, 4, 0.2, 0.2)
    upper = 0.8 * lower + np.array([0.023, 0.022, 0.0005])
    points = np.vstack([lower, upper]) + np.array([0.0, 0.0, 0.002])
    mesh = points, np.vstack([triangles, triangles + len(lower)])
    result = voile.run(
        {
            "scene": {"task": "dynamics"},
            "shell": {"mesh": mesh, "young": 1e5, "thickness": 1e-3, "density": 300.0, "bending": "average"},
            "loads": {"gravity": [0.0, 0.0, -G]},
            "obstacle": [
                {"shape": "plane", "point": [0.0, 0.0, 0.0], "normal": [0.0, 0.0, 1.0], "friction": 0.3}
            ],
            "contact": {"self_contact": True, "offset": 5e-4},
            "dynamics": {"time_step": 2e-3, "duration": 0.03},
        }
    )
    falls = result.points(5)[:, 2] - points[:, 2]
    np.testing.assert_allclose(falls, -0.5 * G * 0.01 * 0.012, rtol=1e-9)
    np.testing.assert_allclose(result.positions[len(lower) :, 2], 1e-3, atol=1e-9)
