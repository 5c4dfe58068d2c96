"""Inflated membranes in closed form or by quadrature: references for finite strains, E = 1e6, nu = 0.3."""

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

LAMBDA, MU = 1e6 * 0.3 / (1.0 - 0.3**2), 1e6 / 2.6  # plane stress


def sphere_pressure(stretch: float, thickness: float, material: str, bends: bool) -> float:
    """Pressure at which a unit sphere has the radius `stretch`: p = W'(s) / s^2, W the energy per rest area.

    With A = s^2 A_rest and B = s B_rest of the uniformly stretched sphere, the energies of voile.elastic are
    W = h/2 (lambda + mu) (s^2 - 1)^2 (stvk), h (mu (s^2 - 1 - 2 ln s) + 2 lambda ln^2 s) (neo-hookean), and the
    Koiter (stvk) bending term h^3/6 (lambda + mu) (s - 1)^2.
    """
    s, h = stretch, thickness
    if material == "stvk":
        slope = 2.0 * h * (LAMBDA + MU) * (s * s - 1.0) * s
    else:
        slope = h * (MU * (2.0 * s - 2.0 / s) + 4.0 * LAMBDA * np.log(s) / s)
    if bends:
        slope += h**3 / 3.0 * (LAMBDA + MU) * (s - 1.0)
    return slope / s**2


def inflated(load: float, radius: float | None, rim: float) -> tuple[float, float]:
    """Stretch at the pole and height over the rim of an axisymmetric St. Venant-Kirchhoff membrane pinned at its rim.

    load: pressure over E h (1/m). radius: of the sphere whose cap is the rest shape, None for a flat disc; rim: arc
    from pole to rim (m). With rho(S) the rest radius, r and z the deformed ones, theta the slope, T the tensions
    per rest length: r' = l1 cos(theta), z' = -l1 sin(theta), l2 = r/rho, rho T1 sin(theta) = p r^2/2 (balance of
    the part above), (rho T1 cos(theta))' = T2 - p r l1 sin(theta); shooting for r(rim) = rho(rim).
    """
    membrane, shear = LAMBDA / 1e6, MU / 1e6  # over E

    def rho(arc: float) -> float:
        return arc if radius is None else radius * np.sin(arc / radius)

    def stretch_of(tension: float, strain_2: float) -> float:
        """l1 where T1 = l1 ((lambda + 2 mu) (l1^2 - 1)/2 + lambda e2), by Newton's method."""
        cubic = 0.5 * (membrane + 2.0 * shear)
        linear, l1 = membrane * strain_2 - cubic, 1.0
        for _ in range(50):
            change = (cubic * l1**3 + linear * l1 - tension) / (3.0 * cubic * l1 * l1 + linear)
            l1 -= change
            if abs(change) < 1e-15:
                break
        return l1

    def slope(arc: float, state: np.ndarray) -> list[float]:
        r, horizontal, _ = state
        vertical = 0.5 * load * r * r
        tension = np.hypot(horizontal, vertical) / rho(arc)
        l2 = r / rho(arc)
        strain_2 = 0.5 * (l2 * l2 - 1.0)
        l1 = stretch_of(tension, strain_2)
        cosine, sine = horizontal / (rho(arc) * tension), vertical / (rho(arc) * tension)
        tension_2 = l2 * ((membrane + 2.0 * shear) * strain_2 + membrane * 0.5 * (l1 * l1 - 1.0))
        return [l1 * cosine, tension_2 - load * r * l1 * sine, l1 * sine]

    def shoot(pole: float) -> np.ndarray:
        start = 1e-6 * rim
        tension = pole * (membrane + shear) * (pole * pole - 1.0)
        solution = solve_ivp(
            slope, (start, rim), [pole * start, tension * start, 0.0], rtol=1e-10, atol=1e-12 * rim
        )
        return solution.y[:, -1]

    # the pole strains by about (load rim)^(2/3) of a disc, or load R of a sphere, whichever is more
    guess = max((load * rim) ** (2.0 / 3.0), 0.0 if radius is None else load * radius)
    pole = brentq(lambda s: shoot(s)[0] - rho(rim), 1.0 + 0.02 * guess, 1.0 + 0.6 * guess, xtol=1e-14)
    return pole, float(shoot(pole)[2])
