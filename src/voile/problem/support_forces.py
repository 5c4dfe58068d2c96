"""What supports and clamps exert on a shell, and its sums over each [[fix]]."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from petsc4py import PETSc

from voile.arrays import Flags, Ints, Reals
from voile.problem.local_axes import Hold
from voile.problem.partition import gathered
from voile.problem.problem import Problem
from voile.problem.shell import Shell

ROUND_OFF = 1e-9  # of 1: a direction that others hold already


@dataclass(frozen=True)
class Supporting:
    """What supports exert on the shell: forces (local vertices, 3) N along degrees of freedom that follow no unknown,
    complete for this rank's own; moments (k, 3) N m of the clamps of some rows (k,) of part.half_edge_clamp, those
    whose triangles count on this rank."""

    forces: Reals
    row: Ints
    moments: Reals


def support_forces(problem: Problem, y: PETSc.Vec) -> Supporting:
    """What balances elastic forces, loads and contact at rest."""
    at, count = problem.point(y), problem.layout.vertices
    forces = problem.inner_forces(at)[:count]
    if problem.contact:
        forces += problem.contact.reactions(at.positions, problem.time).ravel()
    found: Reals = -np.einsum("nij,nj->ni", problem.kept, forces.reshape(-1, 3))
    return Supporting(found, *problem.elastic.clamp_moments(at))


def driven(problem: Problem) -> Flags:
    """(local vertices, 3) components that supports hold where any moves; all that are coupled to one where supports
    move along local axes."""
    carried = (
        np.diff(problem.part.supports.carry.indptr)[: problem.layout.vertices].reshape(-1, 3).any(axis=1)
    )
    alone = np.einsum("nii->ni", problem.kept) == 1.0
    return problem.moves & np.where(carried[:, None], problem.kept.any(axis=2), alone)


def clamp_ends(problem: Problem, row: Ints) -> Ints:
    """(k, 2) vertices in the input's order of the edges of some rows (k,) of part.half_edge_clamp."""
    part = problem.part
    half = part.half_edge_clamp[row, 0].astype(np.int64)
    ends = np.column_stack([part.corners[half // 3, (half + turn) % 3] for turn in (1, 2)])
    found: Ints = part.vertex[ends]
    return found


def support_table(
    problem: Problem, y: PETSc.Vec, given: Supporting, shell: Shell | None, holds: Sequence[Hold] | None
) -> list[dict[str, Any]] | None:
    """On rank 0 (which has shell and holds) what is `given` at y, per [[fix]]: its name, force (N) on the shell and
    moment (N m) about the centroid of its vertices as they are now. What several hold along one direction counts with
    the first; what is sewn to a held vertex counts with that."""
    forces, x = gathered(problem, given.forces), gathered(problem, problem.positions(y))
    pieces = problem.comm.gather((clamp_ends(problem, given.row), given.moments))
    if pieces is None or shell is None or holds is None or forces is None or x is None:
        return None
    ends, moments = (np.concatenate(parts) for parts in zip(*pieces, strict=True))
    joined, loose = shell.sewing()[0].astype(bool), np.ones(len(ends), dtype=bool)
    selected = np.zeros((len(x), len(holds)), dtype=bool)
    for k, hold in enumerate(holds):
        selected[hold.vertices, k] = True
    table = []
    shares = _shares(holds, joined @ (joined.T @ selected), forces)
    for hold, inside, force in zip(holds, selected.T, shares, strict=True):
        centre = x[inside].mean(axis=0)
        moment = np.cross(x - centre, force).sum(axis=0)
        if hold.clamp:
            own = loose & inside[ends].all(axis=1)
            loose &= ~own
            moment += moments[own].sum(axis=0)
        table.append({"name": hold.name, "force": force.sum(axis=0), "moment": moment, "about": centre})
    return table


def _shares(holds: Sequence[Hold], members: Flags, forces: Reals) -> list[Reals]:
    """(n, 3) of each hold of the forces (n, 3) N: along its directions, together all. members (n, holds)."""
    shares, held = [np.zeros_like(forces) for _ in holds], np.flatnonzero(members.any(axis=1))
    alike, which = np.unique(members[held], axis=0, return_inverse=True)
    for kind, tables in enumerate(alike):
        vertices, rows = held[which.ravel() == kind], np.zeros((0, 3))
        owner: list[int] = []
        for k in np.flatnonzero(tables):
            for direction in holds[k].directions:
                new = direction - np.linalg.pinv(rows) @ (rows @ direction)
                if np.linalg.norm(new) > ROUND_OFF:
                    rows, owner = np.vstack([rows, direction]), [*owner, k]
        along = forces[vertices] @ np.linalg.pinv(rows)
        for k, amount, direction in zip(owner, along.T, rows, strict=True):
            shares[k][vertices] += amount[:, None] * direction
    return shares
