"""Between unknowns and triangles: (m, 21) degrees of freedom of corners, vertices across edges and directors."""

import numpy as np
from petsc4py import PETSc

from voile.arrays import Ints, Reals, sums
from voile.problem.problem import Problem


def gather_triangles(problem: Problem, forces: Reals) -> PETSc.Vec:
    """Sum over triangles of forces (m, 21), which are zero across an edge without a neighbour, on the unknowns."""
    f, size = problem.create_vector(), problem.part.matrix.shape[0]
    f.array[:] = problem.layout.collect(sums(_dofs(problem).ravel(), forces.ravel(), size + 1)[:size])
    return f


def spread_triangles(problem: Problem, direction: PETSc.Vec) -> Reals:
    """(m, 21) a direction of the unknowns, as in `gather_triangles`."""
    return np.concatenate([*problem.layout.spread(direction), [0.0]])[_dofs(problem)]


def _dofs(problem: Problem) -> Ints:
    """(m, 21) local degrees of freedom, the place behind them all for directors that a model has not."""
    part = problem.part
    across = part.corners.ravel()[np.maximum(part.across, 0)]
    vertices = np.concatenate([part.corners, across], axis=1)
    places = (3 * vertices[:, :, None] + np.arange(3)).reshape(-1, 18)
    turns = np.where(
        part.triangle_edges < 0, part.matrix.shape[0], problem.layout.vertices + part.triangle_edges
    )
    return np.concatenate([places, turns], axis=1)
