"""The target: the shape that is to be in equilibrium, with what holds it there."""

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
import scipy.linalg
from mpi4py import MPI
from petsc4py import PETSc

from voile.arrays import Array, Flags, Ints, Reals, area_vectors
from voile.contact.candidates import Layers
from voile.contact.contact import Contact
from voile.contact.obstacles import Obstacle
from voile.contact.pairs import FREE, PENALTY, STICK, dot, margin, outer, within
from voile.errors import Hinged, NotConverged
from voile.inverse.bounds import Bounds
from voile.inverse.contact_pairs import ContactPairs, clearances, find_contact_pairs
from voile.inverse.reactions import Balance, Cones, least_friction
from voile.problem.contact import cone_fields, contact_of, with_obstacles
from voile.problem.lifetime import Clock
from voile.problem.partition import gathered
from voile.problem.problem import Problem
from voile.problem.rest import RestShape, field_vector
from voile.problem.scales import slow_rate
from voile.problem.shell import Shell
from voile.problem.supports import free_motions, hinged_parts
from voile.solver.linear import Counts
from voile.solver.stability import smallest_eigenpair

RESERVE = 0.2  # of what friction has to spare that reactions leave unused: they stick also when disturbed
HOLDS = 1.0, 0.1, 0.01  # tried in turn: penalty on rest positions at contacts, over the shell's
CLEARANCE = 1e-3  # in thicknesses, of what sinks into an obstacle at the target and carries nothing
UNLOADED = 1e-9  # of the loads: those whose rate is that of eigenvalues where there are none
HOVERS = 1e-4  # sizes: a gap of what bears that matters
TINY = 1e-9  # reaction over the largest one under which a contact holds nothing


class Target:
    """A problem at its start shape, the target, as the inverse solvers see it.

    What is nearer than `tolerance` (m) to touching, a vertex an obstacle or layers each other, may carry a reaction
    there; gaps are kept as they are. `reactions` (c, 3) N are in Coulomb's cones and hold the shell as a whole; they
    act as dead forces while the rest shape is sought, and are those of contact in the simulation (`obstructed`).
    """

    def __init__(
        self,
        problem: Problem,
        shell: Shell | None,
        obstacles: list[Obstacle],
        offset: float,
        tolerance: float,
        friction: bool = True,
        layers: Layers | None = None,
        counts: Counts | None = None,
    ):
        """layers: the shell's, where they are in each other's way; counts: of the search and its simulations. Raises
        InputError where layers start in the same place or through each other, NotConverged where no reactions can hold
        the target."""
        self.problem, self.obstacles, self.offset, self.tolerance = problem, obstacles, offset, tolerance
        self.layers, self.bounds, self.counts = layers, Bounds(), counts or Counts()
        self.clock = Clock(problem.comm, 0.0)  # of what is under way: the search, then its proof
        self.rest = RestShape(problem)
        self.tangent = problem.create_matrix()
        comm = problem.comm
        modes = comm.bcast(free_motions(shell) if shell is not None else None)
        self.modes = modes[problem.part.vertex]
        self.x = problem.positions(problem.create_vector())
        self.movable = np.diff(problem.part.matrix.indptr)[: 3 * len(self.x)].reshape(-1, 3).any(axis=1)
        self.contacts = self._find_contact_pairs()
        self.own = self._gather(lambda pairs: pairs.own).astype(bool)
        contacts = bool(obstacles) or comm.allreduce(int(self.own.sum())) > 0
        self.ground_rows = np.zeros(0, dtype=np.int32) if contacts else self._grounding()
        self.cones = self._cones(friction)
        self.reactions, self._slope = np.zeros((len(self.own), 3)), np.zeros((len(self.own), 3, 3))
        fabric, part = problem.part.fabric, problem.part
        total = comm.allreduce(np.array([(fabric[0] * fabric[1]) @ part.weight, part.weight.sum()]))
        self.membrane = float(total[0] / total[1])  # N/m, about the shell's own at a vertex
        self.penalty = HOLDS[0] * self.membrane  # N/m, of the spring that holds rest positions at contacts
        self.least_friction: float | None = None
        self._used = self.cones
        self._check_hinges(comm.bcast(hinged_parts(shell) if shell is not None else None))
        self._settle_friction()

    # ---- contacts ----

    def _find_contact_pairs(self) -> list[ContactPairs]:
        contact = with_obstacles(self.problem, self.obstacles, self.offset, self.layers).contact
        return find_contact_pairs(contact, self.x, self.tolerance) if isinstance(contact, Contact) else []

    def _cones(self, friction: bool) -> Cones:
        if not self.contacts:
            return Cones(np.zeros((0, 3)), np.zeros(0))
        mu = [np.full(len(t), t.partner.friction if friction else 0.0) for t in self.contacts]
        return Cones(np.concatenate([t.normal for t in self.contacts]), np.concatenate(mu))

    def _gather(self, part: Callable[[ContactPairs], Array], *shape: int) -> Array:
        """(c, ...) of all contacts, what `part` says of those with one partner."""
        return np.concatenate([np.zeros((0, *shape)), *map(part, self.contacts)])

    def _jump(self, field: Reals) -> Reals:
        """(c, 3, ...) of a field (local vertices, 3, ...) at all contacts."""
        return self._gather(lambda pairs: pairs.relative(field), *field.shape[1:])

    def _spread(self, reactions: Reals) -> Reals:
        """(local vertices, 3) forces of reactions (c, 3) N."""
        return sum((t.spread(reactions[rows]) for t, rows in self._rows()), np.zeros_like(self.x))

    def _rigid(self, pairs: ContactPairs) -> bool:
        """Whether it is with an obstacle."""
        return pairs.index < len(self.obstacles)

    def on_obstacles(self) -> Flags:
        """(c,) marks the contacts with obstacles."""
        return self._gather(lambda pairs: np.full(len(pairs), self._rigid(pairs))).astype(bool)

    def touching(self) -> Flags:
        """(n,) local vertices that touch."""
        marked = np.zeros(len(self.x), dtype=bool)
        for pairs in self.contacts:
            marked |= np.isfinite(pairs.least(np.zeros(len(pairs))))
        return marked

    def gaps(self) -> Reals:
        """(c,) distances (m) of what may touch in the target, from surface to surface: negative where it sinks."""
        thickness = self.layers.thickness if self.layers else 0.0
        return self._gather(lambda t: t.gap - (self.offset if self._rigid(t) else thickness))

    def folds(self) -> tuple[Ints, Reals]:
        """Pairs of neighbouring local triangles (k, 2) and the angle (k,) in radians between them: 0 where one lies on
        the other, pi where they are level."""
        part = self.problem.part
        normal = area_vectors(self.x, part.corners)
        normal /= np.maximum(np.linalg.norm(normal, axis=1), 1e-300)[:, None]
        row, side = np.nonzero(part.across >= 0)
        sides = np.column_stack([row, part.across[row, side] // 3])
        half = 0.5 * np.linalg.norm(normal[sides].sum(axis=1), axis=1)
        return sides, 2.0 * np.arcsin(np.minimum(half, 1.0))

    def _balance(self) -> Balance:
        """The present loads, at load factor 1."""
        problem, part = self.problem, self.problem.part
        n = len(part.vertex)
        load = (problem.loads.weight[: 3 * n] + part.force[: 3 * n]).reshape(-1, 3)
        size = np.linalg.norm(load, axis=1)
        total = problem.comm.allreduce(np.array([size[problem.own].sum(), float(problem.own.sum())]))
        mean = total[0] / total[1]

        def borne(pairs: ContactPairs, values: Reals, else_: float) -> Reals:
            """A vertex takes its own load; layers as little as possible."""
            layers = np.full((len(pairs), *values.shape[1:]), else_)
            return values[pairs.stencil] if self._rigid(pairs) else layers

        resultant = problem.comm.allreduce(np.einsum("vik,vi->k", self.modes[problem.own], load[problem.own]))
        return Balance(
            weight=self._gather(lambda pairs: borne(pairs, np.maximum(size, 1e-3 * mean), mean)),
            load=self._gather(lambda pairs: borne(pairs, load, 0.0), 3),
            modes=self._jump(self.modes),
            resultant=resultant,
            scale=float(total[0]),
            own=self.own,
            add=problem.comm.allreduce,
        )

    def _settle_friction(self) -> None:
        """Chooses how much of the friction the reactions may use. Raises NotConverged where all is not enough."""
        if not self.modes.shape[2] and not self.contacts:
            return
        balance, cones = self._balance(), self.cones
        if balance.solve(cones) is None:
            raise NotConverged(self._no_reactions(balance))
        least = least_friction(balance, cones)
        self.least_friction = least
        if least is not None:
            reserve = RESERVE * np.maximum(cones.friction - least, 0.0)
            self._used = cones.scaled(cones.friction - reserve)

    def _check_hinges(self, parts: list[tuple[Ints, Ints]]) -> None:
        """Raises Hinged for parts that hang by one or two vertices and touch nothing."""
        problem = self.problem
        touching = problem.part.vertex[self.touching()]
        hanging = [part for part in parts if problem.everywhere(not np.isin(part[1], touching).any())]
        if hanging:
            joints, vertices = hanging[0]
            hinge = " and ".join(map(str, joints))
            raise Hinged(
                f"the part of the target with vertex {min(vertices)} ({len(vertices)} vertices) hangs by vertex "
                f"{hinge} alone and turns freely: no rest shape holds it as it is; join it along an edge, support "
                "it, or leave it out",
                hanging,
            )

    def _no_reactions(self, balance: Balance) -> str:
        count = self.problem.comm.allreduce(int(balance.own.sum()))
        partners = [(o.name, o.friction) for o in self.obstacles]
        partners += [("itself", self.layers.friction)] if self.layers else []
        names = ", ".join(f"{name} (friction {friction:g})" for name, friction in partners) or "none"
        if not count:
            return (
                f"the target touches nothing that could hold it: no vertex within inverse.contact_tolerance = "
                f"{self.tolerance:g} m of an obstacle ({names}), and the supports leave it free to move"
            )
        least = least_friction(balance, self.cones)
        offer = "no friction would do: it must touch elsewhere, or be supported"
        if least is not None:
            where = self._where(balance.solve(self.cones.scaled(least)))
            offer = f"the least friction that would do is {least:.4g}, {where}"
        return f"no reactions in the cones of its {count} contacts hold the target on {names}: {offer}"

    def _where(self, r: Reals | None) -> str:
        """The contact that would carry most."""
        assert r is not None
        size, part = np.linalg.norm(r, axis=1), self.problem.part
        places = self._gather(lambda t: t.partner.gather(self.x)[t.geometry.vertex[:, 0]], 3)
        vertex = self._gather(lambda t: part.vertex[t.stencil] if self._rigid(t) else t.stencil[:, 0])
        mine = (float(size.max(initial=0.0)), self.problem.comm.rank)
        most, rank = self.problem.comm.allreduce(mine, op=MPI.MAX)
        text = ""
        if rank == self.problem.comm.rank and len(size):
            k = int(np.argmax(size))
            x = ", ".join(f"{c:.4g}" for c in places[k])
            text = f"with {most:.3g} N at vertex {int(vertex[k])} ({x})"
        found: str = self.problem.comm.bcast(text, root=rank)
        return found

    def hold(self, z: PETSc.Vec) -> None:
        """Reactions for the rest displacement z."""
        moved = self._jump(self.problem.motion(z))
        self.reactions, self._slope = self._used.project(self.penalty * moved)

    def release(self) -> None:
        """No reactions: those of the rest shape that was found are the simulation's."""
        self.reactions = np.zeros_like(self.reactions)

    def residual(self, y: PETSc.Vec, f: PETSc.Vec) -> None:
        """Balance of forces at y with the present rest shape and reactions (N)."""
        self.problem.residual(y, f, self._spread(self.reactions))
        f.array[self._mine() - self.problem.part.first_global] = 0.0

    def jacobian(self, y: PETSc.Vec, matrix: PETSc.Mat) -> None:
        """Its derivative by the rest positions."""
        slope = -self.penalty * self._slope
        blocks = [(pairs.stencil, pairs.over_vertices(slope[rows])) for pairs, rows in self._rows()]
        self.rest.jacobian(y, matrix, blocks)
        if len(self.ground_rows):
            matrix.zeroRowsColumns(self._mine(), 1.0)

    def _rows(self) -> Iterator[tuple[ContactPairs, slice]]:
        """The contacts with each partner and their rows among all."""
        start = 0
        for pairs in self.contacts:
            yield pairs, slice(start, start + len(pairs))
            start += len(pairs)

    def _active(self) -> Flags:
        """(c,) whether a contact carries anything."""
        size = np.linalg.norm(self.reactions, axis=1)
        largest = self.problem.comm.allreduce(float(size.max(initial=0.0)), op=MPI.MAX)
        found: Flags = size > TINY * largest
        return found

    def margins(self) -> tuple[Reals, Reals]:
        """(c,) normal reactions (N) and margins to slip."""
        normal = dot(self.reactions, self.cones.normal)
        return normal, margin(normal, within(self.cones.normal, self.reactions), self.cones.friction)

    def fields(self) -> dict[str, Array]:
        """Of the target at the local vertices as `contact_fields` of a state; gaps of what touches are 0."""
        if not self.contacts:
            return {}
        reaction, gap = self._spread(self.reactions), np.full(len(self.x), np.inf)
        if self.layers:
            gap[:] = self.layers.thickness  # the reach of a simulation's search for layers
        for obstacle in self.obstacles:
            gap = np.minimum(gap, obstacle.gap(self.x, 0.0) - self.offset)
        gap[self.touching()] = 0.0  # as recorded
        state = np.where(np.linalg.norm(reaction, axis=1) > 0.0, STICK, FREE)
        normal, left = self.margins()
        along = self._spread(normal[:, None] * self.cones.normal)
        least, friction = np.ones(len(self.x)), np.full(len(self.x), np.inf)
        for pairs, rows in self._rows():
            active = np.where(normal[rows] > 0.0, self.cones.friction[rows], np.inf)
            least = np.minimum(least, pairs.least(left[rows]))
            friction = np.minimum(friction, pairs.least(active))
        return cone_fields(reaction, gap, state, along, friction, least)

    # ---- the problem at the target ----

    def load(self, fraction: float) -> None:
        """Sets the fraction of all loads."""
        self.problem = self.rest.problem = self.problem.at(fraction)

    def load_norm(self, y: PETSc.Vec) -> float:
        """Norm of the full loads on the unknowns (N)."""
        return self.problem.at(1.0).load_norm(y)

    def _grounding(self) -> Ints:
        """Global indices of as many unknowns as there are free motions, which held stop them all."""
        k = self.modes.shape[2]
        values = np.zeros((self.problem.part.owned, k))
        for mode in range(k):
            values[:, mode] = self.field_vector(self.modes[:, :, mode]).array_r
        values = np.concatenate(self.problem.comm.allgather(values))
        if not k:
            return np.zeros(0, dtype=np.int32)
        _, _, order = scipy.linalg.qr(values.T, mode="economic", pivoting=True)
        return np.sort(order[:k]).astype(np.int32)

    def field_vector(self, field: Reals) -> PETSc.Vec:
        """A displacement field (local vertices, 3) on the unknowns: what held and sewn vertices do is left out."""
        return field_vector(self.problem, field)

    def _mine(self) -> Ints:
        first = self.problem.part.first_global
        return self.ground_rows[
            (self.ground_rows >= first) & (self.ground_rows < first + self.problem.part.owned)
        ]

    # ---- stability ----

    def stiffness(self, y: PETSc.Vec) -> PETSc.Mat:
        """The exact tangent at the target with sticking contacts held, slipping ones (no friction) along the normal."""
        self.problem.tangent(y, self.tangent, "exact", self._held())
        return self.tangent

    def _held(self) -> Iterator[tuple[Ints, Reals]]:
        penalty, active_all = PENALTY * self.membrane, self._active()
        for pairs, rows in self._rows():
            active, sticks = active_all[rows], (self.cones.friction[rows] > 0.0)[:, None, None]
            pressed = dot(self.reactions[rows], pairs.normal)
            blocks = pairs.over_vertices(
                np.where(sticks, penalty * np.eye(3), penalty * outer(pairs.normal, pairs.normal))
            )
            blocks -= pressed[:, None, None] * pairs.bent()
            yield pairs.stencil[active], blocks[active]

    def softest_mode(self, z: PETSc.Vec) -> PETSc.Vec:
        """The mode of the smallest eigenvalue at z (unknowns, largest entry 1)."""
        return self.smallest(z)[1]

    def smallest(self, z: PETSc.Vec) -> tuple[float, PETSc.Vec]:
        """Smallest omega^2 (1/s^2) of the target, nan where none is found, and its mode."""
        scale = max(self.problem.time, UNLOADED) * slow_rate(self.problem)
        return smallest_eigenpair(self.problem, self.stiffness(self.rest.state(z)), scale, self.counts)

    # ---- for the simulation ----

    def hovering(self) -> bool:
        """Whether gaps of what bears matter."""
        bears = self.own & (dot(self.reactions, self.cones.normal) > 0.0)
        near = bool((np.abs(self.gaps()[bears]) <= HOVERS * self.problem.size()).all())
        return not self.problem.everywhere(near)

    def as_statics(self, z: PETSc.Vec) -> Problem:
        """The problem as a scene of statics has it, with the rest displacements z: without reactions, so gaps close."""
        rest = gathered(self.problem, self.x + self.problem.motion(z))
        shell = self.problem.shell
        if shell is not None and rest is not None:
            shell = replace(shell, rest_points=rest)
        problem = Problem(shell, self.problem.comm)
        problem.monitor = self.problem.monitor
        return with_obstacles(problem, self.obstacles, self.offset, self.layers)

    def obstructed(self) -> Problem:
        """The problem under the full load with obstacles and layers in the way, for a simulation: active contacts at
        the gap that they have in the target, with their reactions; others where they are, or just clear of it."""
        problem, active_all = self.problem.at(1.0), self._active()
        if not self.contacts:
            return problem
        offset = np.full((len(self.obstacles), len(self.x)), self.offset)
        clearance, layers = CLEARANCE * problem.thickness(), self.layers
        for pairs, rows in self._rows():
            active = active_all[rows]
            if self._rigid(pairs):
                clear = np.minimum(self.offset, pairs.gap - clearance)
                offset[pairs.index, pairs.stencil] = np.where(active, pairs.gap, clear)
            elif layers:
                distance = clearances(layers, pairs.partner.gather(self.x), clearance)
                distance |= dict(zip(pairs.code[active].tolist(), pairs.gap[active].tolist(), strict=True))
                known = np.array(sorted(distance), dtype=np.int64)
                layers = replace(
                    layers, known=known, min_distance=np.array([distance[code] for code in known.tolist()])
                )
        problem = with_obstacles(problem, self.obstacles, offset, layers)
        contact = contact_of(problem)
        contact.begin(self.x, 1.0)
        contact.pairs(self.x, 1.0)  # finds layers
        for pairs, rows in self._rows():
            r, active = self.reactions[rows], active_all[rows]
            normal = dot(r, pairs.normal)
            places = contact.partners[pairs.index].places(pairs.code[active], contact.history)
            contact.history.normal[pairs.index][places] = (normal / pairs.gradient_norm)[active]
            contact.history.friction[pairs.index][places] = within(pairs.normal, r)[active]
        return problem
