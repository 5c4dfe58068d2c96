"""The discrete problem on PETSc's layout: potential, residual and tangent of a distributed shell."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from voile import _kernels
from voile.contact.state import Contact
from voile.problem.anchor import Anchor
from voile.problem.follower import pressure_energy, pressure_force
from voile.problem.matrix import Assembly, Blocks
from voile.problem.moments import EndMoments
from voile.problem.partition import distribute
from voile.problem.shell import Shell

ENERGIES = ("stretching", "bending", "gravity", "pressure", "force")


class Problem:
    """Equilibrium of a shell: unknown displacements (m) and director angles, at a load factor in [0, 1].

    The potential is the elastic energy less the work of the loads; `residual` is its gradient (N), `tangent` its
    Hessian. `conservative` is False where a load has no potential (pressure up to a free boundary, end moments);
    its work is then left out of `energy`. `moves`: some support is displaced along the load path;
    `held`: there is one; `supported`: along every axis there is. `monitor(load factor, iteration, residual in N)`, if
    set, is told of every Newton iteration.
    """

    def __init__(self, shell: Shell | None, comm: MPI.Comm = MPI.COMM_WORLD):
        self.comm = comm
        settings = None
        if shell is not None:
            follower = bool(shell.pressure and _free_rim(shell)) or shell.moment is not None
            settings = (
                shell.model,
                np.asarray(shell.gravity, float),
                float(shell.pressure),
                shell.flat,
                follower,
            )
        self.model, self.gravity, self.pressure, flat, follower = comm.bcast(settings)
        self.conservative = not follower
        probe = _kernels.Elastic(self.model, *_single_triangle())
        self.directors = probe.directors
        self.part = part = distribute(shell, self.directors, comm)
        self.moments = EndMoments(part) if part.moment.any() else None
        self.load_factor = 1.0
        self.contact: Contact | None = None
        self.anchor: Anchor | None = None
        self.monitor: Callable[[float, int, float], None] | None = None
        self.seconds = {"assembly": 0.0}
        self._size = (3 * len(part.vertex), len(part.edge))
        self.flat = flat
        self.kernel = self._make_kernel(part.points)
        self._base = np.zeros(self._size[0])  # displacements at the last `rebase`
        self._gap, self._base_factor, self._rebased = part.gap.copy(), 0.0, False
        self._collect = part.matrix.T.tocsr()[: part.owned]
        self._vertex_force = self._weights()
        self.own = np.zeros(len(part.vertex), dtype=bool)
        self.own[part.owned_vertices] = True
        axes = comm.allreduce(part.fixed[: 3 * len(part.vertex)].reshape(-1, 3).any(axis=0).astype(int))
        self.held, self.supported = bool(axes.any()), bool(axes.all())
        self.moves = bool(comm.allreduce(bool(part.lift.any()), op=MPI.LOR))
        self._length = self._measure()
        self._make_vectors()
        self._assembly = Assembly(part, self.directors, comm)

    def _make_kernel(self, start: np.ndarray) -> _kernels.Elastic:
        """The elastic model with displacements that count from `start` (local vertices, 3)."""
        part = self.part
        kernel = _kernels.Elastic(
            self.model,
            part.corners,
            part.triangle_edges,
            part.signs,
            part.across,
            len(part.edge),
            np.ascontiguousarray(start),
        )
        clamp = part.half_edge_clamp
        if len(clamp):
            half_edge, conormal, at_rest = np.ascontiguousarray(clamp[:, :3].astype(np.int32).T)
            kernel.set_clamps(half_edge, conormal, at_rest, np.ascontiguousarray(clamp[:, 3:]))
        kernel.set_rest(part.rest_points, part.rest_corners, self.flat)
        kernel.set_fabric(*(np.ascontiguousarray(row) for row in part.fabric[:3]))
        kernel.set_weights(part.weight)
        return kernel

    def set_rest(self, points: np.ndarray, flat: bool = False) -> None:
        """Another rest shape (local rest vertices, 3) m, flat without folds, and the masses that it has."""
        self.part.set_rest(points)
        self.flat = flat
        self.kernel.set_rest(self.part.rest_points, self.part.rest_corners, flat)
        self._vertex_force = self._weights()

    def _weights(self) -> np.ndarray:
        """(local dofs,) gravity at load factor 1 (N)."""
        weight = np.zeros(sum(self._size))
        weight[: self._size[0]] = (self.part.mass[: self._size[0]].reshape(-1, 3) * self.gravity).ravel()
        return weight

    def rebase(self, y: PETSc.Vec) -> None:
        """Counts displacements from the shape at y on; the unknowns of any state are then less by y, those of y zero.

        Stored as numbers near zero, displacements keep the digits that they lose when they are large, and with
        them the membrane forces of a stiff shell that has moved far.
        """
        u, phi = self._shape(y)
        self._rebased = True
        self._base += u
        self._gap, self._base_factor = np.concatenate([np.zeros_like(u), phi]), self.load_factor
        self.kernel = self._make_kernel(self.part.points + self._base.reshape(-1, 3))

    def unbase(self, y: PETSc.Vec) -> None:
        """Takes `rebase` back: y, and any state from now on, counts displacements from the start shape again."""
        if not self._rebased:
            return
        self._rebased = False
        dofs = np.concatenate(self.local(y)) - self.part.gap - self.load_factor * self.part.lift
        self._base[:] = 0.0
        self._gap, self._base_factor = self.part.gap.copy(), 0.0
        self.kernel = self._make_kernel(self.part.points)
        single = np.flatnonzero(np.diff(self.part.matrix.indptr) == 1)
        column = self.part.matrix.indices[self.part.matrix.indptr[single]]
        own = column < self.part.owned
        y.array[column[own]] = dofs[single[own]]

    # ---- layout ----

    def _make_vectors(self) -> None:
        part = self.part
        self.unknowns = int(self.comm.allreduce(part.owned))
        self._template = PETSc.Vec().createMPI((part.owned, self.unknowns), comm=self.comm)
        ghosts = PETSc.IS().createGeneral(part.ghost_global.astype(np.int32), comm=PETSc.COMM_SELF)
        self._ghost_values = PETSc.Vec().createSeq(len(part.ghost_global), comm=PETSc.COMM_SELF)
        self._ghost_scatter = PETSc.Scatter().create(self._template, ghosts, self._ghost_values, None)

    def create_vector(self) -> PETSc.Vec:
        """A zero vector of unknowns."""
        return self._template.duplicate()

    def create_matrix(self) -> PETSc.Mat:
        """A matrix with the tangent's pattern; its values are written in place by `tangent`."""
        return self._assembly.create(self.kernel)

    def local(self, y: PETSc.Vec) -> tuple[np.ndarray, np.ndarray]:
        """Displacements (3 local vertices,) and director angles (local edges,) of unknowns y, supports included."""
        u, phi = self._shape(y)
        return self._base + u, phi

    def _shape(self, y: PETSc.Vec) -> tuple[np.ndarray, np.ndarray]:
        """As `local`, but displacements from the shape of the last `rebase`."""
        u, phi = self._spread(y)
        held = self._gap + (self.load_factor - self._base_factor) * self.part.lift
        return u + held[: len(u)], phi + held[len(u) :]

    def _spread(self, y: PETSc.Vec) -> tuple[np.ndarray, np.ndarray]:
        """C y on the local degrees of freedom."""
        self._ghost_scatter.scatter(y, self._ghost_values, PETSc.InsertMode.INSERT, PETSc.ScatterMode.FORWARD)
        dofs = self.part.matrix @ np.concatenate([y.array_r, self._ghost_values.array_r])
        return dofs[: self._size[0]], dofs[self._size[0] :]

    @contextmanager
    def _timed(self) -> Iterator[None]:
        began = time.perf_counter()
        yield
        self.seconds["assembly"] += time.perf_counter() - began

    # ---- potential, residual, tangent ----

    def energies(self, y: PETSc.Vec) -> dict[str, float]:
        """Parts of the potential (J)."""
        u, phi = self._shape(y)
        with self._timed():
            stretching, bending = self.kernel.energy(u, phi)
        own = np.zeros(len(ENERGIES))
        own[:2] = stretching, bending
        factor, rows = self.load_factor, self.own_dofs()
        own[2] = -factor * np.dot(self._vertex_force[: len(u)] * rows, self._base + u)
        if self.pressure:
            own[3] = factor * pressure_energy(self._positions(u), self.part, self.pressure)
        own[4] = -factor * np.dot(self.part.force[: len(u)] * rows, self._base + u)
        return dict(zip(ENERGIES, self.comm.allreduce(own) + 0.0, strict=True))  # + 0.0: not -0.0

    def energy(self, y: PETSc.Vec) -> float:
        """The potential (J), with those of contact and of the pull towards the anchor."""
        total = float(sum(self.energies(y).values()))
        if self.contact:
            total += self.comm.allreduce(self.contact.energy(self.positions(y), self.load_factor))
        if self.anchor:
            total += self.comm.allreduce(self.anchor.energy(y))
        return total

    def residual(self, y: PETSc.Vec, f: PETSc.Vec, reactions: np.ndarray | None = None) -> None:
        """Writes the gradient of the potential (N; N m for directors) to f. reactions (local vertices, 3): contact
        forces on the shell (N) in place of the potential's own."""
        forces = self._forces(y)
        if self.contact and reactions is None:
            reactions = self.contact.force(self.positions(y), self.load_factor, frozen=True)
        if reactions is not None:
            forces[: self._size[0]] -= reactions.ravel()
        f.array[:] = self._collect @ forces
        if self.anchor:
            f.array[:] += self.anchor.pull(y)

    def _forces(self, y: PETSc.Vec) -> np.ndarray:
        """Gradient of the potential in all local dofs; complete for those of this rank."""
        u, phi = self._shape(y)
        gradient, edge_gradient = np.zeros_like(u), np.zeros_like(phi)
        with self._timed():
            self.kernel.gradient(u, phi, gradient, edge_gradient)
        return np.concatenate([gradient, edge_gradient]) - self._loads(u)

    def _loads(self, u: np.ndarray) -> np.ndarray:
        """External forces on all local dofs; complete for those of this rank."""
        total = self.load_factor * (self._vertex_force + self.part.force)
        if self.pressure:
            total[: len(u)] += self.load_factor * pressure_force(self._positions(u), self.part, self.pressure)
        if self.moments:
            total += self.load_factor * self.moments.forces(self.kernel, u)
        return total

    def load_norm(self, y: PETSc.Vec) -> float:
        """Norm of the external forces on the unknowns (N)."""
        u, _ = self._shape(y)
        loads = self._collect @ self._loads(u)
        return self.norm(loads)

    def reaction_norm(self, y: PETSc.Vec) -> float:
        """Norm of the supports' reactions (N)."""
        part = self.part
        held = part.fixed[: self._size[0]] & self.own_dofs()
        reaction = self._forces(y)[: self._size[0]][held]
        return self.norm(reaction)

    def reactions(self, y: PETSc.Vec) -> np.ndarray:
        """(local vertices, 3) forces that the supports exert on the shell (N)."""
        held = self.part.fixed[: self._size[0]]
        return (self._forces(y)[: self._size[0]] * held).reshape(-1, 3)

    def tangent(
        self, y: PETSc.Vec, matrix: PETSc.Mat, kind: str = "exact", contact: Blocks | None = None
    ) -> None:
        """Writes the Hessian of the potential to a `create_matrix` matrix. kind: exact, safe (positive semidefinite)
        or mixed (exact but for the stresses in its geometric part, extrapolated by `predict`). contact: what contact
        adds, in place of the potential's own."""
        PETSc.garbage_cleanup(self.comm)  # petsc4py only marks what Python has dropped
        u, phi = self._shape(y)
        if self.contact and contact is None:
            contact = self.contact.blocks(self._positions(u), self.load_factor, kind == "safe")
        contact = list(contact or ())
        likely = self.contact.state.candidates.vertex if self.contact else None
        self._assembly.prepare(matrix, self.kernel, contact, likely)
        if self.moments:
            self.kernel.set_turn_weights(-self.load_factor * self.part.moment)
            self.moments.linearise(self._positions(u))
        with self._timed():
            self.kernel.hessian(u, phi, kind, self._assembly.scatter)
            if self.pressure and kind != "safe":
                _kernels.add_pressure_hessian(
                    self._assembly.scatter,
                    self.part.corners,
                    self._positions(u),
                    -self.load_factor * self.pressure,
                )
            self._assembly.add(matrix, contact)
            matrix.assemble()
        if self.anchor:
            self.anchor.add_to(matrix)

    def assemble(self, matrix: PETSc.Mat, blocks: np.ndarray, at_vertices: Blocks = ()) -> None:
        """Writes blocks of triangles (m, 21, 21) and of vertices to a `create_matrix` matrix, symmetric or not."""
        self._assembly.prepare(matrix, self.kernel, at_vertices)
        self._assembly.scatter.assemble(blocks)
        self._assembly.add(matrix, at_vertices)
        matrix.assemble()

    def gather_triangles(self, forces: np.ndarray) -> PETSc.Vec:
        """Sum over triangles of forces (m, 21) on corners, vertices across edges (those are zero without a neighbour)
        and directors, on the unknowns."""
        f = self.create_vector()
        f.array[:] = self._collect @ np.bincount(
            self._triangle_dofs().ravel(), forces.ravel(), sum(self._size)
        )
        return f

    def spread_triangles(self, direction: PETSc.Vec) -> np.ndarray:
        """(m, 21) the direction of the unknowns on the triangles' degrees of freedom, as in `gather_triangles`."""
        return np.concatenate(self._spread(direction))[self._triangle_dofs()]

    def _triangle_dofs(self) -> np.ndarray:
        """(m, 21) local degrees of freedom of corners, vertices across edges and directors."""
        part = self.part
        across = part.corners.ravel()[np.maximum(part.across, 0)]
        vertices = np.concatenate([part.corners, across], axis=1)
        places = (3 * vertices[:, :, None] + np.arange(3)).reshape(-1, 18)
        return np.concatenate([places, self._size[0] + part.triangle_edges], axis=1)

    def add_skew(self, direction: PETSc.Vec, f: PETSc.Vec) -> None:
        """Adds to f (N) what the residual's derivative along a direction has beyond the last `tangent`, which is
        symmetric: the skew part of end moments."""
        motion = np.concatenate(self._spread(direction))
        if self.moments:
            f.array[:] -= self.load_factor * (self._collect @ self.moments.skew_forces(motion))

    def predict(self, y: PETSc.Vec, direction: PETSc.Vec) -> None:
        """Extrapolates the stresses linearly from y along a direction of the unknowns, for a mixed tangent."""
        u, phi = self._shape(y)
        du, dphi = self._spread(direction)
        self.kernel.predict(u, phi, du, dphi)

    def mass(self) -> PETSc.Vec:
        """Diagonal lumped mass of the unknowns (kg; kg m^2 for directors), seams included."""
        vector = self.create_vector()
        weights = self._collect.copy()
        weights.data **= 2
        vector.array[:] = weights @ self.part.mass
        return vector

    def motion(self, direction: PETSc.Vec) -> np.ndarray:
        """(local vertices, 3) displacements (m) of a direction of the unknowns."""
        return self._spread(direction)[0].reshape(-1, 3)

    def mean_motion(self, direction: PETSc.Vec) -> np.ndarray:
        """(3,) mean displacement (m) of a direction of the unknowns."""
        own = self.motion(direction)[self.own]
        total = self.comm.allreduce(np.array([*own.sum(axis=0), len(own)]))
        return total[:3] / total[3]

    def norm(self, own: np.ndarray) -> float:
        """Norm of a vector of unknowns given by each rank's own."""
        return float(np.sqrt(self.comm.allreduce(float(own @ own))))

    def free_share(self, y: PETSc.Vec, direction: PETSc.Vec) -> float:
        """Share of a step along a direction of the unknowns on which no layer of the shell passes through another, at
        most 1."""
        if not (self.contact and self.contact.itself):
            return 1.0
        x = self.positions(y)
        return self.comm.allreduce(self.contact.free_share(x, x + self.motion(direction)), op=MPI.MIN)

    def everywhere(self, here: bool) -> bool:
        """Whether something holds on all ranks."""
        return bool(self.comm.allreduce(here, op=MPI.LAND))

    # ---- scales ----

    def largest_motion(self, direction: PETSc.Vec) -> float:
        """Largest displacement component of a direction of the unknowns over the shell's size."""
        u, _ = self._spread(direction)
        return float(self.comm.allreduce(float(np.abs(u).max(initial=0.0)), op=MPI.MAX)) / self._length

    def thickness(self) -> float:
        """Mean thickness (m)."""
        part = self.part
        total = self.comm.allreduce(np.array([part.fabric[0] @ part.weight, part.weight.sum()]))
        return float(total[0] / total[1])

    def own_dofs(self) -> np.ndarray:
        """(3 local vertices,) marks the displacements that are counted on this rank."""
        return np.repeat(self.own, 3)

    def weight_force(self) -> np.ndarray:
        """(local dofs,) gravity at load factor 1 (N)."""
        return self._vertex_force

    def size(self) -> float:
        """Diagonal of the start shape's bounding box (m)."""
        return self._length

    def _measure(self) -> float:
        points = np.concatenate([self.part.points, -self.part.points], axis=1)
        outermost = self.comm.allreduce(points.max(axis=0, initial=-np.inf), op=_maximum)
        return float(np.linalg.norm(outermost[:3] + outermost[3:]))

    def positions(self, y: PETSc.Vec) -> np.ndarray:
        """(local vertices, 3) positions of unknowns y (m)."""
        return self._positions(self._shape(y)[0])

    def _positions(self, u: np.ndarray) -> np.ndarray:
        return self.part.points + (self._base + u).reshape(-1, 3)


def _maximum(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.maximum(a, b)


def _free_rim(shell: Shell) -> bool:
    """Whether some boundary vertex can move."""
    rim = shell.topology.edges[shell.topology.boundary_edges]
    return bool(len(rim)) and not bool(shell.fixed[rim].all())


def _single_triangle():
    corners = np.arange(3, dtype=np.int32)[None]
    return corners, corners, np.ones_like(corners), np.full((1, 3), -1, dtype=np.int32), 3, np.eye(3)
