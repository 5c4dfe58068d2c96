"""The discrete problem on PETSc's layout: potential, residual and tangent of a distributed shell."""

import copy
from collections.abc import Callable
from typing import Any

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from voile import _kernels
from voile.arrays import Flags, Ints, Reals
from voile.contact.contact import Contact
from voile.elastic import has_directors
from voile.problem.elastic import Elastic
from voile.problem.follower import pressure_rim
from voile.problem.inertia import mass_blocks
from voile.problem.lifetime import stop_if_told
from voile.problem.loads import Loads
from voile.problem.matrix import Assembly, Blocks
from voile.problem.partition import Part, bounding_size, distribute
from voile.problem.shell import Shell
from voile.problem.springs import springs_of
from voile.problem.state import State
from voile.problem.supports import pieces_of
from voile.problem.terms import Hessian, Point, Seen, Term
from voile.problem.unknowns import Unknowns

ROUND_OFF = 1e-12  # of a weight of C

Monitor = Callable[[float, int, float], None]


class Problem:
    """Equilibrium of a shell at one time: unknown displacements (m) and director angles.

    The potential is the sum of the `terms`; `residual` is its gradient (N), `tangent` its Hessian. A problem does not
    change: `at` gives the same at another time (in statics the load factor, 1 at first), `with_terms` with more terms.
    They share the layout, the rest shape and `contact`, whose history is a part of the state.

    `conservative` is False where a load has no potential (pressure up to a free boundary, end moments); its work is
    then left out of `energy`. `moves`: some support does; `held`: there is one; `supported`: each piece has one along
    every axis.
    `turned`: supports hold along local axes. `kept` (local vertices, 3, 3): the part of a vertex's
    motion that follows no unknown.
    `monitor(time, iteration, residual in N)`, if set, is told of every Newton iteration.
    """

    def __init__(self, shell: Shell | None, comm: MPI.Comm = MPI.COMM_WORLD):
        self.comm, self.shell = comm, shell
        settings = None
        if shell is not None:
            rim = pressure_rim(shell) if shell.pressed else None
            loads = np.asarray(shell.gravity, float), rim, shell.load_laws
            settings = shell.model, shell.flat, loads, shell.moment is None, shell.axes is not None
        self.model, flat, loads, no_moments, self.turned = comm.bcast(settings)
        self.conservative = no_moments and (loads[1] is None or loads[1].potential)
        self.directors = has_directors(self.model)
        self.part = part = distribute(shell, self.directors, comm)
        self.layout = Unknowns(part, comm)
        self.elastic = Elastic(part, self.model, flat)
        self.loads = Loads(part, self.elastic, *loads)
        self.springs = springs_of(part, self.loads.own, comm)
        self.terms: tuple[Term, ...] = (self.elastic, self.loads, *self.springs)
        self.time, self.passes = 1.0, False
        self.contact: Contact | None = None
        self.monitor: Monitor | None = None
        self.own = self.loads.own
        self.kept = _kept(part)
        along = np.linalg.eigvalsh(self._kept_by_piece()) > ROUND_OFF
        self.held, self.supported = bool(along.any()), bool(along.all())
        self.moves = bool(comm.allreduce(part.supports.move, op=MPI.LOR))
        self._length = bounding_size(part.points, comm)
        self.assembly = Assembly(part, self.directors, comm)
        self._seen = Seen()

    def _kept_by_piece(self) -> Reals:
        """(pieces, 3, 3) sums of `kept`. Collective."""
        piece: Ints = self.comm.bcast(None if self.shell is None else pieces_of(self.shell))
        total = np.zeros((int(piece.max()) + 1, 3, 3))
        np.add.at(total, piece[self.part.vertex], self.kept)
        found: Reals = self.comm.allreduce(total)
        return found

    # ---- others of the same shell ----

    def at(self, time: float) -> "Problem":
        """The same problem at a time."""
        return self._with(time=time)

    def unloaded(self) -> "Problem":
        """The same problem before any load acts, which therefore has a potential."""
        return self._with(time=0.0, conservative=True)

    def with_passing_hinges(self) -> "Problem":
        """The same problem, in which hinges may turn through 180 degrees, as they may in time where no layer is in
        another's way; equilibria never need it."""
        return self._with(passes=True)

    def with_terms(self, *terms: Term) -> "Problem":
        """The same problem with more terms in its potential."""
        return self._with(terms=(*self.terms, *terms))

    def with_means(self, elastic: Term, loads: Loads, springs: tuple[Term, ...], *terms: Term) -> "Problem":
        """The same problem with other elastic forces, loads and springs, and more terms."""
        kept = self.terms[2 + len(self.springs) :]
        return self._with(loads=loads, springs=springs, terms=(elastic, loads, *springs, *kept, *terms))

    def with_contact(self, contact: Contact | None, *terms: Term) -> "Problem":
        """The same problem with a contact and the terms that it always needs, in place of its own."""
        return self._with(contact=contact, terms=(self.elastic, self.loads, *self.springs, *terms))

    def _with(self, **changed: Any) -> "Problem":
        other = copy.copy(self)
        vars(other).update(changed)
        return other

    def set_rest(self, points: Reals, flat: bool = False) -> None:
        """Another rest shape (local rest vertices, 3) m, flat without folds, and the masses that it has."""
        self.part.set_rest(points)
        self.elastic.set_rest(flat)
        self.loads.weigh()

    @property
    def flat(self) -> bool:
        """Whether the rest shape has no folds."""
        return self.elastic.flat

    @property
    def kernel(self) -> _kernels.Elastic:
        """That of the elastic model."""
        return self.elastic.at(self.time)

    @property
    def seconds(self) -> dict[str, float]:
        """Spent so far, by what for."""
        return {"assembly": self.elastic.seconds}

    # ---- states ----

    def save(self, y: PETSc.Vec) -> State:
        """The state with the unknowns y and what contact remembers now."""
        history = self.contact.history.copy() if self.contact else None
        return State(y.copy(), self.layout.origin.copy(), history, self.time)

    def unknowns_of(self, state: State) -> PETSc.Vec:
        """Those of a state, counted from the present origin."""
        return self.layout.of(state)

    def restore(self, y: PETSc.Vec, state: State) -> None:
        """y and what contact remembers become those of a state."""
        self.unknowns_of(state).copy(y)
        if self.contact and state.history:
            self.contact.history = state.history.copy()

    def move_origin(self, y: PETSc.Vec) -> None:
        """Counts displacements from the shape at y on, so that they keep their digits; y becomes zero."""
        self.layout.count_from(y, self.time)
        self.elastic.count_from(self.part.points + self.layout.base.reshape(-1, 3))

    def reset_origin(self, y: PETSc.Vec) -> None:
        """Takes `move_origin` back: y, and any state from now on, counts displacements from the start shape again."""
        if self.layout.count_from_start(y, self.time):
            self.elastic.count_from(self.part.points)

    @property
    def unknowns(self) -> int:
        """How many there are, over all ranks."""
        return self.layout.count

    def create_vector(self) -> PETSc.Vec:
        """A zero vector of unknowns."""
        return self.layout.create()

    def create_matrix(self) -> PETSc.Mat:
        """A matrix with the tangent's pattern; its values are written in place by `tangent`."""
        return self.assembly.create(self.kernel)

    def local(self, y: PETSc.Vec) -> tuple[Reals, Reals]:
        """Displacements (3 local vertices,) and director angles (local edges,) of unknowns y, supports included."""
        u, phi = self.shape(y)
        return self.layout.base + u, phi

    def shape(self, y: PETSc.Vec) -> tuple[Reals, Reals]:
        """As `local`, but displacements from the shape of the last `move_origin`."""
        return self.layout.shape(y, self.time)

    def point(self, y: PETSc.Vec) -> Point:
        """Where the terms are evaluated. Mostly that is where the last ones were, by this problem or another of the
        same shell: then it is the same object, by which terms know what they have found there."""
        seen, base = self._seen, self.layout.base
        if not self.everywhere(seen.holds(y.array_r, base, self.time, self.passes)):
            u, phi = self.shape(y)
            displacement = base + u
            x = self.part.points + displacement.reshape(-1, 3)
            seen.keep(Point(u, phi, displacement, x, self.time, self.passes), y.array_r, base)
        return seen.point

    # ---- potential, residual, tangent ----

    def energies(self, y: PETSc.Vec) -> dict[str, float]:
        """Parts of the potential (J)."""
        stop_if_told(self.comm)
        at = self.point(y)
        parts: dict[str, float] = {}
        for term in self.terms:
            for name, value in term.energies(at).items():
                parts[name] = parts.get(name, 0.0) + value
        values = self.reduced(np.array(list(parts.values()))) + 0.0  # not -0.0
        return dict(zip(parts, values, strict=True))

    def energy(self, y: PETSc.Vec) -> float:
        """The potential (J)."""
        return float(sum(self.energies(y).values()))

    def residual(self, y: PETSc.Vec, f: PETSc.Vec, reactions: Reals | None = None) -> None:
        """Writes the gradient of the potential (N; N m for directors) to f, less forces on the shell (local vertices,
        3) N, if given."""
        self.unbalanced(self.forces(y), f, reactions)

    def forces(self, y: PETSc.Vec) -> Reals:
        """(local dofs,) those of all terms (N; N m on directors)."""
        stop_if_told(self.comm)
        at = self.point(y)
        return sum((term.forces(at) for term in self.terms[1:]), self.terms[0].forces(at))

    def unbalanced(self, forces: Reals, f: PETSc.Vec, reactions: Reals | None) -> None:
        """As `residual`, by the terms' forces."""
        if reactions is not None:
            forces = forces.copy()
            forces[: self.layout.vertices] += reactions.ravel()
        f.array[:] = -self.layout.collect(forces)

    def load_norm(self, y: PETSc.Vec) -> float:
        """Norm of the external forces on the unknowns (N)."""
        return self.term_norm(self.loads, y)

    def term_norm(self, term: Term, y: PETSc.Vec) -> float:
        """Norm of a term's forces on the unknowns (N)."""
        return self.norm(self.layout.collect(term.forces(self.point(y))))

    def reactions(self, y: PETSc.Vec) -> Reals:
        """(local vertices, 3) forces that the supports exert on the shell (N)."""
        at, count = self.point(y), self.layout.vertices
        found: Reals = -np.einsum("nij,nj->ni", self.kept, self.inner_forces(at)[:count].reshape(-1, 3))
        return found

    def inner_forces(self, at: Point) -> Reals:
        """(local dofs,) forces of the shell itself, its springs and its loads (N; N m on directors)."""
        return sum(
            (term.forces(at) for term in self.springs), self.elastic.forces(at) + self.loads.forces(at)
        )

    def reaction_norm(self, y: PETSc.Vec) -> float:
        """Norm of the supports' reactions (N)."""
        return self.norm(self.reactions(y)[self.own].ravel())

    def tangent(
        self,
        y: PETSc.Vec,
        matrix: PETSc.Mat,
        kind: str = "exact",
        contact: Blocks = (),
        shift: float | Reals = 0.0,
        share: float = 1.0,
    ) -> None:
        """Writes the Hessian of the potential to a `create_matrix` matrix; kind, share: see Hessian. To be added:
        `contact`, what the linearised laws do; shift (1/s^2; one, or (local vertices,)), a multiple of the mass
        C^T M C."""
        stop_if_told(self.comm)
        PETSc.garbage_cleanup(self.comm)  # petsc4py only marks what Python has dropped
        at, which, blocks = self.point(y), Hessian(kind, share), list(contact)
        for term in self.terms:
            blocks += term.blocks(at, which)
        if not self.everywhere(not np.any(shift)):
            blocks.append(mass_blocks(self.vertex_mass(), np.reshape(shift, (-1, 1))))
        likely = self.contact.history.candidates.vertex if self.contact else None
        self.assembly.prepare(matrix, self.kernel, blocks, likely)
        for term in self.terms:
            term.prepare(at)
        with self.elastic.timed():
            for term in self.terms:
                term.scatter(at, which, self.assembly.scatter)
            self.assembly.add(matrix, blocks)
            matrix.assemble()

    def assemble(self, matrix: PETSc.Mat, blocks: Reals, at_vertices: Blocks = ()) -> None:
        """Writes blocks of triangles (m, 21, 21) and of vertices to a `create_matrix` matrix, symmetric or not."""
        self.assembly.prepare(matrix, self.kernel, at_vertices)
        self.assembly.scatter.assemble(blocks)
        self.assembly.add(matrix, at_vertices)
        matrix.assemble()

    def add_skew(self, direction: PETSc.Vec, f: PETSc.Vec) -> None:
        """Adds to f (N) what the residual's derivative along a direction has beyond the last `tangent`, which is
        symmetric: the skew part of end moments."""
        skew = self.loads.skew_forces(np.concatenate(self.layout.spread(direction)), self.time)
        if skew is not None:
            f.array[:] -= self.layout.collect(skew)

    def predict(self, y: PETSc.Vec, direction: PETSc.Vec) -> None:
        """Extrapolates the stresses linearly from y along a direction of the unknowns, for a mixed tangent."""
        at, step = self.point(y), np.concatenate(self.layout.spread(direction))
        for term in self.terms:
            term.predict(at, step)

    def vertex_mass(self) -> Reals:
        """(local vertices,) lumped mass (kg)."""
        return self.part.mass[: self.layout.vertices : 3]

    def mass(self) -> PETSc.Vec:
        """Diagonal of the lumped mass of the unknowns (kg; kg m^2 for directors): a metric for directions. What acts
        as mass is C^T M C (`mass_matrix`), which differs from it where vertices are sewn with weights."""
        vector = self.create_vector()
        vector.array[:] = self.layout.diagonal(self.part.mass)
        return vector

    def mass_matrix(self, rotary: bool = True) -> PETSc.Mat:
        """C^T M C (kg; kg m^2 for directors, zero unless rotary), with the tangent's pattern."""
        matrix = self.create_matrix()
        still = np.zeros((len(self.part.corners), 21, 21))
        self.assemble(matrix, still, [mass_blocks(self.vertex_mass(), 1.0)])
        if not rotary:
            return matrix
        turning, inertia = self.create_vector(), self.part.mass.copy()
        inertia[: self.layout.vertices] = 0.0
        turning.array[:] = self.layout.diagonal(inertia)
        matrix.setDiagonal(turning, addv=PETSc.InsertMode.ADD_VALUES)
        return matrix

    def motion(self, direction: PETSc.Vec) -> Reals:
        """(local vertices, 3) displacements (m) of a direction of the unknowns."""
        return self.layout.spread(direction)[0].reshape(-1, 3)

    def norm(self, own: Reals) -> float:
        """Norm of a vector of unknowns given by each rank's own."""
        return float(np.sqrt(self.reduced(float(own @ own))))

    def longest_step(self, y: PETSc.Vec, direction: PETSc.Vec) -> float:
        """Length of a step over a direction of the unknowns, at most 1, that all terms admit: no layer of the shell
        passes through another, no hinge turns through 180 degrees. The last terms, which may cut it anywhere, come
        first."""
        at, step, most = self.point(y), np.concatenate(self.layout.spread(direction)), 1.0
        for term in reversed(self.terms):
            most = self.reduced(term.longest_step(at, step, most), MPI.MIN)
        return most

    def reduced(self, here: Any, by: MPI.Op = MPI.SUM) -> Any:
        """What all ranks have here, reduced. One rank by itself asks nobody: mpi4py takes 0.04 ms for it."""
        return here if self.comm.size == 1 else self.comm.allreduce(here, op=by)

    def everywhere(self, here: bool) -> bool:
        """Whether something holds on all ranks."""
        return bool(self.reduced(here, MPI.LAND))

    def largest_motion(self, direction: PETSc.Vec) -> float:
        """Largest displacement component of a direction of the unknowns over the shell's size."""
        return self.in_sizes(self.layout.spread(direction)[0])

    def in_sizes(self, lengths: Reals) -> float:
        """Largest of all ranks' lengths (m), whatever their sign, over the shell's size."""
        return float(self.reduced(float(np.abs(lengths).max(initial=0.0)), MPI.MAX)) / self._length

    def thickness(self) -> float:
        """Mean thickness (m)."""
        part = self.part
        total = self.comm.allreduce(np.array([part.fabric[0] @ part.weight, part.weight.sum()]))
        return float(total[0] / total[1])

    def own_dofs(self) -> Flags:
        """(3 local vertices,) marks the displacements that are counted on this rank."""
        return np.repeat(self.own, 3)

    def size(self) -> float:
        """Diagonal of the start shape's bounding box (m)."""
        return self._length

    def positions(self, y: PETSc.Vec) -> Reals:
        """(local vertices, 3) positions of unknowns y (m)."""
        return self.point(y).positions


def _kept(part: Part) -> Reals:
    """Problem.kept: what C leaves out of the identity."""
    vertices = len(part.vertex)
    free = np.asarray(part.matrix[: 3 * vertices] @ part.direction).reshape(-1, 3, 3)
    kept: Reals = np.eye(3) - free
    kept[np.abs(kept) < ROUND_OFF] = 0.0
    return kept
