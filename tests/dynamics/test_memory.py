"""What many steps leave behind in memory."""

import resource
from pathlib import Path

import numpy as np
import pytest
from moving import cloth
from mpi4py import MPI
from test_problem import sheet

from voile.contact.obstacles import Plane
from voile.problem.contact import with_obstacles
from voile.problem.problem import Problem
from voile.results.history import HistoryWriter, read_history
from voile.solver.path_in_time import TimeOptions
from voile.solver.stepping.newton_step import NewtonStep
from voile.solver.stepping.schemes import ImplicitEuler
from voile.solver.stepping.time_path import Stepper, start_path
from voile.tasks.in_time import row


def resident() -> float:
    """Memory of this process (MiB)."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize() / 2**20


def follow(folder: Path, steps: int) -> list[float]:
    """A sheet that slides on a plane, turns, sticks and trembles on: memory (MiB) after each tenth of the steps; all of
    its history is kept."""
    points, triangles = sheet(2, 2, 0.1, 0.1)
    ground = Plane(point=np.zeros(3), normal=np.array([0.0, 0.0, 1.0]), friction=0.3)
    problem = with_obstacles(Problem(cloth(points, triangles), MPI.COMM_SELF), [ground], 0.0).at(0.0)
    velocity = np.column_stack([1.0 - points[:, 1], points[:, 0], 0.0 * points[:, 0]])
    path, used = start_path(problem, velocity), list[float]()
    history = HistoryWriter(folder / "history.h5", MPI.COMM_SELF)

    def see(step, path):
        history.add(row(step, path))
        if path.count % (steps // 10) == 0:
            used.append(resident())

    options = TimeOptions(ImplicitEuler(), 1e-3, 1e-3 * steps)
    Stepper(problem, options, NewtonStep(problem), path).follow(see)
    history.write()
    assert path.converged and path.count == steps
    assert len(read_history(folder)["time"]) == steps
    return used


def test_five_hundred_steps_leave_nothing_but_their_history(tmp_path):
    used = follow(tmp_path, 500)
    assert used[-1] - used[1] < 1.5


@pytest.mark.slow
def test_a_hundred_thousand_steps_leave_nothing_but_their_history(tmp_path):
    """Which is in its file: 8 MiB were left by the steps of a run (0.08 kB each)."""
    used = follow(tmp_path, 100_000)
    assert used[-1] - used[0] < 20.0
