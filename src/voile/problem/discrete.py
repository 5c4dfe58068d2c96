"""The discrete problem on PETSc's layout: potential, residual and tangent of a distributed shell."""

import time
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from voile import _kernels, _petsc
from voile.problem.clamps import held_directors
from voile.problem.constraints import build_constraints
from voile.problem.partition import Part, cut, number_unknowns
from voile.problem.shell import Shell

ENERGIES = ("stretching", "bending", "gravity", "pressure", "force")


def distribute(shell: Shell | None, directors: bool, comm: MPI.Comm) -> Part:
    """The part of each rank of a shell that rank 0 holds (None elsewhere). An error on rank 0 is raised on all."""
    if shell is None:
        failure = comm.bcast(None)
        if failure is not None:
            raise failure
        return comm.recv(source=0)
    try:
        constraints = build_constraints(shell, directors)
        clamps, angles = held_directors(shell, directors)
        constraints.gap[3 * len(shell.points) :] = angles
        numbering = number_unknowns(shell, constraints, comm.size)
    except Exception as failure:
        comm.bcast(failure)
        raise
    comm.bcast(None)
    for rank in range(1, comm.size):
        comm.send(cut(shell, constraints, numbering, rank, clamps), dest=rank)
    return cut(shell, constraints, numbering, 0, clamps)


class Problem:
    """Equilibrium of a shell: unknown displacements (m) and director angles, at a load factor in [0, 1].

    The potential is the elastic energy less the work of the loads; `residual` is its gradient (N), `tangent` its
    Hessian. `conservative` is False where a load has no potential (pressure up to a free boundary, end moments);
    its work is then left out of `energy`. `moves`: some support is displaced along the load path.
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
        self.load_factor = 1.0
        self.seconds = {"assembly": 0.0}
        self._size = (3 * len(part.vertex), len(part.edge))
        self._flat = flat
        self.kernel = self._make_kernel(part.points)
        self._base = np.zeros(self._size[0])  # displacements at the last `rebase`
        self._gap, self._base_factor = part.gap.copy(), 0.0
        self._collect = part.matrix.T.tocsr()[: part.owned]
        self._vertex_force = np.zeros(sum(self._size))
        self._vertex_force[: self._size[0]] = (
            part.mass[: self._size[0]].reshape(-1, 3) * self.gravity
        ).ravel()
        self._own = np.zeros(len(part.vertex), dtype=bool)
        self._own[part.owned_vertices] = True
        self.moves = bool(comm.allreduce(bool(part.lift.any()), op=MPI.LOR))
        self._length = self._measure()
        self._make_vectors()
        self._scatter: _kernels.Scatter

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
        kernel.set_rest(part.rest_points, part.rest_corners, self._flat)
        kernel.set_fabric(*(np.ascontiguousarray(row) for row in part.fabric[:3]))
        kernel.set_weights(part.weight)
        clamp = part.half_edge_clamp
        if len(clamp):
            kernel.set_clamps(
                clamp[:, 0].astype(np.int32), clamp[:, 1].astype(np.int32), np.ascontiguousarray(clamp[:, 2:])
            )
        return kernel

    def rebase(self, y: PETSc.Vec) -> None:
        """Counts displacements from the shape at y on; the unknowns of any state are then less by y, those of y zero.

        Stored as numbers near zero, displacements keep the digits that they lose when they are large, and with
        them the membrane forces of a stiff shell that has moved far.
        """
        u, phi = self._shape(y)
        self._base += u
        self._gap, self._base_factor = np.concatenate([np.zeros_like(u), phi]), self.load_factor
        self.kernel = self._make_kernel(self.part.points + self._base.reshape(-1, 3))

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
        part = self.part
        self._scatter = _kernels.Scatter(
            self.kernel,
            self.directors,
            part.owned,
            part.matrix.indptr.astype(np.int32),
            part.matrix.indices.astype(np.int32),
            part.matrix.data,
        )
        rank = np.concatenate([part.first_global + np.arange(part.owned), part.ghost_global]).astype(np.int64)
        start, column = self._scatter.pattern(rank)
        size = (part.owned, self.unknowns)
        matrix = PETSc.Mat().create(comm=self.comm)
        matrix.setSizes((size, size))
        matrix.setType(PETSc.Mat.Type.AIJ)
        matrix.setPreallocationCSR((start.astype(np.int32), rank[column].astype(np.int32)))
        matrix.setOption(PETSc.Mat.Option.SYMMETRIC, True)
        matrix.setOption(PETSc.Mat.Option.NEW_NONZERO_LOCATION_ERR, True)
        self._bind(matrix)
        return matrix

    def _bind(self, matrix: PETSc.Mat) -> None:
        none = np.zeros(0, dtype=np.int32)
        inside, outside, columns = _petsc.aij_arrays(matrix.handle)
        if outside is None:
            self._scatter.bind(*inside, none, none, np.zeros(0), none)
        else:
            ghost = np.searchsorted(columns, self.part.ghost_global).astype(np.int32)
            self._scatter.bind(*inside, *outside, ghost)
        self._bound = matrix.handle

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
        factor, rows = self.load_factor, np.repeat(self._own, 3)
        own[2] = -factor * np.dot(self._vertex_force[: len(u)] * rows, self._base + u)
        own[3] = self._pressure_energy(u)
        own[4] = -factor * np.dot(self.part.force[: len(u)] * rows, self._base + u)
        return dict(zip(ENERGIES, self.comm.allreduce(own), strict=True))

    def energy(self, y: PETSc.Vec) -> float:
        """The potential (J)."""
        return float(sum(self.energies(y).values()))

    def residual(self, y: PETSc.Vec, f: PETSc.Vec) -> None:
        """Writes the gradient of the potential (N; N m for directors) to f."""
        f.array[:] = self._collect @ self._forces(y)

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
            total[: len(u)] += self._pressure_force(u)
        if self.part.moment.any():
            moment = self.load_factor * self.part.moment
            turning = np.zeros_like(u)
            self.kernel.turn_gradient(u, np.zeros(self._size[1]), moment, turning)
            total[: len(u)] += turning
            part = self.part
            np.add.at(total, len(u) + part.triangle_edges.ravel(), -moment * part.signs.ravel())
        return total

    def load_norm(self, y: PETSc.Vec) -> float:
        """Norm of the external forces on the unknowns (N)."""
        u, _ = self._shape(y)
        loads = self._collect @ self._loads(u)
        return float(np.sqrt(self.comm.allreduce(float(loads @ loads))))

    def reaction_norm(self, y: PETSc.Vec) -> float:
        """Norm of the supports' reactions (N)."""
        part = self.part
        held = part.fixed[: self._size[0]] & np.repeat(self._own, 3)
        reaction = self._forces(y)[: self._size[0]][held]
        return float(np.sqrt(self.comm.allreduce(float(reaction @ reaction))))

    def reactions(self, y: PETSc.Vec) -> np.ndarray:
        """(local vertices, 3) forces that the supports exert on the shell (N)."""
        held = self.part.fixed[: self._size[0]]
        return (self._forces(y)[: self._size[0]] * held).reshape(-1, 3)

    def tangent(self, y: PETSc.Vec, matrix: PETSc.Mat, kind: str = "exact") -> None:
        """Writes the Hessian of the potential to a `create_matrix` matrix. kind: exact, safe (positive semidefinite)
        or mixed (exact but for the stresses in its geometric part, extrapolated by `predict`)."""
        if matrix.handle != self._bound:
            self._bind(matrix)
        u, phi = self._shape(y)
        if self.part.moment.any():
            self.kernel.set_turn_weights(-self.load_factor * self.part.moment)
        with self._timed():
            self.kernel.hessian(u, phi, kind, self._scatter)
            if self.pressure and kind != "safe":
                _kernels.add_pressure_hessian(
                    self._scatter, self.part.corners, self._positions(u), -self.load_factor * self.pressure
                )
            matrix.assemble()

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

    def size(self) -> float:
        """Diagonal of the start shape's bounding box (m)."""
        return self._length

    def _measure(self) -> float:
        low = self.comm.allreduce(self.part.points.min(axis=0, initial=np.inf), op=_minimum)
        high = self.comm.allreduce(self.part.points.max(axis=0, initial=-np.inf), op=_maximum)
        return float(np.linalg.norm(high - low))

    def slow_rate(self) -> float:
        """1/s^2: inverse square of the time in which the load would move the shell's mass by its own size; with
        weak loads that of the slowest elastic waves."""
        part, rows = self.part, np.repeat(self._own, 3)
        count = len(rows)
        force = (self._vertex_force + part.force)[:count][rows]
        mass = part.mass[:count][rows]
        wave = (
            part.fabric[1] @ part.weight / max(part.fabric[3] @ part.weight, 1e-300)
            if len(part.weight)
            else 0.0
        )
        total = self.comm.allreduce(np.array([force @ force, mass @ mass]))
        wave = self.comm.allreduce(wave, op=MPI.MAX)
        size = self.size()
        return float(max(np.sqrt(total[0] / total[1]) / size, 1e-9 * wave / size**2))

    def force_floor(self) -> float:
        """Round-off of the residual at a shape far from the start (N): what no tolerance without loads goes below."""
        part = self.part
        stiffness = part.weight * part.fabric[0] * part.fabric[1]
        total = self.comm.allreduce(float(stiffness @ stiffness))
        return 1e-14 * float(np.sqrt(total)) * self.size() / max(np.sqrt(self.unknowns), 1.0)

    def round_off(self, y: PETSc.Vec) -> tuple[float, float]:
        """Norms of the residual's change (N) when every unknown changes by its last place, which `rebase` can help,
        and of what the last places of the positions make of its evaluation, which nothing can."""
        sign = np.where(np.arange(len(y.array_r)) % 7 % 2, 1.0, -1.0)
        step = y.duplicate()
        step.array[:] = np.finfo(float).eps * sign * y.array_r
        here, ahead = (self._residual_at(y, step, side) for side in (0.0, 1.0))
        stored = (ahead - here).norm()
        step.array[:] = np.finfo(float).eps * sign * self._length
        ahead, back = (self._residual_at(y, step, side) for side in (1.0, -1.0))
        return stored, (ahead + back - 2.0 * here).norm() / np.sqrt(6.0)  # the linear part cancels

    def _residual_at(self, y: PETSc.Vec, step: PETSc.Vec, length: float) -> PETSc.Vec:
        there, f = y.duplicate(), y.duplicate()
        there.waxpy(length, step, y)
        self.residual(there, f)
        return f

    # ---- follower loads ----

    def _positions(self, u: np.ndarray) -> np.ndarray:
        return self.part.points + (self._base + u).reshape(-1, 3)

    def _pressure_energy(self, u: np.ndarray) -> float:
        """-p V with V the volume under the surface (sum of x0.(x1 x x2)/6)."""
        if not self.pressure:
            return 0.0
        x = self._positions(u)[self.part.corners]
        volume = np.einsum("ti,ti->t", x[:, 0], np.cross(x[:, 1], x[:, 2])) / 6.0
        return -self.load_factor * self.pressure * float(volume @ self.part.weight)

    def _pressure_force(self, u: np.ndarray) -> np.ndarray:
        """p A n / 3 at each corner."""
        x = self._positions(u)[self.part.corners]
        share = np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]) * (self.load_factor * self.pressure / 6.0)
        force = np.zeros((len(self.part.vertex), 3))
        for k in range(3):
            np.add.at(force, self.part.corners[:, k], share)
        return force.ravel()


def _minimum(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.minimum(a, b)


def _maximum(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.maximum(a, b)


def _free_rim(shell: Shell) -> bool:
    """Whether some boundary vertex can move."""
    rim = shell.topology.edges[shell.topology.boundary_edges]
    return bool(len(rim)) and not bool(shell.fixed[rim].all())


def _single_triangle():
    corners = np.arange(3, dtype=np.int32)[None]
    return corners, corners, np.ones_like(corners), np.full((1, 3), -1, dtype=np.int32), 3, np.eye(3)
