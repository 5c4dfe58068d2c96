"""The nearest stable shape: barrier and model, derivatives by Taylor tests, soft shells, ranks."""

import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from inverse_shells import folded_skirt, grid, shell
from mpi4py import MPI
from petsc4py import PETSc
from scipy.optimize import minimize
from test_adjoint import wave
from test_direct import heavy_strip, rod, solve

from voile.inverse.direct import Direct
from voile.inverse.journal import Journal
from voile.inverse.moves import Moves
from voile.inverse.nearest import Nearest
from voile.inverse.neighbours import Checkpoint, Neighbours
from voile.inverse.result import inverse_report
from voile.inverse.solve import InverseOptions, Told, _nearer, solve_inverse
from voile.inverse.spectral import Model, barrier
from voile.inverse.target import Target
from voile.inverse.verify import settles_within
from voile.problem.problem import Problem
from voile.solver.path import StaticsOptions
from voile.solver.statics import solve_statics


def test_the_barrier_has_its_derivatives_and_a_smooth_end():
    t, h = np.array([0.01, 0.3, 0.9, 1.5]), 1e-6
    _, first, second = barrier(t)
    np.testing.assert_allclose((barrier(t + h)[0] - barrier(t - h)[0]) / (2 * h), first, rtol=1e-5)
    np.testing.assert_allclose((barrier(t + h)[1] - barrier(t - h)[1]) / (2 * h), second, rtol=1e-5)
    assert np.isinf(barrier(np.array([0.5, 0.0]))[0]).all()
    assert all(abs(values[0]) < 1e-8 for values in barrier(np.array([1.0 - 1e-9])))


def test_moves_do_not_descend_along_what_bends_the_other_way():
    """Round-off makes the metric of huge moves indefinite: no step there, not one of 1e300."""
    metric = PETSc.Mat().createAIJ((2, 2), nnz=2, comm=PETSc.COMM_SELF)
    metric.setValues([0, 1], [0, 1], [1.0, 0.0, 0.0, -1.0])
    metric.assemble()
    moves = SimpleNamespace(
        problem=SimpleNamespace(comm=MPI.COMM_SELF),
        metric_solver=SimpleNamespace(solutions=lambda left: left),
        metric=metric,
        rest_metric=metric,
        _answer=np.zeros_like,
        _reduced=lambda s, z: np.zeros_like(s),
    )
    s, z = Moves._descend(moves, np.eye(2), np.eye(2))
    np.testing.assert_array_equal(s, [[1.0, 0.0], [0.0, 0.0]])
    assert not z.any()


@pytest.mark.parametrize("lowest", [0.1, -0.3])
def test_the_model_is_minimised_from_inside_and_outside(lowest):
    random = np.random.default_rng(2)
    slopes = random.standard_normal((5, 4, 4))
    matrix = np.diag([lowest, 0.1, 0.3, 0.8])
    model = Model(matrix, slopes + slopes.transpose(0, 2, 1), 0.1 * random.standard_normal(5), 0.05)
    c = model.minimise(0.5)
    assert c is not None and np.linalg.eigvalsh(model.at(c))[0] > 0.0
    found = minimize(lambda c: model.value(c, 0.5), c + 1e-4, method="Nelder-Mead", options={"xatol": 1e-10})
    assert model.value(c, 0.5) <= found.fun + 1e-12


def test_a_model_that_no_move_makes_stable_has_no_minimum():
    assert Model(np.diag([-1.0, 1.0]), np.zeros((3, 2, 2)), np.zeros(3), 1.0).minimise(0.0) is None


def neighbours(kind):
    """A place beside a stable target, linearised, and a direction on the manifold of equilibria."""
    shape = folded_skirt(24, 4, young=1e8, bending="average" if kind == "contact" else kind)
    bodies = []
    if kind == "contact":  # the waist hangs on a rod by friction
        shape, bodies = replace(shape, fixed=np.zeros_like(shape.fixed)), [rod(0.9, 0.1495)]
    target = Target(Problem(shape, MPI.COMM_SELF), shape, bodies, 0.5e-3, 1e-3)
    path = Direct(target).follow()
    assert path.converged
    beside = Neighbours(Direct(target), target.touching())
    beside.cut = np.inf  # as many modes as it takes
    place = Checkpoint(target.problem.create_vector(), path.rest.copy(), 1.0, 0.0)
    assert beside.linearise(place) and beside.settle(place)
    gradient = beside.moves.still()
    gradient.s.axpy(1.0, beside.moves.weigh(wave(target, 0.3, 2e-5)))
    return beside, place, steepest(beside.moves, gradient)


def steepest(moves, gradient):
    """The move along a gradient that is steepest for its length in ds."""
    s = moves.metric_solver.solutions(
        moves._reduced(gradient.s.array_r[:, None], gradient.z.array_r[:, None])
    )
    return moves.move(s[:, 0], moves._answer(s)[:, 0])


def test_more_modes_are_told_where_a_way_ends():
    beside, place, _ = neighbours("average")
    lowest, second = place.values[:2]
    beside.cut = 0.5 * (lowest + second)
    assert beside.settle(place) and len(place.modes) == 1
    assert beside.tell_more(place) and len(place.modes) > 1
    assert place.values[1] == pytest.approx(second, rel=1e-6) and place.values[-1] < beside.cut


def test_a_way_that_ends_goes_on_with_more_modes_and_then_with_less_margin():
    search, asked = Nearest.__new__(Nearest), []
    search.problem = SimpleNamespace(create_vector=lambda: None)

    def told(_):
        asked.append("more modes")
        return True

    search.neighbours = SimpleNamespace(
        linearise=lambda _: True, settle=lambda _: True, tell_more=told, slow=1.0
    )
    search.clock, search.budget = SimpleNamespace(over=lambda: False), 1

    def advance(point, fraction, margin):
        asked.append(margin)
        return replace(point, margin=min(margin, 4.0)), margin == 1.0

    search.advance = advance
    path = SimpleNamespace(rest=SimpleNamespace(copy=lambda: None), fraction=0.5)
    assert search.reach(path, 8.0)[1] and asked == [8.0, "more modes", 4.0, 2.0, 1.0]


def test_moves_are_found_at_once_as_one_by_one():
    """Along a gradient, those of a matrix, and the least one: columns of one block, each group a vector."""
    beside, place, move = neighbours("average")
    slopes, f = beside.slopes(place), beside.load_slope(place)
    beside.linearise(place)
    moves, none = beside.moves, f.duplicate()
    none.set(0.0)
    pull = moves.still()
    pull.s.axpy(1.0, moves.weigh(move.s))
    tangent, least = moves.tangent(pull, slopes, f)
    alone = moves.least_move(f)
    for one, other in ((least.s, alone.s), (least.z, alone.z)):
        assert (one - other).norm() < 1e-9 * other.norm() > 0.0
    again, still = moves.tangent(pull, slopes, none)
    assert moves.length(still) == 0.0
    np.testing.assert_allclose(again.form, tangent.form, atol=1e-9 * np.abs(tangent.form).max())


@pytest.mark.parametrize("kind", ["average", "tan", "contact"])
def test_moves_and_slopes_are_those_of_the_equilibria(kind):
    beside, place, move = neighbours(kind)
    assert len(place.modes) > 1
    slopes, modes = beside.slopes(place), place.modes
    beside.linearise(place)

    def projected(h):
        there = place.beside(move, 0.0, 0.0)
        there.s.axpy(h - 1.0, move.s)
        there.z.axpy(h - 1.0, move.z)
        y = beside.go_to(there)
        f = y.duplicate()
        beside.target.residual(y, f)
        assert beside._restore(there)
        k, out = beside.target.stiffness(beside.go_to(there)), y.duplicate()
        values = np.zeros((len(modes), len(modes)))
        for i, j in slopes:
            k.mult(modes[j], out)
            values[i, j] = modes[i].dot(out)
        return f.norm(), values

    linear = np.zeros((len(modes), len(modes)))
    for (i, j), slope in slopes.items():
        linear[i, j] = slope.dot(move)
    rest, here = projected(0.0)
    left, residuals = [], []
    for h in (1.0, 0.5):
        residual, there = projected(h)
        residuals.append(residual - rest)
        left.append(np.abs(there - here - h * linear).max())
    assert np.abs(linear).max() > 20.0 * left[1]
    np.testing.assert_allclose(np.log2(left[0] / left[1]), 2.0, atol=0.3)
    np.testing.assert_allclose(np.log2(residuals[0] / residuals[1]), 2.0, atol=0.3)


def test_a_soft_skirt_ends_near_its_target_and_stays_there():
    shape = folded_skirt(24, 4, young=1e7)
    problem = Problem(shape, MPI.COMM_SELF)
    result = solve_inverse(problem, shape, [], 0.0, InverseOptions())
    assert result.direct.critical is not None and result.adjoint is None
    nearest = result.nearest
    assert nearest is not None and nearest.steps[-1].fraction == 1.0
    assert nearest.sag < 3e-3
    target = result.target
    target.rest.set(nearest.rest)
    path = solve_statics(problem, StaticsOptions(load_steps=1, eigenvalue=True), start=nearest.state)
    assert path.converged and path.stable
    assert problem.largest_motion(path.state - nearest.state) < 1e-8 * problem.size()
    assert path.smallest_eigenvalue > 0.9 * nearest.steps[-1].margin
    tao = solve_inverse(problem, shape, [], 0.0, InverseOptions(method="tao"))
    assert tao.nearest is None and tao.adjoint is not None
    assert nearest.sag < 0.3 * tao.adjoint.steps[-1].sag


def test_a_search_whose_time_is_over_ends_with_the_last_stable_shape(monkeypatch):
    """A clock that counts steps ends the way; the shape is in stable equilibrium under its part of the load."""
    shape = folded_skirt(24, 4, young=1e7)
    problem, steps = Problem(shape, MPI.COMM_SELF), []
    monkeypatch.setattr("voile.problem.lifetime.time", SimpleNamespace(perf_counter=lambda: len(steps)))
    options = InverseOptions(max_seconds=4.0)
    result = solve_inverse(problem, shape, [], 0.0, options, told=Told(nearest=steps.append))
    nearest, figures = result.nearest, inverse_report(result)["nearest"]
    assert nearest is not None and result.adjoint is None
    assert figures["timed_out"] and figures["load_fraction"] == nearest.fraction
    assert len(nearest.steps) == 4 and not result.converged
    assert result.direct.fraction <= nearest.fraction == nearest.steps[-1].fraction < 1.0
    assert f"inverse.max_seconds ended the search at {nearest.fraction:.4g} of the load" in result.reason
    target = result.target
    target.load(nearest.fraction)
    target.rest.set(nearest.rest)
    f = target.problem.create_vector()
    target.residual(nearest.state, f)
    assert f.norm() < 1e-8 * target.load_norm(nearest.state)
    assert nearest.eigenvalue > 0.0


def test_time_that_ends_at_the_full_load_leaves_an_answer(monkeypatch):
    """Without the search for the least margin."""
    shape = folded_skirt(24, 4, young=1e7)
    problem, steps = Problem(shape, MPI.COMM_SELF), []
    over = SimpleNamespace(perf_counter=lambda: 2.0 * bool(steps and steps[-1].fraction == 1.0))
    monkeypatch.setattr("voile.problem.lifetime.time", over)
    options = InverseOptions(max_seconds=1.0)
    result = solve_inverse(problem, shape, [], 0.0, options, told=Told(nearest=steps.append))
    assert result.nearest is not None and result.nearest.timed_out and result.nearest.fraction == 1.0
    assert result.held.stable and result.held.sag < 1e-6
    assert "ended the search at 1 of the load" in result.reason


def test_time_ends_the_adjoint_method_too(monkeypatch):
    shape = folded_skirt(24, 4, young=1e7)
    problem, steps = Problem(shape, MPI.COMM_SELF), []
    monkeypatch.setattr("voile.problem.lifetime.time", SimpleNamespace(perf_counter=lambda: len(steps)))
    options = InverseOptions(method="tao", max_seconds=2.0)
    result = solve_inverse(problem, shape, [], 0.0, options, told=Told(iteration=steps.append))
    assert result.adjoint is not None and len(result.adjoint.steps) == 2
    assert "; inverse.max_seconds ended the search" in result.reason


def test_time_ends_the_direct_method_too(monkeypatch):
    """Between iterations: what it has reached is the answer, and but its proof is left to do."""
    shape = folded_skirt(24, 4, young=1e7)
    problem, seen = Problem(shape, MPI.COMM_SELF), []
    problem.monitor = lambda *iteration: seen.append(iteration)
    monkeypatch.setattr("voile.problem.lifetime.time", SimpleNamespace(perf_counter=lambda: len(seen)))
    result = solve_inverse(problem, shape, [], 0.0, InverseOptions(max_seconds=22.0))
    assert result.direct.fraction == 0.25 and not result.converged  # it would reach 0.3535
    assert result.adjoint is None and result.nearest.fraction == 0.25
    assert "inverse.max_seconds ended the search at 0.25 of the load" in result.reason
    assert result.nearest.timed_out and inverse_report(result)["nearest"]["moved"] is None


def test_a_column_that_cannot_stand_leans_as_little_as_it_can():
    """The least margin at which simulations from the target end there."""
    shape, _ = heavy_strip(9.0, upwards=True, cells=20)
    result = solve(shape)
    assert result.nearest is not None and result.converged
    assert result.simulation.sag == pytest.approx(result.nearest.sag, rel=1e-6)
    assert result.disturbed.sag == pytest.approx(result.nearest.sag, rel=1e-6)
    assert result.nearest.sag < 2e-3
    wide = solve(shape, margin=16.0)
    assert wide.nearest is not None and wide.nearest.sag > 4.0 * result.nearest.sag
    # margins are halved: by round-off the least is one or two halvings more or less
    assert wide.eigenvalue > 5.0 * result.eigenvalue


def confirmed(ends, weights=(1.0,), sags=(1e-2,)):
    """What `confirm` gives, of points 0, 1, ... of rising margins whose simulations end so far from the target, and
    which point it goes nearer from; weights of the rest shape's moves with which each was found."""
    search, from_point = Nearest.__new__(Nearest), []
    points = [SimpleNamespace(z=k, s=SimpleNamespace(dot=lambda _: 1.0), margin=2.0**k) for k in range(9)]
    moves = SimpleNamespace(weight=weights[0], loosen=lambda: False, weigh=lambda s: s)
    search.neighbours = SimpleNamespace(moves=moves, polish=lambda _: None)
    search.clock, search.journal, search.radius = SimpleNamespace(over=lambda: False), Journal(), 1.0
    search.first, search._sag = 1.0, lambda point: sags[min(point.z, len(sags) - 1)]

    def with_margin(margin, found):
        moves.weight = weights[min(found.z + 1, len(weights) - 1)]
        return points[found.z + 1], found.z + 1 < len(ends)

    def advance(point, *_):
        from_point.append(point.z)
        return point, True

    search._with, search.advance = with_margin, advance
    return search.confirm(points[0], lambda z, sag: ends[z] <= 2.0 * sag).z, from_point


def test_margins_are_doubled_until_simulations_end_in_the_answer():
    """Also where those of firmer ones end no nearer, as of a skirt on a rod."""
    assert confirmed([0.3, 0.2, 0.1, 0.005]) == (3, [])
    assert confirmed([0.3, 0.31, 0.3, 0.005]) == (3, [])
    assert confirmed([np.inf, 0.2, 0.005])[0] == 2


@pytest.mark.parametrize(("weights", "nearer"), [((1.0, 0.01), [0]), ((0.01, 0.01), [])])
def test_an_answer_found_by_stiff_moves_is_brought_nearer(weights, nearer):
    """Though the search for a firmer one has loosened them since: a T-shirt's lay at 0.009 sizes for 0.005."""
    assert confirmed([0.3], weights) == (0, nearer)


def test_an_answer_is_nearer_than_the_target_as_its_own_rest_shape():
    """A level sheet held all round: the way from where the direct method stops leads to a dome that sags by more."""
    points, triangles = grid(8, 8, 0.3, 0.3)
    border = (points[:, :2] < 1e-9).any(axis=1) | (points[:, :2] > 0.3 - 1e-9).any(axis=1)
    sheet = shell(
        points, triangles, np.repeat(border[:, None], 3, axis=1), bending="tan", young=1e8, density=200.0
    )
    problem = Problem(sheet, MPI.COMM_SELF)
    plain = solve_statics(problem, StaticsOptions(load_steps=1))
    sag = problem.largest_motion(plain.state) / problem.size()
    result = solve(sheet)
    assert result.converged and not result.exact
    assert result.simulation.sag < sag and result.disturbed.sag < sag
    sag = problem.largest_motion(plain.state)  # in sizes
    assert result.simulation.sag < sag and result.disturbed.sag < sag
    target = Target(problem, sheet, [], 0.0, 1e-3)
    assert settles_within(target, problem.create_vector(), 1e-8, 1.001 * sag)
    for limit in (0.999 * sag, 0.2 * sag):  # ends beyond it; is given up
        assert not settles_within(target, problem.create_vector(), 1e-8, limit)


@pytest.mark.slow
def test_a_skirt_whose_direct_branch_turns_back_ends_near_its_target():
    """dR/dX turns singular at 0.22 of the load, while the target is stable."""
    shape = folded_skirt(young=3e6)
    result = solve_inverse(Problem(shape, MPI.COMM_SELF), shape, [], 0.0, InverseOptions())
    assert result.direct.critical is None and result.direct.fraction < 0.3
    assert result.nearest is not None and result.nearest.sag < 6e-3
    assert result.stable


@pytest.mark.slow
def test_ranks_find_the_same_nearest_shape(mpirun):
    figures = []
    for ranks in (1, 2):
        done = mpirun(ranks, [sys.executable, str(Path(__file__).parent / "nearest.py")], 200)
        assert done.returncode == 0, done.stderr
        figures.append([float(word) for word in done.stdout.split()])
    np.testing.assert_allclose(figures[1], figures[0], rtol=1e-3)
    assert all(figures[0])


def test_an_answer_that_simulations_leave_farther_than_nothing_is_none():
    """A strip drawn level whose nearest shape is near, but from which the simulation ends far away."""
    strip = heavy_strip(10.0)[0]
    target = Target(Problem(strip, MPI.COMM_SELF), strip, [], 0.5e-3, 1e-3)
    near = SimpleNamespace(sag=1e-9)
    for sag, stable, answer in ((10.0, True, False), (1e-8, True, True), (10.0, False, True)):
        run = SimpleNamespace(sag=sag, stable=stable)
        assert _nearer(target, near, run, 1e-8) is answer
