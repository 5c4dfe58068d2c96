"""The discrete problem on PETSc's layout: potential, residual and tangent of a distributed shell."""

import copy
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from voile.contact.state import Contact
from voile.elastic import has_directors
from voile.problem.elastic import make_kernel
from voile.problem.follower import pressure_origin
from voile.problem.loads import Loads
from voile.problem.matrix import Assembly, Blocks
from voile.problem.partition import bounding_size, distribute
from voile.problem.shell import Shell
from voile.problem.state import State
from voile.problem.terms import AugmentedContact, Inertia, Point, Term, mass_blocks

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
        self.comm, self.shell = comm, shell
        settings = None
        if shell is not None:
            gravity, pressure = np.asarray(shell.gravity, float), float(shell.pressure)
            origin = pressure_origin(shell) if pressure else np.zeros(3)
            settings = shell.model, gravity, pressure, shell.flat, origin, shell.moment is None
        self.model, gravity, pressure, flat, origin, no_moments = comm.bcast(settings)
        self.conservative = origin is not None and no_moments
        self.directors = has_directors(self.model)
        self.part = part = distribute(shell, self.directors, comm)
        self.loads = Loads(part, gravity, pressure, origin)
        self.load_factor = 1.0
        self.contact: Contact | None = None
        self.inertia: Inertia | None = None
        self.monitor: Callable[[float, int, float], None] | None = None
        self.seconds = {"assembly": 0.0}
        self._size = (3 * len(part.vertex), len(part.edge))
        self.flat = flat
        self.kernel = make_kernel(part, self.model, part.points, flat)
        self._base = np.zeros(self._size[0])  # displacements at the last `rebase`
        self._gap, self._base_factor, self._rebased = part.gap.copy(), 0.0, False
        self._collect = part.matrix.T.tocsr()[: part.owned]
        self.own = self.loads.own
        axes = comm.allreduce(part.fixed[: 3 * len(part.vertex)].reshape(-1, 3).any(axis=0).astype(int))
        self.held, self.supported = bool(axes.any()), bool(axes.all())
        self.moves = bool(comm.allreduce(bool(part.lift.any()), op=MPI.LOR))
        self._length = bounding_size(part.points, comm)
        self._make_vectors()
        self.origin = self.create_vector()  # unknowns of the shape that displacements are counted from
        self._assembly = Assembly(part, self.directors, comm)

    def set_rest(self, points: np.ndarray, flat: bool = False) -> None:
        """Another rest shape (local rest vertices, 3) m, flat without folds, and the masses that it has."""
        self.part.set_rest(points)
        self.flat = flat
        self.kernel.set_rest(self.part.rest_points, self.part.rest_corners, flat)
        self.loads.weigh()

    # ---- states ----

    def save(self, y: PETSc.Vec) -> State:
        """The state with the unknowns y and what contact remembers now."""
        history = self.contact.state.copy() if self.contact else None
        return State(y.copy(), self.origin.copy(), history)

    def unknowns_of(self, state: State) -> PETSc.Vec:
        """Those of a state, counted from the present origin."""
        y = state.unknowns.copy()
        y.axpy(1.0, state.origin)
        y.axpy(-1.0, self.origin)
        return y

    def restore(self, y: PETSc.Vec, state: State) -> None:
        """y and what contact remembers become those of a state."""
        self.unknowns_of(state).copy(y)
        if self.contact and state.history:
            self.contact.state = state.history.copy()

    def rebase(self, y: PETSc.Vec) -> None:
        """Counts displacements from the shape at y on; y becomes zero.

        Stored as numbers near zero, displacements keep the digits that they lose when they are large, and with
        them the membrane forces of a stiff shell that has moved far.
        """
        u, phi = self._shape(y)
        self._rebased = True
        self._base += u
        self._gap, self._base_factor = np.concatenate([np.zeros_like(u), phi]), self.load_factor
        self.kernel = make_kernel(
            self.part, self.model, self.part.points + self._base.reshape(-1, 3), self.flat
        )
        self.origin.axpy(1.0, y)
        y.set(0.0)

    def unbase(self, y: PETSc.Vec) -> None:
        """Takes `rebase` back: y, and any state from now on, counts displacements from the start shape again."""
        if not self._rebased:
            return
        self._rebased = False
        dofs = np.concatenate(self.local(y)) - self.part.gap - self.load_factor * self.part.lift
        self._base[:] = 0.0
        self._gap, self._base_factor = self.part.gap.copy(), 0.0
        self.kernel = make_kernel(self.part, self.model, self.part.points, self.flat)
        self.origin.set(0.0)
        single = np.flatnonzero(np.diff(self.part.matrix.indptr) == 1)
        column = self.part.matrix.indices[self.part.matrix.indptr[single]]
        own = column < self.part.owned
        y.array[column[own]] = dofs[single[own]]

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

    @property
    def terms(self) -> tuple[Term, ...]:
        """What adds to elasticity and loads."""
        contact = (AugmentedContact(self.contact),) if self.contact else ()
        return (self.inertia, *contact) if self.inertia else contact

    def with_inertia(self, coefficient: float, predicted: np.ndarray) -> "Problem":
        """The same problem with an inertia term (see Inertia): one implicit step in time."""
        other = copy.copy(self)
        other.inertia = Inertia(self.vertex_mass(), self.own, coefficient, predicted)
        return other

    def inertia_norm(self, y: PETSc.Vec) -> float:
        """Norm of the inertia term's forces on the unknowns (N)."""
        if not self.inertia:
            return 0.0
        forces = np.zeros(sum(self._size))
        forces[: self._size[0]] = self.inertia.force(Point(self.positions(y), self.load_factor)).ravel()
        return self.norm(self._collect @ forces)

    def energies(self, y: PETSc.Vec) -> dict[str, float]:
        """Parts of the potential of elasticity and loads (J)."""
        u, phi = self._shape(y)
        with self._timed():
            stretching, bending = self.kernel.energy(u, phi)
        loads = self.loads.energies(self._base + u, self._positions(u), self.load_factor)
        own = np.array([stretching, bending, *(loads[name] for name in ENERGIES[2:])])
        return dict(zip(ENERGIES, self.comm.allreduce(own) + 0.0, strict=True))  # + 0.0: not -0.0

    def energy(self, y: PETSc.Vec) -> float:
        """The potential (J), with that of all terms."""
        total = float(sum(self.energies(y).values()))
        if self.terms:
            at = Point(self.positions(y), self.load_factor)
            total += self.comm.allreduce(sum(term.energy(at) for term in self.terms))
        return total

    def residual(self, y: PETSc.Vec, f: PETSc.Vec, reactions: np.ndarray | None = None) -> None:
        """Writes the gradient of the potential (N; N m for directors) to f. reactions (local vertices, 3): contact
        forces on the shell (N) in place of the potential's own."""
        forces = self._forces(y)
        at = Point(self.positions(y), self.load_factor)
        for term in self.terms:
            if reactions is None or not isinstance(term, AugmentedContact):
                forces[: self._size[0]] -= term.force(at).ravel()
        if reactions is not None:
            forces[: self._size[0]] -= reactions.ravel()
        f.array[:] = self._collect @ forces

    def _forces(self, y: PETSc.Vec) -> np.ndarray:
        """Gradient of the potential in all local dofs; complete for those of this rank."""
        u, phi = self._shape(y)
        gradient, edge_gradient = np.zeros_like(u), np.zeros_like(phi)
        with self._timed():
            self.kernel.gradient(u, phi, gradient, edge_gradient)
        return np.concatenate([gradient, edge_gradient]) - self._loads(u)

    def _loads(self, u: np.ndarray) -> np.ndarray:
        """External forces on all local dofs; complete for those of this rank."""
        return self.loads.forces(self.kernel, u, self._positions(u), self.load_factor)

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
        self,
        y: PETSc.Vec,
        matrix: PETSc.Mat,
        kind: str = "exact",
        contact: Blocks | None = None,
        shift: float = 0.0,
    ) -> None:
        """Writes the Hessian of the potential to a `create_matrix` matrix. kind: exact, safe (positive semidefinite)
        or mixed (exact but for the stresses in its geometric part, extrapolated by `predict`). contact: what contact
        adds, in place of the potential's own; shift (1/s^2): a multiple of the mass C^T M C to add."""
        PETSc.garbage_cleanup(self.comm)  # petsc4py only marks what Python has dropped
        u, phi = self._shape(y)
        positions, safe = self._positions(u), kind == "safe"
        at, blocks = Point(positions, self.load_factor), list(contact or ())
        for term in self.terms:
            if contact is None or not isinstance(term, AugmentedContact):
                blocks += term.blocks(at, safe)
        if shift:
            blocks.append(mass_blocks(self.vertex_mass(), shift))
        likely = self.contact.state.candidates.vertex if self.contact else None
        self._assembly.prepare(matrix, self.kernel, blocks, likely)
        self.loads.begin_hessian(self.kernel, positions, self.load_factor)
        with self._timed():
            self.kernel.hessian(u, phi, kind, self._assembly.scatter)
            if not safe:
                self.loads.add_hessian(self._assembly.scatter, positions, self.load_factor)
            self._assembly.add(matrix, blocks)
            matrix.assemble()

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
        skew = self.loads.skew_forces(np.concatenate(self._spread(direction)), self.load_factor)
        if skew is not None:
            f.array[:] -= self._collect @ skew

    def predict(self, y: PETSc.Vec, direction: PETSc.Vec) -> None:
        """Extrapolates the stresses linearly from y along a direction of the unknowns, for a mixed tangent."""
        u, phi = self._shape(y)
        du, dphi = self._spread(direction)
        self.kernel.predict(u, phi, du, dphi)

    def vertex_mass(self) -> np.ndarray:
        """(local vertices,) lumped mass (kg)."""
        return self.part.mass[: self._size[0] : 3]

    def mass(self) -> PETSc.Vec:
        """Diagonal of the lumped mass of the unknowns (kg; kg m^2 for directors): a metric for directions. What acts
        as mass is C^T M C (`mass_matrix`), which differs from it where vertices are sewn with weights."""
        vector = self.create_vector()
        weights = self._collect.copy()
        weights.data **= 2
        vector.array[:] = weights @ self.part.mass
        return vector

    def mass_matrix(self) -> PETSc.Mat:
        """C^T M C (kg; kg m^2 for directors), with the tangent's pattern."""
        matrix = self.create_matrix()
        still = np.zeros((len(self.part.corners), 21, 21))
        self.assemble(matrix, still, [mass_blocks(self.vertex_mass(), 1.0)])
        rotary = self.create_vector()
        count = self._size[0]
        rotary.array[:] = self._collect[:, count:] @ self.part.mass[count:]
        matrix.setDiagonal(rotary, addv=PETSc.InsertMode.ADD_VALUES)
        return matrix

    def motion(self, direction: PETSc.Vec) -> np.ndarray:
        """(local vertices, 3) displacements (m) of a direction of the unknowns."""
        return self._spread(direction)[0].reshape(-1, 3)

    def norm(self, own: np.ndarray) -> float:
        """Norm of a vector of unknowns given by each rank's own."""
        return float(np.sqrt(self.comm.allreduce(float(own @ own))))

    def longest_step(self, y: PETSc.Vec, direction: PETSc.Vec) -> float:
        """Share of a step along a direction of the unknowns, at most 1, that all terms admit (no layer of the shell
        passes through another) and on which no hinge turns through 180 degrees; 0 where even a millionth does."""
        u, phi = self._shape(y)
        du, dphi = self._spread(direction)
        share = 1.0
        if self.contact and self.contact.itself:
            at, motion = Point(self._positions(u), self.load_factor), du.reshape(-1, 3)
            share = self.comm.allreduce(min(t.longest_step(at, motion) for t in self.terms), op=MPI.MIN)
        while not self.everywhere(not self.kernel.folds_over(u, phi, u + share * du, phi + share * dphi)):
            share *= 0.5
            if share < 1e-6:
                return 0.0
        return share

    def everywhere(self, here: bool) -> bool:
        """Whether something holds on all ranks."""
        return bool(self.comm.allreduce(here, op=MPI.LAND))

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
        return self.loads.weight

    def size(self) -> float:
        """Diagonal of the start shape's bounding box (m)."""
        return self._length

    def positions(self, y: PETSc.Vec) -> np.ndarray:
        """(local vertices, 3) positions of unknowns y (m)."""
        return self._positions(self._shape(y)[0])

    def _positions(self, u: np.ndarray) -> np.ndarray:
        return self.part.points + (self._base + u).reshape(-1, 3)
