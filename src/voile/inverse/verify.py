"""Does the rest shape hold the target? The direct simulation from the target, and from a disturbed start."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from petsc4py import PETSc

from voile.arrays import Reals, triangle_areas
from voile.inverse.target import Target
from voile.problem.lifetime import TimeIsOver, until
from voile.problem.problem import Problem
from voile.problem.rest import PanelRest
from voile.solver.path import Path, StaticsOptions
from voile.solver.statics import solve_statics

DISTURBANCE = 1.0  # thicknesses
NEARER = 0.1  # of its way to where contact may begin, that a vertex is disturbed at most: no jags there
CLOSED = 0.1  # rad, opening of a fold that a disturbance might turn inside out
ASTRAY = (
    4.0  # limits, beyond which no descent comes back: an overshoot against stretching is 4^(1/3) of the way
)
GENTLE = 0.01  # of its distance along the cloth from layers that touch, likewise: strain
TIMED_OUT = "inverse.max_seconds ended the simulation"


@dataclass
class Simulation:
    """A simulation with the rest shape found. sag: largest displacement from the target, or from where it was told to
    start, over the target's size; problem: what it was of; disturbance (m): largest of its start; timed_out: time ended
    it, where it began."""

    path: Path
    sag: float
    problem: Problem
    disturbance: float = 0.0
    timed_out: bool = False

    @property
    def settled_sag(self) -> float | None:
        """The sag where there is an equilibrium."""
        return self.sag if self.path.converged else None

    @property
    def eigenvalue(self) -> float:
        """Smallest omega^2 (1/s^2) where it was asked for, else a number of the same sign; nan where time ended it."""
        value = self.path.smallest_eigenvalue
        if value is not None:
            return value
        return math.nan if self.timed_out else 1.0 if self.stable else -1.0

    @property
    def stable(self) -> bool:
        return self.path.converged and self.path.stable is True


def simulate(
    target: Target,
    z: PETSc.Vec,
    tolerance: float,
    *,
    panels: PanelRest | None = None,
    disturbed: bool = False,
    eigenvalue: bool = False,
    start: PETSc.Vec | None = None,
    watch: Callable[[PETSc.Vec], None] | None = None,
    max_steps: int = StaticsOptions.max_steps,
) -> Simulation:
    """Statics under the full load with rest shape z (rest displacements and director angles, or what `panels` take),
    starting at the target, disturbed a thickness off it away from contacts, or at the unknowns `start`. tolerance:
    residual over the loads' norm; watch: told of the iterates of descents, to which a simulation that is watched keeps
    from the start; max_steps: attempts, the first at the full load. It ends where it began when the target's clock is
    over."""
    (panels or target.rest).set(z)
    problem = target.obstructed()
    first = start.copy() if start else problem.create_vector() if panels else target.rest.state(z)
    beside = _disturbance(target) if disturbed else problem.create_vector()
    first.axpy(1.0, beside)
    first_method: Literal["newton", "descent"] = "descent" if disturbed or watch else "newton"
    options = StaticsOptions(
        load_steps=1,
        tolerance=tolerance,
        eigenvalue=eigenvalue,
        first=first_method,
        watch=watch,
        max_steps=max_steps,
    )
    farthest = beside.norm(PETSc.NormType.INFINITY)
    path, over = _solved(target, problem, options, first)
    return Simulation(path, sag(target, path.state, start), problem, farthest, over)


def as_scene(target: Target, z: PETSc.Vec, options: StaticsOptions) -> Simulation:
    """As `simulate`, of the scene of statics that a user makes of the files, with its options: from the target on, with
    nothing known of contacts, whose gaps close, and by coarser levels of the mesh, which may lead to other folds."""
    problem = target.as_statics(z)
    path, over = _solved(target, problem, options)
    return Simulation(path, sag(target, path.state), problem, timed_out=over)


def _solved(
    target: Target, problem: Problem, options: StaticsOptions, start: PETSc.Vec | None = None
) -> tuple[Path, bool]:
    """The path of statics, or where it began and True if the target's clock was over before its end. Displacements then
    count from the start shape."""
    path, origin = None, problem.create_vector()
    try:
        with until(target.clock):
            path = solve_statics(problem, options, start=start, counts=target.counts)
        return path, False
    except TimeIsOver:
        state = start.copy() if start else problem.create_vector()
        return Path(state, reason=TIMED_OUT, counts=target.counts), True
    finally:
        problem.reset_origin(path.state if path else origin)


class Astray(Exception):
    """A simulation has gone too far."""


def settles_within(target: Target, z: PETSc.Vec, tolerance: float, limit: float) -> bool:
    """Whether the simulation with rest shape z from the target ends stable with a sag under a limit; it is given up
    where it has gone far beyond, or has no end under the full load: a way there by less load, which may fail, too, took
    50 of 58 s on a T-shirt."""

    def watch(y: PETSc.Vec) -> None:
        if sag(target, y) > ASTRAY * limit:
            raise Astray

    try:
        run = simulate(target, z, tolerance, watch=watch, max_steps=1)
    except Astray:
        return False
    return run.stable and run.sag <= limit


class Proofs:
    """Simulations of rest shapes from the target and from beside it, each done once. Beside what the target holds with
    the rest shape, and the tolerance, they depend on nothing."""

    def __init__(self, target: Target, tolerance: float):
        self.target, self.tolerance = target, tolerance
        self.runs: list[tuple[PETSc.Vec, dict[bool, Simulation]]] = []

    def __call__(self, z: PETSc.Vec, disturbed: bool = False) -> Simulation:
        """One of them; the target holds with z."""
        runs = next((runs for known, runs in self.runs if known.equal(z)), None)
        if runs is None:
            runs = dict[bool, Simulation]()
            self.runs.append((z.copy(), runs))
        if disturbed not in runs or runs[disturbed].timed_out:
            runs[disturbed] = simulate(self.target, z, self.tolerance, disturbed=disturbed)
        return runs[disturbed]


def sag(target: Target, y: PETSc.Vec, start: PETSc.Vec | None = None) -> float:
    """Largest displacement of y from the target, or from `start`, over the target's size."""
    problem = target.problem
    origin = problem.positions(start) if start else target.x
    moved = np.linalg.norm(problem.positions(y) - origin, axis=1)
    return problem.in_sizes(moved)


def _disturbance(target: Target) -> PETSc.Vec:
    """A smooth displacement (m) that leaves contacts where they are and sharp folds closed as they are: a thickness in
    the largest entry far off them."""
    problem, x = target.problem, target.x
    wave = np.pi * np.array([[3.0, 1.0, 2.0], [1.0, 3.0, 1.0], [2.0, 1.0, 3.0]]) / problem.size()
    reach = np.full(len(x), DISTURBANCE * problem.thickness())
    for obstacle in target.obstacles:
        away = obstacle.gap(x, 0.0) - target.offset - target.tolerance
        reach = np.minimum(reach, NEARER * np.maximum(away, 0.0))
    reach = np.minimum(reach, NEARER * _from_folds(target))
    if target.layers:
        reach = np.minimum(reach, GENTLE * target.contacts[-1].along())
    return target.field_vector(reach[:, None] * np.sin(x @ wave.T))


def _from_folds(target: Target) -> Reals:
    """(local vertices,) distance (m) from the nearest vertex of a nearly closed fold, plus its opening."""
    corners = target.problem.part.corners
    pairs, opening = target.folds()
    closed = opening < CLOSED
    at, x = corners[pairs[closed]].reshape(-1, 6), target.x
    area = triangle_areas(x, corners[pairs[closed]].reshape(-1, 3))
    width = np.sqrt(area.reshape(-1, 2).min(axis=1, initial=np.inf))
    comm = target.problem.comm
    points = np.concatenate(comm.allgather(x[at].reshape(-1, 3)))
    gaps = np.concatenate(comm.allgather(np.repeat(opening[closed] * width, 6)))
    distance = np.full(len(x), np.inf)
    for point, gap in zip(points, gaps, strict=True):
        np.minimum(distance, gap + np.linalg.norm(x - point, axis=1), out=distance)
    return distance
