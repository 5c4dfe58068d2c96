"""Material parameters from an observed equilibrium of a known rest shape, with how well each is determined.

    min_p  1/2 sum over unknowns of |x(p) - x_o|^2,   p the logarithms of the parameters,

by Gauss and Newton's method with the sensitivities dx/dp = -K^-1 dR/dp. With independent noise of variance
s^2 = 2 J / (N - k) in the N observed coordinates the estimate has the covariance s^2 (S^T S)^-1 (Nocedal & Wright,
section 10.1). Parameters that no observation tells apart, as E and rho, which only enter by their ratio, are refused.
"""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from petsc4py import PETSc

from voile.errors import InputError, NotConverged
from voile.problem.discrete import Problem
from voile.problem.rest import RestShape
from voile.solver.newton import use_cholesky
from voile.solver.path import StaticsOptions
from voile.solver.statics import solve_statics

NAMES = ("thickness", "young", "poisson", "density")  # as in Part.fabric
MOST, SETTLED = 40, 1e-9  # iterations; change of the logarithms of the parameters that ends them
FARTHEST = np.log(4.0)  # change of a parameter in one iteration
HALVINGS = 8
SAME = (
    1e-6  # least over largest singular value of the sensitivities under which parameters cannot be told apart
)
BLIND = 1e-9  # displacement over the size that a parameter's doubling makes, under which nothing tells it


@dataclass
class Estimate:
    """values and deviations (standard, absolute) by name in SI units; misfit: root mean square distance of an observed
    coordinate (m); iterations: (misfit, values) of each."""

    values: dict[str, float]
    deviations: dict[str, float]
    misfit: float
    state: PETSc.Vec
    iterations: list[tuple[float, dict[str, float]]] = field(default_factory=list)
    forward_solves: int = 0


Progress = Callable[[int, float, dict[str, float]], None]


class Estimation:
    """Estimates parameters that are the same all over the shell, from those the problem has."""

    def __init__(self, problem: Problem, names: tuple[str, ...], accuracy: float = 1e-10):
        """The problem's start shape is the observed one, its rest shape the known one. accuracy of statics: residual
        over the loads' norm. Raises InputError for a parameter that differs from triangle to triangle."""
        self.problem, self.names, self.accuracy = problem, names, accuracy
        self.rest = RestShape(problem, target=False)
        self.factor = PETSc.PC().create(comm=problem.comm)
        use_cholesky(self.factor)
        self.factor.setFromOptions()
        self.tangent = problem.create_matrix()
        self.forward_solves = 0
        self.seen = self.rest.is_vertex
        self.count = problem.comm.allreduce(int(self.seen.sum()))
        start = [self._uniform(name) for name in names]
        self.start = np.log(np.array(start))

    def _uniform(self, name: str) -> float:
        values = self.problem.part.fabric[NAMES.index(name)]
        ends = self.problem.comm.allreduce(
            [(float(values.min(initial=np.inf)), float(values.max(initial=-np.inf)))]
        )
        low, high = min(end[0] for end in ends), max(end[1] for end in ends)
        if low != high:
            raise InputError(
                f"inverse.estimate: {name} differs from part to part ({low:g} to {high:g}); allowed: one value"
            )
        return low

    def solve(self, on_step: Progress | None = None) -> Estimate:
        """The estimate. Raises NotConverged where it does not settle, InputError where the data cannot determine it."""
        p, y = self.start.copy(), self.problem.create_vector()
        found = self._simulate(p, y)
        if found is None:
            raise NotConverged("estimation: no equilibrium with the first guess of the parameters")
        y, history = found, []
        for iteration in range(MOST):
            misfit, sensitivity = self._misfit(y), self._sensitivities(y)
            values = dict(zip(self.names, np.exp(p).tolist(), strict=True))
            history.append((float(np.sqrt(misfit / self.count)), values))
            if on_step:
                on_step(iteration, *history[-1])
            gram, slope = self._normal_equations(sensitivity, y)
            self._check(gram)
            step = -np.linalg.solve(gram, slope)
            step *= min(1.0, FARTHEST / max(np.abs(step).max(), 1e-300))
            moved = self._advance(p, step, y, misfit)
            if moved is None or np.abs(moved[0] - p).max() < SETTLED:
                if moved is not None:
                    p, y = moved
                if moved is None and np.abs(step).max() > 1e-4:
                    raise NotConverged(
                        f"estimation: no step along the descent direction decreases the misfit {history[-1][0]:.3e} m"
                    )
                return self._estimate(p, y, history)
            p, y = moved
        raise NotConverged(f"estimation: {MOST} iterations did not settle")

    def _simulate(self, p: np.ndarray, start: PETSc.Vec) -> PETSc.Vec | None:
        """The equilibrium with parameters exp(p) from a start, None where there is none."""
        problem, fabric = self.problem, self.problem.part.fabric
        for name, value in zip(self.names, np.exp(p), strict=True):
            fabric[NAMES.index(name)] = value
        problem.kernel.set_fabric(*(np.ascontiguousarray(row) for row in fabric[:3]))
        problem.set_rest(problem.part.rest_points)  # the masses
        self.forward_solves += 1
        path = solve_statics(problem, StaticsOptions(load_steps=1, tolerance=self.accuracy), start=start)
        problem.unbase(path.state)
        return path.state.copy() if path.converged else None

    def _advance(self, p, step, y, misfit) -> tuple[np.ndarray, PETSc.Vec] | None:
        """The longest of the halved steps that decreases the misfit."""
        for halving in range(HALVINGS):
            trial = p + 0.5**halving * step
            there = self._simulate(trial, y)
            if there is not None and self._misfit(there) < misfit:
                return trial, there
        self._simulate(p, y)
        return None

    def _misfit(self, y: PETSc.Vec) -> float:
        """Sum of squared displacements from the observed shape (m^2)."""
        own = y.array_r[self.seen]
        return self.problem.comm.allreduce(float(own @ own))

    def _sensitivities(self, y: PETSc.Vec) -> np.ndarray:
        """(own unknowns, k) dx/dp of displacements; zero for director angles."""
        self.problem.tangent(y, self.tangent)
        self.factor.setOperators(self.tangent)
        self.factor.setUp()
        columns = []
        for name in self.names:
            slope = self.rest.fabric_derivative(y, name)
            moved = slope.duplicate()
            self.factor.apply(slope, moved)
            value = self._uniform(name)
            columns.append(np.where(self.seen, -value * moved.array_r, 0.0))
        return np.stack(columns, axis=1)

    def _normal_equations(self, s: np.ndarray, y: PETSc.Vec) -> tuple[np.ndarray, np.ndarray]:
        add = self.problem.comm.allreduce
        return add(s.T @ s), add(s.T @ np.where(self.seen, y.array_r, 0.0))

    def _check(self, gram: np.ndarray) -> None:
        """Raises InputError, naming them, where parameters leave no or the same trace."""
        size = np.sqrt(np.diag(gram))
        blind = size <= BLIND * self.problem.size() * np.sqrt(self.count)
        if blind.any():
            name = self.names[int(np.argmax(blind))]
            raise InputError(
                f"inverse.estimate: the observed shape does not depend on {name}: it cannot be determined"
            )
        values, vectors = np.linalg.eigh(gram / np.outer(size, size))
        if values[0] <= SAME**2 * values[-1]:
            mixed = [n for n, v in zip(self.names, vectors[:, 0], strict=True) if abs(v) > 0.1]
            raise InputError(
                f"inverse.estimate: the observed shape cannot tell {' and '.join(mixed)} apart: only a combination of "
                "them enters; estimate one and give the others"
            )

    def _estimate(self, p: np.ndarray, y: PETSc.Vec, history) -> Estimate:
        gram, _ = self._normal_equations(self._sensitivities(y), y)
        variance = self._misfit(y) / max(self.count - len(p), 1)
        deviation = np.sqrt(variance * np.diag(np.linalg.inv(gram))) * np.exp(p)
        return Estimate(
            values=dict(zip(self.names, np.exp(p).tolist(), strict=True)),
            deviations=dict(zip(self.names, deviation.tolist(), strict=True)),
            misfit=float(np.sqrt(self._misfit(y) / self.count)),
            state=y,
            iterations=history,
            forward_solves=self.forward_solves,
        )
