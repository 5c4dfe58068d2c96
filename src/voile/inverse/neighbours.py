"""Equilibria beside a target: shapes displaced from it, their rest shapes, softest modes, and how these change.

A neighbour has a displacement s of the shape and a rest shape z with R(s, z) = 0; from one to the next go `Moves`.
"""

import math
from dataclasses import dataclass, field

import numpy as np
from petsc4py import PETSc

from voile.arrays import Flags, Reals
from voile.inverse.direct import Direct
from voile.inverse.modes import Modes
from voile.inverse.moves import Move, Moves, Slopes
from voile.problem.scales import slow_rate
from voile.problem.triangles import gather_triangles, spread_triangles
from voile.solver.anderson import Anderson
from voile.solver.linear import unsymmetric

CUT = 20.0  # slow rates above the margin under which modes are known
# Times that, where a way ends: a T-shirt's did at a mode of 600/s^2 that sank by 100 in a millionth of the size. It
# went on to the full load with that one known.
HIGHER = 4.0
ALONG = 1e-5  # sizes of the shell: differences along modes, whose error must not tell equal modes apart
EXACT = 1e-10  # residual over the loads' norm, of an answer
CHORDS, RENEWALS = 20, 6  # iterations; factors
CONTRACTS = 0.3  # of the residual that one of them leaves at most
DEPTH = 5  # of them that Anderson's method looks back on
RESTORATIONS = 15  # moves
WORST = 100.0  # growth of the residual in one of them


@dataclass
class Checkpoint:
    """A stable equilibrium: displacement s of the shape from the target, its rest shape z, the fraction of the load,
    the margin (1/s^2), the lowest eigenvalues (1/s^2) and their modes of unit mass."""

    s: PETSc.Vec
    z: PETSc.Vec
    fraction: float
    margin: float
    values: Reals = field(default_factory=lambda: np.zeros(0))
    modes: list[PETSc.Vec] = field(default_factory=list)

    def beside(self, move: Move, load: float, margin: float) -> "Checkpoint":
        """Another point, not yet in equilibrium."""
        return Checkpoint(self.s + move.s, self.z + move.z, self.fraction + load, self.margin + margin)


class Neighbours:
    """Equilibria beside a target on which the direct method has stopped."""

    def __init__(self, direct: Direct, held: Flags):
        """held: (n,) local vertices that stay where they are in the target."""
        self.direct, self.target, self.problem = direct, direct.target, direct.problem
        target, problem = self.target, self.problem
        target.rest.set(problem.create_vector())
        self.slow = slow_rate(problem)
        self.cut = CUT * self.slow
        self.moves = Moves(direct, held)
        self.modes = Modes(problem, self.moves.mass, target.counts)
        self.renewed = unsymmetric(problem.comm, "nearest_", target.counts)

    # ---- equilibria ----

    def go_to(self, point: Checkpoint) -> PETSc.Vec:
        """The problem at a point; its state."""
        point.s.copy(self.direct.moved)
        self.target.load(point.fraction)
        self.target.rest.set(point.z)
        self.target.hold(point.z)
        return self.direct.state(point.z)

    def linearise(self, point: Checkpoint) -> bool:
        """Takes the manifold's tangent at a point; False where it cannot be factored."""
        y = self.go_to(point)
        self.direct.linearise(y)
        return self.moves.linearise(self.target.stiffness(y), self.direct.matrix)

    def settle(self, point: Checkpoint) -> bool:
        """Brings a point near the one linearised to equilibrium, at its shape or else with the least move, and finds
        its modes; whether there is one."""
        start = point.z.copy()
        if not self._balance(point, self.direct.tolerance):
            start.copy(point.z)
            if not self._restore(point):
                return False
        return self._find_modes(point)

    def polish(self, point: Checkpoint) -> None:
        """Brings the residual of a point in equilibrium down to round-off, or as near as Newton's method does."""
        kept = point.z.copy()
        if not (self.linearise(point) and self._balance(point, EXACT)):
            kept.copy(point.z)

    def _tolerance(self, y: PETSc.Vec, over_loads: float) -> float:
        """N."""
        return max(over_loads * self.target.load_norm(y), self.direct.floor())

    def _balance(self, point: Checkpoint, tolerance: float) -> bool:
        """Equilibrium at the point's shape to a tolerance over the loads' norm, by chord steps that Anderson's method
        speeds up, with a new factor only where these contract the residual too little."""
        solver, f, step = self.moves.solver, self.problem.create_vector(), self.problem.create_vector()
        chords, ahead = Anderson(self.problem.comm, len(f.array_r), DEPTH), step.array_r.copy()
        norm, least, anew, kept, poor = math.inf, math.inf, 0, point.z.copy(), 0
        for _ in range(CHORDS):
            y = self.go_to(point)
            self.target.residual(y, f)
            before, norm = norm, f.norm()
            if norm <= self._tolerance(y, tolerance):
                return not self.target.bounds.broken(self.target.rest)
            if not norm < WORST * least:
                return False
            poor = poor + 1 if norm > CONTRACTS * before else 0
            if poor > 1 or norm > before:
                poor = 0
                if solver is self.moves.solver and norm > least:  # a step of no use
                    kept.copy(point.z)
                    y = self.go_to(point)
                    self.target.residual(y, f)
                    norm = f.norm()
                anew += 1
                self.direct.linearise(y)
                solver = self.renewed
                chords.forget()
                if anew > RENEWALS or not solver.factor(self.direct.matrix):
                    return False
            if norm < least:
                least = norm
                point.z.copy(kept)
            solver.solve(f, step)
            step.scale(-1.0)
            chords.step(point.z.array_r, step.array_r, ahead)
            point.z.array[:] += ahead
        return False

    def _restore(self, point: Checkpoint) -> bool:
        """Equilibrium by least moves, with a new factorisation where the last one has left more than a half."""
        f, norm = self.problem.create_vector(), math.inf
        for _ in range(RESTORATIONS):
            y = self.go_to(point)
            if self.target.bounds.broken(self.target.rest):
                return False
            self.target.residual(y, f)
            before, norm = norm, f.norm()
            if norm <= self._tolerance(y, self.direct.tolerance):
                return True
            if not norm < WORST * before or (norm > CONTRACTS * before and not self.linearise(point)):
                return False
            f.scale(-1.0)
            step = self.moves.least_move(f)
            point.s.axpy(1.0, step.s)
            point.z.axpy(1.0, step.z)
        return False

    # ---- modes ----

    def _find_modes(self, point: Checkpoint) -> bool:
        """Eigenvalues less than a cut above the margin, and at least one; whether they were found."""
        values, modes, below = self.modes.find(
            self.target.stiffness(self.go_to(point)), point.margin, self.cut
        )
        if not len(values) or below > int((values < point.margin).sum()):
            return False
        if not below and len(values) == self.modes.most:
            self.cut = min(self.cut, max(values[-1] - point.margin, self.slow))
        kept = max(int((values < point.margin + self.cut).sum()), 1)
        point.values, point.modes = values[:kept], [self._vector(mode) for mode in modes.T[:kept]]
        return True

    def _vector(self, column: Reals) -> PETSc.Vec:
        vector = self.problem.create_vector()
        vector.array[:] = column
        return vector

    def tell_more(self, point: Checkpoint) -> bool:
        """Knows modes up to a higher cut from now on, those of a point in equilibrium, too; whether it has them."""
        self.cut *= HIGHER
        return self.linearise(point) and self._find_modes(point)

    def slopes(self, point: Checkpoint) -> Slopes:
        """Gradients of v_i^T K v_j, i <= j, by shape and rest shape: (v_i^T R_y v_j) by central differences along v_j.
        Masses, contact and the rest invariants' derivative do not change along it."""
        modes, problem, y = point.modes, self.problem, self.go_to(point)
        local, slopes = np.stack([spread_triangles(problem, mode) for mode in modes], axis=2), Slopes()
        kernel, right = problem.kernel, problem.kernel.rest_jacobian()[:, :, :18].transpose(0, 2, 1)
        there, out, directors = y.duplicate(), y.duplicate(), ~self.target.rest.is_vertex
        pulls = np.zeros((len(right), 21))
        for j, mode in enumerate(modes):
            step = ALONG * problem.size() / mode.norm(PETSc.NormType.INFINITY)
            along = [problem.create_vector() for _ in range(j + 1)]
            rates = np.zeros((len(right), right.shape[2], j + 1))
            for side in (step, -step):
                there.waxpy(side, mode, y)
                stiffness, shape = self.target.stiffness(there), problem.shape(there)
                left = kernel.invariants_jacobian(*shape)
                rate = np.matmul(left, local[:, :, : j + 1])
                for i, slope in enumerate(along):
                    stiffness.mult(modes[i], out)
                    slope.axpy(0.5 / side, out)
                    change = kernel.mixed_along(*shape, np.ascontiguousarray(rate[:, :, i]))
                    rates[:, :, i] += 0.5 / side * change
            turned = np.matmul(right, rates)
            for i, slope in enumerate(along):
                pulls[:, :18] = turned[:, :, i]
                pull = gather_triangles(problem, pulls)
                pull.array[directors] += slope.array_r[directors]  # the director angles are z's
                slope.array[~self.moves.free] = 0.0
                slopes[i, j] = Move(slope, pull)
        return slopes

    def load_slope(self, point: Checkpoint) -> PETSc.Vec:
        """The residual's derivative by the fraction of the load (N), in which it is linear."""
        y = self.go_to(point)
        less, more = y.duplicate(), y.duplicate()
        for side, f in ((-0.5, less), (0.5, more)):
            self.target.load(point.fraction + side)
            self.target.residual(y, f)
        self.target.load(point.fraction)
        return more - less
