"""Unknowns of a distributed shell, and the degrees of freedom that follow: C unknowns + closure + supports.

Displacements count from an origin: the start shape, or a shape nearer by (`count_from`). All problems of one shell
share it, for it changes how a shape is stored, not what it is.
"""

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from voile.arrays import Reals
from voile.problem.partition import Part
from voile.problem.state import State


class Unknowns:
    """Local degrees of freedom: 3 per local vertex, then one per local edge.

    `origin` (unknowns) and `base` (3 local vertices,) m are the shape that displacements count from.
    """

    def __init__(self, part: Part, comm: MPI.Comm):
        self.part, self.comm = part, comm
        self.vertices = 3 * len(part.vertex)  # degrees of freedom that are displacements
        self.count = int(comm.allreduce(part.owned))
        self._template = PETSc.Vec().createMPI((part.owned, self.count), comm=comm)
        ghosts = PETSc.IS().createGeneral(part.ghost_global.astype(np.int32), comm=PETSc.COMM_SELF)
        self._ghost_values = PETSc.Vec().createSeq(len(part.ghost_global), comm=PETSc.COMM_SELF)
        self._ghost_scatter = PETSc.Scatter().create(self._template, ghosts, self._ghost_values, None)
        self._collect = part.matrix.T.tocsr()[: part.owned]
        # (own unknowns,) whether each is a director's; the axis that the others move along, nearly where axes are local
        self.turns = part.place >= len(part.vertex)
        self.axis = np.where(self.turns, 3, np.abs(part.direction[: part.owned]).argmax(axis=1))
        self.origin = self.create()
        self._counted_anew = False
        self._start()

    def _start(self) -> None:
        self.base = np.zeros(self.vertices)
        self._hold(self.part.closure.copy(), 0.0)

    def _hold(self, closure: Reals, time: float) -> None:
        """What of the degrees of freedom is not C unknowns, at a time."""
        self._closure, self._since = closure, time
        self._held = closure, time

    def held(self, time: float) -> Reals:
        """(dofs,) the closure and what supports have moved; kept for the next call."""
        if self._held[1] != time:
            self._held = self._closure + self.part.supports.between(self._since, time), time
        return self._held[0]

    def create(self) -> PETSc.Vec:
        """A zero vector of unknowns."""
        return self._template.duplicate()

    # ---- degrees of freedom ----

    def spread(self, y: PETSc.Vec) -> tuple[Reals, Reals]:
        """C y: displacements (3 local vertices,) and director angles (local edges,)."""
        dofs = self._spread(y)
        return dofs[: self.vertices], dofs[self.vertices :]

    def _spread(self, y: PETSc.Vec) -> Reals:
        self._ghost_scatter.scatter(y, self._ghost_values, PETSc.InsertMode.INSERT, PETSc.ScatterMode.FORWARD)
        found: Reals = self.part.matrix @ np.concatenate([y.array_r, self._ghost_values.array_r])
        return found

    def shape(self, y: PETSc.Vec, time: float) -> tuple[Reals, Reals]:
        """Displacements from the origin (3 local vertices,) m and director angles (local edges,)."""
        dofs = self._spread(y)
        dofs += self.held(time)
        return dofs[: self.vertices], dofs[self.vertices :]

    def collect(self, dofs: Reals) -> Reals:
        """C^T of local forces: (own unknowns,)."""
        found: Reals = self._collect @ dofs
        return found

    def diagonal(self, dofs: Reals) -> Reals:
        """(own unknowns,) diagonal of C^T D C for a diagonal D over local degrees of freedom."""
        squares = self._collect.copy()
        squares.data **= 2
        found: Reals = squares @ dofs
        return found

    # ---- the origin ----

    def of(self, state: State) -> PETSc.Vec:
        """Those of a state, counted from the present origin."""
        y = state.unknowns.copy()
        y.axpy(1.0, state.origin)
        y.axpy(-1.0, self.origin)
        return y

    def count_from(self, y: PETSc.Vec, time: float) -> None:
        """The shape at y becomes the origin; y becomes zero.

        Stored as numbers near zero, displacements keep the digits that they lose when they are large, and with them
        the membrane forces of a stiff shell that has moved far.
        """
        u, phi = self.shape(y, time)
        self.stand_at(self.base + u, phi, time)
        self.origin.axpy(1.0, y)
        y.set(0.0)

    def stand_at(self, u: Reals, phi: Reals, time: float) -> None:
        """The shape with displacements u (3 local vertices,) m from the start shape and director angles phi (local
        edges,) becomes the origin."""
        self._counted_anew = True
        self.base = u
        self._hold(np.concatenate([np.zeros_like(u), phi]), time)

    def count_from_start(self, y: PETSc.Vec, time: float) -> bool:
        """The start shape becomes the origin again, and y counts from it; False where it was."""
        if not self._counted_anew:
            return False
        self._counted_anew = False
        part = self.part
        u, phi = self.shape(y, time)
        dofs = np.concatenate([self.base + u, phi]) - part.closure - part.supports.between(0.0, time)
        self._start()
        self.origin.set(0.0)
        y.array[:] = self.along(dofs)
        return True

    def along(self, dofs: Reals) -> Reals:
        """(own unknowns,) components of local degrees of freedom (dofs,) along each: what C would make of them, where
        it does."""
        nodes, part = dofs[: self.vertices].reshape(-1, 3), self.part
        found = np.empty(part.owned)
        still = ~self.turns
        found[still] = np.einsum("ni,ni->n", part.direction[: part.owned][still], nodes[part.place[still]])
        found[self.turns] = dofs[part.place[self.turns] + 2 * len(part.vertex)]
        return found
