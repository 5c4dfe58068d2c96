"""Equilibria along the arc of a path, through limit points and onto bifurcated branches.

Unknowns are the shape y and the load factor t. From an equilibrium with the unit direction v of the path (Riks 1979,
Keller 1977) the next one is the solution of R(y, t) = 0 on the plane <v, (y - y_0, t - t_0)> = s. The product is that
of the mass, for motions over the shell's size, and of load factors, which count as what they move at the start. So s
does not depend on the mesh. Newton steps are those of `mixed_newton`:
the first goes along v with the exact tangent, the others have stresses extrapolated from the last iterate (Magisano,
Leonetti & Garcea 2017). Each factorisation serves two systems, for the residual and for the load.
"""

import math
from dataclasses import dataclass, field

import numpy as np
from petsc4py import PETSc

from voile.contact.contact import Linearised
from voile.problem.problem import Problem
from voile.problem.state import State, difference
from voile.solver.methods.method import Workspace
from voile.solver.methods.semismooth import closed_step, law_norms
from voile.solver.methods.steps import Stall, factor, limit, to_round_off

ITERATIONS = 15  # of a step at most
CORRECTIONS = 3  # solves that turn penalties into constraints, as of the semismooth method
INVERSE = 8  # iterations, next to an eigenvalue of zero


@dataclass
class PathPoint:
    """An equilibrium at a load factor; the unit direction of its path, by which the factor changes by `slope`;
    negative: eigenvalues of its tangent, None where the loads have no potential; touching: this rank's contacts."""

    state: State
    factor: float
    iterations: int
    residual: float
    reason: str
    direction: PETSc.Vec = field(repr=False)
    slope: float = 0.0
    negative: int | None = None
    touching: list[tuple[bytes, ...]] = field(default_factory=list)


class Linear:
    """The equations of equilibrium, and the laws of contact without friction, linearised at y: one factorisation.
    before: those of the iterate before, whose laws tell which contacts pulled there."""

    def __init__(
        self, work: Workspace, problem: Problem, y: PETSc.Vec, kind: str, before: "Linear | None" = None
    ):
        self.work, self.problem, self.y, contact = work, problem, y, problem.contact
        if contact is None:
            self.laws: list[Linearised] = []
            self.solver = factor(work, problem, y, kind)
            return
        known = before.laws if before else [None, None]
        self.laws = [contact.linearise(problem.positions(y), problem.time, each) for each in known]
        problem.tangent(y, work.matrix, kind, self.laws[0].blocks())
        self.solver = work.symmetric
        self.solver.factor(work.matrix)

    def steps(self, residual: PETSc.Vec, load: PETSc.Vec) -> tuple[PETSc.Vec, PETSc.Vec]:
        """Newton's step for a residual (N) without reactions, and what the whole load (N) adds to it."""
        newton, loaded = residual.duplicate(), residual.duplicate()
        if not self.laws:
            self.solver.solve(residual, newton)
            newton.scale(-1.0)
            self.solver.solve(load, loaded)
            return newton, loaded
        more = difference(residual, load)
        self._laws_kept(self.laws[0], residual, newton)
        self._laws_kept(self.laws[1], more, loaded)
        loaded.axpy(-1.0, newton)
        return newton, loaded

    def take(self, change: float, share: float) -> None:
        """The reactions go a share of the way to those of Newton's step, with a change of the load factor."""
        if not self.laws:
            return
        for here, more in zip(self.laws[0].parts, self.laws[1].parts, strict=True):
            here.normal += change * (more.normal - here.normal)
            here.friction += change * (more.friction - here.friction)
        self.laws[0].reactions(share)

    def states(self) -> list[tuple[bytes, ...]]:
        """Which contacts are active on this rank."""
        return self.laws[0].states() if self.laws else []

    def _laws_kept(self, laws: Linearised, residual: PETSc.Vec, step: PETSc.Vec) -> None:
        """The step on which active contacts stay closed, for a residual (N) without reactions."""
        problem, at = self.problem, self.problem.point(self.y)

        def present(f: PETSc.Vec) -> None:
            residual.copy(f)
            f.array[:] -= problem.layout.collect(at.over_dofs(laws.force()))

        closed_step(problem, laws, self.solver, self.work.matrix, present, step, CORRECTIONS)


class Arc:
    """The equilibria of a problem whose supports and obstacles do not move, and on which nothing rubs; tolerance: of
    the residual (N)."""

    def __init__(self, problem: Problem, work: Workspace, tolerance: float):
        self.problem, self.work, self.tolerance = problem, work, tolerance
        self.weight = problem.mass()
        self.weight.array[problem.layout.axis == 3] = 0.0  # directors follow
        self.weight.scale(1.0 / (self.weight.sum() * problem.size() ** 2))
        self.psi = 0.0  # sizes that a unit of the load factor counts as

    def along(self, point: PathPoint, other: PathPoint) -> float:
        """How far another point is along the direction of one (sizes)."""
        ahead = self.product(point.direction, self.between(point, other))
        return ahead + self.psi**2 * point.slope * (other.factor - point.factor)

    def cosine(self, a: PathPoint, b: PathPoint) -> float:
        """Of the angle between two points' directions."""
        return self.product(a.direction, b.direction) + self.psi**2 * a.slope * b.slope

    def product(self, a: PETSc.Vec, b: PETSc.Vec) -> float:
        """Of two motions (sizes^2)."""
        weighed = a.duplicate()
        weighed.pointwiseMult(self.weight, b)
        return float(weighed.dot(a))

    def norm(self, a: PETSc.Vec) -> float:
        """Root mean square motion (sizes)."""
        return math.sqrt(self.product(a, a))

    def load(self, y: PETSc.Vec) -> PETSc.Vec:
        """The whole load at a shape (N)."""
        whole, f = self.problem.at(1.0), y.duplicate()
        f.array[:] = whole.layout.collect(whole.loads.forces(whole.point(y)))
        return f

    def unknowns(self, point: PathPoint) -> PETSc.Vec:
        """Those of a point, counted from the present origin."""
        return self.problem.unknowns_of(point.state)

    def back(self, point: PathPoint) -> PETSc.Vec:
        """The same, and contact remembers what it did there."""
        y = self.problem.create_vector()
        self.problem.restore(y, point.state)
        return y

    def between(self, a: PathPoint, b: PathPoint) -> PETSc.Vec:
        """The way from one point to another."""
        return difference(self.unknowns(b), self.unknowns(a))

    def start(self) -> PathPoint | None:
        """The equilibrium of the unloaded shell next to where it starts."""
        y = self.problem.create_vector()
        if self.problem.contact:
            self.problem.contact.begin(self.problem.positions(y), 0.0)
        point = self._correct(
            PathPoint(self.problem.save(y), 0.0, 0, 0.0, "", y), y.duplicate(), 0.0, None, 0.0, 0.0
        )
        if not (point and self.aim(point, self.problem.create_vector(), 1.0)):
            return None
        self.psi = 1.0 / point.slope
        self.aim(point, point.direction, point.slope)
        return point

    def softest(self, point: PathPoint, guess: PETSc.Vec) -> tuple[float, PETSc.Vec]:
        """The eigenvalue of the tangent nearest to zero (over the product), and its unit vector: inverse iteration."""
        linear = Linear(self.work, self.problem.at(point.factor), self.back(point), "exact").solver
        x, weighed, value = guess.copy(), guess.duplicate(), 0.0
        for _ in range(INVERSE):
            x.scale(1.0 / self.norm(x))
            weighed.pointwiseMult(self.weight, x)
            before = x.copy()
            linear.solve(weighed, x)
            value = 1.0 / self.product(before, x)
        x.scale(1.0 / self.norm(x))
        return value, x

    def along_load(self, point: PathPoint) -> float:
        """m: the displacement from the start along the whole load, its work over the sum of its forces."""
        whole = self.problem.at(1.0)
        at, own = whole.point(self.unknowns(point)), self.problem.own
        force = whole.loads.forces(at)[: len(at.u)].reshape(-1, 3)[own]
        moved = at.displacement.reshape(-1, 3)[own]
        sums = np.array([(force * moved).sum(), np.linalg.norm(force, axis=1).sum()])
        work, size = self.problem.comm.allreduce(sums)
        return float(work / size)

    def aim(self, point: PathPoint, before: PETSc.Vec, slope: float) -> bool:
        """Gives a point the direction of its path, on along the direction before. False where there is none."""
        problem, y = self.problem.at(point.factor), self.back(point)
        linear, residual = Linear(self.work, problem, y, "exact"), y.duplicate()
        if not linear.solver.usable:
            return False
        problem.residual(y, residual)
        _, b = linear.steps(residual, self.load(y))
        size = math.hypot(self.norm(b), self.psi)
        if not 0.0 < size < np.inf:
            return False
        sign = math.copysign(1.0, self.product(before, b) + (self.psi or 1.0) ** 2 * slope)
        b.scale(sign / size)
        point.direction, point.slope = b, sign / size
        point.negative = linear.solver.negative if problem.conservative else None
        point.touching = linear.states()
        return True

    def follow(self, point: PathPoint, length: float) -> PathPoint | None:
        """The equilibrium that lies so far along the path's direction, with its own; None where there is none."""
        there = self.advance(point, length, point.direction, point.slope)
        return there if there and self.aim(there, point.direction, point.slope) else None

    def rebound(self, before: PathPoint | None, point: PathPoint, length: float) -> PathPoint | None:
        """The equilibrium behind a touch that turns the path by more than a right angle: as the motion goes on, the
        load factor changes the other way. None where there is none, or where contacts are those before the point: then
        the path would go back."""
        there = self.advance(point, length, point.direction, -point.slope)
        if there is None or not self.aim(there, point.direction, -point.slope):
            return None
        back = before and self.problem.everywhere(before.touching == there.touching)
        return None if back else there

    def advance(self, point: PathPoint, length: float, v: PETSc.Vec, slope: float) -> PathPoint | None:
        """The equilibrium that lies so far along a direction; None where there is none."""
        way = v.copy()
        way.scale(length)
        return self._correct(point, way, point.factor + length * slope, v, slope, length)

    def reach(self, point: PathPoint, beyond: PathPoint, target: float) -> PathPoint | None:
        """The equilibrium at a load factor between those of two points."""
        way = self.between(point, beyond)
        way.scale((target - point.factor) / (beyond.factor - point.factor))
        return self._correct(point, way, target, None, 0.0, 0.0)

    def _correct(
        self, point: PathPoint, way: PETSc.Vec, t: float, v: PETSc.Vec | None, slope: float, length: float
    ) -> PathPoint | None:
        """Newton's method from a first step on: on the plane a length along (v, slope), or, without v, at the factor
        t."""
        problem, y, stall, kind, sharp = self.problem, self.back(point), Stall(), "mixed", False
        residual, linear = y.duplicate(), None
        if limit(problem.at(t), y, way) < 1.0:
            return None
        problem.predict(y, way)
        y.axpy(1.0, way)
        for it in range(1, ITERATIONS + 1):
            now = problem.at(t)
            norm = self._norm(now, y, residual)
            if not np.isfinite(norm):
                return None
            if self.work.monitor:
                self.work.monitor(t, it, norm)
            reason = "residual below tolerance" if norm <= self.tolerance else ""
            if not reason and stall.reached(now, y, norm):
                reason = to_round_off(now, y, norm, self.tolerance) if sharp else ""
                if not sharp:  # the rounding of large displacements may hide that it has converged
                    problem.move_origin(y)
                    stall, kind, sharp = Stall(), "exact", True
            if reason:
                return PathPoint(now.save(y), t, it, norm, reason, way)
            self.work.counts.iterations += 1
            linear = Linear(self.work, now, y, kind, linear)
            kind = "mixed"
            if not linear.solver.usable:
                return None
            now.residual(y, residual)
            a, b = linear.steps(residual, self.load(y))
            change = 0.0
            if v is not None:
                missing = length - self.psi**2 * slope * (t - point.factor)
                missing -= self.product(v, difference(y, self.unknowns(point))) + self.product(v, a)
                change = missing / (self.product(v, b) + self.psi**2 * slope)
                a.axpy(change, b)
            share = limit(now, y, a)
            linear.take(change, share)
            t += share * change
            problem.predict(y, a)
            y.axpy(1.0, a)
        return None

    def _norm(self, problem: Problem, y: PETSc.Vec, residual: PETSc.Vec) -> float:
        """Of the residual, with what the laws of contact miss (N)."""
        if problem.contact:
            return float(np.hypot(*law_norms(problem, y, residual, self.tolerance)))
        problem.residual(y, residual)
        return float(residual.norm())
