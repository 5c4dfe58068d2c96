"""Objectives as a function of the design alone: the equilibrium follows it, the adjoint equation its derivatives.

With K the tangent at the equilibrium y(z) and D = dR/dX the mixed derivative,

    dJ/dz = J_z - D^T K^-T J_y,      H dz = J_zz dz + D^T K^-T J_yy K^-1 D dz,

each gradient one transposed solve, each product with the Hessian (Gauss and Newton's) a tangent and an adjoint solve
with the same factor.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from petsc4py import PETSc

from voile.contact.history import History
from voile.errors import NotConverged
from voile.inverse.forward import Forward
from voile.inverse.objective import Design, Objective
from voile.inverse.target import Target
from voile.inverse.verify import sag
from voile.problem.rest import PanelRest
from voile.solver.linear import symmetric, unsymmetric
from voile.solver.path import Arrays
from voile.solver.stepping.restart import unpacked_history

UNREACHABLE = 1e10  # the objective where no equilibrium is found


@dataclass(eq=False)
class Iterate:
    """Design variables, the equilibrium that the search found for them, and its sag over the size."""

    rest: PETSc.Vec
    state: PETSc.Vec
    sag: float


class Reduced:
    """The sum of objectives as a function of the rest shape, its derivatives, and the Python context of its Hessian."""

    def __init__(
        self,
        target: Target,
        design: Design,
        objectives: Sequence[Objective],
        start: PETSc.Vec,
        accuracy: float = 1e-8,
    ):
        """start: state that the first simulation starts from; accuracy of statics: residual over the loads' norm."""
        target.load(1.0)
        problem = target.obstructed()
        self.target, self.problem, self.design = target, problem, design
        self.objectives = objectives
        self.tangent = problem.create_matrix()
        # By L L^T or L D L^T (its inertia tells a saddle) or, where something slips, by L U.
        self.symmetric = symmetric(problem.comm, PETSc.KSP.Type.PREONLY, 0.0, target.counts, "adjoint_")
        self.unsymmetric = unsymmetric(problem.comm, "adjoint_", target.counts)
        self.solver = self.symmetric
        self.forward, self.adjoint_solves = Forward(problem, accuracy, target.counts), 0
        self.start = start.copy()  # of every simulation: see `accept`
        self.began = problem.contact.history.copy() if problem.contact else None
        self.state = self.start.copy()  # the last equilibrium, of the rest shape `at`
        self.at: PETSc.Vec | None = None
        self.carried: History | None = None  # its contact's history
        self.slope = design.create()  # dJ/dz through it
        self.factored: PETSc.Vec | None = None  # the state that `solver` has factored
        self.best = math.inf  # objective of the last of the trail
        self.trail: list[Iterate] = []  # the best so far, one after the other
        self.shifted = 0.0  # multiple of the identity in the Hessian

    def go_on(self, trail: list[Iterate], found: Arrays) -> None:
        """Where a search was that had accepted the last of a trail, with what contact remembered there (packed)."""
        self.trail, self.state = trail[:-1], trail[-1].state.copy()  # the last is evaluated anew
        contact = self.problem.contact
        if contact:
            contact.history = unpacked_history(found, len(contact.partners))
        self.accept()

    # ---- the map from rest shape to equilibrium ----

    def simulate(self, z: PETSc.Vec) -> bool:
        """The equilibrium of rest shape z from `start`; False, with the last one, where there is none. Raises
        NotConverged where the first one is not found."""
        if self.at is not None and self.at.equal(z):
            return True
        contact = self.problem.contact
        try:
            self.state, self.slope = self._equilibrium(z)
        except NotConverged:
            if self.at is None:
                raise
            self._return(self.at)
            return False
        self.at, self.carried = z.copy(), contact.history.copy() if contact else None
        return True

    def _equilibrium(self, z: PETSc.Vec) -> tuple[PETSc.Vec, PETSc.Vec]:
        """That of rest shape z, and dJ/dz through it. Raises NotConverged where there is none."""
        first = self.at is None
        self.design.set(z)
        broken = self.target.bounds.broken(self.design)
        if broken:
            raise NotConverged(f"adjoint method: where it starts, {broken}")
        y, contact = self.start.copy(), self.problem.contact
        if contact and self.began:
            contact.history = self.began.copy()
        found = self.forward.solve(y) or (first and self.forward.search(self.start.copy(y)))
        if not (found and self._linearise(y)):
            raise NotConverged("adjoint method: the first simulation, from the target, did not converge")
        slope = self._pull(_sum(each.by_state(y, z) for each in self.objectives))
        if not math.isfinite(slope.norm()):
            raise NotConverged(
                "adjoint method: the first simulation, from the target, folds triangles to lines"
            )
        return y, slope

    def _return(self, z: PETSc.Vec) -> None:
        """Takes up the last equilibrium again, that of rest shape z, with its reactions and tangent."""
        self.design.set(z)
        if self.problem.contact and self.carried:
            self.problem.contact.history = self.carried.copy()
        if self.factored is not self.state:
            self._linearise(self.state)

    def accept(self) -> None:
        """Simulations start from the present equilibrium from now on; slip is still measured from the target. Those of
        panels start from the target, as a drape does: of two equilibria they show the one that it finds."""
        if isinstance(self.design, PanelRest):
            return
        self.start = self.state.copy()
        if self.problem.contact:
            self.began = self.problem.contact.history.copy()

    def _linearise(self, y: PETSc.Vec) -> bool:
        """Factors the tangent at the equilibrium y, which leaves a saddle first; False where there is none beside."""
        problem, self.factored = self.problem, None
        if problem.contact:  # whose solver has left saddles
            linear = problem.contact.linearise(problem.positions(y), problem.time)
            problem.tangent(y, self.tangent, "exact", linear.blocks())
            slips = not problem.everywhere(linear.symmetric)
        else:
            problem.tangent(y, self.tangent)
            slips = False
        self.solver = self.unsymmetric if slips else self.symmetric
        if not self._factors():
            if problem.contact or not self.forward.search(y):
                return False
            problem.tangent(y, self.tangent)
            if not self._factors():
                return False
        self.design.linearise(y)
        self.factored = y
        return True

    def _factors(self) -> bool:
        """Factors the tangent; False where that fails, or where without contact it has a negative eigenvalue."""
        usable = self.solver.factor(self.tangent)
        return usable and (self.problem.contact is not None or not self.solver.negative)

    # ---- what TAO asks ----

    def evaluate(self, z: PETSc.Vec, gradient: PETSc.Vec) -> float:
        """The objective and its gradient; UNREACHABLE, with the last equilibrium's gradient, where z has none."""
        found = self.simulate(z)
        value = sum(each.value(self.state, z) for each in self.objectives)
        self.slope.copy(gradient)
        for each in self.objectives:
            gradient.axpy(1.0, each.by_design(self.state, z))
        if found and value < self.best:
            self.best = value
            self.trail.append(Iterate(z.copy(), self.state.copy(), sag(self.target, self.state)))
        return value if found else UNREACHABLE

    def mult(self, _matrix: PETSc.Mat, v: PETSc.Vec, out: PETSc.Vec) -> None:
        """The Gauss-Newton Hessian times v; the identity on entries that are no design variables."""
        image = self.design.push(v)
        moved = image.duplicate()
        self.solver.solve(image, moved)
        moved.scale(-1.0)  # the equilibrium's change, -K^-1 D v
        self.adjoint_solves += 1
        self._pull(_sum(each.along_state(moved) for each in self.objectives)).copy(out)
        for each in self.objectives:
            out.axpy(1.0, each.along_design(v))
        idle = self.design.idle()
        out.array[idle] = v.array_r[idle]
        out.axpy(self.shifted, v)

    def shift(self, _matrix: PETSc.Mat, by: float) -> None:
        """Adds a multiple of the identity to the Hessian, until the next one."""
        self.shifted += by

    def _pull(self, v: PETSc.Vec) -> PETSc.Vec:
        """-D^T K^-T v."""
        adjoint = v.duplicate()
        self.solver.solve_transposed(v, adjoint)
        self.adjoint_solves += 1
        out = self.design.pull(adjoint)
        out.scale(-1.0)
        return out


def _sum(vectors: Iterable[PETSc.Vec]) -> PETSc.Vec:
    first, *others = vectors
    for other in others:
        first.axpy(1.0, other)
    return first
