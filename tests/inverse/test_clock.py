"""inverse.max_seconds: what time ends in search and proof, and what is said of it."""

import itertools
from types import SimpleNamespace

import numpy as np
import pytest
from inverse_shells import folded_skirt
from mpi4py import MPI
from test_direct import heavy_strip
from test_panels import cone_skirt

from voile.errors import NotConverged
from voile.inverse.adjoint import minimise
from voile.inverse.developable import DevelopableRest, start_of_panels
from voile.inverse.result import inverse_report
from voile.inverse.solve import InverseOptions, Told, solve_inverse
from voile.inverse.target import Target
from voile.inverse.verify import TIMED_OUT, settles_within, simulate
from voile.problem.lifetime import Clock, TimeIsOver, until
from voile.problem.problem import Problem
from voile.solver.path import Path


@pytest.fixture
def counting(monkeypatch):
    """A clock that goes on by a second whenever it is looked at, as it is at each evaluation of forces."""
    looks = itertools.count()
    monkeypatch.setattr("voile.problem.lifetime.time", SimpleNamespace(perf_counter=lambda: next(looks)))
    return looks


def test_a_simulation_ends_where_it_began_whenever_its_time_is_over(counting):
    """Displacements then count from the target again, and another simulation finds what it would have found."""
    strip = heavy_strip(24.0, cells=20)[0]
    target = Target(Problem(strip, MPI.COMM_SELF), strip, [], 0.5e-3, 1e-3)
    own = target.problem.create_vector()
    whole, ended = simulate(target, own, 1e-8), 0
    assert whole.stable and whole.sag > 0.3
    for seconds in (1, 2, 5, 20, 50, 100):
        target.clock = Clock(MPI.COMM_SELF, seconds)
        run = simulate(target, own, 1e-8)
        ended += run.timed_out
        if run.timed_out:
            assert not run.path.converged and run.path.reason == TIMED_OUT and run.sag == 0.0
        np.testing.assert_array_equal(target.problem.positions(own), target.x)
    assert ended > 3
    target.clock = Clock(MPI.COMM_SELF, 0.0)
    assert simulate(target, own, 1e-8).sag == whole.sag


def test_a_simulation_that_is_given_up_leaves_the_target_where_it_is(monkeypatch):
    """Whatever displacements counted from then."""
    strip = heavy_strip(24.0, cells=20)[0]
    target = Target(Problem(strip, MPI.COMM_SELF), strip, [], 0.5e-3, 1e-3)
    own, problem = target.problem.create_vector(), target.problem

    def moves_and_gives_up(_problem, options, *, start, **_):
        problem.move_origin(problem.create_vector() + 0.01)
        options.watch(start + 1.0)
        raise AssertionError

    monkeypatch.setattr("voile.inverse.verify.solve_statics", moves_and_gives_up)
    assert not settles_within(target, own, 1e-8, 1e-3)
    np.testing.assert_array_equal(problem.positions(own), target.x)


def test_a_target_let_go_is_judged_by_the_full_load(monkeypatch):
    strip = heavy_strip(24.0, cells=20)[0]
    target = Target(Problem(strip, MPI.COMM_SELF), strip, [], 0.5e-3, 1e-3)
    asked = []

    def sees(problem, options, *, start, **_):
        asked.append((options.load_steps, options.max_steps))
        return Path(start.copy())

    monkeypatch.setattr("voile.inverse.verify.solve_statics", sees)
    assert not settles_within(target, target.problem.create_vector(), 1e-8, 1e-3)
    assert asked == [(1, 1)]


@pytest.mark.parametrize("runs", [0, 1])
def test_a_rest_shape_whose_proof_takes_too_long_is_kept_and_told_of(monkeypatch, runs):
    """Its search has ended in time; the proof's is over after so many simulations."""
    done, found, now = [], [], [0.0]

    def counted(*words, **more):
        now[0] += 10.0 * (len(done) == runs)
        done.append(simulate(*words, **more))
        return done[-1]

    monkeypatch.setattr("voile.inverse.solve.simulate", counted)
    monkeypatch.setattr("voile.problem.lifetime.time", SimpleNamespace(perf_counter=lambda: now[0]))
    shape = folded_skirt(24, 4, young=1e9)
    problem, options = Problem(shape, MPI.COMM_SELF), InverseOptions(max_seconds=1.0)
    result = solve_inverse(problem, shape, [], 0.0, options, told=Told(found=found.append))
    report = inverse_report(result)
    assert result.exact and result.stable and len(found) == 1 and report["proof_timed_out"]
    assert report["sag_disturbed"] is None and result.disturbed.timed_out
    if runs:
        assert result.converged and report["sag"] < 1e-9
        assert result.reason.endswith(f"; {TIMED_OUT} from beside it")
    else:
        assert not result.converged and report["sag"] is None
        assert result.reason == f"{TIMED_OUT} from the target"


def test_the_adjoint_method_ends_within_a_simulation(counting):
    """At the best so far, which is proved; without one it has no answer, and says why."""
    shape = folded_skirt(24, 4, young=1e7)
    problem = Problem(shape, MPI.COMM_SELF)
    result = solve_inverse(problem, shape, [], 0.0, InverseOptions(method="tao", max_seconds=1200.0))
    assert result.adjoint is not None and "; inverse.max_seconds ended the search" in result.reason
    np.testing.assert_array_equal(problem.positions(problem.create_vector()), result.target.x)


def test_the_adjoint_method_without_a_simulation_has_no_answer(counting):
    shape = folded_skirt(24, 4, young=1e7)
    target = Target(Problem(shape, MPI.COMM_SELF), shape, [], 0.5e-3, 1e-3)
    target.clock = Clock(MPI.COMM_SELF, 2.0)
    with pytest.raises(NotConverged, match="max_seconds ended the simulation that it starts from"):
        minimise(target, target.problem.create_vector(), 1e-3, 20)


def test_what_goes_wrong_after_the_time_is_over_is_its_doing():
    """Newer PETSc loses what a callback raises."""
    clock = Clock(MPI.COMM_SELF, 1e-9)
    for ended, raised in ((True, TimeIsOver), (False, ValueError)):
        clock.ended = ended
        with pytest.raises(raised), until(clock):
            raise ValueError


@pytest.mark.parametrize("seconds", [0, 3])
def test_panels_are_laid_flat_in_time(counting, monkeypatch, seconds):
    """230 iterations and 44 s before a search of 2 s, once."""
    whole, flat = cone_skirt(12, 4, young=1e7)
    target = Target(Problem(whole, MPI.COMM_SELF), whole, [], 0.0, 1e-3)
    z, prepare, tries = target.rest.create(), DevelopableRest._prepare, []
    z.array[:] = 5e-3 * np.sin(np.arange(z.getSize()) ** 2)
    monkeypatch.setattr(DevelopableRest, "_prepare", lambda *words: (tries.append(1), prepare(*words)))
    target.clock = Clock(MPI.COMM_SELF, float(seconds))
    found = start_of_panels(target, whole, z, flat)
    if seconds:
        assert len(tries) <= seconds and found is flat.coordinates
        with pytest.raises(
            NotConverged, match="angle defect .* is left; inverse.max_seconds ended its search"
        ):
            DevelopableRest(target, whole).set(z, target.clock.over)
    else:
        assert len(tries) > 3 and found is not flat.coordinates
