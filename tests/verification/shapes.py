"""Strips and plates with closed forms: builders return a Shell, cases return rows. Strips lie along x from a clamp at
x = 0, one metre long, with nu = 0, so that they bend as rods do."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from mpi4py import MPI
from scipy.integrate import trapezoid
from scipy.optimize import brentq
from shells import Row, make, row, solve

from voile.problem.problem import Problem
from voile.problem.shell import Shell
from voile.solver.linear import factored
from voile.validate.shapes import DENSITY, YOUNG, rigidity, shared_by_length
from voile.validate.shells import mapped

# Heavy strip clamped horizontally: drop over reach of the tip by gamma = rho g h L^3 / B; and the dead tip force
# alpha = P L^2 / (B b): shortening and deflection over L. Elasticas solved to 1e-8 as boundary value problems of
# theta'' = -gamma (1 - s) cos(theta), theta'' = -alpha cos(theta); test_strips.py solves them again.
CANTILEVER = {
    0.5: 0.06244445727,
    1.0: 0.12456176644,
    2.0: 0.24667320580,
    5.0: 0.58572118251,
    10.0: 1.06680232043,
    20.0: 1.86393014444,
    50.0: 3.70556099197,
    100.0: 5.88810462333,
    200.0: 8.90677072661,
    500.0: 14.76880345275,
}
END_SHEAR = {
    1.0: (0.05643323628, 0.30172077381),
    2.0: (0.16064172083, 0.49345748039),
    4.0: (0.32894124225, 0.66996418128),
    6.0: (0.43458882868, 0.74457114889),
    8.0: (0.50482773313, 0.78498237495),
}
SUPPORTED, CLAMPED = (
    0.00406235,
    0.00126532,
)  # Timoshenko & Woinowsky-Krieger 1959: w D / (q a^4) at the centre
LATERAL = 12.85  # Timoshenko & Gere 1961, 6.3: (w L) L^2 / sqrt(E I G J) of a cantilever under its own weight


def strip(nx: int, ny: int, width: float = 0.05, thickness: float = 1e-3, uniform: float = 1.0, **given):
    """Strip and the mask of its tip; cells near the clamp are `uniform` times the mean length."""
    u, v, triangles, side = mapped(nx, ny, "alternating")
    points = np.column_stack([u * (uniform + (1.0 - uniform) * u), width * v, np.zeros(len(u))])
    given = {"young": YOUNG, "poisson": 0.0, "thickness": thickness, **given}
    return make(points, triangles, side.u0, [side.u0], **given), side.u1


def heavy_strip(gamma: float, nx: int, ny: int, bending: str = "tan") -> tuple[Shell, np.ndarray]:
    """Cantilever under its weight, finer towards the clamp, where it bends most at large gamma."""
    gravity = np.array([0.0, 0.0, -gamma * rigidity(1e-3) / (DENSITY * 1e-3)])
    return strip(nx, ny, uniform=0.3, gravity=gravity, bending=bending)


def sheared_strip(alpha: float, nx: int, ny: int, width: float = 0.05) -> tuple[Shell, np.ndarray]:
    """Cantilever under a dead force across its tip."""
    shell, tip = strip(nx, ny, width)
    shell.force = shared_by_length(shell.points, tip, np.array([0.0, 0.0, alpha * rigidity(1e-3) * width]))
    return shell, tip


def rolled_strip(turns: float, nx: int, ny: int) -> tuple[Shell, np.ndarray]:
    """Cantilever under the end moment 2 pi B b / L times `turns`: a full circle at one turn."""
    width, thickness = 0.05, 1e-2
    shell, tip = strip(nx, ny, width, thickness)
    topology = shell.topology
    edge = topology.triangle_edges.ravel()
    rim = (topology.across.ravel() < 0) & tip[topology.edges[edge]].all(axis=1)
    shell.moment = 2.0 * np.pi * turns * rigidity(thickness) * width * rim / rim.sum()
    return shell, tip


def hanging_strip(nx: int, span: float) -> tuple[Shell, np.ndarray]:
    """Strip without noticeable bending or stretching stiffness, both ends held level at a distance `span`, starting
    from the arc of a circle: rho g L / E = 1e-5 and rho g h L^3 / B = 1e5."""
    thickness = np.sqrt(12.0 * 1e-5 / 1e5)
    shell, tip = strip(nx, 1, 2.0 / nx, thickness, gravity=np.array([0.0, 0.0, -1e-5 * YOUNG / DENSITY]))
    shell.fixed[tip] = True
    shell.clamped_edges = np.zeros(0, np.int32)
    half = brentq(lambda a: np.sin(a) / a - span, 1e-3, 3.0)  # of the arc's angle
    angle = half * (2.0 * shell.points[:, 0] - 1.0)
    arc = shell.points.copy()
    arc[:, 0] = 0.5 * (span + np.sin(angle) / half)
    arc[:, 2] = 0.5 * (np.cos(half) - np.cos(angle)) / half
    return replace(shell, points=arc), tip


def standing_strip(
    load: float, height: float, nx: int, ny: int, thin: float = 50.0
) -> tuple[Shell, np.ndarray]:
    """Cantilever on edge (y up) under `load` times the weight at which it buckles sideways, height / thin thick."""
    thickness = height / thin
    shell, tip = strip(nx, ny, height, thickness)
    inertia, torsion = height * thickness**3 / 12.0, height * thickness**3 / 3.0
    weight = LATERAL * np.sqrt(YOUNG * inertia * 0.5 * YOUNG * torsion)
    shell.gravity = np.array([0.0, -load * weight / (DENSITY * thickness * height), 0.0])
    return shell, tip


def planar_state(problem: Problem):
    """Unknowns of the equilibrium that stays plane, stable or not, and the negative eigenvalues of its tangent.
    Plain Newton's method: a plane sheet in its plane is pushed out of it by nothing."""
    y, residual, step = (problem.create_vector() for _ in range(3))
    matrix = problem.create_matrix()
    for _ in range(5):
        problem.residual(y, residual)
        problem.tangent(y, matrix)
        solver = factored(matrix)
        negative = solver.negative
        solver.solve(residual, step)
        y.axpy(-1.0, step)
        solver.destroy()
    if not residual.norm() < 1e-8 * problem.load_norm(y):
        raise AssertionError(f"the plane state has a residual of {residual.norm():.2e} N")
    return y, negative


def buckling_load(height: float, nx: int, ny: int) -> float:
    """Load of `standing_strip` at which the tangent of the plane state loses its first positive eigenvalue."""
    shell, _ = standing_strip(2.0, height, nx, ny)
    problem = Problem(shell, MPI.COMM_SELF)
    low, high = 0.5, 2.0
    for _ in range(14):
        middle = 0.5 * (low + high)
        problem = problem.at(0.5 * middle)
        low, high = (low, middle) if planar_state(problem)[1] else (middle, high)
    return 0.5 * (low + high)


def square_plate(n: int, clamped: bool, diagonals: str = "crossed") -> tuple[Shell, int, float]:
    """Unit plate under its weight, its rim supported; the centre, and q a^4 / D. Sags by a thousandth of h = 0.01."""
    u, v, triangles, side = mapped(n, n, diagonals)
    rim = np.any(list(side), axis=0)
    points = np.column_stack([u, v, np.zeros(len(u))])
    scale = 1e-5 / (CLAMPED if clamped else SUPPORTED)
    pressure = scale * rigidity(0.01, poisson=0.3)
    shell = make(
        points,
        triangles,
        rim,
        list(side) if clamped else [],
        thickness=0.01,
        young=YOUNG,
        poisson=0.3,
        gravity=np.array([0.0, 0.0, -pressure / (DENSITY * 0.01)]),
    )
    return shell, int(np.argmin((u - 0.5) ** 2 + (v - 0.5) ** 2)), scale


def long_plate(nx: int, thickness: float, load: float) -> tuple[Shell, int]:
    """Slice of an infinitely long plate across its span 1 in x, both edges clamped, nu = 0.3, under
    load = q / (D h) (1/m^4); and its middle. FvK theory knows no other parameter for sag over thickness."""
    u, v, triangles, side = mapped(nx, 2, "alternating")
    points = np.column_stack([u, 2.0 * v / nx, np.zeros(len(u))])
    ends, sides = side.u0 | side.u1, side.v0 | side.v1
    fixed = np.column_stack([ends, ends | sides, ends])
    pressure = load * rigidity(thickness, poisson=0.3) * thickness
    shell = make(
        points,
        triangles,
        fixed,
        list(side),
        thickness=thickness,
        young=YOUNG,
        poisson=0.3,
        gravity=np.array([0.0, 0.0, -pressure / (DENSITY * thickness)]),
    )
    return shell, int(np.argmin((points[:, 0] - 0.5) ** 2 + (points[:, 1] - 1.0 / nx) ** 2))


def long_plate_sag(load: float) -> float:
    """Sag over thickness of `long_plate` (Timoshenko & Woinowsky-Krieger 1959, chapter 1, built-in edges).

    W'''' - k^2 W'' = load with W = w/h over xi = x/l, and the stretch k^2 = S l^2 / D = 6 int W'^2 dxi.
    """
    xi = np.linspace(0.0, 1.0, 2001)

    def shape(k: float) -> np.ndarray:
        edge = (np.cosh(0.5 * k) - np.cosh(k * (xi - 0.5))) / (k * np.sinh(0.5 * k))
        return 0.5 * load / k**2 * (xi * (1.0 - xi) - edge)

    def excess(k: float) -> float:
        slope = 0.5 * load / k**2 * (1.0 - 2.0 * xi + np.sinh(k * (xi - 0.5)) / np.sinh(0.5 * k))
        return 6.0 * float(trapezoid(slope**2, xi)) - k**2

    return float(shape(brentq(excess, 0.01, 200.0, xtol=1e-12))[1000])


def wavy_plate(thickness: float, n: int) -> Shell:
    """Unit plate with every vertex held at z = h f, and moved by h^2 g in its plane, with h its thickness."""
    u, v, triangles, _ = mapped(n, n, "alternating")
    rest = np.column_stack([u, v, np.zeros(len(u))])
    f = np.sin(np.pi * u) * np.sin(np.pi * v) + 0.5 * u * u * v
    g = 0.5 * np.sin(np.pi * u) * v * v, 0.3 * u * np.cos(np.pi * v)
    held = np.ones((len(u), 3), dtype=bool)
    shell = make(rest, triangles, held, [], thickness=thickness, young=YOUNG, poisson=0.3)
    return replace(
        shell, points=rest + np.column_stack([thickness**2 * g[0], thickness**2 * g[1], thickness * f])
    )


def wavy_energy() -> float:
    """Foppl-von Karman energy of `wavy_plate` over h^5 (J/m^5), by Gauss' rule: stretching by the strains
    sym grad g + grad f grad f / 2, bending by the second derivatives of f."""
    pi, (x, w) = np.pi, np.polynomial.legendre.leggauss(20)
    u, v = np.meshgrid(0.5 * (x + 1.0), 0.5 * (x + 1.0))
    sin_u, cos_u, sin_v, cos_v = np.sin(pi * u), np.cos(pi * u), np.sin(pi * v), np.cos(pi * v)
    f_u, f_v = pi * cos_u * sin_v + u * v, pi * sin_u * cos_v + 0.5 * u * u
    f_uu, f_vv, f_uv = -(pi**2) * sin_u * sin_v + v, -(pi**2) * sin_u * sin_v, pi**2 * cos_u * cos_v + u
    e_uu, e_vv = 0.5 * pi * cos_u * v * v + 0.5 * f_u**2, -0.3 * pi * u * sin_v + 0.5 * f_v**2
    e_uv = 0.5 * (sin_u * v + 0.3 * cos_v + f_u * f_v)

    def density(a, b, c):
        return 0.5 * YOUNG / (1.0 - 0.09) * ((a + b) ** 2 - 1.4 * (a * b - c * c))

    both = density(e_uu, e_vv, e_uv) + density(f_uu, f_vv, f_uv) / 12.0
    return float(np.sum(0.25 * np.outer(w, w) * both))


# ---- cases ----


def tip_of(shell: Shell, tip: np.ndarray, load_steps: int = 1) -> np.ndarray:
    """(3,) mean position of the tip at the full load."""
    return (shell.points + solve(shell, load_steps).u)[tip].mean(axis=0)


def cantilever_row(gamma: float, nx: int = 80, ny: int = 4) -> Row:
    x = tip_of(*heavy_strip(gamma, nx, ny))
    return row(
        f"heavy cantilever, H/W, gamma = {gamma:g}", f"{nx}x{ny} graded", -x[2] / x[0], CANTILEVER[gamma]
    )


def cantilever_refined(gamma: float = 10.0, meshes=(20, 40, 80)) -> list[Row]:
    return [cantilever_row(gamma, nx, nx // 20) for nx in meshes]


def shear_rows(alpha: float, nx: int = 32, ny: int = 2) -> list[Row]:
    x = tip_of(*sheared_strip(alpha, nx, ny))
    return [
        row(f"end shear, {name}, alpha = {alpha:g}", f"{nx}x{ny}", value, reference)
        for name, value, reference in zip(
            ("shortening", "deflection"), (1.0 - x[0], x[2]), END_SHEAR[alpha], strict=True
        )
    ]


def shear_refined(alpha: float = 4.0, meshes=(20, 40, 80)) -> list[Row]:
    return [shear_rows(alpha, nx, nx // 20)[1] for nx in meshes]


def roll_refined(turns: float = 1.0, meshes=(20, 40, 80)) -> list[Row]:
    """Distance of the tip from where it should be, over the length."""
    angle = 2.0 * np.pi * turns
    place = np.array([np.sin(angle), 0.0, 1.0 - np.cos(angle)]) / angle
    rows = []
    for nx in meshes:
        x = tip_of(*rolled_strip(turns, nx, nx // 20), load_steps=4)
        distance = float(np.hypot(x[0] - place[0], x[2] - place[2]))
        rows.append(
            Row(f"roll-up, tip's distance from {turns:g} turn", f"{nx}x{nx // 20}", distance, 0.0, distance)
        )
    return rows


def catenary_refined(span: float = 0.8, meshes=(20, 40, 80)) -> list[Row]:
    """Sag against a (cosh(d / 2a) - 1) with 2 a sinh(d / 2a) = L."""
    a = brentq(lambda a: 2.0 * a * np.sinh(0.5 * span / a) - 1.0, 0.05, 10.0)
    sag = a * (np.cosh(0.5 * span / a) - 1.0)
    rows = []
    for nx in meshes:
        shell, _ = hanging_strip(nx, span)
        lowest = -(shell.points + solve(shell, 1).u)[:, 2].min()
        rows.append(row(f"hanging strip, sag at a span of {span:g} L", f"{nx}x1", lowest, sag))
    return rows


def plate_refined(clamped: bool, meshes=(12, 24, 48)) -> list[Row]:
    rows = []
    for n in meshes:
        shell, centre, scale = square_plate(n, clamped)
        name = f"square plate, {'clamped' if clamped else 'simply supported'}, w D / (q a^4)"
        sag = -solve(shell, 1).u[centre, 2] / scale
        rows.append(row(name, f"{n}x{n} crossed", sag, CLAMPED if clamped else SUPPORTED))
    return rows


def long_plate_refined(load: float = 2000.0, meshes=(32, 64, 128)) -> list[Row]:
    """Cylindrical bending with stretching at h / l = 1e-3."""
    rows = []
    for nx in meshes:
        shell, middle = long_plate(nx, 1e-3, load)
        name = "long clamped plate, sag over thickness, h/l = 0.001"
        rows.append(row(name, f"{nx}x2", -solve(shell, 1).u[middle, 2] / 1e-3, long_plate_sag(load)))
    return rows


def small_slopes(thicknesses=(0.05, 0.025, 0.0125), load: float = 2000.0, nx: int = 64) -> list[Row]:
    """The same sag over thickness by Koiter's energy, against its limit at small slopes on the same mesh."""

    def sag(thickness: float) -> float:
        shell, middle = long_plate(nx, thickness, load)
        return -solve(shell, 1).u[middle, 2] / thickness

    limit = sag(1e-4)
    name = "Koiter to Foppl-von Karman, sag of the long plate"
    return [row(name, f"h/l = {h:g}", sag(h), limit) for h in thicknesses]


def field_energy(thickness: float, n: int) -> float:
    """Koiter's energy of `wavy_plate` over h^5 (J/m^5), directors relaxed."""
    energies = solve(wavy_plate(thickness, n), 1).path.steps[-1].energies
    return (energies["stretching"] + energies["bending"]) / thickness**5


def field_energy_refined(meshes=(24, 48, 96)) -> list[Row]:
    """Koiter's energy of a given field of slopes of 1e-3 against the Foppl-von Karman energy."""
    name = "Foppl-von Karman energy of a field, h/a = 0.001"
    return [row(name, f"{n}x{n}", field_energy(1e-3, n), wavy_energy()) for n in meshes]


def small_slopes_energy(thicknesses=(0.1, 0.05, 0.025), n: int = 48) -> list[Row]:
    """The same energy as slopes fall, against its limit on the same mesh."""
    limit = field_energy(1e-3, n)
    name = "Koiter to Foppl-von Karman, energy of a field"
    return [row(name, f"h/a = {h:g}, {n}x{n}", field_energy(h, n), limit) for h in thicknesses]


def buckling_refined(heights=(0.1, 0.05, 0.025)) -> list[Row]:
    """Lateral buckling: the beam's load is the limit of slender strips."""
    return [
        row(
            "lateral buckling, w L^3 / sqrt(E I G J)",
            f"b/L = {b:g}, {round(4 / b)}x4",
            LATERAL * buckling_load(b, round(4 / b), 4),
            LATERAL,
        )
        for b in heights
    ]


CASES: dict[str, Callable[[], list[Row]]] = {
    "heavy cantilever: all gamma": lambda: [cantilever_row(gamma) for gamma in CANTILEVER],
    "heavy cantilever: refinement": cantilever_refined,
    "end shear: all alpha": lambda: [r for alpha in END_SHEAR for r in shear_rows(alpha)],
    "end shear: refinement": shear_refined,
    "roll-up: half turn": lambda: roll_refined(0.5),
    "roll-up: full circle": roll_refined,
    "roll-up: turn and a half": lambda: roll_refined(1.5),
    "hanging strip: catenary": catenary_refined,
    "square plate: simply supported": lambda: plate_refined(False),
    "square plate: clamped": lambda: plate_refined(True),
    "long plate: bending with stretching": long_plate_refined,
    "small slopes: sag": small_slopes,
    "small slopes: energy": small_slopes_energy,
    "small slopes: energy, refinement": field_energy_refined,
    "lateral buckling": buckling_refined,
}
