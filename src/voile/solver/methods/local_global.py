"""Projective Dynamics with dry friction (Bouaziz et al. 2014; Ly, Jouve, Boissieux & Bertails-Descoubes 2020).

An implicit step x minimises c/2 |x - predicted|^2_M + E(x) under contact's laws. Elements project their deformation on
what is free of energy (local); the positions come from a constant matrix A = c M + K (global), factored once per run.
With the forces F of all terms that is x <- x + A^-1 (F(x) + r), for K is the energies' Hessian with projections held.
Held projections resist a motion along the normals as they resist stretching, of which the shell does nothing where it
is flat. So of stiff cloth W, the forces along weighted normals w n (solver/normals.py), go through another constant
matrix B, with a share of the stretching: x <- x + (T A^-1 T + W^T B^-1 W) (F(x) + r), T = 1 - n W. That is a third of
the iterations.
Reactions r are estimated in Gauss-Seidel sweeps: the vertices of a contact go where B leads them, and the laws cut that
motion. A fixed point obeys balance and laws exactly; stopped before, it is a prediction.
"""

from dataclasses import dataclass

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from voile.arrays import Reals
from voile.contact.directions import lengths
from voile.contact.local import LocalLaws
from voile.problem.contact import contact_of
from voile.problem.elastic import Elastic
from voile.problem.inertia import Inertia, mass_blocks
from voile.problem.mean import MeanElastic
from voile.problem.problem import Problem
from voile.problem.projective import constant_blocks
from voile.solver.anderson import Anderson
from voile.solver.constant import ConstantMatrices
from voile.solver.linear import Counts
from voile.solver.methods.method import Outcome
from voile.solver.normals import normals
from voile.solver.resistance import Resistance

SIZES = 2  # of time steps whose factors are kept
# Of the stretching in B. Any has the same fixed points. With none reactions creep and tension is forgotten, with all of
# it reactions overshoot, for a sweep does not see how the shell around gives way. From 0.04 to 0.15 runs hardly differ.
SHARE = 0.08
# Mean stretching over the inertia from which on forces are split: on the rotating sphere of 5,929 vertices (16) the
# second solve costs what it saves, on a drop with 60 iterations and time are halved.
WORTH = 30.0


@dataclass
class Options:
    """iterations at most. renew: iterations after which contacts are linearised anew, or as soon as what is missed has
    fallen to a share `fallen`: on the rotating sphere a tenth takes as many iterations and twice the time for it. near:
    sizes of the shell beyond its motion in the step within which a vertex may come into contact. depth: of Anderson's
    acceleration, 0 without. growth: of a step over the last one, beyond which acceleration starts anew."""

    iterations: int = 20
    renew: int = 10
    fallen: float = 0.01
    near: float = 1e-4
    depth: int = 5
    growth: float = 2.0


class LocalGlobal:
    """A method for the problems of steps, which have an inertia term. It stops at the tolerance or after its
    iterations, and says which in the outcome. `norms`: of forces out of balance and of what the laws miss (N), before
    each iteration of the last run and at its end."""

    name = "local-global"

    def __init__(self, problem: Problem, options: Options | None = None):
        self.options, self.counts = options or Options(), Counts()
        self.blocks = [constant_blocks(problem.part, share) for share in (1.0, SHARE)]
        self.norms: list[tuple[float, float]] = []
        self._matrices: dict[
            tuple[float, float], tuple[ConstantMatrices, Reals | None, Resistance | None]
        ] = {}

    def solve(self, problem: Problem, y: PETSc.Vec, tolerance: float) -> Outcome:
        """See Method."""
        PETSc.garbage_cleanup(problem.comm)  # petsc4py only marks what Python has dropped
        step, most, self.norms = _Step(self, problem, y), self.options.iterations, []
        for iteration in range(most + 1):
            step.measure(y)
            if (
                iteration % self.options.renew == 0
                or iteration == most
                or step.norm <= max(tolerance, step.renewed)
            ):
                step.renew()
            self.norms.append(step.norms)
            if step.norm <= tolerance or iteration == most or not np.isfinite(step.norm):
                break
            step.advance(y)
            self.counts.iterations += 1
        step.finish()
        if not np.isfinite(step.norm):
            return Outcome(False, self.name, "the iteration diverged")
        if step.through:
            return Outcome(False, self.name, "a step leads a layer of the shell through another")
        reason = "" if step.norm <= tolerance else f"{most} iterations, norm {step.norm:.3e} N"
        return Outcome(True, self.name, reason, norm=step.norm)

    def sharpen(self, problem: Problem, y: PETSc.Vec, tolerance: float) -> None:
        """Its iterations are counted; there is none to spare."""

    def matrices(
        self, problem: Problem, coefficient: float
    ) -> tuple[ConstantMatrices, Reals | None, Resistance | None]:
        """For an inertia of `coefficient` (1/s^2): A and, with the stretching in A over the inertia (own unknowns,), B
        where forces are split; and what contacts take for B."""
        elastic = problem.terms[0]
        assert isinstance(elastic, Elastic | MeanElastic)
        # The last step ends at the duration: its length differs by round-off, which they need not follow.
        key = float(f"{coefficient:.9e}"), elastic.stiffness
        if key not in self._matrices:
            inertia, made = mass_blocks(problem.vertex_mass(), coefficient), []
            for blocks in self.blocks:
                made.append(problem.create_matrix())
                problem.assemble(made[-1], elastic.stiffness * blocks, [inertia])
            kept = list(self._matrices.items())[1 - SIZES :]
            resistance = Resistance(problem, made[-1]) if problem.contact else None
            whole, soft = (matrix.getDiagonal().array for matrix in made)
            stiffness = (whole - soft) / (1.0 - SHARE) / (coefficient * problem.mass().array)
            mean = problem.comm.allreduce(float(stiffness.sum())) / problem.unknowns
            splits = mean > WORTH
            factors = ConstantMatrices(problem, made if splits else made[:1], self.counts)
            self._matrices = dict(kept) | {key: (factors, stiffness if splits else None, resistance)}
        return self._matrices[key]


class _Step:
    """The iteration of one step in time. `norms`: of forces out of balance and of what the laws miss (N), where y was
    last measured; renewed: below which contacts are linearised anew."""

    def __init__(self, method: LocalGlobal, problem: Problem, y: PETSc.Vec):
        self.problem, self.options = problem, method.options
        # Where parts of the shell have inertia of their own (schemes change where contact bears), A takes the most.
        mass = problem.vertex_mass()[:, None]
        inertia = sum(
            (t.coefficient * mass for t in problem.terms if isinstance(t, Inertia)), np.zeros((len(mass), 3))
        )
        most = float(np.max(inertia / np.maximum(mass, 1e-300), initial=0.0))
        most = problem.comm.allreduce(most, op=MPI.MAX)
        self.matrices, stiffness, resistance = method.matrices(problem, most)
        self.normals: list[tuple[Reals, Reals]] = []
        if stiffness is not None:
            normal, weighted = normals(problem, problem.positions(y), stiffness)
            self.normals = [(normal[rows], weighted[rows]) for rows in self.matrices.groups]
        self.force, self.direction = problem.create_vector(), problem.create_vector()
        self.anderson = Anderson(problem.comm, len(y.array_r), method.options.depth)
        self.stepped, self._spread = np.inf, np.zeros(problem.part.matrix.shape[0])
        self.reactions = np.zeros(len(y.array_r))  # along the own unknowns (N)
        self.norms, self.renewed = (np.inf, 0.0), 0.0
        self.laws: LocalLaws | None = None
        if problem.contact and resistance:
            self.resistance = resistance
            self.start = self.anchor = problem.contact.history.reference
            self.laws = LocalLaws(problem.contact, len(mass), problem.time)

    @property
    def norm(self) -> float:
        """Of both together (N)."""
        return float(np.hypot(*self.norms))

    @property
    def through(self) -> bool:
        """Whether a layer was led through another where contacts were last linearised."""
        return bool(self.laws and contact_of(self.problem).itself and self.anchor is not self.x)

    def measure(self, y: PETSc.Vec) -> None:
        """Evaluates forces and laws at y."""
        at, terms = self.problem.point(y), self.problem.terms
        self.x = at.positions
        self.shell = self.problem.layout.collect(sum((t.forces(at) for t in terms[1:]), terms[0].forces(at)))
        self._miss()

    def renew(self) -> None:
        """Linearises contacts where y was last measured."""
        if self.laws is not None:
            self._linearise(self.laws, self.x)
            self._react(self.laws)
            self._miss()
        self.renewed = self.options.fallen * self.norm

    def _react(self, laws: LocalLaws) -> None:
        """Takes the reactions' forces."""
        reactions = laws.forces().ravel()
        self._spread[: len(reactions)] = reactions
        self.reactions = self.problem.layout.collect(self._spread)

    def _miss(self) -> None:
        """Measures forces and laws."""
        laws, missed = self.laws, 0.0
        np.add(self.shell, self.reactions, out=self.force.array)
        if laws is not None and laws.found is not None:
            missed = self.problem.reduced(laws.mismatch(self.x))
        self.norms = float(self.force.norm()), float(np.sqrt(missed))

    def _linearise(self, laws: LocalLaws, x: Reals) -> None:
        contact, problem = contact_of(self.problem), self.problem
        laws.remember()
        if contact.itself and contact.free_share(self.start, x) == 1.0:
            self.anchor = x
        reach = lengths(x - self.start) + self.options.near * problem.size()
        laws.linearise(x, reach, self.anchor)

    def advance(self, y: PETSc.Vec) -> None:
        """One iteration from y, where `force` has been measured."""
        force, direction = self.force, self.direction
        if self.laws is not None:
            self.laws.sweep(self.x, self.resistance.stiffness, self.resistance.gather(force))
            self._react(self.laws)
            np.add(self.shell, self.reactions, out=force.array)
        self._solve()
        size = direction.norm()
        if size > self.options.growth * self.stepped:
            self.anderson.forget()
        self.stepped = size
        self.anderson.step(y.array_r, direction.array_r, force.array)
        y.axpy(1.0, force)

    def _solve(self) -> None:
        """direction = A^-1 force, or (T A^-1 T + W^T B^-1 W) force where forces are split."""
        groups, force, found = self.matrices.groups, self.force.array_r, self.direction.array
        if not self.normals:
            self.matrices.solve(0, force, found)
            return
        tangential, along, way = np.zeros_like(force), np.zeros_like(force), np.zeros_like(force)
        for rows, (normal, weighted) in zip(groups, self.normals, strict=True):
            along[rows[0]] = (weighted * force[rows]).sum(axis=0)  # one axis stands for the normal
            tangential[rows] = force[rows] - normal * along[rows[0]]
        self.matrices.solve(0, tangential, found)
        self.matrices.solve(1, along, way)
        for rows, (normal, weighted) in zip(groups, self.normals, strict=True):
            u = found[rows]
            found[rows] = u + weighted * way[rows[0]] - normal * (weighted * u).sum(axis=0)

    def finish(self) -> None:
        """The reactions become the contact's."""
        if self.laws is not None:
            self.laws.remember()
