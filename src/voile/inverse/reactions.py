"""Reactions in Coulomb's cones that hold a shell as a whole, and the least friction with which there are any.

Internal forces have no resultant, so the reactions of a shell without supports balance its loads by themselves: one
equation per free rigid motion. Among the reactions that do, those nearest to carrying each vertex's own load,

    min sum_i |r_i + f_i|^2 / (2 w_i)   with   r_i in K_i,   Z^T (r + f) = 0,

w_i the size of the vertex's load, Z the free rigid motions, are r_i = P_Ki(w_i Z_i lambda - f_i) with lambda the least
of a convex function in as many unknowns as there are free motions, which has none where no reactions suffice. Then
lambda grows towards a motion that no reaction in the cones resists and the loads drive (Farkas' lemma): met, it proves
that there are none.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from voile.arrays import Flags, Reals

MOST = 300  # Newton iterations
# Damping over the mean of the first Hessian's diagonal, the least; its factor after a step that fails.
SOFTEST, HARDER = 1e-10, 10.0
SHORTEST = 1e-14  # of lambda: no step
HIDDEN = 1e-12  # relative, of the function: where round-off hides its fall the gradient has to
FAR = 1e7  # |lambda| beyond which the reactions cannot balance the loads
BALANCED = 1e-13  # resultant over the loads
BISECTIONS = 40


@dataclass
class Cones:
    """Contacts of one rank: unit normal (c, 3) and friction (c,) of each."""

    normal: Reals
    friction: Reals

    def scaled(self, friction: Reals | float) -> "Cones":
        """The same contacts with another friction."""
        return replace(self, friction=np.broadcast_to(friction, self.friction.shape))

    def project(self, v: Reals) -> tuple[Reals, Reals]:
        """Projection (c, 3) of v (c, 3) on the cones |r_T| <= mu r_N, and its derivative (c, 3, 3)."""
        n, mu = self.normal, self.friction
        vn = np.einsum("ci,ci->c", n, v)
        vt = v - vn[:, None] * n
        size = np.linalg.norm(vt, axis=1)
        along = vt / np.maximum(size, 1e-300)[:, None]
        inside, polar = size <= mu * vn, mu * size <= -vn
        length = (vn + mu * size) / (1.0 + mu**2)
        edge = n + mu[:, None] * along
        across = np.cross(n, along)
        on_edge = edge[:, :, None] * edge[:, None, :] / (1.0 + mu**2)[:, None, None]
        turning = mu * length / np.maximum(size, 1e-300)
        on_edge += turning[:, None, None] * across[:, :, None] * across[:, None, :]
        r = np.where(inside[:, None], v, np.where(polar[:, None], 0.0, length[:, None] * edge))
        slope = np.where(inside[:, None, None], np.eye(3), np.where(polar[:, None, None], 0.0, on_edge))
        return r, slope


@dataclass
class Balance:
    """The loads to be held: weight (c,) > 0 and load (c, 3) N that each contact should carry, modes (c, 3, k) the free
    rigid motions there (their jump between layers), resultant (k,) N of all loads in them, scale (N) of the loads; own
    (c,) marks what this rank counts, add sums an array over ranks."""

    weight: Reals
    load: Reals
    modes: Reals
    resultant: Reals
    scale: float
    own: Flags
    add: Callable[[Reals], Reals]

    def solve(self, cones: Cones) -> Reals | None:
        """(c, 3) reactions (N), or None where no reactions in the cones balance the loads."""
        k = len(self.resultant)
        if not self.scale:
            return np.zeros_like(self.load)
        factor, damping = np.zeros(k), 0.0
        value, gradient, hessian, r = self._dual(cones, factor)
        least = SOFTEST * np.trace(hessian) / max(k, 1) + 1e-14 * self.scale
        for _ in range(MOST):
            if np.linalg.norm(gradient) <= BALANCED * self.scale:
                return r
            step = -np.linalg.solve(hessian + max(damping, least) * np.eye(k), gradient)
            trial = self._dual(cones, factor + step)
            falls = trial[0] <= value + 1e-4 * float(gradient @ step)
            same = trial[0] <= value + HIDDEN * abs(value)
            if not (falls or (same and np.linalg.norm(trial[1]) < np.linalg.norm(gradient))):
                damping = HARDER * max(damping, least)
                if np.linalg.norm(step) <= SHORTEST * np.linalg.norm(factor):
                    return r if np.linalg.norm(gradient) <= 1e3 * BALANCED * self.scale else None
                continue
            damping /= HARDER
            factor = factor + step
            value, gradient, hessian, r = trial
            if np.linalg.norm(factor) > FAR or self._escapes(cones, factor):
                return None
        return None

    def _escapes(self, cones: Cones, motion: Reals) -> bool:
        """Whether no reaction in the cones resists a rigid motion (k,) that the loads drive."""
        largest = float(np.linalg.norm(self.resultant) * np.linalg.norm(motion))
        driven = float(self.resultant @ motion) < -HIDDEN * largest
        resisted = cones.project(self.modes @ motion)[0].any(axis=1) & self.own
        return driven and not bool(self.add(np.array([float(resisted.any())]))[0])

    def _dual(self, cones: Cones, factor: Reals) -> tuple[float, Reals, Reals, Reals]:
        """The convex function of lambda, its gradient (k,), Hessian (k, k), and the reactions."""
        trial = self.weight[:, None] * (self.modes @ factor) - self.load
        r, slope = cones.project(trial)
        own = self.own
        value = np.sum((r**2).sum(axis=1)[own] / (2.0 * self.weight[own]))
        counted = self.modes * own[:, None, None]
        rows = counted.reshape(r.size, len(factor))
        gradient = r.ravel() @ rows
        hessian = rows.T @ ((slope * self.weight[:, None, None]) @ self.modes).reshape(rows.shape)
        total = self.add(np.concatenate([[value], gradient, hessian.ravel()]))
        k = len(factor)
        return (
            float(total[0] + self.resultant @ factor),
            total[1 : k + 1] + self.resultant,
            total[k + 1 :].reshape(k, k),
            r,
        )


def least_friction(balance: Balance, cones: Cones, most: float = 100.0) -> float | None:
    """The least friction, the same everywhere, with which some reactions balance the loads; None beyond `most`."""
    if balance.solve(cones.scaled(0.0)) is not None:
        return 0.0
    if balance.solve(cones.scaled(most)) is None:
        return None
    low, high = 1e-6, most
    for _ in range(BISECTIONS):
        middle = float(np.sqrt(low * high))
        low, high = (low, middle) if balance.solve(cones.scaled(middle)) is not None else (middle, high)
        if high < 1.0005 * low:
            break
    return high
