"""Section forces: what a shell's own stresses carry from one side of a cut to the other."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from petsc4py import PETSc

from voile.arrays import Flags, Ints, Reals
from voile.problem.partition import gathered
from voile.problem.problem import Problem
from voile.problem.shell import Shell
from voile.problem.support_forces import clamp_ends


@dataclass(frozen=True)
class Section:
    """A cut round `vertices` (k,): moments count about `about` (3,) m, or about the centroid of the vertices next to
    the cut where they are now. areas (2, n): of the vertices that lie on the cut itself those beyond it, and all."""

    name: str
    vertices: Ints
    about: Reals | None
    areas: Reals


def section_table(
    problem: Problem, y: PETSc.Vec, shell: Shell | None, sections: Sequence[Section]
) -> list[dict[str, Any]] | None:
    """On rank 0 (which has the shell) per section its name, the force (N) and the moment (N m) that the rest of the
    shell exerts on the vertices inside.

    A triangle away from the cut is in balance with itself, so the elastic forces at the vertices inside add up to what
    crosses it: exactly what balances the loads, reactions and inertia there. What is sewn counts with the vertices that
    it follows. Clamps inside turn their triangles from outside the shell: their moments are taken off. Of a vertex on
    the cut, with what is sewn to it, its part of the loads and inertia counts; what holds it is on the other side.
    """
    at = problem.point(y)
    elastic = problem.elastic.forces(at)[: problem.layout.vertices].reshape(-1, 3)
    forces, x = gathered(problem, elastic), gathered(problem, problem.positions(y))
    loads = gathered(problem, -elastic - problem.reactions(y))
    row, turning = problem.elastic.clamp_moments(at)
    pieces = problem.comm.gather((clamp_ends(problem, row), turning))
    if pieces is None or shell is None or forces is None or loads is None or x is None:
        return None
    ends, moments = (np.concatenate(parts) for parts in zip(*pieces, strict=True))
    sewing, _ = shell.sewing()
    joined = (sewing == 1.0).T
    table = []
    for section in sections:
        inside = np.zeros(len(x))
        inside[section.vertices] = 1.0
        held = joined @ inside > 0.0
        share = sewing @ held  # of each vertex's force, that reaches what is inside
        beyond, whole = section.areas @ sewing
        on = (joined @ section.areas[1] > 0.0) & ~held
        parts = sewing @ np.where(on, beyond / np.where(on, whole, 1.0), 0.0)
        about = _next_to(shell, x, share > 0.0) if section.about is None else section.about
        force = share[:, None] * forces - parts[:, None] * loads
        moment = np.cross(x - about, force).sum(axis=0)
        moment -= (share[ends].min(axis=1)[:, None] * moments).sum(axis=0)
        table.append({"name": section.name, "force": force.sum(axis=0), "moment": moment, "about": about})
    return table


def _next_to(shell: Shell, x: Reals, inside: Flags) -> Reals:
    """(3,) centroid of the vertices inside that have neighbours outside, at positions x (n, 3); of all without such."""
    edges = shell.topology.edges
    cut = edges[inside[edges].any(axis=1) & ~inside[edges].all(axis=1)]
    rim = np.unique(cut[inside[cut]]) if len(cut) else np.flatnonzero(inside)
    found: Reals = x[rim].mean(axis=0)
    return found
