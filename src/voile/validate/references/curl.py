"""A naturally curved rod that hangs from a clamp: its planar curl, and when that leaves its plane (Miller et al. 2014).

Kirchhoff's rod, inextensible, of length 1 and stiffness 1 against bending in its plane. hard, torsion: the stiffnesses
against bending out of the plane and twist; weight: w L^3 / B, w per length; natural: natural curvature times L.
"""

from collections.abc import Callable

import numpy as np
from scipy.integrate import solve_bvp
from scipy.linalg import eigvals_banded
from scipy.optimize import brentq
from scipy.sparse import coo_matrix

from voile.arrays import Flags, Reals
from voile.errors import NotConverged

ELEMENTS = 400  # critical curvatures to 3e-5
STEP, LARGEST = 0.5, 25.0  # of natural curvatures followed

Curl = Callable[[Reals], Reals]


def planar(weight: float, natural: float, start: Curl | None = None) -> Curl:
    """s (k,) from the clamp -> (2, k): angle from the vertical and curvature; start: such a curl nearby.

    theta'' = weight (1 - s) sin(theta), theta(0) = 0, theta'(1) = natural."""
    s = np.linspace(0.0, 1.0, 201)

    def slope(s: Reals, y: Reals) -> Reals:
        return np.vstack([y[1], weight * (1.0 - s) * np.sin(y[0])])

    def ends(a: Reals, b: Reals) -> Reals:
        return np.array([a[0], b[1] - natural])

    found = solve_bvp(slope, ends, s, start(s) if start else np.zeros((2, 201)), tol=1e-8, max_nodes=20000)
    if not found.success:
        raise NotConverged(f"planar curl of natural curvature {natural:g}: {found.message}")
    values: Curl = found.sol
    return values


def softest(angle: Reals, moment: Reals, pull: Reals, hard: float, torsion: float, held: Flags) -> float:
    """The smallest eigenvalue of the energy's second variation out of the plane; negative: the rod leaves it.

    The frame turns by psi about the direction in the plane across the tangent and by phi about the tangent. Twice the
    second variation is the integral of hard (psi' - phi kappa)^2 + torsion (phi' + psi kappa)^2
    - moment (kappa (psi^2 + phi^2) + psi phi' - phi psi') + pull (psi^2 cos(angle) - phi psi sin(angle)).

    angle (n + 1,): of the tangent from the vertical, at the ends of n equal elements in which psi and phi are linear;
    moment, pull (n,): bending moment, and force down the vertical; held (n + 1, 2): where psi, phi are zero."""
    n, step = len(moment), 1.0 / len(moment)
    kappa, middle = np.diff(angle)[:, None] / step, 0.5 * (angle[1:] + angle[:-1])
    # Values at the middle and slopes, from the unknowns (psi, phi) of both ends.
    psi, phi = np.array([[0.5, 0.0, 0.5, 0.0], [0.0, 0.5, 0.0, 0.5]])
    psi_s, phi_s = np.array([[-1.0, 0.0, 1.0, 0.0], [0.0, -1.0, 0.0, 1.0]]) / step

    def product(weight: Reals | float, a: Reals, b: Reals) -> Reals:
        a, b = np.broadcast_to(a, (n, 4)), np.broadcast_to(b, (n, 4))
        both = np.einsum("e,ei,ej->eij", np.broadcast_to(weight, n), a, b)
        found: Reals = 0.5 * (both + both.transpose(0, 2, 1))
        return found

    bend, twist = psi_s - kappa * phi, phi_s + kappa * psi
    parts = product(hard, bend, bend) + product(torsion, twist, twist)
    parts -= product(moment * kappa[:, 0], psi, psi) + product(moment * kappa[:, 0], phi, phi)
    parts -= product(moment, psi, phi_s) - product(moment, phi, psi_s)
    parts += product(pull * np.cos(middle), psi, psi) - product(pull * np.sin(middle), phi, psi)
    at = 2 * np.arange(n)[:, None] + np.arange(4)
    rows, columns = np.broadcast_arrays(at[:, :, None], at[:, None, :])
    matrix = coo_matrix((step * parts.ravel(), (rows.ravel(), columns.ravel()))).tocsr()
    free = np.flatnonzero(~held.ravel())
    matrix = matrix[free][:, free]
    bands = np.zeros((4, len(free)))
    for k in range(4):
        bands[k, : len(free) - k] = matrix.diagonal(-k)
    return float(eigvals_banded(bands, lower=True, select="i", select_range=(0, 0))[0] / step)


def stiffness(curl: Curl, weight: float, natural: float, hard: float, torsion: float) -> float:
    """The smallest eigenvalue of a planar curl."""
    s = np.linspace(0.0, 1.0, ELEMENTS + 1)
    middle = 0.5 * (s[1:] + s[:-1])
    held = np.zeros((ELEMENTS + 1, 2), bool)
    held[0] = True
    moment = curl(middle)[1] - natural
    return softest(curl(s)[0], moment, weight * (1.0 - middle), hard, torsion, held)


def critical(weight: float, hard: float, torsion: float) -> float:
    """The natural curvature at which the curl that grows from the straight rod leaves its plane.

    Raises NotConverged where it stays in it up to `LARGEST`."""
    curl = planar(weight, 0.0)
    for natural in np.arange(STEP, LARGEST, STEP):
        last, curl = curl, planar(weight, natural, curl)
        if stiffness(curl, weight, natural, hard, torsion) < 0.0:
            return float(
                brentq(
                    lambda k, near=last: stiffness(planar(weight, k, near), weight, k, hard, torsion),
                    natural - STEP,
                    natural,
                    xtol=1e-6,
                )
            )
    raise NotConverged(
        f"a rod of torsion {torsion:g} stays in its plane up to a natural curvature of {LARGEST:g}"
    )
