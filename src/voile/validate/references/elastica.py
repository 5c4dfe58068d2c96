"""Planar inextensible elasticas of strips of length 1 and bending stiffness 1, as boundary value problems."""

from dataclasses import dataclass

import numpy as np
from scipy.integrate import solve_bvp, solve_ivp
from scipy.optimize import brentq, root

from voile.arrays import Reals
from voile.errors import NotConverged


@dataclass(frozen=True)
class Elastica:
    """x along the clamp's direction, z down, at 2001 places along the strip."""

    x: Reals
    z: Reals

    @property
    def reach(self) -> float:
        return float(self.x[-1])

    @property
    def drop(self) -> float:
        return float(self.z[-1])


def cantilever(load: float, heavy: bool) -> Elastica:
    """Clamped level, bent down by its weight, load = rho g h L^3 / B, or by a tip force, load = P L^2 / (B b).

    theta'' = -load (1 - s, or 1 without weight) cos(theta), theta(0) = 0, theta'(1) = 0, x' = cos(theta),
    z' = sin(theta), by collocation."""
    layer = min(1.0, 3.0 / np.sqrt(load))  # heavy strips bend near the clamp
    places = np.concatenate([np.linspace(0.0, layer, 201), np.linspace(0.0, 1.0, 201)])
    s = np.unique(places.round(9))  # none nearer to each other than that

    def slope(s: Reals, y: Reals) -> Reals:
        arm = 1.0 - s if heavy else 1.0 + 0.0 * s
        return np.vstack([y[1], -load * arm * np.cos(y[0]), np.cos(y[0]), np.sin(y[0])])

    def ends(a: Reals, b: Reals) -> Reals:
        return np.array([a[0], b[1], a[2], a[3]])

    theta = np.pi / 2 * (1.0 - np.exp(-np.sqrt(load) * s)) * min(1.0, 0.2 * load)
    guess = np.vstack([theta, np.gradient(theta, s), s, 0.0 * s])
    found = solve_bvp(slope, ends, s, guess, tol=1e-9, max_nodes=200000)
    if not found.success:
        raise NotConverged(f"elastica at load {load:g}: {found.message}")
    y = found.sol(np.linspace(0.0, 1.0, 2001))
    return Elastica(y[2], y[3])


def slip_onset(friction: float) -> float:
    """Lowering over length at which the tip of a clamped upright strip, lowered on a plane, slips.

    The tip carries V and friction V, no moment: theta'' = V (friction cos theta - sin theta) along the strip from the
    tip, theta from the vertical, theta'(0) = 0; the clamp stands upright above the tip: theta(1) = 0, x(1) = x(0).
    Followed from the buckled column, tan k = k, where theta = friction (1 - cos(k s) / cos k). Beyond friction = 0.36
    the curve dips below the plane."""
    k = 4.493409457909064

    def end(unknowns: Reals, mu: float) -> Reals:
        v, tip = unknowns

        def slope(_: float, y: Reals) -> list[float]:
            return [y[1], v * (mu * np.cos(y[0]) - np.sin(y[0])), np.sin(y[0]), np.cos(y[0])]

        found: Reals = solve_ivp(slope, (0.0, 1.0), [tip, 0.0, 0.0, 0.0], "LSODA", rtol=1e-10, atol=1e-12).y[
            :, -1
        ]
        return found

    found, last = np.array([k * k, 1.0 - 1.0 / np.cos(k)]), 1.0
    for mu in np.linspace(0.0, friction, int(np.ceil(20.0 * friction)) + 2)[1:]:
        start = [found[0], found[1] * mu / last]
        found, last = root(lambda u, mu=mu: end(u, mu)[[0, 2]], start, tol=1e-12).x, mu
    return float(1.0 - end(found, friction)[3])


def catenary(span: float, x: Reals) -> Reals:
    """Depth below the ends of a chain of length 1 between ends `span` apart, at x from its middle."""
    a = brentq(lambda a: 2.0 * a * np.sinh(0.5 * span / a) - 1.0, 0.05, 10.0)
    found: Reals = a * (np.cosh(0.5 * span / a) - np.cosh(x / a))
    return found
