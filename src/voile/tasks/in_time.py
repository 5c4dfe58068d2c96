"""What a task in time writes: steps with velocities, and its figures."""

import math
import time

import numpy as np

from voile.problem.damping import Air
from voile.problem.problem import Problem
from voile.results import ResultWriter
from voile.solver.stepping.time_path import TimePath, TimeStep
from voile.tasks.run import Run, rows


def initial_velocity(job: Run, x: np.ndarray) -> np.ndarray:
    """(n, 3) m/s of points x (n, 3) m that move as the scene's shell does at the start."""
    shell = job.scene.shell
    about = x - np.array(shell.angular_center)
    return np.array(shell.velocity) + np.cross(np.array(shell.angular_velocity), about)


def air(job: Run) -> Air | None:
    """The scene's, where it drags."""
    loads = job.scene.loads
    return Air(np.array(loads.wind), loads.drag) if loads.drag else None


class TimeSteps:
    """Takes the steps of a path as they come: tells the progress and writes the start, every so many, and the last."""

    def __init__(self, job: Run, problem: Problem, writer: ResultWriter, duration: float):
        self.job, self.problem, self.writer, self.duration = job, problem, writer, duration
        self.written = -1.0

    def __call__(self, step: TimeStep, path: TimePath) -> None:
        self.job.progress.time_step(step, self.duration)
        if step.time >= self.duration or path.count % self.job.scene.output.every == 0:
            self.write(step.time, step.residual, path)

    def finish(self, path: TimePath) -> None:
        """Writes the last good step where it is not."""
        if self.written < path.time:
            self.write(path.time, path.last.residual if path.last else math.nan, path)

    def write(self, at: float, residual: float, path: TimePath) -> None:
        """A step of the result file."""
        start, problem = time.perf_counter(), self.problem.at(at)
        values, own = rows(problem, path.state), problem.part.owned_vertices
        values["point_data"] = {**values.get("point_data", {}), "velocity": path.kinematics.velocity[own]}
        self.writer.write_step(at, scalars={"residual": residual, "converged": 1.0}, **values)
        self.written = at
        self.job.writing += time.perf_counter() - start


def figures(problem: Problem, path: TimePath) -> dict:
    """The summary's `dynamics`."""
    books, k = path.books, path.kinematics
    momentum, angular = books.momenta(k)
    energies = path.last.energies if path.last else problem.energies(path.state)
    return {
        "time": path.time,
        "energy": {"kinetic": books.kinetic(k), **energies, **books.totals},
        "balance_error": books.error,
        "momentum": momentum,
        "angular_momentum": angular,
    }
