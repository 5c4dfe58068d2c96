"""The softest modes of one tangent after another: block inverse iteration from the last ones.

K v = lambda M v with the shift at the margin that is asked for: the inertia of the factorisation tells whether all
eigenvalues are above it, and those near it, which matter most, come first. Each sweep takes Rayleigh-Ritz values in
the block Krylov space of the last modes, so modes that changed little cost two solves.
"""

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from voile.arrays import Reals
from voile.problem.problem import Problem
from voile.problem.rest import field_vector
from voile.solver.columns import products, times
from voile.solver.linear import Counts, add_mass, symmetric

MODES = 12  # at most
GUARD = 3  # more in the block: they speed up the last ones
POWERS = 2  # solves in a sweep
SWEEPS = 12
SETTLED = (
    1e-5  # change of an eigenvalue by the last solve over the range wanted: modes are then right to 1e-3
)
DEPENDENT = 1e-12  # squared length of a unit column, that is left of it beside others


class Modes:
    """Lowest eigenpairs by the mass M of a problem's tangents."""

    def __init__(self, problem: Problem, mass: PETSc.Vec, counts: Counts):
        self.problem, self.mass, self.most = problem, mass, min(MODES, problem.unknowns)
        self.solver = symmetric(problem.comm, PETSc.KSP.Type.PREONLY, 0.0, counts, "nearest_modes_")
        self.block = _start(problem, min(MODES + GUARD, problem.unknowns))

    def find(self, tangent: PETSc.Mat, margin: float, cut: float) -> tuple[Reals, Reals, int]:
        """Up to `most` eigenvalues (1/s^2), in order, their modes (own, p) of unit mass, right where they are less than
        a cut above the margin, and how many are below the margin: then they are only rough. None where the tangent
        cannot be factored. The tangent's diagonal is changed."""
        add_mass(tangent, self.mass, -margin)
        nothing = np.zeros(0), np.zeros((len(self.block), 0)), 0
        if not self.solver.factor(tangent):
            return nothing
        below = self.solver.negative or 0
        width = self.block.shape[1]
        for _ in range(SWEEPS):
            before, values, block = self._sweep(tangent)
            if not np.isfinite(block).all() or block.shape[1] < width:
                return nothing
            self.block = block
            wanted = max(int((values[: self.most] < cut).sum()), 1)
            change = np.abs(values - before)[:wanted] / max(min(cut, values[self.most - 1]), abs(values[0]))
            if below or change.max() <= SETTLED:  # no place to stay: about how low is enough
                break
        return values[: self.most] + margin, self.block[:, : self.most], below

    def _sweep(self, shifted: PETSc.Mat) -> tuple[Reals, Reals, Reals]:
        """Ritz values above the margin without the last solve, with it, and their vectors, in the space of the block
        and its solves."""
        comm, weight = self.problem.comm, self.mass.array_r[:, None]
        space, last, first = np.zeros((len(self.block), 0)), self.block, 0
        for power in range(POWERS + 1):
            if power:
                first = space.shape[1]
                last = self.solver.solutions(weight * last)
            last = self._beside(space, last)
            space = np.concatenate([space, last], axis=1)
        projected = products(space, times(shifted, space), comm)
        projected = 0.5 * (projected + projected.T)
        values, q = np.linalg.eigh(projected)
        width = self.block.shape[1]
        return np.linalg.eigvalsh(projected[:first, :first])[:width], values[:width], space @ q[:, :width]

    def _beside(self, space: Reals, columns: Reals) -> Reals:
        """Columns as an orthonormal basis (by M) of what they add to an orthonormal one."""
        comm, weight = self.problem.comm, self.mass.array_r[:, None]
        for _ in range(2):  # twice is enough (Kahan, in Parlett 1980)
            columns = columns - space @ products(space, weight * columns, comm)
            size = np.sqrt(comm.allreduce((weight * columns**2).sum(axis=0)))
            columns = columns / np.maximum(size, 1e-300)
            theta, q = np.linalg.eigh(products(columns, weight * columns, comm))
            kept = theta > DEPENDENT
            columns = columns @ (q[:, kept] / np.sqrt(theta[kept]))
        return columns


def _start(problem: Problem, count: int) -> Reals:
    """(own, count) random displacements, vertex by vertex the same for any number of ranks."""
    vertex = problem.part.vertex
    fields = np.random.default_rng(0).standard_normal(
        (problem.comm.allreduce(vertex.max(), op=MPI.MAX) + 1, 3, count)
    )
    return np.stack([field_vector(problem, fields[vertex, :, k]).array_r for k in range(count)], axis=1)
