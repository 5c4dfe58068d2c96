"""Obstacles in a distributed problem: how they come in, and what their contact is afterwards."""

from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import scipy.sparse as sp
from mpi4py import MPI
from petsc4py import PETSc

from voile.arrays import Array, Flags, Ints, Reals, sums, triangle_areas
from voile.contact.candidates import Layers, near_along
from voile.contact.contact import FREE, SLIP, STICK, Contact
from voile.contact.interfaces import SelfContact
from voile.contact.obstacles import Obstacle
from voile.contact.pairs import Pairs, margin
from voile.problem.augmented import ImpenetrableLayers
from voile.problem.problem import Problem
from voile.problem.shell import Shell, seam_gaps

SAMPLED, MOST_SAMPLES = 0.01, 200  # sizes of the shell between places at which a way is looked at; how many
DEEP = 0.01  # sizes of the shell: how deep the way of a step may lead into an obstacle
SHARP = 1e-13  # sizes: gaps and slips that make up the tolerance of a residual
TOUCH = 1e-10  # times the shell's size: a gap that is none to round-off


def with_obstacles(
    problem: Problem, obstacles: list[Obstacle], offset: float | Reals, layers: Layers | None = None
) -> Problem:
    """The problem with obstacles in the shell's way, at a distance of `offset` (m) from the mid-surface, one or
    (obstacles, local vertices), and with layers the shell in its own; without contact if there are none."""
    if not obstacles and layers is None:
        return problem.with_contact(None)
    part = problem.part
    unknowns = np.diff(part.matrix.indptr)[: 3 * len(part.vertex)].reshape(-1, 3)
    stiffness = part.fabric[0] * part.fabric[1]
    bending = stiffness * part.fabric[0] ** 2 / 12.0
    area = triangle_areas(part.rest_points, part.rest_corners)
    totals = [stiffness @ part.weight, bending @ part.weight, area @ part.weight, part.weight.sum()]
    stretches, bends, covers, count = problem.comm.allreduce(np.array(totals))
    scale, pliable = float(stretches / count), float(bends / covers)
    movable = unknowns.any(axis=1)
    itself = None if layers is None else _on_itself(problem, layers, movable)
    contact = Contact(obstacles, offset, scale, movable, problem.own, TOUCH * problem.size(), itself, pliable)
    return problem.with_contact(contact, *([ImpenetrableLayers(contact)] if itself else []))


def shell_layers(shell: Shell, offset: float, friction: float) -> Layers:
    """The layers of a sewn shell whose surfaces touch at `offset` (m) from the mid-surface. Vertices nearer along the
    cloth than half the circumference of the tightest fold cannot keep apart, nor can what is sewn together, nor what a
    sliver parts, nor layers that start nearer than the seams gape: closing those may carry one through the other. Of
    what seams join further along them cannot what lies along the seam or starts too near."""
    edges, x, n = shell.topology.edges, shell.points, len(shell.points)
    masters = np.concatenate([shell.first, shell.second])
    share = np.concatenate([1.0 - shell.weight, shell.weight])  # of the slave's position
    sewn = np.column_stack([np.tile(shell.slave, 2), masters])[share > 0.0]
    across = np.linalg.norm(x[shell.second] - x[shell.first], axis=1)
    opening = (1.0 - share) * np.tile(across, 2)
    along = np.linalg.norm(x[edges[:, 1]] - x[edges[:, 0]], axis=1)
    length = np.concatenate([along, opening[share > 0.0]])
    near = near_along(np.concatenate([edges, sewn]), length, n, np.pi * offset)
    thin = _across_slivers(x, shell.triangles, np.pi * offset)
    excluded, joined = np.unique(np.concatenate([near, thin]), axis=0), _joined(sewn, n)
    along_seams = joined[~np.isin(joined @ [n, 1], excluded @ [n, 1])]
    excluded = np.concatenate([excluded, along_seams])
    layers = Layers(x, shell.triangles, edges, excluded, 2.0 * offset, friction, seams=along_seams)
    gape = seam_gaps(shell).max(initial=0.0)
    layers = replace(layers, barred=layers.joined(max(gape, 2.0 * offset)))
    caught = layers.nearer(gape)
    return replace(layers, excluded=np.concatenate([excluded, caught]), caught=len(np.unique(caught, axis=0)))


def _across_slivers(x: Reals, triangles: Ints, limit: float) -> Ints:
    """(b, 2) ascending pairs of vertices: of triangles less than `limit` (m) high, the corner across from the longest
    side and that side's ends."""
    corner = x[triangles]
    side = np.roll(corner, -2, axis=1) - np.roll(corner, -1, axis=1)  # across from each corner
    length = np.linalg.norm(side, axis=2)
    twice = np.linalg.norm(np.cross(side[:, 0], side[:, 1]), axis=1)
    flat = np.flatnonzero(twice < limit * length.max(axis=1))
    first = length[flat].argmax(axis=1)
    pairs = [triangles[flat[:, None], (first[:, None] + [0, k]) % 3] for k in (1, 2)]
    return np.sort(np.concatenate(pairs), axis=1)


def _joined(sewn: Ints, n: int) -> Ints:
    """(b, 2) ascending pairs of n vertices joined by up to three links sewn (k, 2): those that may lie on one edge
    where up to four panels meet."""
    ones = np.ones(len(sewn))
    link = sp.csr_matrix((ones, sewn.T), shape=(n, n))
    link = link + link.T
    return np.column_stack(sp.triu(link + link @ link + link @ link @ link, 1).nonzero())


def _on_itself(problem: Problem, layers: Layers, movable: Flags) -> SelfContact:
    """Layers as all ranks see them: each has the positions of all vertices, and the same pairs. Raises InputError where
    layers start in the same place or through each other, or supports hold them too near."""
    part, comm = problem.part, problem.comm
    own = part.owned_vertices
    place = np.concatenate(comm.allgather(part.vertex[own]))
    everything = np.empty_like(place)
    everything[place] = np.arange(len(place))

    def gather(rows: Array) -> Array:
        found: Array = np.concatenate(comm.allgather(rows[own]))[everything]
        return found

    start: Reals = gather(part.points + part.closure[: part.points.size].reshape(-1, 3))
    free: Flags = gather(movable)
    carried = part.supports.between(0.0, 1.0)
    layers.check_start(start)
    layers = layers.started(start)
    end: Reals = start + gather(carried[: part.points.size].reshape(-1, 3))
    for x in (start, end):
        layers.check_held(x, free)
    mine = np.zeros(len(place), dtype=bool)
    mine[part.vertex[own]] = True
    return SelfContact(layers, gather, part.vertex, free, mine)


def contact_fields(problem: Problem, y: PETSc.Vec) -> dict[str, Array]:
    """At the local vertices: reaction (n, 3) N on the shell, gap (n,) m to the nearest obstacle or layer, where one is
    near, contact (n,): 0 free, 1 stick, 2 slip; and of Coulomb's cone: normal_reaction (n, 3) N along its axis,
    friction (n,) its coefficient, 0 without active contact, margin (n,) the share of friction's bound that is left."""
    return _fields(problem, y, contact_of(problem).pairs(problem.positions(y), problem.time))


def _fields(problem: Problem, y: PETSc.Vec, found: list[Pairs]) -> dict[str, Array]:
    contact, x, factor = contact_of(problem), problem.positions(y), problem.time
    n, along = len(x), np.zeros_like(x)
    state, friction, left = np.full(n, FREE), np.full(n, np.inf), np.ones(n)
    for pairs in found:
        active = pairs.lam_n > 0.0
        kind = np.where(pairs.slips, SLIP, STICK)
        state = np.maximum(state, -contact.least(pairs, active, -kind))
        friction = np.minimum(friction, contact.least(pairs, active, np.full(len(active), pairs.friction)))
        normal, tangential = pairs.project()
        share = margin(pairs.gradient_norm * normal, tangential, pairs.friction)
        left = np.minimum(left, contact.least(pairs, active, share))
        contact.collect(pairs, partial(pairs.spread, normal, 0.0 * tangential), along)
    gaps = [contact.nearest(k, x, factor) for k in range(len(contact.partners))]
    return cone_fields(contact.projected(found), np.min(gaps, axis=0), state, along, friction, left)


def cone_fields(
    reaction: Reals, gap: Reals, state: Reals, along: Reals, friction: Reals, left: Reals
) -> dict[str, Array]:
    """The fields of `contact_fields`; friction is infinite without active contact."""
    return {
        "reaction": reaction,
        "gap": gap,
        "contact": state.astype(np.uint8),
        "normal_reaction": along,
        "friction": np.where(np.isfinite(friction), friction, 0.0),
        "margin": left,
    }


def contact_report(problem: Problem, y: PETSc.Vec) -> dict[str, Any]:
    """Figures of the contact over all ranks: active, stick, slip (vertices), max_penetration (m), friction_error
    (mismatch of the laws over the reactions' norm), self_contacts (pairs that touch), and of each obstacle name,
    vertices, force (N), moment about the origin (N m) on the shell and contact area (m^2, of the rest shape)."""
    contact, x, factor, comm = contact_of(problem), problem.positions(y), problem.time, problem.comm
    found = contact.pairs(x, factor)
    fields = _fields(problem, y, found)
    state = fields["contact"][problem.own]
    counts = comm.allreduce(np.array([(state > FREE).sum(), (state == STICK).sum(), (state == SLIP).sum()]))
    inside = problem.own & contact.movable
    depth = comm.allreduce(abs(float(np.min(fields["gap"][inside], initial=0.0))), op=MPI.MAX)
    area = vertex_areas(problem)
    totals, touching = np.zeros((len(contact.obstacles), 8)), 0
    for pairs in found:
        normal, friction = pairs.project()
        own = contact.counted(pairs) & (normal > 0.0)
        if pairs.index == len(contact.obstacles):
            touching = int(own.sum())
            continue
        force = (normal[:, None] * pairs.gradient + friction)[own]
        v = pairs.vertex[own]
        totals[pairs.index] = [*force.sum(axis=0), *np.cross(x[v], force).sum(axis=0), area[v].sum(), len(v)]
    totals = comm.allreduce(totals)
    mismatch = comm.allreduce(contact.missed(found))
    size = comm.allreduce(float((fields["reaction"][problem.own] ** 2).sum()))
    return {
        "active": int(counts[0]),
        "stick": int(counts[1]),
        "slip": int(counts[2]),
        "max_penetration": depth,
        "friction_error": float(np.sqrt(mismatch / size)) if size else 0.0,
        "self_contacts": comm.allreduce(touching),
        "obstacles": [
            {"name": o.name, "vertices": int(t[7]), "force": t[:3], "moment": t[3:6], "area": t[6]}
            for o, t in zip(contact.obstacles, totals, strict=True)
        ],
    }


def measured_pairs(problem: Problem, x: Reals, tolerance: float) -> list[Pairs]:
    """The pairs at positions x (n, 3) by which a residual is measured that is to be within a tolerance (N)."""
    return contact_of(problem).measured_pairs(x, problem.time, tolerance / (SHARP * problem.size()))


def contact_work(problem: Problem, found: list[Pairs], way: Reals, before: Reals) -> dict[str, float]:
    """Of the pairs found over the vertices' way (n, 3) m since they were at `before` (n, 3) m (J): friction and
    impact, what tangential and normal reactions dissipate over the way relative to their partner; obstacles, what
    these work by moving; total, on the shell."""
    contact, total = contact_of(problem), np.zeros(4)
    for pairs in found:
        partner, index = contact.partners[pairs.index], pairs.index
        normal, tangential = pairs.project()
        _, moved = pairs.motion(partner.gather(way))
        force, carried = normal[:, None] * pairs.gradient, np.zeros_like(moved)
        if index < len(contact.obstacles):
            start = before[pairs.row]
            began = contact.history.time
            carried = contact.obstacles[index].carry(start, began, problem.time) - start
            closed = contact.hollow(index, began) - contact.hollow(index, problem.time)
            carried += (closed[pairs.row] / pairs.gradient_norm)[:, None] * pairs.unit
        own, relative = contact.counted(pairs), moved - carried
        parts = (-(tangential * relative), -(force * relative), (force + tangential) * carried)
        works = np.array([part[own].sum() for part in parts])
        total += [*works, works[2] - works[0] - works[1]]
    return dict(zip(("friction", "impact", "obstacles", "total"), problem.comm.allreduce(total), strict=True))


def leads_through(problem: Problem, before: Reals, began: float, after: Reals, touching: float) -> bool:
    """Whether the straight way from positions `before` (n, 3), at the load factor `began`, to those `after`, at the
    present one, leads a vertex through an obstacle, deeper than `touching` (sizes of the shell)."""
    farthest = problem.in_sizes(np.linalg.norm(after - before, axis=1))
    shares = np.linspace(0.0, 1.0, min(int(farthest / SAMPLED), MOST_SAMPLES) + 1)[1:-1]
    inside = contact_of(problem).inside_between(
        before, began, after, problem.time, shares, problem.size(), touching
    )
    return not problem.everywhere(not inside.any())


def passes_through(problem: Problem, before: Reals, began: float, after: Reals) -> bool:
    """The same of a step that may be taken: it leads a vertex deep into an obstacle, or in on one side and out on
    another, for there are thinner ones."""
    if leads_through(problem, before, began, after, DEEP):
        return True
    crosses = contact_of(problem).crosses(before, began, after, problem.time)
    return not problem.everywhere(not crosses.any())


def pushed_vertices(problem: Problem, x: Reals) -> Flags:
    """(local vertices,) marks those on which something bears at positions x (n, 3)."""
    if not problem.contact:
        return np.zeros(len(x), dtype=bool)
    found: Flags = problem.contact.reactions(x, problem.time).any(axis=1)
    return found


def contact_of(problem: Problem) -> Contact:
    """The contact of a problem that has one."""
    assert problem.contact is not None
    return problem.contact


def vertex_areas(problem: Problem) -> Reals:
    """(local vertices,) a third of the rest triangles around (m^2); complete for this rank's own."""
    part = problem.part
    area = triangle_areas(part.rest_points, part.rest_corners) / 3.0
    return sums(part.corners.ravel(), np.repeat(area, 3), len(part.vertex))
