"""Natural vibrations about an equilibrium and linear buckling: the lowest eigenpairs of K x = mu G x.

Vibration: G = C^T M C, mu = omega^2; directors have no mass, so G is singular. Buckling: G = -Kg, the geometric
stiffness of the load's stresses, indefinite; mu is the load factor. K is the tangent, with sticking contacts held and
slipping ones free along their way.

SLEPc's Krylov-Schur method finds the largest theta of G x = theta B x, B = K - shift G, mu = shift + 1/theta: that is
shift-and-invert in the inner product of B, which is positive definite where the shift is below all mu > 0. The inertia
of K - cut G then tells how many mu lie below a cut: a copy of a multiple one that a single start vector missed is
looked for again beside those found.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from voile.arrays import Reals
from voile.errors import NotConverged
from voile.problem.problem import Problem
from voile.problem.rest import field_vector
from voile.solver.linear import Counts, Inverse, LinearSolver, factored
from voile.solver.stability import below_spectrum, contact_tangent, factored_beside

NEAR = 64.0  # bending rates from zero to the shift: about the lowest omega^2 of a cantilever plate
FURTHER = 2  # eigenpairs beside those asked for: between them lies a cut for the inertia
TOLERANCE = 1e-10  # SLEPc's, on theta's residual; eigenvalues are right to its square
ROUGH, BELOW = 0.02, 0.9  # tolerance of a first look at the lowest; share of it at which a shift is tried
ALIKE = 1e-7  # relative: eigenvalues nearer than this are one, whose modes are told apart by fixed fields
SEARCHES = 6  # for copies that the inertia misses
NOISE = 100.0  # units of round-off in a Rayleigh quotient: a rigid motion has no more
SMALL_MOVE = 1e-5  # sizes of the shell over which a support's effect is differenced


@dataclass
class Modes:
    """Eigenvalues, ascending, and their shapes: displacements whose largest is 1 (local vertices, 3)."""

    values: Reals
    shapes: list[Reals]

    @property
    def frequencies(self) -> Reals:
        """Hz, of values omega^2 (1/s^2); negative where the mode grows, at the rate 2 pi times it."""
        found: Reals = np.sign(self.values) * np.sqrt(np.abs(self.values)) / (2.0 * np.pi)
        return found


def vibrations(
    problem: Problem, y: PETSc.Vec, count: int, counts: Counts, rigid: Reals | None = None
) -> Modes:
    """The lowest omega^2 (1/s^2) of an equilibrium; exactly zero where it is round-off. rigid (local vertices, 3, k):
    motions, independent, that are known to cost nothing: round-off in them would spoil the others."""
    stiffness, mass = _tangent(problem, y), problem.mass_matrix(rotary=False)
    shift, solver = below_spectrum(stiffness, mass, -NEAR * bending_rate(problem), counts)
    if solver.negative:
        raise NotConverged("modes: the tangent has eigenvalues that no shift is below")
    pencil = Pencil(problem, stiffness, mass, counts)
    still = [] if rigid is None else [field_vector(problem, motion) for motion in np.moveaxis(rigid, 2, 0)]
    values, modes = pencil.lowest(count, shift, solver, still)
    scale, weight = stiffness.getDiagonal(), mass.getDiagonal()
    for k, mode in enumerate(modes):
        square = mode.copy()
        square.pointwiseMult(mode, mode)
        if abs(values[k]) * square.dot(weight) <= NOISE * np.finfo(float).eps * square.dot(scale):
            values[k] = 0.0
    if problem.contact:
        own = _of_the_shell(problem, y, values, modes)
        values, modes = values[own], [modes[k] for k in own]
    return Modes(values, pencil.shapes(values, modes))


def buckling(problem: Problem, y: PETSc.Vec, count: int, counts: Counts) -> Modes:
    """The lowest load factors above the problem's at which its structure, linearised at y, buckles; less where there
    are fewer. Raises NotConverged where it is not stable itself."""
    stiffness = _tangent(problem, y)
    solver = factored(stiffness, counts, definite=True)
    if solver.negative or not solver.usable:
        raise NotConverged(
            f"modes.buckling: at load factor {problem.time:g} the structure is not stable, so nothing is left to "
            "buckle; supports must hold it without the loads"
        )
    geometric = _geometric(problem, y, stiffness, solver)
    pencil = Pencil(problem, stiffness, geometric, counts)
    shift, solver = pencil.closer(solver)
    values, modes = pencil.lowest(count, shift, solver)
    return Modes(problem.time + values, pencil.shapes(values, modes))


def free_displacements(problem: Problem) -> int:
    """How many unknowns have mass, and so a vibration."""
    return int(problem.comm.allreduce(int((problem.layout.axis < 3).sum())))


def bending_rate(problem: Problem) -> float:
    """1/s^2: D/(rho h L^4), L the shell's size: below omega^2 of its bending, but not by many orders."""
    part = problem.part
    thickness, young, poisson, density = part.fabric[:4]
    stiffness = (young * thickness**2 / (12.0 * (1.0 - poisson**2))) @ part.weight
    total = problem.comm.allreduce(np.array([stiffness, density @ part.weight]))
    return float(total[0] / total[1]) / problem.size() ** 4


def _tangent(problem: Problem, y: PETSc.Vec) -> PETSc.Mat:
    """The exact tangent, with contacts as the laws hold them."""
    matrix = problem.create_matrix()
    if problem.contact:
        return contact_tangent(problem, y, matrix)
    problem.tangent(y, matrix)
    return matrix


def _of_the_shell(problem: Problem, y: PETSc.Vec, values: Reals, modes: list[PETSc.Vec]) -> list[int]:
    """Which vibrations the shell carries. Contacts are held by springs, so to each direction that they hold belongs a
    mode as well: it has most of its energy in them, a shell's nearly none, and it is none of an exact constraint."""
    free, mass, product = problem.create_matrix(), problem.mass_matrix(rotary=False), problem.create_vector()
    problem.tangent(y, free, "exact")
    own = []
    for k, mode in enumerate(modes):
        free.mult(mode, product)
        carried = mode.dot(product)
        mass.mult(mode, product)
        if values[k] <= 0.0 or carried >= 0.5 * values[k] * mode.dot(product):
            own.append(k)
    return own


def _geometric(problem: Problem, y: PETSc.Vec, stiffness: PETSc.Mat, solver: LinearSolver) -> PETSc.Mat:
    """-Kg: minus the derivative by the load factor of the tangent whose stresses follow the load linearly."""
    response, moved = _rate(problem, y, solver)
    du, dphi = problem.layout.spread(response)
    count = problem.layout.vertices
    problem.kernel.predict(*problem.shape(y), du + moved[:count], dphi + moved[count:])
    matrix = problem.create_matrix()
    # pressure's own tangent grows with the load, too
    loaded = problem if problem.moves else problem.at(problem.time + 1.0)
    loaded.tangent(y, matrix, "mixed")
    matrix.axpy(-1.0, stiffness, structure=PETSc.Mat.Structure.SAME_NONZERO_PATTERN)
    matrix.scale(-1.0)
    return matrix


def _rate(problem: Problem, y: PETSc.Vec, solver: LinearSolver) -> tuple[PETSc.Vec, Reals]:
    """By the load factor: the unknowns that answer the residual's change, and what supports move (local dofs,)."""
    t, layout = problem.time, problem.layout
    step = 1.0
    if problem.moves:
        step = SMALL_MOVE / max(problem.in_sizes(layout.held(t + 1.0) - layout.held(t)), 1e-300)
    ahead, back, response = (problem.create_vector() for _ in range(3))
    problem.at(t + step).residual(y, ahead)
    problem.at(t - step).residual(y, back)
    ahead.axpby(-0.5 / step, 0.5 / step, back)
    solver.solve(ahead, response)
    response.scale(-1.0)
    return response, (layout.held(t + step) - layout.held(t - step)) / (2.0 * step)


@dataclass
class Pencil:
    """K x = mu G x over a problem's unknowns."""

    problem: Problem
    stiffness: PETSc.Mat
    other: PETSc.Mat
    counts: Counts

    def closer(self, solver: LinearSolver) -> tuple[float, LinearSolver]:
        """A shift just below the lowest eigenvalue above 0, and its matrix, factored: loads of buckling lie so close to
        each other that from 0 they are hard to tell apart. solver: of K."""
        values, _ = self._search(1, 0.0, solver, [], self._fields(1)[0], ROUGH)
        shift = values[0] if len(values) else 0.0
        for _ in range(SEARCHES if shift else 0):
            shift *= BELOW
            near = factored_beside(self.stiffness, self.other, shift, self.counts, definite=True)
            if near.usable and not near.negative:
                solver.destroy()
                return shift, near
            near.destroy()
        return 0.0, solver

    def lowest(
        self, count: int, shift: float, solver: LinearSolver, still: Sequence[PETSc.Vec] = ()
    ) -> tuple[Reals, list[PETSc.Vec]]:
        """The `count` lowest eigenvalues above a shift, ascending, and their vectors; less where there are fewer.
        solver: of K - shift G, which is positive definite; still: vectors of the eigenvalue 0 that are known."""
        values, vectors = np.zeros(len(still)), list(still)
        fields = self._fields(1)
        missing = max(count - len(still), 0)
        for _ in range(SEARCHES):
            found, more = self._search(missing + FURTHER, shift, solver, vectors, fields[0])
            values, vectors = np.concatenate([values, found]), vectors + more
            order = np.argsort(values, kind="stable")
            values, vectors = values[order], [vectors[k] for k in order]
            cut = _cut(values, count)
            if not more or cut is None:
                break
            check = factored_beside(self.stiffness, self.other, cut, self.counts)
            missing = (check.negative or 0) - int((values < cut).sum())
            check.destroy()
            if missing <= 0:
                break
        else:
            raise NotConverged("modes: the inertia tells of more eigenvalues than are found")
        solver.destroy()
        return values[:count], vectors[:count]

    def _search(
        self,
        count: int,
        shift: float,
        solver: LinearSolver,
        found: list[PETSc.Vec],
        first: PETSc.Vec,
        tolerance: float = TOLERANCE,
    ) -> tuple[Reals, list[PETSc.Vec]]:
        """Further eigenpairs beside those found."""
        from slepc4py import SLEPc

        definite, room = solver.ksp.getOperators()[0], self.problem.unknowns - len(found)
        product = self.problem.create_vector()
        self.other.mult(first, product)
        if not room or product.norm() == 0.0:
            return np.zeros(0), []
        eps = SLEPc.EPS().create(comm=definite.comm)
        eps.setOperators(self.other, definite)
        eps.setProblemType(SLEPc.EPS.ProblemType.GHEP)
        eps.setWhichEigenpairs(SLEPc.EPS.Which.LARGEST_REAL)
        eps.setOptionsPrefix("modes_")
        eps.setDimensions(min(count, room), min(max(2 * count + 8, 24), room))
        eps.setTolerances(tolerance, 1000)
        if found:
            eps.setDeflationSpace(found)
        eps.setInitialSpace([first])
        ksp = eps.getST().getKSP()
        ksp.setType(PETSc.KSP.Type.PREONLY)
        ksp.pc.setType(PETSc.PC.Type.PYTHON)
        ksp.pc.setPythonContext(Inverse(solver))
        eps.setFromOptions()
        eps.solve()
        values, vectors = [], []
        least = 0.0
        for k in range(eps.getConverged()):
            vector = self.problem.create_vector()
            theta = eps.getEigenpair(k, vector).real
            least = least or NOISE * np.finfo(float).eps * abs(theta)
            if theta > least:
                values.append(shift + 1.0 / theta)
                vectors.append(vector)
        eps.destroy()
        return np.array(values), vectors

    def shapes(self, values: Reals, modes: list[PETSc.Vec]) -> list[Reals]:
        """(local vertices, 3) the modes' displacements, largest 1. Those of one multiple eigenvalue, and all signs, are
        chosen by fixed fields: the same on any number of ranks."""
        mass, found = self.problem.mass_matrix(rotary=False), list[Reals]()
        begin = 0
        while begin < len(modes):
            end = begin + 1
            while end < len(modes) and values[end] - values[begin] <= ALIKE * abs(values[end]):
                end += 1
            found += [self._unit(mode) for mode in self._told_apart(modes[begin:end], mass)]
            begin = end
        return found

    def _told_apart(self, modes: list[PETSc.Vec], mass: PETSc.Mat) -> list[PETSc.Vec]:
        """A basis of the modes' space: projections of fixed fields, each beside those before."""
        weighed = [mass.createVecLeft() for _ in modes]
        for mode, product in zip(modes, weighed, strict=True):
            mass.mult(mode, product)
        gram = np.array([[a.dot(b) for b in weighed] for a in modes])
        along = np.array([[a.dot(b) for b in self._fields(len(modes))] for a in weighed])
        root = np.linalg.cholesky(gram)
        q, r = np.linalg.qr(np.linalg.solve(root, along))
        mixed = np.linalg.solve(root.T, q * np.where(np.diag(r) < 0.0, -1.0, 1.0))
        chosen = []
        for column in mixed.T:
            vector = self.problem.create_vector()
            vector.maxpy(list(column), modes)
            chosen.append(vector)
        return chosen

    def _unit(self, mode: PETSc.Vec) -> Reals:
        shape = self.problem.motion(mode)
        largest = np.linalg.norm(shape, axis=1).max(initial=0.0)
        found: Reals = shape / self.problem.comm.allreduce(float(largest), op=MPI.MAX)
        return found

    def _fields(self, count: int) -> list[PETSc.Vec]:
        """Random displacements, vertex by vertex the same on any number of ranks."""
        problem, vertex = self.problem, self.problem.part.vertex
        n = problem.comm.allreduce(int(vertex.max()), op=MPI.MAX) + 1
        fields = np.random.default_rng(0).standard_normal((count, n, 3))
        return [field_vector(problem, field[vertex]) for field in fields]


def _cut(values: Reals, count: int) -> float | None:
    """Between two different eigenvalues, at least `count` of them below it; None where there are not so many."""
    for k in range(count, len(values)):
        if values[k] - values[k - 1] > ALIKE * abs(values[k]):
            found: float | None = 0.5 * (values[k] + values[k - 1])
            return found
    return None
