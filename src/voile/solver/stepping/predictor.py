"""Predictors of a load step: where an equilibrium goes with its supports and obstacles, to first order.

Put to their new places at once, supports strain the triangles beside them by their whole motion, which Newton's
method then has to take out again: a sheet pinned at a corner, led over a ball, took five times as many factorisations.
A smooth path goes on as it went in the load step before (secant), whatever sticks or slips and however soft the shell
is. After a snap, and at the start, the tangent leads it (Euler).
"""

from collections.abc import Iterator

import numpy as np
from petsc4py import PETSc

from voile.arrays import Reals, triangle_areas
from voile.contact.directions import lengths
from voile.contact.natural_map import STUCK
from voile.contact.pairs import outer, times
from voile.problem.contact import contact_of
from voile.problem.matrix import Blocks
from voile.problem.problem import Problem
from voile.problem.scales import slow_rate
from voile.solver.methods.method import Workspace
from voile.solver.methods.steps import descent_direction

# Of a load step, from which forces' rates are taken: far above round-off, of next to no curvature.
SHARE = 1e-4
NEAR = 0.03  # of the start's norm, under which a prediction needs no other: as good ones start Newton's method alike


def predict(
    work: Workspace, problem: Problem, y: PETSc.Vec, began: float, most: float, went: PETSc.Vec | None
) -> None:
    """Moves y from an equilibrium at the time `began` towards that at the problem's, where no motion is more than
    `most` sizes, no layer passes through another, and the shell is out of balance by less than where it was. went: the
    load step before, as far as this one goes."""
    before, force, there, best = problem.at(began), y.duplicate(), y.duplicate(), y.copy()
    start, contact = before.positions(y), contact_of(problem)
    problem.residual(y, force)
    first = least = force.norm()
    for step in _steps(work, before, problem, y, went):
        if not problem.largest_motion(step) < most or before.longest_step(y, step) < 1.0:
            continue
        there.waxpy(1.0, step, y)
        # supports go there at once, too
        if not problem.everywhere(contact.free_share(start, problem.positions(there)) == 1.0):
            continue
        problem.residual(there, force)
        if force.norm() < least:
            least = force.norm()
            there.copy(best)
        if least < NEAR * first:
            break
    best.copy(y)


def _steps(
    work: Workspace, before: Problem, problem: Problem, y: PETSc.Vec, went: PETSc.Vec | None
) -> Iterator[PETSc.Vec]:
    """The secant's and the tangent's: the safe one with some mass, for the exact one may be indefinite, and where it is
    not it leads what is soft far away. Nothing slides that the load step does not move."""
    if went is not None:
        yield went
    rate, step = _rate(before, problem, y), y.duplicate()
    blocks, carried = _contacts(before, problem, y)
    rate.array[:] -= problem.layout.collect(problem.point(y).over_dofs(carried))
    before.tangent(y, work.matrix, "safe", blocks, slow_rate(problem))
    if work.symmetric.factor_definite(work.matrix):
        descent_direction(work.symmetric, rate, step)
        yield step


def edge_length(problem: Problem) -> float:
    """That of a square of two mean triangles (m)."""
    part = problem.part
    area = triangle_areas(part.rest_points, part.rest_corners)
    total, count = problem.comm.allreduce(np.array([area @ part.weight, part.weight.sum()]))
    return float(np.sqrt(2.0 * total / count))


def _rate(before: Problem, problem: Problem, y: PETSc.Vec) -> PETSc.Vec:
    """What of the residual (N) changes with time alone, over the load step from `before`."""
    start, rate = y.duplicate(), y.duplicate()
    before.residual(y, start)
    problem.at(before.time + SHARE * (problem.time - before.time)).residual(y, rate)
    rate.axpy(-1.0, start)
    rate.scale(1.0 / SHARE)
    return rate


def _contacts(before: Problem, problem: Problem, y: PETSc.Vec) -> tuple[Blocks, Reals]:
    """Springs that keep active contacts closed and lead what sticks with its obstacle, and their forces (n, 3) N over
    the load step."""
    contact, x, began = contact_of(problem), before.positions(y), before.time
    force, blocks = np.zeros_like(x), []
    for p in contact.pairs(x, began):
        normal, friction = (
            part[p.index][p.row] for part in (contact.history.normal, contact.history.friction)
        )
        active = normal > 0.0
        sticks = active & (lengths(friction) < (1.0 - STUCK) * p.friction * p.gradient_norm * normal)
        block = active[:, None, None] * outer(p.gradient, p.gradient)
        block += sticks[:, None, None] * (np.eye(3) - outer(p.unit, p.unit))
        block *= contact.penalty
        if p.index < len(contact.obstacles):
            there = contact.obstacles[p.index].carry(x[p.row], began, problem.time)
            force[p.row] += times(block, there - x[p.row])
        curved = np.where(active, normal, 0.0)[:, None, None] * p.curvature
        blocks.append((p.stencil, p.over_vertices(block, p.geometry.weight) - curved))
    return blocks, force
