"""Parameters of fabric and friction from observed equilibria, with how well each is determined.

    min_p  1/2 sum over unknowns of all observations of |x(p) - x_o|^2,   p the logarithms of the parameters,

by Levenberg and Marquardt's method (Nocedal & Wright, section 10.3). Sensitivities dx/dp are -K^-1 dR/dp; where
contact, with its kinks and its way, or an unknown rest shape enters, central differences of simulations. With
independent noise of variance s^2 = 2 J / (N - k) in the N observed coordinates the estimate has the covariance
s^2 (S^T S)^-1 (Nocedal & Wright, section 10.1). Parameters that no observation tells apart, as E and rho, which only
enter by their ratio, are refused.

Where the rest shape is unknown, too, the first observation, taken as exact, gives it for any parameters (the direct
method), and the others give the parameters: a variable projection (Golub & Pereyra 1973).
"""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from petsc4py import PETSc

from voile.arrays import Reals
from voile.errors import InputError, NotConverged
from voile.inverse.observation import Observation, UnknownRest

MOST, SETTLED = 40, 1e-9  # iterations; change of the logarithms of the parameters that ends them
STUCK = 1e-4  # the same of a step that should decrease the misfit and does not
FARTHEST = np.log(4.0)  # change of a parameter in one iteration
DAMPING, HARDEST = 0.1, 1e8  # of steps, over the diagonal: the first, and where none is left to try
# Decrease of the misfit over the model's from which steps are damped less, and under which more.
TRUSTED, POOR = 0.75, 0.25
DOUBLINGS = 3  # of a first guess of friction under which nothing holds
NEARER = 0.9  # of the misfit: another branch
DIFFERENCE = 1e-3  # of the logarithms in central differences
# Least over largest singular value of sensitivities, from tangents and from differences, under which parameters cannot
# be told apart.
SAME = {True: 1e-6, False: 1e-4}
BLIND = 1e-9  # displacement over the size that a parameter's doubling makes, under which nothing tells it


@dataclass
class Estimate:
    """values and deviations (standard, absolute) by name in SI units; misfit: root mean square distance of an observed
    coordinate (m); states: the simulation of each observation; rest (n, 3) m: the rest shape where it was unknown;
    iterations: (misfit, values) of each."""

    values: dict[str, float]
    deviations: dict[str, float]
    misfit: float
    states: list[PETSc.Vec]
    rest: Reals | None
    iterations: list[tuple[float, dict[str, float]]] = field(default_factory=list)
    forward_solves: int = 0


Progress = Callable[[int, float, dict[str, float]], None]


class Estimation:
    """Estimates parameters that are the same all over the shell in all observations, from those of the first one."""

    def __init__(
        self,
        observations: list[Observation],
        names: tuple[str, ...],
        accuracy: float = 1e-10,
        unknown: UnknownRest | None = None,
    ):
        """accuracy of statics: residual over the loads' norm; unknown: one more observation of the same mesh, which
        gives the rest shape of all others. Raises InputError for parameters that differ from part to part."""
        self.observations, self.names, self.accuracy = observations, names, accuracy
        self.unknown = unknown
        self.rest: Reals | None = None
        self.history: list[
            tuple[float, dict[str, float]]
        ] = []  # misfit (m) and values of the iterations so far
        starts = [[o.value(name) for name in names] for o in observations]
        self.start = np.log(np.array(starts[0]))
        self.count = sum(o.count for o in observations)
        self.smooth = unknown is None and not any(o.obstacles for o in observations)

    def solve(self, on_step: Progress | None = None) -> Estimate:
        """The estimate. Raises NotConverged where it does not settle, InputError where the data cannot determine it."""
        p, history = self.start.copy(), self.history
        states = self._simulate(p)
        for _ in range(DOUBLINGS if "friction" in self.names else 0):
            if states is None:  # it may slide for want of friction
                p[self.names.index("friction")] += np.log(2.0)
                states = self._simulate(p)
        if states is None:
            raise NotConverged(f"estimation: with the first guess of the parameters: {self._reason()}")
        damping = DAMPING
        for iteration in range(MOST):
            misfit = self._misfit(states)
            history.append((float(np.sqrt(misfit / self.count)), self._values(p)))
            if on_step:
                on_step(iteration, *history[-1])
            gram, slope = self._normal_equations(p, states)
            moved, damping = self._advance(p, gram, slope, misfit, damping)
            whole = np.abs(np.linalg.solve(gram, slope)).max()
            done = moved is None or whole < SETTLED
            nearer = self._from_observed(*(moved or (p, states))) if done else None
            if nearer:
                p, states = nearer
                continue
            if moved is None and whole > STUCK:
                raise NotConverged(
                    f"estimation: no step along the descent direction decreases the misfit {history[-1][0]:.3e} m"
                )
            p, states = moved or (p, states)
            if done:
                return self._estimate(p, states)
        raise NotConverged(f"estimation: {MOST} iterations did not settle")

    def _values(self, p: Reals) -> dict[str, float]:
        return dict(zip(self.names, np.exp(p).tolist(), strict=True))

    def _simulate(self, p: Reals) -> list[PETSc.Vec] | None:
        """The equilibria with parameters exp(p); None where there is none, or no rest shape."""
        values, states = self._values(p), []
        if self.unknown:
            self.rest = self.unknown.find(values)
            if self.rest is None:
                return None
        for observation in self.observations:
            if self.rest is not None:
                observation.set_rest(self.rest)
            state = observation.simulate(self.accuracy) if observation.set(values) else None
            if state is None:
                return None
            states.append(state)
        return states

    def _reason(self) -> str:
        """Why there are no equilibria with the last parameters."""
        reasons = [o.reason for o in self.observations if o.reason]
        return (
            f"no equilibrium: {reasons[0]}" if reasons else "no stable rest shape for the first observation"
        )

    def _advance(
        self, p: Reals, gram: Reals, slope: Reals, misfit: float, damping: float
    ) -> tuple[tuple[Reals, list[PETSc.Vec]] | None, float]:
        """The first of ever more damped steps that decreases the misfit, and the damping of the next one."""
        while damping <= HARDEST:
            step = -np.linalg.solve(gram + damping * np.diag(np.diag(gram)), slope)
            step *= min(1.0, FARTHEST / max(float(np.abs(step).max()), 1e-300))
            there = self._simulate(p + step)
            if there is not None and (left := self._misfit(there)) < misfit:
                gain = (misfit - left) / max(float(-2.0 * slope @ step - step @ gram @ step), 1e-300)
                damping *= 0.1 if gain > TRUSTED else 10.0 if gain < POOR else 1.0
                return (p + step, there), damping
            damping *= 10.0
        self._simulate(p)
        return None, DAMPING

    def _from_observed(self, p: Reals, states: list[PETSc.Vec]) -> tuple[Reals, list[PETSc.Vec]] | None:
        """Equilibria that simulations from the observed shapes find much nearer to them: a poor first guess may have
        led to another branch, which those that go on from the last ones never leave."""
        if all(o.obstacles for o in self.observations):
            return None  # whose simulations all start anew
        if np.sqrt(self._misfit(states) / self.count) <= BLIND * self.observations[0].problem.size():
            return None
        last = [o.state for o in self.observations]
        for observation in self.observations:
            observation.state = observation.target.copy()
        there = self._simulate(p)
        if there is not None and self._misfit(there) < NEARER * self._misfit(states):
            return p, there
        for observation, state in zip(self.observations, last, strict=True):
            observation.state = state
        self._simulate(p)
        return None

    def _misfit(self, states: list[PETSc.Vec]) -> float:
        """Sum of squared distances from the observed shapes (m^2)."""
        own = sum(float(e @ e) for e in self._missed(states))
        return float(self.observations[0].problem.comm.allreduce(own))

    def _missed(self, states: list[PETSc.Vec]) -> list[Reals]:
        return [o.missed(y) for o, y in zip(self.observations, states, strict=True)]

    def _normal_equations(self, p: Reals, states: list[PETSc.Vec]) -> tuple[Reals, Reals]:
        """S^T S and S^T (x - x_o). Raises InputError where the data cannot determine the parameters."""
        s = self._by_tangents(p, states) if self.smooth else self._by_differences(p)
        add = self.observations[0].problem.comm.allreduce
        gram = add(sum(part.T @ part for part in s))
        self._check(gram, p)
        return gram, add(sum(part.T @ e for part, e in zip(s, self._missed(states), strict=True)))

    def _by_tangents(self, p: Reals, states: list[PETSc.Vec]) -> list[Reals]:
        return [o.slopes(y, self._values(p)) for o, y in zip(self.observations, states, strict=True)]

    def _by_differences(self, p: Reals) -> list[Reals]:
        """Of each observation (own unknowns, k). Raises NotConverged where a simulation beside p has no end."""
        columns = []
        for step in DIFFERENCE * np.eye(len(p)):
            beyond, before = self._simulate(p + step), self._simulate(p - step)
            if beyond is None or before is None:
                raise NotConverged(f"estimation: just beside {self._values(p)}: {self._reason()}")
            ends = zip(self._missed(beyond), self._missed(before), strict=True)
            columns.append([(b - a) / (2.0 * DIFFERENCE) for b, a in ends])
        return [np.stack(own, axis=1) for own in zip(*columns, strict=True)]

    def _check(self, gram: Reals, p: Reals) -> None:
        """Raises InputError, naming them, where parameters leave no or the same trace."""
        extent = max(o.problem.size() for o in self.observations)
        size = np.sqrt(np.diag(gram))
        blind = size <= BLIND * extent * np.sqrt(self.count)
        if blind.any():
            name = self.names[int(np.argmax(blind))]
            raise InputError(
                f"inverse.estimate: what was observed does not depend on {name} near {self._values(p)[name]:g}: it "
                "cannot be determined"
            )
        values, vectors = np.linalg.eigh(gram / np.outer(size, size))
        if values[0] <= SAME[self.smooth] ** 2 * values[-1]:
            mixed = [n for n, v in zip(self.names, vectors[:, 0], strict=True) if abs(v) > 0.1]
            raise InputError(
                f"inverse.estimate: what was observed cannot tell {' and '.join(mixed)} apart: only a combination of "
                "them enters; estimate one and give the others, or observe under other loads (inverse.also)"
            )

    def _estimate(self, p: Reals, states: list[PETSc.Vec]) -> Estimate:
        gram, _ = self._normal_equations(p, states)
        variance = self._misfit(states) / max(self.count - len(p), 1)
        deviation = np.sqrt(variance * np.diag(np.linalg.inv(gram))) * np.exp(p)
        again = self._simulate(p)  # contacts and rest shape as they are there
        assert again is not None
        return Estimate(
            values=self._values(p),
            deviations=dict(zip(self.names, deviation.tolist(), strict=True)),
            misfit=float(np.sqrt(self._misfit(states) / self.count)),
            states=again,
            rest=self.rest,
            iterations=self.history,
            forward_solves=sum(o.simulations for o in self.observations),
        )
