"""Rest shapes that can be laid flat: zero angle defect at every vertex inside a panel, as equality constraints.

A triangle mesh is locally isometric to the plane where the angles around each inner vertex sum to 2 pi. Design
variables z are first moved to the nearest developable shape (Newton's method on the constraints, least change in the
mass metric M),

    z <- z - M^-1 J^T (J M^-1 J^T)^-1 c(z),

so every shape that is simulated satisfies them to round-off; derivatives are projected on their tangent space. A design
of the adjoint method like any other: no multipliers, no penalty.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import scipy.sparse as sp
from mpi4py import MPI
from petsc4py import PETSc

from voile.arrays import Flags, Ints, Reals, area_vectors
from voile.errors import NotConverged
from voile.inverse.flatten import FlatPanels, flatten, overlaps
from voile.inverse.target import Target
from voile.problem.partition import gathered
from voile.problem.rest import RestShape
from voile.problem.shell import Shell
from voile.solver.linear import use_lu

FLAT = 1e-10  # rad, largest angle defect of a shape that is taken as developable
ENDED = "inverse.max_seconds ended its search"
MOST = 400  # Newton iterations of a projection
FIRST_DAMPING, LEAST_DAMPING = 1e-3, 1e-13  # of the largest diagonal entry


class DevelopableRest:
    """Rest positions of a surface whose angle defects vanish at its inner vertices; boundaries, seams and the borders
    between groups are exempt.

    exempt (n,), on rank 0: further vertices without constraint, None elsewhere. `projected` are the design variables of
    the shape that was set last.
    """

    def __init__(self, target: Target, shell: Shell | None, exempt: Ints | None = None):
        self.rest: RestShape = target.rest
        self.problem = problem = target.problem
        part = problem.part
        inner = None
        if shell is not None:
            topology = shell.topology
            inner = np.ones(len(shell.points), dtype=bool)
            inner[topology.edges[topology.boundary_edges]] = False
            for ends in (shell.slave, shell.first, shell.second):
                inner[ends] = False
            if exempt is not None:
                inner[exempt] = False
            used = np.zeros(len(shell.points), dtype=bool)
            used[shell.triangles] = True
            held = shell.fixed.all(axis=1)
            ring = np.zeros(len(shell.points), dtype=bool)  # has a neighbour that can move, or can itself
            free = ~held[shell.triangles].all(axis=1)
            ring[shell.triangles[free]] = True
            inner &= used & ring
        inner = problem.comm.bcast(inner)
        self.rows = np.flatnonzero(inner[part.vertex] & problem.own)
        self.count = problem.comm.allreduce(len(self.rows))
        self.inverse_mass = self.rest.weight()
        own = self.inverse_mass.array
        own[own > 0.0] = 1.0 / own[own > 0.0]
        self._row = np.full(len(part.vertex), -1)
        self._row[self.rows] = np.arange(len(self.rows))
        self._columns = np.concatenate([part.first_global + np.arange(part.owned), part.ghost_global]).astype(
            np.int32
        )
        self.projected = problem.create_vector()
        self._made: tuple[Any, ...] = ()  # PETSc objects of the last `_prepare`

    # ---- the constraints ----

    def defects(self) -> Reals:
        """(own constraints,) 2 pi less the angles around a vertex (rad), of the present rest shape."""
        corners, angle, _ = self._angles()
        return 2.0 * np.pi - np.bincount(
            self._row[corners[self._row[corners] >= 0]], angle[self._row[corners] >= 0], len(self.rows)
        )

    def largest_defect(self) -> float:
        """Largest absolute angle defect (rad)."""
        return float(self.problem.comm.allreduce(float(np.abs(self.defects()).max(initial=0.0)), op=MPI.MAX))

    def _angles(self) -> tuple[Ints, Reals, Reals]:
        """Vertices (m, 3) of the rest triangles' corners, angles there (m, 3), their gradients (m, 3, 3, 3) by the
        corners: angle k by corner j's axis."""
        part = self.problem.part
        x = part.rest_points[part.rest_corners]
        angle, gradient = np.empty(x.shape[:2]), np.zeros((len(x), 3, 3, 3))
        normal = area_vectors(part.rest_points, part.rest_corners)
        normal /= np.linalg.norm(normal, axis=1)[:, None]
        for k in range(3):
            one, two = x[:, (k + 1) % 3] - x[:, k], x[:, (k + 2) % 3] - x[:, k]
            angle[:, k] = np.arctan2(
                np.linalg.norm(np.cross(one, two), axis=1), np.einsum("ti,ti->t", one, two)
            )
            # turning either side towards the other at the rate 1 / length
            first = np.cross(one, normal) / np.einsum("ti,ti->t", one, one)[:, None]
            second = np.cross(normal, two) / np.einsum("ti,ti->t", two, two)[:, None]
            gradient[:, k, (k + 1) % 3] = first
            gradient[:, k, (k + 2) % 3] = second
            gradient[:, k, k] = -first - second
        return part.corners, angle, gradient

    def jacobian(self) -> PETSc.Mat:
        """(constraints, unknowns) derivative of `defects` by the design variables."""
        problem, part = self.problem, self.problem.part
        corners, _, gradient = self._angles()
        row = np.broadcast_to(self._row[corners][:, :, None, None], gradient.shape)
        column = np.broadcast_to(3 * corners[:, None, :, None] + np.arange(3), gradient.shape)
        used = row >= 0
        local = sp.csr_matrix(
            (-gradient[used], (row[used], column[used])), shape=(len(self.rows), 3 * len(part.vertex))
        )
        local = (local @ part.matrix[: 3 * len(part.vertex)]).tocsr()
        matrix = PETSc.Mat().createAIJ(
            ((len(self.rows), self.count), (part.owned, problem.unknowns)),
            csr=(local.indptr.astype(np.int32), self._columns[local.indices], local.data),
            comm=problem.comm,
        )
        matrix.assemble()
        return matrix

    # ---- as a design ----

    def create(self) -> PETSc.Vec:
        """A zero vector of design variables: those of the surface's rest shape."""
        return self.rest.create()

    def set(self, z: PETSc.Vec, over: Callable[[], bool] = lambda: False) -> None:
        """Gives the problem the developable rest shape nearest to z. Raises NotConverged where there is none near, or
        its time is over before. Collective."""
        self.projected = z.copy()
        self.rest.set(self.projected)
        before, damping = self._norm(), FIRST_DAMPING
        for _ in range(MOST):
            if self.largest_defect() < FLAT:
                self._prepare(0.0)
                return
            if over():
                raise NotConverged(f"{self._missed()}; {ENDED}")
            self._prepare(damping)
            trial = self.projected.copy()
            trial.axpy(-1.0, self._correction())
            self.rest.set(trial)
            now = self._norm()
            if now < before:
                self.projected, before, damping = trial, now, 0.03 * damping
            else:
                self.rest.set(self.projected)
                damping *= 10.0
        raise NotConverged(self._missed())

    def _missed(self) -> str:
        return (
            f"no developable rest shape is found: an angle defect of {self.largest_defect():.2e} rad is left"
        )

    def _norm(self) -> float:
        own = self.defects()
        return float(np.sqrt(self.problem.comm.allreduce(float(own @ own))))

    def _prepare(self, damping: float) -> None:
        """Jacobian J at the present shape and the factor of J M^-1 J^T, damped (Levenberg, Marquardt): where the shape
        is plane the constraints depend on it to second order only."""
        for old in self._made:
            old.destroy()
        self._jacobian = self.jacobian()
        scaled = self._jacobian.copy()
        scaled.diagonalScale(None, self.inverse_mass)
        gram = scaled.matTransposeMult(self._jacobian)
        scaled.destroy()
        gram.setOption(PETSc.Mat.Option.NEW_NONZERO_ALLOCATION_ERR, False)  # a plane's rows are empty
        diagonal = gram.getDiagonal()
        gram.shift((damping + LEAST_DAMPING) * diagonal.max()[1])
        self._factor = PETSc.PC().create(comm=self.problem.comm)
        self._factor.setOperators(gram)
        use_lu(self._factor)
        self._factor.setUp()
        self._made = self._jacobian, gram, self._factor

    def _correction(self) -> PETSc.Vec:
        c = self._jacobian.createVecLeft()
        c.array[:] = self.defects()
        return self._lift(c)

    def _lift(self, c: PETSc.Vec) -> PETSc.Vec:
        """M^-1 J^T (J M^-1 J^T)^-1 c."""
        multiplier, out = c.duplicate(), self.create()
        self._factor.apply(c, multiplier)
        self._jacobian.multTranspose(multiplier, out)
        out.pointwiseMult(self.inverse_mass, out)
        return out

    def tangential(self, v: PETSc.Vec) -> PETSc.Vec:
        """Projection of a direction on those that keep the constraints."""
        c = self._jacobian.createVecLeft()
        self._jacobian.mult(v, c)
        out = v.copy()
        out.axpy(-1.0, self._lift(c))
        return out

    def cotangential(self, slope: PETSc.Vec) -> PETSc.Vec:
        """The transpose of `tangential`."""
        scaled, c, multiplier = self.create(), self._jacobian.createVecLeft(), self._jacobian.createVecLeft()
        scaled.pointwiseMult(self.inverse_mass, slope)
        self._jacobian.mult(scaled, c)
        self._factor.applyTranspose(c, multiplier)
        out, along = slope.copy(), self.create()
        self._jacobian.multTranspose(multiplier, along)
        out.axpy(-1.0, along)
        return out

    def ratios(self) -> tuple[Reals, Reals]:
        """Areas (m,) and edges (m, 3) of rest triangles over those of the target."""
        return self.rest.ratios()

    def weight(self) -> PETSc.Vec:
        """The diagonal metric, of sum 1 in each direction."""
        return self.rest.weight()

    def linearise(self, y: PETSc.Vec) -> None:
        """Takes dR/dX at the state y for `push` and `pull`."""
        self.rest.linearise(y)

    def push(self, v: PETSc.Vec) -> PETSc.Vec:
        """dR/dX v (N) along the constraints."""
        return self.rest.push(self.tangential(v))

    def pull(self, w: PETSc.Vec) -> PETSc.Vec:
        """w^T dR/dX along the constraints."""
        return self.cotangential(self.rest.pull(w))

    def idle(self) -> Flags:
        """(own,) marks entries that are no design variables."""
        return self.rest.idle()


def start_of_panels(
    target: Target, shell: Shell | None, z: PETSc.Vec, flat: FlatPanels | None
) -> Reals | None:
    """(p, 2) m on rank 0: the panels of the developable shape nearest to the rest shape z, which hang nearer to the
    target than the target laid flat does; `flat` itself where there is none, where its panels overlap, or where the
    target's clock is over. The shell has `flat` as rest shape; both on rank 0."""
    seams = None if shell is None else _on_seams(shell)
    design, points = DevelopableRest(target, shell, seams), None
    try:
        design.set(z, target.clock.over)
        points = gathered(target.problem, target.x + target.problem.motion(design.projected))
    except NotConverged:
        pass
    target.rest.set(z)
    if shell is None or flat is None or points is None:
        return flat.coordinates if flat else None
    panels = flat.panels
    surface = panels.points.copy()
    surface[panels.vertex[shell.rest_triangles]] = points[shell.triangles]
    nearer = flatten(replace(panels, points=surface)).coordinates
    return flat.coordinates if any(overlaps(nearer[each]) for each in panels.outlines) else nearer


def _on_seams(shell: Shell) -> Ints:
    """Vertices that have several in the rest shape."""
    pairs = np.column_stack([shell.triangles.ravel(), shell.rest_triangles.ravel()])
    return np.flatnonzero(np.bincount(np.unique(pairs, axis=0)[:, 0]) > 1)
