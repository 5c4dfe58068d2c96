"""Obstacles in a distributed problem: how they come in, and what their contact is afterwards."""

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from voile.contact.obstacles import Obstacle
from voile.contact.state import FREE, SLIP, STICK, Contact
from voile.problem.discrete import Problem

TOUCH = 1e-10  # times the shell's size: a gap that is none to round-off


def attach(problem: Problem, obstacles: list[Obstacle], offset: float | np.ndarray) -> None:
    """Puts obstacles in the way, at a distance of `offset` (m) from the mid-surface, one or (obstacles, local
    vertices). Nothing if there are none."""
    if not obstacles:
        return
    part = problem.part
    unknowns = np.diff(part.matrix.indptr)[: 3 * len(part.vertex)].reshape(-1, 3)
    stiffness = part.fabric[0] * part.fabric[1]
    total = problem.comm.allreduce(np.array([stiffness @ part.weight, part.weight.sum()]))
    scale = float(total[0] / total[1])
    problem.contact = Contact(
        obstacles, offset, scale, unknowns.any(axis=1), problem.own, TOUCH * problem.size()
    )


def contact_fields(problem: Problem, y: PETSc.Vec) -> dict[str, np.ndarray]:
    """reaction (local vertices, 3) N on the shell, gap (local vertices,) m to the nearest obstacle, contact
    (local vertices,): 0 free, 1 stick, 2 slip."""
    contact, x, factor = _contact(problem), problem.positions(y), problem.load_factor
    gaps = [contact.gap(k, x, factor) for k in range(len(contact.obstacles))]
    state = np.full(len(x), FREE, dtype=np.uint8)
    for pairs in contact.pairs(x, factor):
        active = pairs.lam_n > 0.0
        slips = contact.slips(pairs)
        state[pairs.vertex[active & ~slips]] = np.maximum(state[pairs.vertex[active & ~slips]], STICK)
        state[pairs.vertex[active & slips]] = SLIP
    return {"reaction": contact.force(x, factor, frozen=False), "gap": np.min(gaps, axis=0), "contact": state}


def contact_report(problem: Problem, y: PETSc.Vec) -> dict:
    """Figures of the contact over all ranks: active, stick, slip (vertices), max_penetration (m), friction_error
    (mismatch of the laws over the reactions' norm), and of each obstacle name, vertices, force (N), moment about the
    origin (N m) on the shell and contact area (m^2, of the rest shape)."""
    contact, x, factor, comm = _contact(problem), problem.positions(y), problem.load_factor, problem.comm
    fields = contact_fields(problem, y)
    state = fields["contact"][problem.own]
    counts = comm.allreduce(np.array([(state > FREE).sum(), (state == STICK).sum(), (state == SLIP).sum()]))
    inside = problem.own & contact.movable
    depth = comm.allreduce(float(np.max(-fields["gap"][inside], initial=0.0)), op=MPI.MAX)
    area = _vertex_areas(problem)
    totals = np.zeros((len(contact.obstacles), 8))
    for pairs in contact.pairs(x, factor):
        normal, friction = contact.project(pairs)
        own = problem.own[pairs.vertex] & (normal > 0.0)
        force = (normal[:, None] * pairs.gradient + friction)[own]
        v = pairs.vertex[own]
        totals[pairs.index] = [*force.sum(axis=0), *np.cross(x[v], force).sum(axis=0), area[v].sum(), len(v)]
    totals = comm.allreduce(totals)
    mismatch = comm.allreduce(contact.mismatch(x, factor))
    size = comm.allreduce(float((fields["reaction"][problem.own] ** 2).sum()))
    return {
        "active": int(counts[0]),
        "stick": int(counts[1]),
        "slip": int(counts[2]),
        "max_penetration": depth,
        "friction_error": float(np.sqrt(mismatch / size)) if size else 0.0,
        "obstacles": [
            {"name": o.name, "vertices": int(t[7]), "force": t[:3], "moment": t[3:6], "area": t[6]}
            for o, t in zip(contact.obstacles, totals, strict=True)
        ],
    }


def _contact(problem: Problem) -> Contact:
    assert problem.contact is not None
    return problem.contact


def _vertex_areas(problem: Problem) -> np.ndarray:
    """(local vertices,) a third of the rest triangles around (m^2); complete for this rank's own."""
    part = problem.part
    a, b, c = (part.rest_points[part.rest_corners[:, k]] for k in range(3))
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 6.0
    return np.bincount(part.corners.ravel(), np.repeat(area, 3), len(part.vertex))
