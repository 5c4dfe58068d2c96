"""A barrier over the lowest eigenvalues of a matrix, and the minimum of a model that has it."""

import math
from dataclasses import dataclass

import numpy as np

from voile.arrays import Reals

INSIDE = 0.02  # of the barrier's reach: where a start inside lies
EDGE = 1e-8  # nearer to the barrier, round-off tells on which side of it
STEPS = 100
DECREASE = 1e-10  # relative, of the last step
DAMPINGS, FIRST_DAMPING, LONGER = 25, 0.1, 1.25  # tried for a length; the first; over it, that is enough


def barrier(t: Reals) -> tuple[Reals, Reals, Reals]:
    """phi(t) = -(1 - t)^2 log t (Li et al. 2020), zero for t > 1 and infinite for t <= 0, with two derivatives."""
    if not (t > 0.0).all():
        infinite: Reals = np.full_like(t, math.inf)
        return infinite, infinite, infinite
    t = np.minimum(t, 1.0)
    u: Reals = 1.0 - t
    log: Reals = np.log(t)
    second = np.asarray(-2.0 * log + 4.0 * u / t + u**2 / t**2, dtype=float)
    return -(u**2) * log, 2.0 * u * log - u**2 / t, second


@dataclass
class Model:
    """pull c + (c form c + damping |c|^2)/2 + mu sum_i phi(eig_i(matrix + sum_p c_p slopes_p - sink |c|^2)), of
    coordinates c (p,).

    matrix (k, k) and slopes (p, k, k): symmetric, in units of the barrier's reach; form (p, p): 1 where it is not
    given; sink: what modes lose to those that the matrix does not know, by the square of the move.
    """

    matrix: Reals
    slopes: Reals
    pull: Reals
    mu: float
    form: Reals | None = None
    sink: float = 0.0

    def distance(self, c: Reals) -> float:
        """Its part without the barrier, undamped."""
        bent = c if self.form is None else self.form @ c
        return float(self.pull @ c + 0.5 * (c @ bent))

    def at(self, c: Reals) -> Reals:
        """The matrix at c."""
        turned = c @ self.slopes.reshape(len(c), self.matrix.size)
        found: Reals = self.matrix + turned.reshape(self.matrix.shape)
        np.einsum("ii->i", found)[:] -= self.sink * float(c @ c)
        return found

    def slopes_at(self, c: Reals) -> Reals:
        """Its derivatives there."""
        if not self.sink:
            return self.slopes
        return self.slopes - 2.0 * self.sink * c[:, None, None] * np.eye(len(self.matrix))

    def value(self, c: Reals, damping: float = 0.0) -> float:
        t = np.linalg.eigvalsh(self.at(c))
        if t[0] <= EDGE:
            return math.inf
        return self.distance(c) + 0.5 * damping * float(c @ c) + self.mu * float(barrier(t)[0].sum())

    def lowest(self, c: Reals) -> float:
        """The lowest eigenvalue at c."""
        return float(np.linalg.eigvalsh(self.at(c))[0])

    def within(self, radius: float) -> Reals | None:
        """Its minimiser, damped so that |c| is about the radius where it would be more; None where there is none."""
        c, damping = self._inside(), 0.0
        if c is None or np.linalg.norm(c) > LONGER * radius:
            return None
        low, high, best = 0.0, math.inf, None
        for _ in range(DAMPINGS):
            c = self.minimise(damping, c)
            assert c is not None
            size = float(np.linalg.norm(c))
            if size <= LONGER * radius:
                best, high = c, damping
                if not damping or size >= radius / LONGER:
                    break
            else:
                low = damping
            if high == math.inf:
                damping = 4.0 * max(damping, FIRST_DAMPING)
            else:
                damping = math.sqrt(max(low, FIRST_DAMPING / 4.0) * high)
        return best

    def minimise(self, damping: float, start: Reals | None = None) -> Reals | None:
        """Its minimiser, by Newton's method from a start inside; None where none is found."""
        c = self._inside() if start is None else start
        if c is None:
            return None
        value = self.value(c, damping)
        for _ in range(STEPS):
            gradient, hessian = self._derivatives(c, damping)
            # close to the barrier numerically singular
            try:
                step = -np.linalg.solve(hessian, gradient)
            except np.linalg.LinAlgError:
                step = -np.linalg.lstsq(hessian, gradient, rcond=None)[0]
            slope = float(gradient @ step)
            if not -slope > DECREASE * abs(value):
                break
            length = 1.0
            while not self.value(c + length * step, damping) <= value + 1e-4 * length * slope:
                length *= 0.5
                if length < 1e-10:  # round-off
                    return c
            c = c + length * step
            value = self.value(c, damping)
        return c

    def _derivatives(self, c: Reals, damping: float) -> tuple[Reals, Reals]:
        """Gradient and Hessian; the latter by divided differences (Lewis and Sendov 2001)."""
        t, v = np.linalg.eigh(self.at(c))
        _, first, second = barrier(t)
        turned = v.T @ self.slopes_at(c) @ v
        gap = t[:, None] - t[None, :]
        close = np.abs(gap) < 1e-9
        mean = 0.5 * (second[:, None] + second)
        divided = np.where(close, mean, (first[:, None] - first) / np.where(close, 1.0, gap))
        flat = turned.reshape(len(c), -1)
        form = damping * np.eye(len(c)) + (np.eye(len(c)) if self.form is None else self.form)
        gradient = self.pull + form @ c + self.mu * np.einsum("pii,i->p", turned, first)
        form = form - 2.0 * self.mu * self.sink * first.sum() * np.eye(len(c))
        return gradient, form + self.mu * (flat * divided.ravel()) @ flat.T

    def _inside(self) -> Reals | None:
        """The least move that lifts all eigenvalues clearly above zero, step by step."""
        c = np.zeros(len(self.pull))
        for _ in range(60):
            t, v = np.linalg.eigh(self.at(c))
            if t[0] > EDGE:
                return c
            low = t < INSIDE
            rise = np.einsum("ai,pab,bi->pi", v[:, low], self.slopes_at(c), v[:, low])
            if not rise.any():
                return None
            c = c + rise @ np.linalg.lstsq(rise.T @ rise, 2.0 * INSIDE - t[low], rcond=1e-10)[0]
        return None
