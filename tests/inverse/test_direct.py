"""Inverse statics at a target: closed forms, stability, contact and friction."""

import re
from dataclasses import replace

import numpy as np
import pytest
from inverse_shells import folded_skirt, hanging_sheet, panels, shell, strip
from mpi4py import MPI
from petsc4py import PETSc

from voile.arrays import triangle_areas
from voile.contact.obstacles import Cylinder, Motion, Plane
from voile.errors import NotConverged
from voile.inverse.direct import NARROWEST, Direct
from voile.inverse.result import inverse_report
from voile.inverse.solve import InverseOptions, solve_inverse
from voile.inverse.target import Target
from voile.problem.problem import Problem
from voile.problem.supports import hinged_parts, without_flaps
from voile.solver.path import StaticsOptions, require
from voile.solver.statics import solve_statics

LENGTH, WIDTH, THICKNESS, DENSITY = 0.3, 0.03, 1e-3, 300.0


def solve(shape, obstacles=(), **options):
    problem = Problem(shape, MPI.COMM_SELF)
    return solve_inverse(problem, shape, list(obstacles), 0.5e-3, InverseOptions(**options))


def heavy_strip(gamma, upwards=False, cells=60, behind=1):
    """gamma = rho g h L^3 / B; nu = 0 makes the strip a beam with B = E h^3 / 12."""
    rigidity = DENSITY * 9.81 * THICKNESS * LENGTH**3 / gamma
    shape = strip(
        cells, LENGTH, WIDTH, behind, bending="tan", young=12.0 * rigidity / THICKNESS**3, thickness=THICKNESS,
        density=DENSITY,
    )  # fmt: skip
    shape.poisson[:] = 0.0
    if upwards:  # standing on its clamp: gravity along the strip
        shape.gravity = np.array([-9.81, 0.0, 0.0])
    return shape, rigidity


@pytest.mark.parametrize("behind", [0, 1], ids=["held along a line", "held behind the clamp"])
@pytest.mark.parametrize("gamma", [1.0, 10.0, 50.0])
def test_strip_that_must_hang_straight_has_the_curvature_of_its_moment(gamma, behind):
    """kappa(s) = rho g h (L - s)^2 / (2 B): the moment of the overhang over the rigidity."""
    shape, rigidity = heavy_strip(gamma, behind=behind)
    result = solve(shape)
    assert result.converged and result.stable
    assert result.simulation.sag < 1e-9 and result.disturbed.sag < 1e-6
    x = result.target.x + result.target.problem.motion(result.rest)
    middle = x[1::3]  # the centre line, from behind the clamp to the tip
    step = np.diff(middle, axis=0)
    length = np.linalg.norm(step, axis=1)
    turn = np.diff(np.arctan2(step[:, 2], step[:, 0]))
    curvature = 2.0 * np.tan(turn / 2.0) / (0.5 * (length[1:] + length[:-1]))  # the discrete measure of `tan`
    s = LENGTH / 60 * (np.arange(len(turn)) + 1 - behind)
    exact = DENSITY * 9.81 * THICKNESS * (LENGTH - s) ** 2 / (2.0 * rigidity)
    mean, expected = (
        0.5 * (k[1:] + k[:-1]) for k in (curvature, exact)
    )  # diagonals alternate from cell to cell
    np.testing.assert_allclose(mean[1:30], expected[1:30], rtol=5e-3)


def test_a_rest_shape_in_place_is_at_rest_in_its_clamp():
    """Statics with the rest shape found end in the target, also where the start turns the clamped edge a little."""
    shape, _ = heavy_strip(10.0, behind=0)
    result = solve(shape)
    rest = result.target.x + result.target.problem.motion(result.rest)
    for slope, bound in ((0.0, 1e-9), (1e-3, 3e-6)):
        turned = result.target.x + np.outer(np.sin(9.0 * result.target.x[:, 0]), [0.0, 0.0, slope / 9.0])
        problem = Problem(replace(shape, points=turned, rest_points=rest), MPI.COMM_SELF)
        path = solve_statics(problem, StaticsOptions(load_steps=1))
        assert path.converged and path.stable
        assert np.abs(problem.positions(path.state) - result.target.x).max() < bound * LENGTH


def test_the_target_is_reached_from_an_equilibrium_beside_it():
    shape = folded_skirt(young=3e7)
    target = Target(Problem(shape, MPI.COMM_SELF), shape, [], 0.5e-3, 1e-3)
    direct = Direct(target)
    exact = direct.follow()
    assert exact.converged
    wave = np.sin(20.0 * target.x[:, ::-1]) * (target.x[:, 2:] < -1e-6)
    aside = target.field_vector(2e-3 * wave)
    aside.copy(direct.moved)
    beside = exact.rest.copy()
    assert not direct.solve(beside, 1.0)[0]  # its own rest shape
    state = direct.state(beside)
    assert (beside - exact.rest).norm() > 1e-3 * exact.rest.norm()
    found = direct.home(state, beside)
    assert found and found.converged and direct.moved.norm() == 0.0
    assert (found.rest - exact.rest).norm() < 1e-6 * exact.rest.norm()


def test_a_way_home_that_is_none_is_told_by_its_first_step(monkeypatch):
    """Seven halvings took 10 s of a T-shirt's search."""
    shape = folded_skirt(young=3e7)
    target = Target(Problem(shape, MPI.COMM_SELF), shape, [], 0.5e-3, 1e-3)
    direct, ahead = Direct(target), []
    state = direct.state(target.problem.create_vector()) + 1.0

    def none(*_):
        ahead.append(direct.moved.norm(PETSc.NormType.INFINITY))
        return "none", 1.0, 40

    monkeypatch.setattr(direct, "solve", none)
    assert direct.home(state, target.problem.create_vector()) is None
    assert ahead == [0.0, pytest.approx(1.0 - NARROWEST)]


def test_without_loads_the_target_is_its_own_rest_shape():
    result = solve(folded_skirt(young=1e7, gravity=np.zeros(3)))
    assert result.converged and result.direct.iterations == 0
    assert result.rest.norm() == 0.0 and result.simulation.sag < 1e-12


def test_a_step_that_overshoots_is_cut():
    """Newton's step thrice as long leaves twice the residual; the half of it, half the residual."""
    shape = folded_skirt(young=1e7)
    target = Target(Problem(shape, MPI.COMM_SELF), shape, [], 0.5e-3, 1e-3)
    direct, z = Direct(target), target.problem.create_vector()
    target.load(1e-6)
    f, direction = z.duplicate(), z.duplicate()
    y, norm = direct._evaluate(z, f)
    assert direct._step(y, f, direction)
    assert direct._shorter(z, direction, norm) == 1.0
    assert direct._shorter(z, 3.0 * direction, norm) == 0.5


def test_standing_strip_is_certified_unstable_beyond_the_column_that_buckles():
    """A heavy column buckles at gamma = 7.837 (Greenhill 1881)."""
    below, _ = heavy_strip(7.4, upwards=True)
    above, _ = heavy_strip(8.3, upwards=True)
    assert solve(below).stable
    result = solve(above, method="direct")
    assert not result.converged
    assert result.direct.critical == pytest.approx(7.837 / 8.3, rel=0.02)
    assert "stability is lost" in result.reason and 'inverse.method = "adjoint" goes on' in result.reason
    firmer = float(re.search(r"([\d.]+) times the Young's modulus would keep it", result.reason)[1])
    assert firmer == pytest.approx(8.3 / 7.837, rel=0.02)
    assert solve(heavy_strip(8.3 / firmer, upwards=True)[0], method="direct").stable
    mode = result.target.problem.motion(result.mode)
    tip = np.argmax(result.target.x[:, 0])
    assert abs(mode[tip, 2]) > 0.9  # it bends sideways


@pytest.mark.parametrize("bending", ["average", "sin", "tan", "theta"])
@pytest.mark.parametrize("build", [hanging_sheet, panels])
def test_target_of_every_bending_model_stands(build, bending):
    result = solve(build(bending=bending, young=2e9))
    assert result.converged, result.reason
    assert result.simulation.sag < 1e-10
    assert result.residual < 1e-6 * result.target.load_norm(result.rest)


def tube(around=32, up=8, radius=0.1, height=0.1):
    """A tube about z."""
    angle = 2 * np.pi * np.arange(around) / around
    points = np.array(
        [[radius * np.cos(a), radius * np.sin(a), height * k / up] for k in range(up + 1) for a in angle]
    )
    k, j = np.meshgrid(np.arange(up), np.arange(around), indexing="ij")
    a, b = k * around + j, k * around + (j + 1) % around
    c, d = b + around, a + around
    triangles = np.concatenate(
        [np.stack([a, b, c], -1).reshape(-1, 3), np.stack([a, c, d], -1).reshape(-1, 3)]
    )
    return points, triangles.astype(np.int32)


def rod(friction, radius=0.0995):
    return Cylinder(
        name="rod",
        friction=friction,
        motion=Motion(),
        center=np.zeros(3),
        axis=np.array([0, 0, 1.0]),
        radius=radius,
    )


def on_rod():
    points, triangles = tube()
    return shell(points, triangles, np.zeros(points.shape, dtype=bool), young=1e7)


def test_tube_on_a_rod_needs_friction_and_is_held_by_it():
    """Held by nothing but friction: reactions balance the weight within their cones, and the tube stays."""
    result = solve(on_rod(), [rod(0.5)], contact_tolerance=1e-3)
    report = inverse_report(result)["reactions"]
    assert result.converged, result.reason
    np.testing.assert_allclose(
        report["force"], -result.target.problem.loads.weight[2::3].sum() * np.array([0, 0, 1]), atol=1e-10
    )
    assert report["least_margin"] > 0.0
    assert result.simulation.sag < 1e-10 and result.disturbed.sag < 1e-10
    step = result.simulation.path.steps[-1].contact
    assert step["friction_error"] < 1e-8 and step["slip"] == 0


def sheet_with_flap(joints):
    """Points, triangles and supports of a sheet with a triangle or two that hang by a corner, or it and another vertex,
    and these joints."""
    shape = hanging_sheet()
    n = len(shape.points)
    corner = int(np.argmax(shape.points[:, 0] + shape.points[:, 1]))
    other = corner - 2  # on the same boundary, two vertices on
    middle = 0.5 * (shape.points[corner] + shape.points[other])
    flap = np.array([shape.points[corner], middle]) + np.array([0.02, 0.0, 0.0])
    points = np.concatenate([shape.points, flap])
    strip = [[corner, n, n + 1], [corner, n + 1, other]][:joints]
    triangles = np.concatenate([shape.triangles, strip]).astype(np.int32)
    fixed = np.concatenate([shape.fixed, np.zeros((2, 3), dtype=bool)])
    return points, triangles, fixed, [corner] if joints == 1 else [other, corner]


@pytest.mark.parametrize("joints", [1, 2])
def test_a_part_that_hangs_by_a_vertex_or_two_is_refused(joints):
    """It turns freely about them; supported it is part of the shell."""
    points, triangles, fixed, by = sheet_with_flap(joints)
    n = len(points) - 2
    with pytest.raises(NotConverged, match=f"hangs by vertex {' and '.join(map(str, by))} alone"):
        solve(shell(points, triangles, fixed, young=1e10))
    fixed[n:] = True
    assert solve(shell(points, triangles, fixed, young=1e10)).converged


@pytest.mark.parametrize("joints", [1, 2])
def test_what_has_no_balance_of_its_own_leaves_the_rest_its_own(joints):
    """Without flaps the sheet bears their weight at the joints, as the sheet alone would."""
    points, triangles, fixed, by = sheet_with_flap(joints)
    whole = shell(points, triangles, fixed, young=1e10)
    cut = without_flaps(whole, hinged_parts(whole))
    force = cut.force[:, 2]
    mass = whole.density * whole.thickness * triangle_areas(points, triangles)
    assert force.sum() == pytest.approx(-9.81 * mass[-joints:].sum())
    assert sorted(np.flatnonzero(force)) == sorted(by)
    result = solve(cut)
    assert result.converged, result.reason
    n = len(points) - 2
    alone = solve(shell(points[:n], triangles[:-joints], fixed[:n], young=1e10, force=cut.force[:n]))
    rests = [each.target.problem.motion(each.rest) for each in (result, alone)]
    order = [each.target.problem.part.vertex for each in (result, alone)]
    both = [rest[np.argsort(vertex)] for rest, vertex in zip(rests, order, strict=True)]
    np.testing.assert_allclose(both[0][:n], both[1], atol=1e-9)
    np.testing.assert_array_equal(both[0][n:], 0.0)


def test_tube_on_a_smooth_rod_is_refused():
    with pytest.raises(NotConverged, match="no reactions in the cones"):
        solve(on_rod(), [rod(0.0)])


def test_target_out_of_reach_of_its_obstacle_is_refused():
    with pytest.raises(NotConverged, match="touches nothing"):
        solve(on_rod(), [rod(0.5, radius=0.05)])


def on_incline(slope, friction, **more):
    """A flat sheet that lies on an incline, and the incline."""
    shape = hanging_sheet(**more)
    shape.fixed[:] = False
    points = shape.points * [1.0, 1.0, 0.0]
    turn = np.array([[np.cos(slope), 0, -np.sin(slope)], [0, 1, 0], [np.sin(slope), 0, np.cos(slope)]])
    shape.points = shape.rest_points = points @ turn.T
    normal = turn @ [0, 0, 1.0]
    return shape, Plane(
        name="incline", friction=friction, motion=Motion(), point=-0.5e-3 * normal, normal=normal
    )


def test_least_friction_of_a_sheet_on_an_incline_is_its_slope():
    shape, plane = on_incline(0.4, 0.6)
    target = Target(Problem(shape, MPI.COMM_SELF), shape, [plane], 0.5e-3, 1e-3)
    assert target.least_friction == pytest.approx(np.tan(0.4), rel=1e-3)


def test_captured_target_that_hovers_starts_without_a_jump():
    """The gap of the target is kept: 0.4 mm above the rod, the tube still rests there."""
    result = solve(on_rod(), [rod(0.5, radius=0.0991)], contact_tolerance=1e-3)
    assert result.converged, result.reason
    assert result.simulation.sag < 1e-10
    report = inverse_report(result)
    assert report["reactions"]["gaps"] == pytest.approx([0.0, 4e-4], abs=1e-9)
    assert report["disturbance"] == 0.0  # all of it touches


def test_a_draped_sheet_gives_back_its_rest_shape_from_near_it_and_another_from_afar():
    """Simulated forward from a known rest shape: the target stands again; the answer is not unique."""
    known = hanging_sheet(young=5e8)
    draping = Problem(known, MPI.COMM_SELF)
    draped = require(solve_statics(draping, StaticsOptions(tolerance=1e-12)))
    shape = hanging_sheet(young=5e8)
    shape.points = shape.rest_points = draping.positions(draped.state)
    near = solve_inverse(Problem(shape, MPI.COMM_SELF), shape, [], 0.0, guess=known.points + 1e-6)
    afar = solve_inverse(Problem(shape, MPI.COMM_SELF), shape, [], 0.0)
    for result in (near, afar):
        assert result.converged and result.simulation.sag < 1e-8, result.reason
    assert inverse_report(near)["rest_distance_to_guess"] < 1e-5
    assert inverse_report(near)["direct_iterations"] < inverse_report(afar)["direct_iterations"]


@pytest.mark.parametrize("bending", ["average", "tan"])
def test_a_known_rest_shape_is_recognised(bending):
    """It comes without the director angles that it has at the target, a quarter of the size away."""
    known = hanging_sheet(young=1e7, bending=bending)
    draping = Problem(known, MPI.COMM_SELF)
    path = require(solve_statics(draping, StaticsOptions(tolerance=1e-12)))
    shape = hanging_sheet(young=1e7, bending=bending)
    shape.points = shape.rest_points = draping.positions(path.state)
    result = solve_inverse(Problem(shape, MPI.COMM_SELF), shape, [], 0.0, guess=known.points)
    assert result.converged and result.direct.iterations <= 1 and result.simulation.sag < 1e-12
    assert inverse_report(result)["rest_distance_to_guess"] < 1e-9


def pleated_strip(bending):
    """A strip with a pleat of 179.97 degrees."""
    shape, _ = heavy_strip(1.0, cells=12)
    points = shape.points.copy()
    half, beyond = 0.5 * LENGTH, points[:, 0] > 0.5 * LENGTH + 1e-9
    angle, reach = np.radians(179.97), points[beyond, 0] - half
    points[beyond, 0], points[beyond, 2] = half + reach * np.cos(angle), reach * np.sin(angle)
    return replace(shape, points=points, rest_points=points, model=shape.model.replace("tan", bending))


def test_a_pleat_is_refused_where_the_bending_measure_has_no_bound():
    """tan(angle / 2) hides the loads behind round-off."""
    with pytest.raises(
        NotConverged, match=r"cannot be resolved.* folded by 179\.97 degrees at triangle \d+.*theta"
    ):
        solve(pleated_strip("tan"))


def test_a_pleat_is_held_where_the_bending_measure_has_a_bound():
    """Also from beside the target, which does not turn the pleat inside out: it is open by 3 um."""
    result = solve(pleated_strip("theta"), method="direct")
    for simulation in (result.simulation, result.disturbed):
        assert simulation.stable and simulation.settled_sag < 1e-8


@pytest.mark.filterwarnings("ignore:overflow")
def test_loads_beyond_all_numbers_are_none():
    with pytest.raises(NotConverged, match="the loads are not finite"):
        solve(hanging_sheet(pressure=1e300))
