"""Time schemes: what each makes of a step, as an inertia term and an update.

A step from t_n over h solves coefficient M (x - predicted) = F + r for the positions x at its end, r the contacts'
reactions; then v = rate (x - still) and a = coefficient (x - predicted). F is (1 - early) times the forces at the end
and `early` times those at the start; of the elastic force, twice `early` its mean over the way instead (see
problem.mean), which neither gains nor loses energy, or that in its middle, which keeps angular momentum, or none but
those at both ends, which strain nothing that turns. Where a contact bears or a support moves, velocities jump: there
every scheme moves as implicit Euler's, whose v = (x - x_n) / h is what the contact's law leaves.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from voile.arrays import Flags, Reals
from voile.problem.mean import Nodes, end_nodes, mean_nodes, middle_nodes

# What is kept without contact, with half of the forces early.
ENERGY, ANGULAR_MOMENTUM, NOTHING = "energy", "angular-momentum", "nothing"
KEEPING = {ENERGY: mean_nodes, ANGULAR_MOMENTUM: middle_nodes, NOTHING: end_nodes}


@dataclass(frozen=True)
class Kinematics:
    """Of the local vertices, (n, 3) each: positions (m), velocity (m/s), acceleration (m/s^2) by the forces of the last
    step; filtered: that of generalised-alpha; before: the step before."""

    positions: Reals
    velocity: Reals
    acceleration: Reals
    filtered: Reals
    before: "Before | None" = None


@dataclass(frozen=True)
class Before:
    """Positions (n, 3) m and velocity (n, 3) m/s one step (s) ago."""

    positions: Reals
    velocity: Reals
    step: float


@dataclass(frozen=True)
class Prediction:
    """coefficient (1/s^2) and predicted (n, 3) m of the inertia term; rate (1/s) and still (n, 3) m of the velocity;
    early: share of the forces at the step's start. Coefficient, rate and early: one, or (n, 3)."""

    coefficient: float | Reals
    predicted: Reals
    rate: float | Reals
    still: Reals
    early: float | Reals = 0.0

    def where(self, chosen: Flags, other: "Prediction") -> "Prediction":
        """The other one for the chosen (n, 3) components."""
        return Prediction(
            np.where(chosen, other.coefficient, self.coefficient),
            np.where(chosen, other.predicted, self.predicted),
            np.where(chosen, other.rate, self.rate),
            np.where(chosen, other.still, self.still),
            np.where(chosen, other.early, self.early),
        )

    def velocity(self, x: Reals) -> Reals:
        """(n, 3) m/s at the step's end, if that is at x."""
        return self.rate * (x - self.still)

    def flow(self, before: Reals) -> tuple[Reals, Reals]:
        """Rate and `still` (n, 3) of the mean velocity in the step, (1 - early) times that at its end and `early` times
        `before` (n, 3) m/s."""
        rate = np.broadcast_to((1.0 - np.asarray(self.early)) * self.rate, before.shape)
        end = (1.0 - np.asarray(self.early)) * self.rate * self.still
        return rate, (end - self.early * before) / rate

    def acceleration(self, x: Reals) -> Reals:
        """(n, 3) m/s^2."""
        return self.coefficient * (x - self.predicted)


class Scheme:
    """What a scheme makes of the step over h (s) from k."""

    @property
    def memory(self) -> bool:
        """Whether its first step needs the acceleration, or the director angles, at the start."""
        return False

    @property
    def order(self) -> int:
        """Of its error in the length of steps, without contact."""
        return 2

    @property
    def nodes(self) -> Nodes:
        """Where on a step's way the elastic force is taken, with weights."""
        return mean_nodes(2.0 * self.early)

    @property
    def early(self) -> float:
        """Share of the forces at a step's start; 0 to 1/2."""
        return 0.0

    def predict(self, k: Kinematics, h: float) -> Prediction:
        """The step's inertia."""
        raise NotImplementedError

    def update(self, k: Kinematics, h: float, p: Prediction, x: Reals) -> Kinematics:
        """After the step to positions x (n, 3)."""
        a = p.acceleration(x)
        return Kinematics(x, p.velocity(x), a, a, Before(k.positions, k.velocity, h))


@dataclass(frozen=True)
class ImplicitEuler(Scheme):
    """First order; dissipates."""

    @property
    def order(self) -> int:
        return 1

    def predict(self, k: Kinematics, h: float) -> Prediction:
        return Prediction(1.0 / h**2, k.positions + h * k.velocity, 1.0 / h, k.positions)


@dataclass(frozen=True)
class Bdf2(Scheme):
    """Second order, with steps of any lengths; the first one is implicit Euler's."""

    def predict(self, k: Kinematics, h: float) -> Prediction:
        if k.before is None:
            return ImplicitEuler().predict(k, h)
        w = h / k.before.step
        rate = (1.0 + 2.0 * w) / (h * (1.0 + w))
        now, then = (1.0 + w) ** 2 / (1.0 + 2.0 * w), -(w**2) / (1.0 + 2.0 * w)
        still = now * k.positions + then * k.before.positions
        steady = now * k.velocity + then * k.before.velocity
        return Prediction(rate**2, still + steady / rate, rate, still)


@dataclass(frozen=True)
class GeneralizedAlpha(Scheme):
    """Second order (Chung & Hulbert 1993), its forces means over the step; spectral_radius (0 to 1) of its highest
    frequencies. The filtered acceleration b obeys (1 - alpha_m) b + alpha_m b_n = a."""

    spectral_radius: float
    keeps: str = ENERGY

    @property
    def nodes(self) -> Nodes:
        return KEEPING[self.keeps](2.0 * self.early)

    @property
    def memory(self) -> bool:
        return True

    @property
    def early(self) -> float:
        return self.spectral_radius / (self.spectral_radius + 1.0)

    @property
    def _alphas(self) -> tuple[float, float, float]:
        """alpha_m, beta, gamma."""
        rho = self.spectral_radius
        m = (2.0 * rho - 1.0) / (rho + 1.0)
        gamma = 0.5 + self.early - m
        return m, 0.25 * (gamma + 0.5) ** 2, gamma

    def predict(self, k: Kinematics, h: float) -> Prediction:
        m, beta, gamma = self._alphas
        explicit = k.positions + h * k.velocity + h**2 * (0.5 - beta) * k.filtered
        shift = beta * h**2 * m / (1.0 - m) * k.filtered
        rate = gamma / (beta * h)
        steady = k.velocity + h * (1.0 - gamma) * k.filtered
        return Prediction(
            (1.0 - m) / (beta * h**2), explicit - shift, rate, explicit - steady / rate, self.early
        )

    def update(self, k: Kinematics, h: float, p: Prediction, x: Reals) -> Kinematics:
        m, _, _ = self._alphas
        filtered = (p.acceleration(x) - m * k.filtered) / (1.0 - m)
        return replace(super().update(k, h, p, x), filtered=filtered)


@dataclass(frozen=True)
class MoreauJean(Scheme):
    """M (v - v_n) = h F + impulses of contact, F = theta F_n+1 + (1 - theta) F_n or a mean over the step;
    x - x_n = h (theta v + (1 - theta) v_n) (Moreau 1988; Jean 1999). First order, second for theta = 1/2 without
    contact, where it keeps the energy."""

    theta: float
    keeps: str = ENERGY

    @property
    def nodes(self) -> Nodes:
        return KEEPING[self.keeps](2.0 * self.early)

    @property
    def order(self) -> int:
        return 1 if self.theta > 0.5 else 2

    @property
    def memory(self) -> bool:
        return self.theta < 1.0

    @property
    def early(self) -> float:
        return 1.0 - self.theta

    def predict(self, k: Kinematics, h: float) -> Prediction:
        theta = self.theta
        still = k.positions + h * (1.0 - theta) * k.velocity
        return Prediction(
            1.0 / (theta * h**2), k.positions + h * k.velocity, 1.0 / (h * theta), still, self.early
        )


@dataclass(frozen=True)
class SchemeOptions:
    """What schemes can be told: see their classes."""

    spectral_radius: float = 0.8
    theta: float = 1.0
    keeps: str = ENERGY


SCHEMES: dict[str, Callable[[SchemeOptions], Scheme]] = {
    "implicit-euler": lambda _: ImplicitEuler(),
    "bdf2": lambda _: Bdf2(),
    "generalized-alpha": lambda asked: GeneralizedAlpha(asked.spectral_radius, asked.keeps),
    "moreau-jean": lambda asked: MoreauJean(asked.theta, asked.keeps),
}
