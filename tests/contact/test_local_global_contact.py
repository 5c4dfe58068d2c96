"""Projective Dynamics with dry friction: what sticks stays, what slides slides as Coulomb says."""

import resource
from dataclasses import replace
from pathlib import Path

import numpy as np
import protocols
import pytest
from falling import G, Slope, cloth, turning_sphere
from local_global_ranks import OFFSET, stack
from marching import ALWAYS, March
from test_problem import make_shell, sewn_panels, sheet

from voile.problem.contact import shell_layers, with_obstacles
from voile.problem.problem import Problem
from voile.solver.cascade import Cascade
from voile.solver.methods.augmented_lagrangian import AugmentedLagrangian
from voile.solver.methods.augmented_lagrangian import Options as LagrangianOptions
from voile.solver.methods.descent import Descent
from voile.solver.methods.local_global import LocalGlobal, Options
from voile.solver.methods.method import Workspace
from voile.solver.methods.semismooth import Semismooth, law_norms


def local_global(problem, iterations=2000, **options):
    return LocalGlobal(problem, Options(iterations=iterations, **options))


def newton(problem):
    work = Workspace(problem)
    semismooth = Semismooth(work)
    descent = Descent(work)
    firm = AugmentedLagrangian(descent, semismooth, 0.0, LagrangianOptions(softest=1.0))
    return Cascade([semismooth, firm])


@pytest.mark.parametrize(("angle", "friction"), [(45.0, 0.1), (45.0, 0.6), (30.0, 0.0)])
def test_a_falling_sheet_lands_and_slides_down(angle, friction):
    """Ly et al. 2020, figure 5: perfectly plastic impact with friction, then a constant acceleration."""
    slope, drop, h = Slope(np.radians(angle)), 0.2, 1e-3
    problem = slope.problem(friction, lift=drop)
    march, solver = March(problem, 0.0, h, 1e-10), local_global(problem)
    rate, moving = np.sin(slope.angle) - friction * np.cos(slope.angle), []
    while march.time < 0.35:
        march.step(solver.solve)
        moving.append([march.time, *march.velocity.mean(axis=0), np.ptp(march.velocity, axis=0).max()])
        assert (march.x @ slope.normal).min() > -1e-12
    time, velocity, spread = np.split(np.array(moving), [1, 4], axis=1)
    time, landed = time.ravel(), np.flatnonzero(problem_landed(velocity, slope))[0]
    impact = np.sqrt(2.0 * drop / G)
    assert time[landed] == pytest.approx(impact, abs=2.0 * h)
    down, after = velocity @ slope.down, slice(landed + 1, None)
    exact = G * impact * rate + G * rate * (time - impact)
    assert np.abs(down[after] / exact[after] - 1.0).max() < 0.01  # h over the time of the fall
    np.testing.assert_allclose(down[after], exact[after], rtol=1e-10)  # measured: 1e-13 from the landing on
    acceleration = np.diff(down[after]) / h
    assert np.abs(acceleration / (G * rate) - 1.0).max() < 1e-6
    assert spread.max() < 1e-9


def problem_landed(velocity, slope):
    """(steps,) marks those after which nothing moves into the slope."""
    return np.abs(velocity @ slope.normal) < 1e-9


@pytest.mark.parametrize("angle", [10.0, 30.0])
def test_stick_and_slip_on_a_slope(angle):
    slope, h = Slope(np.radians(angle)), 0.01
    for share in (1.00001, 0.99999):
        problem = slope.problem(share * np.tan(slope.angle))
        march, solver = March(problem, 0.0, h, 1e-12), local_global(problem)
        march.run(solver.solve, 20)
        speed, exact = march.velocity @ slope.down, G * np.sin(slope.angle) * (1.0 - share) * march.time
        if share > 1.0:
            assert np.abs(march.velocity).max() < 1e-12
        else:
            assert np.abs(speed / exact - 1.0).max() < 1e-6


def test_a_sliding_sheet_stops_and_stays():
    """After v0/(mu g) and v0^2/(2 mu g), to the step's order."""
    slope, friction, speed, h = Slope(0.0), 0.4, 1.0, 1e-3
    problem = slope.problem(friction)
    march, solver = March(problem, speed * slope.down, h, 1e-11), local_global(problem)
    began, stop = march.x.copy(), speed / (friction * G)
    march.run(solver.solve, int(stop / h) - 1)
    assert np.abs(march.velocity).max() > 0.0
    march.run(solver.solve, 3)
    way = (march.x - began) @ slope.down
    assert np.abs(way - speed**2 / (2.0 * friction * G)).max() < h * speed
    there, before = march.x.copy(), resident()
    march.run(solver.solve, 2000)
    assert np.abs(march.x - there).max() < 1e-14
    assert resident() - before < 4  # MiB: steps leave nothing behind


def resident() -> float:
    """Memory of this process (MiB)."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize() / 2**20


@pytest.mark.parametrize("friction", [0.0, 0.3])
def test_steps_on_a_turning_sphere_are_newtons(friction):
    points, triangles = protocols.plate(1.0, 1.0, 0.1)
    shell = cloth(points - [0.45, 0.48, 0.0], triangles, young=1e4)
    sphere = turning_sphere(friction, 0.3, -0.02, 2.857)
    ours, theirs = (with_obstacles(Problem(shell), [sphere], 5e-4) for _ in range(2))
    fast, slow = March(ours, 0.0, 0.01, 1e-8), March(theirs, 0.0, 0.01, 1e-10)
    quick, exact = local_global(ours), newton(theirs)
    for _ in range(30):
        fast.step(quick.solve)
        slow.step(exact.solve)
        assert np.abs(fast.x - slow.x).max() < 1e-6
        f = fast.y.duplicate()
        step = ours.at(fast.time)
        assert law_norms(step, fast.y, f, 1e-8 * fast.scale)[1] < 1e-8 * fast.scale
    normal, theirs = ours.contact.history.normal[0], theirs.contact.history.normal[0]
    assert (theirs > 0.0).sum() > 20
    assert np.abs(normal - theirs).max() < 1e-5 * theirs.max()


@pytest.mark.parametrize("sewn", [False, True])
def test_what_is_held_along_some_axes_or_sewn_lands_as_newtons(sewn):
    """Sweeps move a vertex with the components that it has, or with what it is sewn to. The far edge
    lands with its x held."""
    shell = sewn_panels() if sewn else make_shell(*sheet(10, 5))
    shell.model, shell.load_laws, shell.clamped_edges = "projective//", ALWAYS, np.zeros(0, dtype=np.int32)
    shell.young = 1e5 * np.ones(len(shell.triangles))
    shell.fixed[:, 1:] = False
    ball = replace(turning_sphere(0.3, 0.2, 0.0, 0.0), center=np.array([1.02 if sewn else 0.6, 0.25, -0.201]))
    bumps = [ball, replace(Slope(0.0).plane(0.3), point=np.array([0.0, 0.0, -0.02]))]
    ours, theirs = (with_obstacles(Problem(shell), bumps, 0.0) for _ in range(2))
    fast, slow = March(ours, 0.0, 0.01, 1e-10), March(theirs, 0.0, 0.01, 1e-10)
    quick, exact = local_global(ours, 20000), newton(theirs)
    for _ in range(10):
        fast.step(quick.solve)
        slow.step(exact.solve)
        assert fast.outcome.reason == ""
    assert np.abs(fast.x - slow.x).max() < 1e-6
    held = shell.fixed[:, 0]
    assert (fast.x[held][:, 0] == ours.part.points[held][:, 0]).all() and fast.x[held, 2].max() < -0.019
    assert sum(int((normal > 0.0).sum()) for normal in ours.contact.history.normal) > 5


@pytest.mark.mpi
@pytest.mark.parametrize(
    ("name", "steps", "exact"),
    [pytest.param("free", 18, 1e-10, marks=pytest.mark.slow), ("sphere", 20, 1e-6), ("layers", 14, 1e-6)],
)
def test_any_number_of_ranks_finds_the_same(tmp_path, script_on, rank_counts, name, steps, exact):
    """Steps in which the sheet falls by more than 0.1 m, and layers meet."""
    found = []
    for ranks in rank_counts:
        program = Path(__file__).with_name("local_global_ranks.py")
        script_on(ranks, program, name, steps, tmp_path / f"{ranks}.npz")
        found.append(np.load(tmp_path / f"{ranks}.npz"))
    first = found[0]
    assert np.ptp(first["x"][:, 2]) > (1e-3 if name == "layers" else 0.1)
    for other in found[1:]:
        assert np.abs(other["x"] - first["x"]).max() < exact
        assert np.abs(other["reaction"] - first["reaction"]).max() <= 1e-5 * np.abs(first["reaction"]).sum()


def test_layers_land_on_each_other_and_rest():
    """Three sheets, each smaller than the one below: none passes through another, and the floor bears them all."""
    shell = stack(3, apart=1.5e-3)
    floor = Slope(0.0).plane(0.5)
    problem = with_obstacles(Problem(shell), [floor], OFFSET, shell_layers(shell, OFFSET, 0.4))
    march, solver = March(problem, 0.0, 4e-3, 1e-6), local_global(problem, 60)
    started = march.x.copy()
    for _ in range(40):
        before = march.x
        march.step(solver.solve)
        assert problem.contact.free_share(before, march.x) == 1.0
    height = OFFSET * np.round(2.0 * started[:, 2] / 1.5e-3 - 1.0)  # 1, 3, 5 offsets
    assert np.abs(march.x[:, 2] - height).max() < 0.01 * OFFSET
    weight = G * problem.vertex_mass().sum()
    reaction = problem.contact.reactions(march.x, march.time)
    assert reaction[:, 2].sum() == pytest.approx(weight, rel=0.05)
    assert (problem.contact.history.normal[1] > 0.0).any()


@pytest.mark.slow
@pytest.mark.parametrize(("friction", "follows"), [(0.1, False), (0.3, True)])
def test_a_cloth_on_a_turning_sphere_follows_or_slips(friction, follows):
    """Ly et al. 2020, Square1, 6,000 vertices, 20 iterations a step: turn of the part on the sphere over the sphere's
    own in the sixth second. Its corners drag on the floor with the same friction (measured: 0.66 and 1.00)."""
    points, triangles = protocols.plate(2.4, 2.4, 2.4 / 76)
    given = {"young": 2.3e5, "thickness": 1e-3, "density": 3000.0}
    shell = cloth(points - [1.2, 1.2, -0.093], triangles, **given)
    bodies = [turning_sphere(friction, 0.5, -0.02, 2.857), Slope(0.0).plane(friction)]
    bodies[1] = replace(bodies[1], point=np.array([0.0, 0.0, -1.0]))
    problem = with_obstacles(Problem(shell), bodies, 0.0)
    march, solver = March(problem, 0.0, 5e-3, 1e-6), local_global(problem, 20)
    on_top = np.flatnonzero(np.linalg.norm(points[:, :2] - 1.2, axis=1) < 0.3)
    turn, angle = [], np.arctan2(march.x[on_top, 1], march.x[on_top, 0])
    while march.time < 6.0:
        march.step(solver.solve)
        now = np.arctan2(march.x[on_top, 1], march.x[on_top, 0])
        turn.append(np.median((now - angle + np.pi) % (2.0 * np.pi) - np.pi) / (2.857 * march.h))
        angle = now
        assert march.x[:, 2].min() > -1.02 and np.isfinite(march.x).all()
    rate = np.mean(turn[-200:])
    assert rate > 0.97 if follows else 0.3 < rate < 0.8, rate
