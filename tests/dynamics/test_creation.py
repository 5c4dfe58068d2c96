"""Energy from nowhere: what the books let pass, and what ends a run."""

from dataclasses import replace

import numpy as np
import pytest
from moving import cloth, move
from mpi4py import MPI
from test_problem import sheet

from voile.contact.obstacles import Plane
from voile.problem.problem import Problem
from voile.solver.stepping.books import LOST, TOTALS, Books
from voile.solver.stepping.creation import Creation


def entries(present: float, missed: float = 0.0, scheme: float = 0.0) -> dict[str, float]:
    """Of a step that ends with an energy `present` (J)."""
    return dict.fromkeys(TOTALS, 0.0) | {"present": present, "error": missed, "scheme_dissipated": scheme}


def begun() -> tuple[Creation, Books]:
    problem = Problem(cloth(*sheet(4, 4)), MPI.COMM_SELF).at(0.0)
    books = Books(problem)
    books.enter(entries(10.0))
    assert books.most == 10.0
    return Creation(problem), books


def test_a_step_that_leaps_is_cut_and_then_let_pass():
    creation, books = begun()
    assert "nowhere" in creation.refusal(books, entries(11.0, scheme=-1.0), short=False)
    assert not creation.refusal(books, entries(11.0, scheme=-1.0), short=True) and not creation.nonsense
    assert not creation.refusal(books, entries(11.0), short=False)  # what loads give


def test_half_of_all_there_is_ends_a_run():
    creation, books = begun()
    for _ in range(16):
        step = entries(10.3, scheme=-0.3)
        assert not creation.refusal(books, step, short=False)
        books.enter(step)
    assert books.most == 10.0 and abs(books.created - 4.8) < 1e-12
    said = creation.refusal(books, entries(11.0, scheme=-0.4), short=False)
    assert creation.nonsense and said.startswith("5.2 J come from nowhere")


def test_what_residuals_work_counts_where_the_scheme_dissipates_it():
    creation, books = begun()
    said = creation.refusal(books, entries(10.0, missed=6.0, scheme=6.0), short=False)
    assert creation.nonsense and said
    assert "not finite" in creation.refusal(books, entries(np.nan), short=False)
    assert set(LOST) < set(TOTALS)


@pytest.mark.parametrize(("scheme", "step"), [("implicit-euler", 2e-4), ("generalized-alpha", 1e-3)])
def test_a_shell_that_starts_in_an_obstacle_is_let_out_gently(scheme, step):
    """The obstacle closes at rates up to 1.5 times the mean and works what lifts the shell, which it does not throw."""
    ground = Plane(name="ground", point=np.zeros(3), normal=np.array([0.0, 0.0, 1.0]), friction=0.3)
    points, triangles = sheet(2, 2)
    shell, depth = cloth(points - np.array([0.0, 0.0, 1e-3]), triangles), 1.5e-3
    run = move(shell, scheme, step, 0.05, obstacles=[ground], offset=5e-4)
    contact, books = run.problem.contact, run.path.books
    assert run.path.converged and contact.closes > np.sqrt(6.0 * depth / 9.81)
    assert np.abs(run.positions[-1] - points - [0.0, 0.0, 5e-4]).max() < 1e-12
    shell_mass = run.problem.vertex_mass().sum()
    lifted = shell_mass * 9.81 * depth
    fastest = max(books.kinetic(replace(run.path.kinematics, velocity=v)) for v in run.velocities)
    assert abs(fastest - 0.5 * shell_mass * (1.5 * depth / contact.closes) ** 2) < 0.01 * lifted
    assert abs(books.totals["obstacles_work"] / lifted - 1.0) < 0.02 and abs(books.error) < 1e-9 * lifted
