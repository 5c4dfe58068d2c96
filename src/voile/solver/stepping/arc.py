"""Equilibria along the arc of a path, through limit points and onto bifurcated branches.

Unknowns are the shape y and the load factor t. From an equilibrium with the unit direction v of the path (Riks 1979,
Keller 1977) the next one is the solution of R(y, t) = 0 on the plane <v, y - y_0> = s. The product is that of the
mass: s is the root mean square motion of the unknowns over the shell's size. Newton steps are those of `mixed_newton`:
the first goes along v with the exact tangent, the others have stresses extrapolated from the last iterate (Magisano,
Leonetti & Garcea 2017). Each factorisation serves two systems, for the residual and for the load.
"""

import math
from dataclasses import dataclass, field

import numpy as np
from petsc4py import PETSc

from voile.problem.problem import Problem
from voile.problem.state import State, difference
from voile.solver.methods.method import Workspace
from voile.solver.methods.steps import Stall, factor, limit, to_round_off

ITERATIONS = 15  # of a step at most
INVERSE = 8  # iterations, next to an eigenvalue of zero


@dataclass
class Place:
    """An equilibrium at a load factor; the unit direction of its path, by which the factor changes by `slope`;
    negative: eigenvalues of its tangent, None where the loads have no potential."""

    state: State
    factor: float
    iterations: int
    residual: float
    reason: str
    direction: PETSc.Vec = field(repr=False)
    slope: float = 0.0
    negative: int | None = None


class Arc:
    """The equilibria of a problem without contact whose supports do not move; tolerance: of the residual (N)."""

    def __init__(self, problem: Problem, work: Workspace, tolerance: float):
        self.problem, self.work, self.tolerance = problem, work, tolerance
        self.weight = problem.mass()
        self.weight.array[problem.layout.axis == 3] = 0.0  # directors follow
        self.weight.scale(1.0 / (self.weight.sum() * problem.size() ** 2))

    def product(self, a: PETSc.Vec, b: PETSc.Vec) -> float:
        """Of two directions (sizes^2)."""
        weighed = a.duplicate()
        weighed.pointwiseMult(self.weight, b)
        return weighed.dot(a)

    def norm(self, a: PETSc.Vec) -> float:
        """Root mean square motion (sizes)."""
        return math.sqrt(self.product(a, a))

    def load(self, y: PETSc.Vec) -> PETSc.Vec:
        """The whole load at a shape (N)."""
        whole, f = self.problem.at(1.0), y.duplicate()
        f.array[:] = whole.layout.collect(whole.loads.forces(whole.point(y)))
        return f

    def unknowns(self, place: Place) -> PETSc.Vec:
        """Those of a place, counted from the present origin."""
        return self.problem.unknowns_of(place.state)

    def between(self, a: Place, b: Place) -> PETSc.Vec:
        """The way from one place to another."""
        return difference(self.unknowns(b), self.unknowns(a))

    def start(self) -> Place | None:
        """The equilibrium of the unloaded shell next to where it starts."""
        y = self.problem.create_vector()
        place = self._correct(Place(self.problem.save(y), 0.0, 0, 0.0, "", y), y.duplicate(), 0.0, None, 0.0)
        return place if place and self.aim(place, None) else None

    def softest(self, place: Place, guess: PETSc.Vec) -> tuple[float, PETSc.Vec]:
        """The eigenvalue of the tangent nearest to zero (over the product), and its unit vector: inverse iteration."""
        linear = factor(self.work, self.problem.at(place.factor), self.unknowns(place), "exact")
        x, weighed, value = guess.copy(), guess.duplicate(), 0.0
        for _ in range(INVERSE):
            x.scale(1.0 / self.norm(x))
            weighed.pointwiseMult(self.weight, x)
            before = x.copy()
            linear.solve(weighed, x)
            value = 1.0 / self.product(before, x)
        x.scale(1.0 / self.norm(x))
        return value, x

    def along_load(self, place: Place) -> float:
        """m: the displacement from the start along the whole load, its work over the sum of its forces."""
        whole = self.problem.at(1.0)
        at, own = whole.point(self.unknowns(place)), self.problem.own
        force = whole.loads.forces(at)[: len(at.u)].reshape(-1, 3)[own]
        moved = at.displacement.reshape(-1, 3)[own]
        sums = np.array([(force * moved).sum(), np.linalg.norm(force, axis=1).sum()])
        work, size = self.problem.comm.allreduce(sums)
        return float(work / size)

    def aim(self, place: Place, along: PETSc.Vec | None) -> bool:
        """Gives a place the direction of its path, on along another one; upwards without. False where there is none."""
        problem, y = self.problem.at(place.factor), self.unknowns(place)
        linear, b = factor(self.work, problem, y, "exact"), y.duplicate()
        if not linear.usable:
            return False
        linear.solve(self.load(y), b)
        size = self.norm(b)
        if not 0.0 < size < np.inf:
            return False
        sign = -1.0 if along is not None and self.product(along, b) < 0.0 else 1.0
        b.scale(sign / size)
        place.direction, place.slope = b, sign / size
        place.negative = linear.negative if problem.conservative else None
        return True

    def advance(
        self, place: Place, length: float, direction: PETSc.Vec | None = None, slope: float | None = None
    ):
        """The equilibrium that lies so far along the path's direction, or along another; None where there is none."""
        v = place.direction if direction is None else direction
        way = v.copy()
        way.scale(length)
        return self._correct(
            place, way, place.factor + length * (place.slope if slope is None else slope), v, length
        )

    def reach(self, place: Place, beyond: Place, target: float) -> Place | None:
        """The equilibrium at a load factor between those of two places."""
        way = self.between(place, beyond)
        way.scale((target - place.factor) / (beyond.factor - place.factor))
        return self._correct(place, way, target, None, 0.0)

    def _correct(
        self, place: Place, way: PETSc.Vec, t: float, v: PETSc.Vec | None, length: float
    ) -> Place | None:
        """Newton's method from a first step on: on the plane a length along v, or, without one, at the factor t."""
        problem, y, stall, kind, sharp = self.problem, self.unknowns(place), Stall(), "mixed", False
        residual, a, b = (y.duplicate() for _ in range(3))
        if limit(problem.at(t), y, way) < 1.0:
            return None
        problem.predict(y, way)
        y.axpy(1.0, way)
        for it in range(1, ITERATIONS + 1):
            now = problem.at(t)
            now.residual(y, residual)
            norm = residual.norm()
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
                return Place(now.save(y), t, it, norm, reason, way)
            self.work.counts.iterations += 1
            linear = factor(self.work, now, y, kind)
            kind = "mixed"
            if not linear.usable:
                return None
            linear.solve(residual, a)
            a.scale(-1.0)
            if v is not None:
                linear.solve(self.load(y), b)
                change = length - self.product(v, difference(y, self.unknowns(place))) - self.product(v, a)
                change /= self.product(v, b)
                a.axpy(change, b)
            share = limit(now, y, a)
            t += share * change if v is not None else 0.0
            problem.predict(y, a)
            y.axpy(1.0, a)
        return None
