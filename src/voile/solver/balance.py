"""Whether obstacles can balance the loads of a shell that nothing holds: virtual work of a translation.

All reactions of a plane lie in one cone of Coulomb. Where some translation takes work from the loads, and none of the
planes' reactions may resist it, no shape of the shell is an equilibrium.
"""

import numpy as np
from petsc4py import PETSc

from voile.arrays import Reals
from voile.problem.contact import contact_of
from voile.problem.problem import Problem
from voile.solver.methods.steps import WORTH

ROUNDS = 50  # of rays of the cones: one for a plane, some five for a groove
EXACT = 1e-13  # of the loads: resistance of a reaction that is round-off
CERTAIN = 1e-6  # of the loads: what must be left of them lest round-off decide


def slides(problem: Problem, why: str, way: Reals) -> str:
    """That the shell leaves, and which way (3,)."""
    way = way / max(float(np.linalg.norm(way)), 1e-300)
    bodies = ", ".join(f"{name} (friction {mu:g})" for name, mu in contact_of(problem).frictions)
    return (
        f"the shell slides or falls: {why}; it moves along "
        f"({way[0]:.3f}, {way[1]:.3f}, {way[2]:.3f}) past {bodies}"
    )


def unbalanced(problem: Problem, y: PETSc.Vec, tolerance: float) -> str:
    """Why no shape of the shell has a residual's norm near the tolerance (N); empty where that is not certain: where
    supports or springs bear, pressure turns with the shell, or an obstacle has normals of more than one direction."""
    obstacles = contact_of(problem).obstacles
    if problem.held or problem.springs or problem.loads.pressed or not all(o.flat for o in obstacles):
        return ""
    at, own = problem.point(y), problem.own
    dead = problem.loads.forces(at)[: at.u.size].reshape(-1, 3)[own]
    total = problem.comm.allreduce(np.append(dead.sum(axis=0), len(dead)))
    load, vertices = total[:3], total[3]
    normals = np.array([o.gap_derivatives(np.zeros((1, 3)), problem.time)[1][0] for o in obstacles])
    left, bearing = unresisted(load, normals.reshape(-1, 3), np.array([o.friction for o in obstacles]))
    # A unit translation works at most the residual's norm times the root of the vertices that follow it.
    if float(np.linalg.norm(left)) <= WORTH * tolerance * np.sqrt(vertices):
        return ""
    along = left - np.linalg.pinv(bearing) @ (bearing @ left)
    way = along if float(np.linalg.norm(along)) > CERTAIN * float(np.linalg.norm(left)) else left
    return slides(problem, "no reactions of the obstacles balance its loads", way)


def unresisted(load: Reals, normals: Reals, frictions: Reals) -> tuple[Reals, Reals]:
    """What planes (k, 3) at least leave of a load (3,) N, zero where they may bear it, and the normals (b, 3) of
    those that bear then. Least squares over rays of their cones, to which those are added that resist what
    is left."""
    pressed = -normals @ load
    if (np.linalg.norm(load + pressed[:, None] * normals, axis=1) <= frictions * pressed).any():
        return np.zeros(3), normals  # one plane bears all
    from scipy.optimize import nnls  # takes 0.1 s to load

    size, rays, of = float(np.linalg.norm(load)), np.zeros((0, 3)), np.zeros(0, dtype=int)
    left, shares = load, np.zeros(0)
    for _ in range(ROUNDS):
        lifts = normals @ left
        along = left - lifts[:, None] * normals
        drags = np.linalg.norm(along, axis=1)
        if (lifts - frictions * drags >= -EXACT * size).all():
            break
        fresh = normals - (frictions / np.maximum(drags, 1e-300))[:, None] * along
        rays, of = np.concatenate([rays, fresh]), np.append(of, np.arange(len(normals)))
        shares = nnls(rays.T, -load)[0]
        left = load + shares @ rays
    else:
        return np.zeros(3), normals
    if float(np.linalg.norm(left)) <= CERTAIN * size:
        return np.zeros(3), normals
    return left, normals[np.unique(of[shares > 0.0])]
