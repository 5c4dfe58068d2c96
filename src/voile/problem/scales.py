"""Scales of a problem: rates, round-off, what its numbers mean."""

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from voile.arrays import triangle_areas
from voile.problem.problem import Problem


def slow_rate(problem: Problem) -> float:
    """1/s^2: inverse square of the time in which the load would move the shell's mass by its own size; with
    weak loads that of the slowest elastic waves."""
    part, rows = problem.part, problem.own_dofs()
    count = len(rows)
    force = (problem.loads.weight + part.force)[:count][rows]
    mass = part.mass[:count][rows]
    wave = (
        part.fabric[1] @ part.weight / max(part.fabric[3] @ part.weight, 1e-300) if len(part.weight) else 0.0
    )
    loaded = problem.norm(force) / problem.norm(mass)  # not of their squares, which overflow first
    wave = problem.comm.allreduce(wave, op=MPI.MAX)
    size = problem.size()
    return float(max(loaded / size, 1e-9 * wave / size**2))


def strained_rate(problem: Problem, y: PETSc.Vec) -> float:
    """1/s^2: as of a load, of what strains a shell out of balance."""
    f = y.duplicate()
    problem.residual(y, f)
    mass = problem.part.mass[: len(problem.own_dofs())][problem.own_dofs()]
    return float(f.norm() / max(problem.norm(mass) * problem.size(), 1e-300))


def force_floor(problem: Problem) -> float:
    """Round-off of the residual at a shape far from the start (N): what no tolerance without loads goes below."""
    part = problem.part
    stiffness = part.weight * part.fabric[0] * part.fabric[1]
    total = problem.comm.allreduce(float(stiffness @ stiffness))
    return float(1e-14 * float(np.sqrt(total)) * problem.size() / max(np.sqrt(problem.unknowns), 1.0))


def mean_mass(problem: Problem) -> float:
    """Of a vertex (kg)."""
    mass = problem.vertex_mass()[problem.own]
    total = problem.comm.allreduce(np.array([mass.sum(), len(mass)]))
    return float(total[0] / total[1])


def round_off(problem: Problem, y: PETSc.Vec) -> tuple[float, float]:
    """Norms of the residual's change (N) when every unknown changes by its last place, which `Problem.move_origin` can
    help, and of what the last places of the positions make of its evaluation, which nothing can."""
    sign = np.where(np.arange(len(y.array_r)) % 7 % 2, 1.0, -1.0)
    step = y.duplicate()
    step.array[:] = np.finfo(float).eps * sign * y.array_r
    here, ahead = (_residual_at(problem, y, step, side) for side in (0.0, 1.0))
    stored = (ahead - here).norm()
    step.array[:] = np.finfo(float).eps * sign * problem.size()
    ahead, back = (_residual_at(problem, y, step, side) for side in (1.0, -1.0))
    return stored, (ahead + back - 2.0 * here).norm() / np.sqrt(6.0)  # the linear part cancels


def least_area(problem: Problem, y: PETSc.Vec) -> float:
    """The smallest area of a triangle over that at rest."""
    part = problem.part
    now = triangle_areas(problem.positions(y), part.corners)
    rest = triangle_areas(part.rest_points, part.rest_corners)
    return float(problem.comm.allreduce(float((now / rest).min(initial=np.inf)), op=MPI.MIN))


def _residual_at(problem: Problem, y: PETSc.Vec, step: PETSc.Vec, length: float) -> PETSc.Vec:
    there, f = y.duplicate(), y.duplicate()
    there.waxpy(length, step, y)
    problem.residual(there, f)
    return f
