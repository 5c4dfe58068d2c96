"""Shells that snap: builders return a Shell and the vertex where it is measured."""

from dataclasses import replace

import numpy as np
from mesh_helpers import generator
from scipy.integrate import solve_bvp
from scipy.special import ellipk
from shells import make

from voile.problem.shell import Shell
from voile.validate.shapes import shared_by_length
from voile.validate.shells import mapped, only


def hinged_roof(around: int, along: int, thickness: float, load: float) -> tuple[Shell, int]:
    """A quarter of Sze, Liu & Lo's cylindrical roof (2004; N, mm): straight edges hinged, a load at the middle."""
    u, v, triangles, side = mapped(around, along, "alternating")
    angle, radius = 0.1 * u, 2540.0
    points = np.column_stack([radius * np.sin(angle), 254.0 * v, radius * (np.cos(angle) - np.cos(0.1))])
    points[side.u0, 0] = 0.0
    fixed = np.column_stack([side.u0, side.v0, np.zeros(len(u), dtype=bool)])
    fixed[side.u1] = True
    middle, force = only(side.u0 & side.v0), np.zeros_like(points)
    force[middle, 2] = -0.25 * load
    planes = [side.u0, side.v0]
    given = {"thickness": thickness, "young": 3102.75, "poisson": 0.3}
    return replace(make(points, triangles, fixed, planes, **given), force=force), middle


def pinned_strip(n: int, load: float) -> Shell:
    """A strip of 1 m, nu = 0, pinned at both ends and pushed along x with `load` times Euler's load; it stays in the
    plane of x and z."""
    u, v, triangles, side = mapped(n, 1, "alternating")
    points = np.column_stack([u, v / n, np.zeros(len(u))])
    fixed = np.zeros((len(u), 3), dtype=bool)
    fixed[:, 1] = True
    fixed[side.u0] = True
    fixed[side.u1, 2] = True
    shell = make(points, triangles, fixed, [], thickness=1e-3, young=1e9, poisson=0.0)
    euler = np.pi**2 * 1e9 * 1e-9 / 12.0 / n
    return replace(shell, force=shared_by_length(points, side.u1, np.array([-load * euler, 0.0, 0.0])))


def elastica(angle: float) -> tuple[float, float]:
    """Load over Euler's and deflection over length of a pinned column whose ends turn by an angle."""
    modulus = np.sin(0.5 * angle)
    quarter = ellipk(modulus**2)
    return (2.0 * quarter / np.pi) ** 2, modulus / quarter


def clamped_dome(size: float, load: float, lam: float = 4.5, poisson: float = 0.3) -> Shell:
    """A shallow spherical cap of radius 1 at its clamped rim, whose slope there is 0.04, under `load` times the
    classical pressure from above; lam^2 = sqrt(12 (1 - nu^2)) a^2 / (R h)."""
    slope = 0.04
    radius = 1.0 / slope
    thickness = np.sqrt(12.0 * (1.0 - poisson**2)) / (lam**2 * radius)
    pressure = load * 2e9 * (thickness / radius) ** 2 / np.sqrt(3.0 * (1.0 - poisson**2))
    angle = np.linspace(0.0, 2.0 * np.pi, round(2.0 * np.pi / size), endpoint=False)
    flat, triangles = generator("patterns").unstructured(
        [np.column_stack([np.cos(angle), np.sin(angle)])], size
    )
    r = np.hypot(*flat.T)
    points = np.column_stack([flat, 0.5 * slope * (1.0 - r**2)])
    rim = r > 1.0 - 1e-9
    fixed = np.repeat(rim[:, None], 3, axis=1)
    return make(
        points, triangles, fixed, [rim], thickness=thickness, young=1e9, poisson=poisson, pressure=-pressure
    )


def dome_path(sags: np.ndarray, lam: float = 4.5, poisson: float = 0.3) -> np.ndarray:
    """Pressure over the classical 2 E h^2 / (R^2 sqrt(3 (1 - nu^2))) at sags of the middle of `clamped_dome`, over its
    rise. Marguerre's shallow shell, axisymmetric, r over the rim's radius, f = w' and p = r N_r made dimensionless:
    r f'' + f' - f/r = lam^4 p (f - r) - q r^2 / 2, r p'' + p' - p/r = r f - f^2 / 2, q = 4 lam^2 classical ones."""
    r = np.linspace(1e-3, 1.0, 200)
    guess, q, found = np.zeros((5, len(r))), np.zeros(1), []

    def derivatives(r, y, q):
        f, g, p, s, _ = y
        bent = lam**4 * p * (f - r) / r - 0.5 * q[0] * r
        return np.array([g, bent - g / r + f / r**2, s, f - 0.5 * f**2 / r - s / r + p / r**2, f])

    for sag in sags:

        def ends(a, b, q, sag=sag):
            near = [a[0] - r[0] * a[1], a[2] - r[0] * a[3], a[4] + 0.5 * sag]
            return np.array([*near, b[0], b[3] - poisson * b[2], b[4]])

        solution = solve_bvp(derivatives, ends, r, guess, q, tol=1e-6, max_nodes=20000)
        assert solution.success
        guess, q = solution.sol(r), solution.p
        found.append(q[0] / (4.0 * lam**2))
    return np.array(found)


TOGGLE = (12.94, 0.386, 0.753, 0.243, 1.03e7)  # in, lb/in^2: span of a half, rise, width, thickness, modulus


def toggle(n: int, load: float) -> tuple[Shell, int]:
    """Half of Williams' toggle (1964): two straight beams, clamped where they stand and where they meet."""
    span, rise, width, thickness, young = TOGGLE
    u, v, triangles, side = mapped(n, n // 15, "crossed")
    points = np.column_stack([span * u, width * v, rise * u])
    fixed = np.zeros((len(u), 3), dtype=bool)
    fixed[:, 1] = ~side.u1
    fixed[side.u0] = True
    fixed[side.u1, 0] = True
    shell = make(points, triangles, fixed, [side.u0, side.u1], thickness=thickness, young=young, poisson=0.0)
    force = shared_by_length(points, side.u1, np.array([0.0, 0.0, -0.5 * load]))
    return replace(shell, force=force), only(side.u1 & side.v0)


def toggle_path() -> np.ndarray:
    """(states, 2) displacement of the middle and load of the toggle by beam-columns, shallow: for a thrust P = B k^2,
    u = k L, each half bends to w' = k b (1 - cos k x - tan(u/2) sin k x), sinks by d = b (u - 2 tan(u/2)), and
    P L / (E A) = d H / L - (w', w') / 2 gives b; the load is 2 P (H / L - k b). Errors are of the slope's square."""
    span, rise, width, thickness, young = TOGGLE
    u = np.linspace(0.05, 6.2, 20000)
    k, t, s, c = u / span, np.tan(0.5 * u), np.sin(u), np.cos(u)
    thrust = young * width * thickness**3 / 12.0 * k**2
    square = t**2 * (u - s * c) / 2.0 + 1.5 * u - 2.0 * s + s * c / 2.0 - t * (2.0 - 2.0 * c - s**2)
    sunk = u - 2.0 * t
    half = 0.5 * rise / span * sunk
    root = half**2 - 0.5 * k * square * thrust * span / (young * width * thickness)
    found = []
    for sign in (1.0, -1.0):
        b = (half + sign * np.sqrt(np.maximum(root, 0.0))) / (0.5 * k * square)
        found.append(np.column_stack([b * sunk, 2.0 * thrust * (rise / span - k * b)])[root > 0.0])
    path = np.concatenate(found)
    return path[np.argsort(path[:, 0])]
