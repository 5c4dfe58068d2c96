"""Inverse statics without forward solves: the rest shape for which the target itself is in equilibrium.

With the rest positions of held vertices at their target, the balance of forces at the target, R(x_t, phi; X) = 0, is
a square system for the rest positions X and the director angles phi: Newton's method along a continuation in the load
from X = x_t, where a shell without load is in equilibrium. Each step ends with the inertia of the tangent K(x_t; X) on
the unknowns that contact leaves free: where it is lost, no stable answer continues the branch.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from voile.errors import NotConverged
from voile.inverse.target import Target
from voile.problem.problem import Problem
from voile.problem.scales import force_floor
from voile.solver.linear import counting, factored, unsymmetric

MOST = 40  # Newton iterations of one step
SHARP = 1e-8  # residual over the loads' norm: enough where round-off may be larger
STAGNANT = 0.5  # of the norm: a smaller decrease where round-off may hide the rest is the last
IDLE = 10  # of them without a smaller residual
CYCLING = 2  # of them after which a step must lessen it
SHARES = 1.0, 0.5, 0.25, 0.125  # of a step, tried then
CHORD = 0.01  # of the norm that a step leaves at most, after which its factor serves again: Newton's would do no better
EASY = 5  # iterations after which the next step doubles
NARROWEST = 1.0 / 64.0  # step of the way home from an equilibrium beside the target
SMALLEST = 1e-3  # fraction of the load: the resolution of the critical one
WORST = 1e6  # times the loads: a residual from which Newton's method is not followed
ROUND_OFF = 4e-15  # relative, of the residual's evaluation
ENDED = "inverse.max_seconds ended the direct method"
FOLDED = 170.0  # degrees, between the normals of triangles, where tan(angle / 2) grows steeply


@dataclass
class DirectStep:
    """A converged step: load fraction, iterations, norm of the residual (N)."""

    fraction: float
    iterations: int
    residual: float


@dataclass
class DirectPath:
    """The outcome. `rest`: rest displacements and director angles of the last stable step, at load `fraction`;
    `reason` says what ended the path before the full load; `critical`: fraction at which stability is lost, and `mode`,
    there, the shape of the instability (unknowns, largest entry 1); lost: the rest shape there; step: the next, a
    fraction of the load."""

    rest: PETSc.Vec
    fraction: float = 0.0
    converged: bool = False
    reason: str = ""
    critical: float | None = None
    mode: PETSc.Vec | None = None
    lost: PETSc.Vec | None = None
    residual: float = math.nan
    iterations: int = 0
    step: float = 1.0
    steps: list[DirectStep] = field(default_factory=list)


Progress = Callable[[DirectStep], None]


class Direct:
    """Newton's method in the rest shape at a target."""

    def __init__(self, target: Target, tolerance: float = 1e-10, over: Callable[[], bool] = lambda: False):
        """tolerance: residual over the loads' norm; over: whether the time of its solutions is over. Collective."""
        self.target, self.rest = target, target.rest
        self.tolerance, self.over = tolerance, over
        self.moved = self.problem.create_vector()  # displacement of the shape to be held from the target
        self.matrix, self.tangent = self.problem.create_matrix(), target.tangent
        self.matrix.setOption(PETSc.Mat.Option.SYMMETRIC, False)
        self.matrix.setOption(PETSc.Mat.Option.KEEP_NONZERO_PATTERN, True)
        self.solver = unsymmetric(self.problem.comm, "inverse_", target.counts)
        self.inertia = counting(self.problem.comm, target.counts)

    @property
    def problem(self) -> Problem:
        """The target's, at its present load."""
        return self.target.problem

    def follow(
        self,
        on_step: Progress | None = None,
        guess: PETSc.Vec | None = None,
        smallest: float = SMALLEST,
        path: DirectPath | None = None,
        keep: Callable[[DirectPath], None] | None = None,
    ) -> DirectPath:
        """The branch from the target itself without load to the full load, or to where it ends. guess: rest
        displacements from which the full load is tried first; smallest: step, a fraction of the load; path: one that
        ended in larger steps, to go on with; keep: told of the path after each step."""
        z = self.problem.create_vector()
        if path is None:
            path = (guess and self.begin_with(guess, on_step)) or DirectPath(rest=z.copy())
        while path.fraction < 1.0 and path.step >= smallest and not self.over():
            fraction = min(1.0, path.fraction + path.step)
            path.rest.copy(z)
            reason, norm, iterations = self.solve(z, fraction)
            path.iterations += iterations
            if reason or not self.stable(z):
                path.step *= 0.5
                if not reason:
                    path.critical, path.lost = fraction, z.copy()
                path.reason = reason
                continue
            path.fraction, path.residual = fraction, norm
            z.copy(path.rest)
            path.steps.append(DirectStep(fraction, iterations, norm))
            if on_step:
                on_step(path.steps[-1])
            if path.critical is not None:
                path.step = min(path.step, 0.5 * (path.critical - fraction))
            elif iterations <= EASY:
                path.step *= 2.0
            if keep:
                keep(path)
        path.converged = path.fraction >= 1.0
        if not path.converged and self.over():
            path.reason = ENDED
        if path.critical is not None:
            path.reason = _lost(path.fraction, path.critical)
        if path.lost is not None and path.critical is not None:
            self._go_to(path.lost, path.critical)
            path.mode = self.target.softest_mode(path.lost)
        self._go_to(path.rest, path.fraction)
        return path

    def _go_to(self, z: PETSc.Vec, fraction: float) -> None:
        self.target.load(fraction)
        self.rest.set(z)
        self.target.hold(z)

    def home(self, state: PETSc.Vec, rest: PETSc.Vec, on_step: Progress | None = None) -> DirectPath | None:
        """The complete path, where the way from an equilibrium beside the target under the full load (unknowns and its
        rest shape) straight to the target is one of stable equilibria."""
        away, z, left, step = state.copy(), rest.copy(), 1.0, 1.0
        away.array[~self.rest.is_vertex] = 0.0
        while left and step >= NARROWEST:
            away.copy(self.moved)
            ahead, trial = max(left - step, 0.0), z.copy()
            self.moved.scale(ahead)
            if self.solve(trial, 1.0)[0] or not self.stable(trial):
                # What is too far at once mostly is so in parts, too: the least one tells it first.
                step = NARROWEST if step == 1.0 else 0.5 * step
                continue
            z, left, step = trial, ahead, 2.0 * step
        self.moved.set(0.0)
        return None if left else self.begin_with(z, on_step)

    def begin_with(self, guess: PETSc.Vec, on_step: Progress | None = None) -> DirectPath | None:
        """The complete path, where Newton's method from a guess ends stable under the full load."""
        z = guess.copy()
        self._relax(z)
        reason, norm, iterations = self.solve(z, 1.0)
        if reason or not self.stable(z):
            return None
        step = DirectStep(1.0, iterations, norm)
        if on_step:
            on_step(step)
        self._go_to(z, 1.0)
        return DirectPath(z, 1.0, True, residual=norm, iterations=iterations, steps=[step])

    def _relax(self, z: PETSc.Vec) -> None:
        """Brings z's director angles, which a guess of the rest shape does not have, to equilibrium between the target
        and that rest shape; as near as Newton's method does."""
        if not self.problem.directors:
            return
        self.target.load(1.0)
        problem, f, step = self.problem, self.problem.create_vector(), self.problem.create_vector()
        vertices = np.flatnonzero(self.rest.is_vertex) + problem.part.first_global
        before = math.inf
        for _ in range(MOST):
            y, _ = self._evaluate(z, f)
            f.array[self.rest.is_vertex] = 0.0
            if not f.norm() < before:
                return
            before = f.norm()
            problem.tangent(y, self.tangent)
            self.tangent.zeroRowsColumns(vertices.astype(np.int32), 1.0)
            solver = factored(self.tangent, self.target.counts, definite=True)
            solver.solve(f, step)
            solver.destroy()
            z.axpy(-1.0, step)

    def solve(self, z: PETSc.Vec, fraction: float) -> tuple[str, float, int]:
        """Newton's method at a fraction of the load from z, which ends at the solution: reason of a failure or empty,
        norm of the residual (N) and iterations."""
        self.target.load(fraction)
        problem, target = self.problem, self.target
        f, direction = problem.create_vector(), problem.create_vector()
        norm, best, worst, idle = math.inf, math.inf, 0.0, 0
        near, kept = math.inf, z.copy()  # least norm under round-off, and where
        # then that of this start: a failed way may have left the matrix of a wild state
        noise = force_floor(problem)
        for it in range(MOST + 1):
            before = norm
            y, norm = self._evaluate(z, f)
            if problem.monitor:
                problem.monitor(fraction, it, norm)
            broken = target.bounds.broken(self.rest)
            if broken:
                return broken, norm, it
            loads = target.load_norm(y)
            if norm <= max(self.tolerance * loads, min(noise, SHARP * loads)):
                return "", norm, it
            if near < math.inf and not norm < STAGNANT * near:
                break
            if self.over():
                return ENDED, norm, it
            if norm <= noise:
                near = norm
                z.copy(kept)
            if norm > worst:  # what comes back from a large residual is on its way
                best, worst, idle = norm, norm, 0
            idle = idle + 1 if norm >= best else 0
            if not norm < WORST * loads or idle > IDLE:
                break
            best = min(best, norm)
            anew = before == math.inf or not norm <= CHORD * before
            if not self._step(y, f, direction, anew):
                return "dR/dX is singular", norm, it
            if it == 0:
                noise = self.floor()
            z.axpy(-(1.0 if idle < CYCLING else self._shorter(z, direction, norm)), direction)
        if near < math.inf:
            kept.copy(z)
            self._evaluate(z, f)
            return "", near, it
        return f"the residual stays at {norm:.2e} N", norm, it

    def _evaluate(self, z: PETSc.Vec, f: PETSc.Vec) -> tuple[PETSc.Vec, float]:
        """The state and the norm of its residual (N), left in f, with the rest shape of z."""
        self.rest.set(z)
        y = self.state(z)
        self.target.hold(z)
        self.target.residual(y, f)
        return y, f.norm()

    def _shorter(self, z: PETSc.Vec, direction: PETSc.Vec, norm: float) -> float:
        """The share of a step, halved until it lessens the norm (N), that breaks a cycle of contacts; all of it where
        none does."""
        f, trial = z.duplicate(), z.duplicate()
        for length in SHARES:
            trial.waxpy(-length, direction, z)
            if self._evaluate(trial, f)[1] < norm:
                return length
        return 1.0

    def state(self, z: PETSc.Vec) -> PETSc.Vec:
        """The problem's unknowns at the shape to be held, with z's director angles."""
        return self.rest.state(z) + self.moved

    def _step(self, y: PETSc.Vec, f: PETSc.Vec, direction: PETSc.Vec, anew: bool = True) -> bool:
        """Newton's direction D^-1 f, with the last factor unless `anew`; False where D is singular."""
        self.target.counts.iterations += 1
        if anew:
            self.linearise(y)
            if not self.solver.factor(self.matrix):
                return False
        self.solver.solve(f, direction)
        return bool(np.isfinite(direction.norm()))

    def linearise(self, y: PETSc.Vec) -> None:
        """Writes the derivative of the residual by rest positions and director angles to `matrix`."""
        problem = self.problem
        self.target.jacobian(y, self.matrix)
        if problem.directors:
            problem.tangent(y, self.tangent)
            mask = problem.create_vector()
            mask.array[~self.rest.is_vertex] = 1.0
            self.tangent.diagonalScale(None, mask)
            self.matrix.axpy(1.0, self.tangent, PETSc.Mat.Structure.SAME_NONZERO_PATTERN)

    def check_round_off(self) -> None:
        """Raises NotConverged where the last places of the target's positions are worth more than the loads."""
        self.target.load(1.0)
        problem, target = self.problem, self.target
        y, _ = self._evaluate(problem.create_vector(), problem.create_vector())
        self.linearise(y)
        noise, loads = self.floor(), target.load_norm(y)
        if noise <= loads or loads == 0.0:
            return
        fold, where = self._sharpest_fold()
        hint = ""
        if "/tan/" in problem.model and fold > FOLDED:
            hint = (
                f'; the target is folded by {fold:.2f} degrees at triangle {where}, and shell.bending = "tan" grows '
                'without bound towards 180: "theta", "sin" and "average" do not'
            )
        raise NotConverged(
            f"the target cannot be resolved: round-off of its positions is worth {noise:.1e} N, its loads {loads:.1e} N"
            + hint
        )

    def _sharpest_fold(self) -> tuple[float, int]:
        """Largest angle (degrees) between normals of neighbouring triangles at the target, and one of the two."""
        pairs, opening = self.target.folds()
        found = (0.0, -1)
        if len(pairs):
            sharpest = int(opening.argmin())
            angle = 180.0 - float(np.degrees(opening[sharpest]))
            found = angle, int(self.problem.part.triangle[pairs[sharpest, 0]])
        values: tuple[float, int] = self.problem.comm.allreduce(found, op=MPI.MAX)
        return values

    def floor(self) -> float:
        """Round-off of the residual (N): of positions times the stiffness that was linearised last."""
        stiffness = self.matrix.norm(PETSc.NormType.INFINITY)
        return float(max(ROUND_OFF * stiffness * self.problem.size(), force_floor(self.problem)))

    def stable(self, z: PETSc.Vec) -> bool:
        """Whether the tangent at the target has no negative eigenvalue, on what contact leaves free."""
        return self.inertia.positive(self.target.stiffness(self.state(z)))


def _lost(fraction: float, critical: float) -> str:
    """Where stability is lost, and what keeps it: a shell of E / fraction under the full load is that of E under the
    fraction."""
    advice = (
        f"; {math.ceil(1e3 / fraction) / 1e3:g} times the Young's modulus would keep it" if fraction else ""
    )
    return f"stability is lost between {fraction:.4g} and {critical:.4g} of the load{advice}"
