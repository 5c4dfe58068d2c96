"""What a task in time writes: steps with velocities, and its figures."""

import math
import time
from typing import Any

import numpy as np

from voile.arrays import Reals
from voile.problem.damping import Air
from voile.problem.problem import Problem
from voile.results import ResultWriter
from voile.results.history import HistoryWriter, read_history
from voile.solver.path_in_time import TimePath, TimeStep
from voile.solver.stepping.restart import packed, unpacked
from voile.solver.stepping.time_path import start_path
from voile.tasks.run import NO_CONTACT, Run, rows

MISSED = 2.0  # tolerances: laws measured anew at a step's end miss up to 1.4 times what a method saw


def initial_velocity(job: Run, x: Reals) -> Reals:
    """(n, 3) m/s of points x (n, 3) m that move as the scene's shell does at the start."""
    shell = job.scene.shell
    about = x - np.array(shell.angular_center)
    found: Reals = np.array(shell.velocity) + np.cross(np.array(shell.angular_velocity), about)
    return found


def air(job: Run) -> Air | None:
    """The scene's, where it drags."""
    loads = job.scene.loads
    return Air(np.array(loads.wind), loads.drag) if loads.drag else None


def begun(job: Run, problem: Problem) -> TimePath:
    """The path from the scene's start, or from where the run that it resumes was."""
    if job.resumes:
        return unpacked(problem, job.found)
    return start_path(problem, initial_velocity(job, problem.positions(problem.create_vector())))


class TimeSteps:
    """Takes the steps of a path as they come: tells the progress, adds to the history, writes the start, every so many,
    and the last, and now and then all that the run could go on from."""

    def __init__(self, job: Run, problem: Problem, writer: ResultWriter, path: TimePath, duration: float):
        self.job, self.problem, self.writer, self.duration = job, problem, writer, duration
        self.written, stored = path.time if job.resumes else -1.0, path.count if job.resumes else 0
        if stored and job.comm.rank == 0:  # before the first step there is no history
            read_history(job.folder)  # refuses one that is damaged
        self.history = HistoryWriter(job.folder / "history.h5", job.comm, stored)
        if not job.resumes:
            self.write(0.0, 0.0, path)
            self.save(path)

    def __call__(self, step: TimeStep, path: TimePath) -> None:
        self.history.add(row(step, path) | self._supports(step, path))
        if step.residual > MISSED * step.tolerance:
            path.short, path.worst = path.short + 1, max(path.worst, step.residual / step.tolerance)
        if step.time >= self.duration or path.count % self.job.scene.output.every == 0:
            self.write(step.time, step.residual, path)
            if self.job.restarts.due():
                self.save(path)
        self.job.progress.time_step(step, self.duration)  # what is printed is there

    def _supports(self, step: TimeStep, path: TimePath) -> dict[str, Reals]:
        """What each [[fix]] exerted in a step, on rank 0: columns of the history."""
        columns: dict[str, Reals] = {}
        table = self.job.supports(self.problem.at(step.time), path.state, path.supporting)
        for k, support in enumerate(table):
            columns |= {f"support_{k}": support["force"], f"support_{k}_moment": support["moment"]}
        return columns

    def finish(self, path: TimePath) -> None:
        """Writes the last good step where it is not, and where the run ended."""
        if self.written < path.time:
            self.write(path.time, path.last.residual if path.last else math.nan, path)
        self.save(path)
        self.history.close()

    def write(self, at: float, residual: float, path: TimePath) -> None:
        """A step of the result file."""
        start, problem = time.perf_counter(), self.problem.at(at)
        values, own = rows(problem, path.state, self.job.scene.output.fields), problem.part.owned_vertices
        values["point_data"] = {**values.get("point_data", {}), "velocity": path.kinematics.velocity[own]}
        self.writer.write_step(at, scalars={"residual": residual, "converged": 1.0}, **values)
        self.written = at
        self.job.writing += time.perf_counter() - start

    def save(self, path: TimePath) -> None:
        """History and restart files, in this order: no restart without its history."""
        began = time.perf_counter()
        self.history.write()
        self.job.keep(path.count, packed(self.problem, path), self.writer.steps, began)
        self.job.writing += time.perf_counter() - began


def row(step: TimeStep, path: TimePath) -> dict[str, Any]:
    """A step of the history."""
    books, k = path.books, path.kinematics
    momentum, angular = books.momenta(k)
    contact = step.contact or {**NO_CONTACT, "obstacles": []}
    forces = [body["force"] for body in contact["obstacles"]]
    return {
        "time": step.time,
        "time_step": step.length,
        "kinetic": books.kinetic(k),
        **step.energies,
        **books.totals,
        "balance_error": books.error,
        "momentum": momentum,
        "angular_momentum": angular,
        "speed": step.speed,
        "residual": step.residual,
        "balance_residual": step.balance_residual,
        "law_residual": step.law_residual,
        "tolerance": step.tolerance,
        "iterations": step.iterations,
        "factorisations": path.counts.factorisations,
        **{name: contact[name] for name in NO_CONTACT},
        "contact_force": np.sum(forces, axis=0) if forces else np.zeros(3),
    }


def figures(problem: Problem, path: TimePath) -> dict[str, Any]:
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
