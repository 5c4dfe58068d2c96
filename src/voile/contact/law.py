"""Signorini's and Coulomb's laws of discrete contacts, in frames (normal, tangent 1, tangent 2).

u = W r + q, with reactions r in the cones |r_T| <= mu r_N, u_hat = u + mu |u_T| e_N in their duals, and u_hat . r = 0
(De Saxce & Feng 1998).
"""

from typing import Any

import numpy as np
import scipy.sparse as sp

from voile import _friction
from voile.arrays import Ints, Reals
from voile.errors import InputError

OPEN, STICK, SLIP = 0, 1, 2
SMALL = 1e-6


def check_problem(W: Any, q: Any, mu: Any) -> tuple[sp.csr_matrix, Reals, Reals]:
    """W (3c, 3c) as CSR, q (3c,) and mu (c,) as arrays of doubles; InputError where they are none of a problem."""
    q, mu = vector("q", q), vector("mu", mu)
    c = len(mu)
    if len(q) != 3 * c:
        raise InputError(
            f"q has {len(q)} entries, mu {c}: q needs 3 per contact (normal, tangent 1, tangent 2)"
        )
    if (mu < 0.0).any():
        raise InputError(f"mu is {mu.min():g} at contact {int(mu.argmin())}; friction must not be negative")
    if not sp.issparse(W) and np.ndim(W) != 2:
        raise InputError("W must be a matrix, sparse or dense")
    if W.shape != (3 * c, 3 * c):
        raise InputError(f"W is {W.shape[0]} by {W.shape[1]}; {c} contacts need {3 * c} by {3 * c}")
    matrix = sp.csr_matrix(W, dtype=float)
    if not np.isfinite(matrix.data).all():
        raise InputError("W has entries that are not finite")
    return matrix, q, mu


def vector(name: str, values: Any) -> Reals:
    """One-dimensional finite array of doubles; InputError names what it is not."""
    try:
        array = np.ascontiguousarray(values, dtype=float)
    except (TypeError, ValueError) as error:
        raise InputError(f"{name} must be an array of numbers") from error
    if array.ndim != 1:
        raise InputError(f"{name} must have one dimension, not {array.ndim}")
    if not np.isfinite(array).all():
        raise InputError(f"{name}[{int(np.flatnonzero(~np.isfinite(array))[0])}] is not finite")
    return array


def project_on_cone(s: Reals, mu: Reals) -> Reals:
    """(c, 3) Euclidean projection of the rows of s on the cones |s_T| <= mu s_N, mu (c,)."""
    normal, size = s[:, 0], np.hypot(s[:, 1], s[:, 2])
    foot = (normal + mu * size) / (1.0 + mu * mu)  # normal part of the foot on the cone's surface
    turn = mu * foot / np.where(size > 0.0, size, 1.0)
    surface = np.column_stack([foot, turn[:, None] * s[:, 1:]])
    outside = np.where((mu * size <= -normal)[:, None], 0.0, surface)
    return np.where((size <= mu * normal)[:, None], s, outside)


def natural_map(r: Reals, u: Reals, mu: Reals, rho: float) -> tuple[Reals, Reals, Reals, Ints]:
    """The laws as F(r, u) = 0 in the form of Alart & Curnier 1991: F (c, 3), its generalised derivatives A = dF/dr and
    B = dF/du (c, 3, 3), and states (c,): OPEN, STICK or SLIP.

    r, u (c, 3), mu (c,); rho: force per velocity, about the inverse of W's diagonal.
    """
    r, u, mu = (np.ascontiguousarray(a, dtype=float) for a in (r, u, mu))
    c = len(mu)
    F, A, B = np.empty((c, 3)), np.empty((c, 3, 3)), np.empty((c, 3, 3))
    state = np.empty(c, np.int8)
    _friction.natural_map(r, u, mu, rho, F, A, B, state)
    return F, A, B, state


def friction_error(W: Any, q: Any, mu: Any, r: Any) -> float:
    """|r - P(r - u_hat)| / max(|q|, |r|, |u|), P the projection on the cones (undivided where that is round-off).

    The measure of Siconos (Acary et al., fc3d_compute_error). InputError on shapes that do not fit or entries that
    are not finite.
    """
    W, q, mu = check_problem(W, q, mu)
    r = vector("r", r)
    if r.shape != q.shape:
        raise InputError(f"r has {len(r)} entries, q {len(q)}")
    u = W @ r + q
    rows, u_hat = r.reshape(-1, 3), u.reshape(-1, 3).copy()
    u_hat[:, 0] += mu * np.hypot(u_hat[:, 1], u_hat[:, 2])
    miss = float(np.linalg.norm(rows - project_on_cone(rows - u_hat, mu)))
    size = max(float(np.linalg.norm(a)) for a in (q, r, u))
    return miss / size if size > np.finfo(float).eps else miss


def contact_states(W: Any, q: Any, mu: Any, r: Reals) -> Ints:
    """(c,) OPEN (no reaction), STICK (no tangential velocity) or SLIP of a solution r; SMALL relative to the largest
    reaction and to the largest velocity without reactions counts as none."""
    W, q, mu = check_problem(W, q, mu)
    u = (W @ r + q).reshape(-1, 3)
    normal = r.reshape(-1, 3)[:, 0]
    open_ = normal <= SMALL * np.abs(r).max(initial=0.0)
    slip = np.hypot(u[:, 1], u[:, 2]) > SMALL * np.abs(q).max(initial=0.0)
    return np.where(open_, OPEN, np.where(slip, SLIP, STICK))
