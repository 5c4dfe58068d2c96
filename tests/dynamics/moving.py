"""Shells in time for tests: problems of arrays, followed by a scheme."""

from dataclasses import dataclass, field

import numpy as np
from mpi4py import MPI

from voile.contact.obstacles import Obstacle
from voile.problem.contact import with_obstacles
from voile.problem.load import History
from voile.problem.loads import LOADS
from voile.problem.problem import Problem
from voile.problem.shell import Shell
from voile.solver.path_in_time import TimeOptions, TimePath, TimeStep
from voile.solver.stepping.newton_step import NewtonStep
from voile.solver.stepping.schemes import SCHEMES, SchemeOptions
from voile.solver.stepping.time_path import Stepper, start_path

STEADY = dict.fromkeys(LOADS, History())


def cloth(points: np.ndarray, triangles: np.ndarray, held: np.ndarray | None = None, **given) -> Shell:
    """A shell of 1 mm, 1 MPa, 300 kg/m^3 in steady gravity along -z, unless given otherwise; held (n,): vertices that
    are clamped."""
    one = np.ones(len(triangles))
    fixed = np.zeros(points.shape, dtype=bool)
    if held is not None:
        fixed[held] = True
    values = {
        "rest_points": points,
        "rest_triangles": triangles,
        "flat": True,
        "model": "koiter/tan/stvk",
        "thickness": 1e-3,
        "young": 1e6,
        "poisson": 0.3,
        "density": 300.0,
        "fixed": fixed,
        "motion": np.zeros_like(points),
        "gravity": np.array([0.0, 0.0, -9.81]),
        "load_laws": STEADY,
    } | given
    for name in ("thickness", "young", "poisson", "density"):
        values[name] = values[name] * one
    shell = Shell(points=points, triangles=triangles, **values)
    if held is not None:
        shell.clamped_edges = np.flatnonzero(shell.fixed[shell.topology.edges].all(axis=(1, 2)))
    return shell


@dataclass
class Recorded:
    """A run with what was seen of every step: times (k,), positions and velocities (k, n, 3)."""

    path: TimePath
    problem: Problem
    solver: NewtonStep
    steps: list[TimeStep] = field(default_factory=list)
    times: list[float] = field(default_factory=list)
    positions: list[np.ndarray] = field(default_factory=list)
    velocities: list[np.ndarray] = field(default_factory=list)

    def see(self, step: TimeStep, path: TimePath) -> None:
        self.steps.append(step)
        self.times.append(step.time)
        self.positions.append(path.kinematics.positions)
        self.velocities.append(path.kinematics.velocity)

    @property
    def end(self) -> np.ndarray:
        return self.positions[-1]


def move(
    shell: Shell,
    scheme: str,
    time_step: float,
    duration: float,
    velocity: np.ndarray | float = 0.0,
    obstacles: list[Obstacle] | None = None,
    offset: float = 0.0,
    tolerance: float = 1e-9,
    asked: SchemeOptions | None = None,
    **more,
) -> Recorded:
    """Follows a shell in time; velocity: (n, 3) or (3,) m/s at the start."""
    problem = with_obstacles(Problem(shell, MPI.COMM_SELF), obstacles or [], offset).at(0.0)
    start = np.broadcast_to(velocity, shell.points.shape)[problem.part.vertex].astype(float)
    path = start_path(problem, start)
    solver = NewtonStep(problem)
    seen = Recorded(path, problem, solver)
    options = TimeOptions(SCHEMES[scheme](asked or SchemeOptions()), time_step, duration, tolerance, **more)
    Stepper(problem, options, solver, path).follow(seen.see)
    return seen
