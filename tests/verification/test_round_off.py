"""Where double precision ends above the tolerance: a run converges to round-off and says so, but to nothing worse."""

import re

import numpy as np
import pytest
from mpi4py import MPI
from shells import make

import voile
from voile.problem.problem import Problem
from voile.problem.scales import round_off
from voile.solver.statics import StaticsOptions, solve_statics
from voile.validate.shells import mapped


def taut(load: float):
    """A stiff sheet held at its rim, stretched by 5 and 10 % where it starts, under a force of `load` per vertex: its
    stresses' round-off does not depend on the load."""
    u, v, triangles, side = mapped(10, 10, "crossed")
    points = np.column_stack([u, v, np.zeros(len(u))])
    rim = np.any(list(side), axis=0)
    force = -load * np.column_stack([0.1 + u, np.zeros(len(u)), np.ones(len(u))])
    shell = make(points, triangles, rim, [], thickness=1e-3, young=1e9, poisson=0.3, force=force)
    shell.rest_points = points / [1.1, 1.05, 1.0]
    return shell


def solved(load: float):
    problem = Problem(taut(load), MPI.COMM_SELF)
    path = solve_statics(problem, StaticsOptions(load_steps=1))
    return problem, path, problem.local(path.state)[0] / load


def test_converged_to_round_off():
    """The residual is within ten times its round-off; the displacement is that of a hundred times the load."""
    problem, path, u = solved(1e-5)
    step = path.steps[-1]
    assert path.converged and path.stable
    assert re.match(r"converged to round-off \(\S+ N\): residual \S+ N, tolerance \S+ N$", path.reason)
    assert step.tolerance < step.residual < 10.0 * round_off(problem, path.state)[1]
    _, resolved, large = solved(1e-3)
    assert resolved.reason == "residual below tolerance"
    assert np.abs(u - large).max() < 1e-4 * np.abs(large).max()


@pytest.mark.parametrize("load", [1e-7, 1e-12])
def test_loads_that_round_off_hides_are_refused(load):
    _, path, _ = solved(load)
    assert not path.converged and not path.steps
    assert re.search(r"misses .* round-off is \S+ N", path.reason)


def test_where_round_off_ends_a_run_is_kept():
    """The message names the key that helps; the last step stored is the iterate, at its load factor, not converged."""
    u, v, triangles, _ = mapped(4, 4, "crossed")
    points = np.column_stack([u, v, np.zeros(len(u))])
    ends = ({"select": {"box": [[x - 0.001, -1, -1], [x + 0.001, 2, 1]]}} for x in (0.0, 1.0))
    scene = {
        "shell": {
            "mesh": (points, triangles), "rest": (points / [1.1, 1.05, 1.0], triangles), "young": 1e9,
            "thickness": 1e-3, "density": 1e-12,
        },
        "statics": {"load_steps": 1},
        "fix": list(ends),
    }  # fmt: skip
    with pytest.raises(voile.NotConverged, match=r"statics\.tolerance.* at load factor") as told:
        voile.run(scene)
    result = told.value.result
    assert result.n_steps == 1 and f"at load factor {result.values[0]:g};" in f"{told.value};"
    moved = np.abs(result.points() - points).max(axis=0)
    assert 0.01 < moved[1] < 0.1  # between its ends the sheet is as wide as its rest shape lets it
    assert result.summary["load_factor"] == 0.0 and not result.summary["converged"]
