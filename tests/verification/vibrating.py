"""Shells whose modes are known: builders return a problem at its equilibrium, references come in closed form or from
methods that share nothing with the program."""

from dataclasses import replace

import numpy as np
from mesh_helpers import generator
from mpi4py import MPI
from scipy.linalg import eigh
from scipy.optimize import brentq
from shells import make

from voile.problem.problem import Problem
from voile.problem.shell import Shell
from voile.problem.supports import free_motions
from voile.solver.linear import Counts
from voile.solver.modes import Modes, buckling, vibrations
from voile.solver.path import StaticsOptions, require
from voile.solver.statics import solve_statics
from voile.validate.shapes import shared_by_length
from voile.validate.shells import Sides, mapped

YOUNG, POISSON, THICKNESS, DENSITY = 1e9, 0.3, 0.01, 1000.0
BENDING = YOUNG * THICKNESS**3 / (12.0 * (1.0 - POISSON**2))  # N m
UNIT = np.sqrt(BENDING / (DENSITY * THICKNESS))  # rad/s of lambda^2 = 1 on a plate of 1 m


def modes(shell: Shell, count: int) -> Modes:
    """Those about the equilibrium under the shell's loads, shapes (n, 3) in the shell's order."""
    problem = Problem(shell, MPI.COMM_SELF)
    y = problem.create_vector()
    if problem.load_norm(y) or problem.moves:
        y = require(solve_statics(problem, StaticsOptions(load_steps=4))).state
    rigid = None
    if not problem.held:
        rigid = free_motions(shell)[problem.part.vertex]
    found = vibrations(problem, y, count, Counts(), rigid)
    order = np.argsort(problem.part.vertex)
    return Modes(found.values, [shape[order] for shape in found.shapes])


def omegas(shell: Shell, count: int) -> np.ndarray:
    """rad/s, about the equilibrium under the shell's loads."""
    return 2.0 * np.pi * modes(shell, count).frequencies


def factors(shell: Shell, count: int) -> np.ndarray:
    """Load factors of buckling about the unloaded shell."""
    problem = Problem(shell, MPI.COMM_SELF).at(0.0)
    return buckling(problem, problem.create_vector(), count, Counts()).values


# ---- plates ----


def plate(n: int, held: str, length: float = 1.0) -> tuple[Shell, Sides]:
    """A square (or length x 1) plate of n cells to a metre: cantilever, free, or simply supported. And its sides."""
    u, v, triangles, side = mapped(round(n * length), n, "alternating")
    points = np.column_stack([length * u, v, np.zeros(len(u))])
    fixed, clamped = np.zeros((len(u), 3), dtype=bool), []
    if held == "cantilever":
        fixed[side.u0], clamped = True, [side.u0]
    elif held == "supported":
        fixed[np.any(side, axis=0), 2] = True
        fixed[side.u0, 0] = True
        fixed[side.u0 & side.v0, 1] = True
    shell = make(points, triangles, fixed, clamped, thickness=THICKNESS, young=YOUNG, poisson=POISSON)
    return shell, side


def ritz(held: str, count: int, order: int = 14) -> np.ndarray:
    """lambda^2 of a square plate, a side clamped or none, by Ritz's method: products of Legendre polynomials in x and
    y, times x^2 where clamped, exact Gauss integration. An upper bound, which settles to 1e-4 (free corners are weakly
    singular); the quoted values of Leissa and Barton lie above it by up to 1 %."""
    at, weight = np.polynomial.legendre.leggauss(order + 4)
    x, weight = 0.5 * (at + 1.0), 0.5 * weight
    lift = np.polynomial.Polynomial([0.0, 0.0, 1.0] if held == "cantilever" else [1.0])
    legendre = [
        np.polynomial.Legendre.basis(k, [0.0, 1.0]).convert(kind=np.polynomial.Polynomial)
        for k in range(order)
    ]
    along = [[(lift * p).deriv(d)(x) for p in legendre] for d in range(3)]
    across = [[p.deriv(d)(x) if d else p(x) for p in legendre] for d in range(3)]

    def product(f: int, g: int, basis) -> np.ndarray:
        return np.einsum("ik,jk,k->ij", basis[f], basis[g], weight)

    def term(f: tuple[int, int], g: tuple[int, int]) -> np.ndarray:
        return np.kron(product(f[0], g[0], along), product(f[1], g[1], across))

    xx, yy, xy, w = (2, 0), (0, 2), (1, 1), (0, 0)
    stiffness = term(xx, xx) + term(yy, yy) + POISSON * (term(xx, yy) + term(yy, xx))
    stiffness += 2.0 * (1.0 - POISSON) * term(xy, xy)
    return np.sqrt(np.abs(eigh(stiffness, term(w, w), eigvals_only=True)[:count]))


def clamped_disc(size: float) -> Shell:
    """A clamped circular plate of radius 1, irregular triangles."""
    patterns = generator("patterns")
    angle = np.linspace(0.0, 2.0 * np.pi, round(2.0 * np.pi / size), endpoint=False)
    flat, triangles = patterns.unstructured([np.column_stack([np.cos(angle), np.sin(angle)])], size)
    points = np.column_stack([flat[:, :2], np.zeros(len(flat))])
    rim = np.hypot(*points.T[:2]) > 1.0 - 1e-9
    fixed = np.repeat(rim[:, None], 3, axis=1)
    return make(points, triangles, fixed, [rim], thickness=THICKNESS, young=YOUNG, poisson=POISSON)


def pushed_plate(n: int, length: float) -> Shell:
    """A simply supported plate under a unit force per width along x."""
    shell, side = plate(n, "supported", length)
    share = np.where(side.v0 | side.v1, 0.5, 1.0) * side.u1
    force = np.zeros_like(shell.points)
    force[:, 0] = -share / share.sum()
    return replace(shell, force=force)


# ---- strips ----


def beam(n: int, held: str, width: float = 0.05) -> Shell:
    """A strip of 1 m, nu = 0, in bending alone: only z is free."""
    u, v, triangles, side = mapped(n, n // 20, "alternating")
    points = np.column_stack([u, width * v, np.zeros(len(u))])
    fixed = np.zeros((len(u), 3), dtype=bool)
    fixed[:, :2] = True
    ends = {"pinned": ("u0", "u1"), "clamped-free": ("u0",), "clamped": ("u0", "u1")}[held]
    for end in ends:
        fixed[getattr(side, end)] = True
    clamped = [getattr(side, end) for end in ends] if held != "pinned" else []
    return make(points, triangles, fixed, clamped, thickness=THICKNESS, young=YOUNG, poisson=0.0)


def hanging_chain(n: int) -> Shell:
    """A strip without bending stiffness that hangs down 1 m along -z, g = 9.81 m/s^2; it swings along x."""
    u, v, triangles, side = mapped(n, 1, "alternating")
    points = np.column_stack([np.zeros(len(u)), 0.05 * v, -u])
    fixed = np.zeros((len(u), 3), dtype=bool)
    fixed[:, 1] = True
    fixed[side.u0] = True
    gravity = np.array([0.0, 0.0, -9.81])
    return make(
        points,
        triangles,
        fixed,
        [],
        thickness=1e-3,
        young=1e10,
        poisson=0.0,
        model="membrane",
        gravity=gravity,
    )


# ---- membranes ----


def stretched(n: int, strain: float = 1e-3) -> Shell:
    """A square membrane, nu = 0, its sides moved apart by a strain along x and y."""
    u, v, triangles, side = mapped(n, n, "alternating")
    points = np.column_stack([u, v, np.zeros(len(u))])
    rim = np.any(side, axis=0)
    fixed = np.repeat(rim[:, None], 3, axis=1)
    shell = make(points, triangles, fixed, [], thickness=1e-4, young=YOUNG, poisson=0.0, model="membrane")
    return replace(shell, motion=strain * points * rim[:, None])


def blown_arc(n: int, half: float = 0.8, strain: float = 1e-6) -> Shell:
    """A cylindrical membrane of radius 1 over an arc of 2 `half` rad, long and held at both lines, that pressure
    stretches by a strain; it moves in the plane of the arc."""
    u, v, triangles, side = mapped(n, 1, "alternating")
    angle = half * (2.0 * u - 1.0)
    points = np.column_stack([np.sin(angle), v * 2.0 * half / n, np.cos(angle)])
    fixed = np.zeros((len(u), 3), dtype=bool)
    fixed[:, 1] = True
    fixed[side.u0 | side.u1] = True
    shell = make(points, triangles, fixed, [], thickness=1e-3, young=YOUNG, poisson=0.0, model="membrane")
    return replace(shell, pressure=YOUNG * 1e-3 * strain)


def arc_omegas(half: float, count: int, tension: float, mass: float) -> np.ndarray:
    """rad/s of an inextensible arc of radius 1 under pressure (own derivation). Tangential displacement v, normal
    minus its derivative (no stretching), dynamic tension eliminated: v'''' + (1 + s) v'' - s v = 0 with
    s = omega^2 m R^2 / T and v = v' = 0 at both ends."""

    def ends(s: float, odd: bool) -> float:
        root = np.sqrt((1.0 + s) ** 2 + 4.0 * s)
        a, b = np.sqrt((root + 1.0 + s) / 2.0), np.sqrt((root - 1.0 - s) / 2.0)
        if odd:  # sin(a x), sinh(b x)
            return np.sin(a * half) * b * np.cosh(b * half) - a * np.cos(a * half) * np.sinh(b * half)
        return np.cos(a * half) * b * np.sinh(b * half) + a * np.sin(a * half) * np.cosh(b * half)

    found, grid = [], np.linspace(0.5, 400.0, 8000)
    for odd in (True, False):
        values = [ends(s, odd) for s in grid]
        turns = np.flatnonzero(np.sign(values[1:]) != np.sign(values[:-1]))
        found += [brentq(ends, grid[k], grid[k + 1], args=(odd,)) for k in turns]
    return np.sqrt(np.sort(found)[:count] * tension / mass)


# ---- buckling of a cylinder ----


def pushed_cylinder(around: int, along: int, length: float, thickness: float) -> Shell:
    """A cylinder of radius 1, nu = 0, under a unit axial force per circumference; its ends keep their circles."""
    u, v, triangles, _ = mapped(around, along, "alternating")
    angle = 2.0 * np.pi * u
    points = np.column_stack([np.cos(angle), np.sin(angle), length * v])
    points, triangles = generator("patterns").weld(points, triangles, 1e-9)
    low, high = points[:, 2] < 1e-9, points[:, 2] > length - 1e-9
    fixed = np.zeros_like(points, dtype=bool)
    fixed[low | high, :2] = True
    fixed[low, 2] = True
    force = np.zeros_like(points)
    force[high, 2] = -2.0 * np.pi / np.count_nonzero(high)
    shell = make(points, triangles, fixed, [], thickness=thickness, young=YOUNG, poisson=0.0)
    return replace(shell, force=force)


def donnell(length: float, thickness: float) -> float:
    """N/m at which a cylinder of radius 1, nu = 0, buckles on ends that keep their circles (Donnell's equations)."""
    m, n = np.meshgrid(np.arange(1, 20), np.arange(0, 30))
    a, b = (m * np.pi / length) ** 2, n**2
    both = (a + b) ** 2 / a
    return float((YOUNG * thickness**3 / 12.0 * both + YOUNG * thickness / both).min())


# ---- strips on edge ----


def edge_strip(height: float, thin: float, nx: int, ny: int, poisson: float) -> tuple[Shell, np.ndarray]:
    """A strip of 1 m clamped on edge (y up), height / thin thick, and the mask of its tip."""
    u, v, triangles, side = mapped(nx, ny, "alternating")
    points = np.column_stack([u, height * v, np.zeros(len(u))])
    given = {"thickness": height / thin, "young": YOUNG, "poisson": poisson}
    return make(points, triangles, side.u0, [side.u0], **given), side.u1


def own_weight(height: float, thin: float, nx: int, ny: int, poisson: float) -> float:
    """rho g h L^3 / (E h^3 / 12) at which a strip on edge buckles sideways under its weight."""
    shell, _ = edge_strip(height, thin, nx, ny, poisson)
    shell = replace(shell, gravity=np.array([0.0, -1.0, 0.0]))
    return float(factors(shell, 1)[0] * DENSITY / (YOUNG * (height / thin) ** 2 / 12.0))


def tip_load(height: float, thin: float, nx: int, ny: int) -> float:
    """Tip load over sqrt(E I G J) / L^2 at which a strip on edge buckles sideways, nu = 0."""
    shell, tip = edge_strip(height, thin, nx, ny, 0.0)
    shell = replace(shell, force=shared_by_length(shell.points, tip, np.array([0.0, -1.0, 0.0])))
    h = height / thin
    stiffness = YOUNG * np.sqrt(height * h**3 / 12.0 * 0.5 * height * h**3 / 3.0)
    return float(factors(shell, 1)[0] / stiffness)


def moved_plate(n: int) -> Shell:
    """The square of `pushed_plate`, nu aside, pushed by its side instead."""
    shell = pushed_plate(n, 1.0)
    side = shell.points[:, 0] > 1.0 - 1e-9
    fixed, motion = shell.fixed.copy(), np.zeros_like(shell.points)
    fixed[side, 0] = True
    motion[side, 0] = -1.0 / (YOUNG * THICKNESS)
    return replace(shell, fixed=fixed, motion=motion, force=None)


# ---- contact ----


def resting_strip() -> Shell:
    """A strip clamped at x = 0 that its weight bends down onto what is 5 cm below."""
    u, v, triangles, side = mapped(20, 2, "alternating")
    points = np.column_stack([u, 0.1 * v, np.zeros(len(u))])
    gravity = np.array([0.0, 0.0, -9.81])
    given = {"thickness": 0.01, "young": 2e8, "poisson": 0.3, "gravity": gravity}
    return make(points, triangles, side.u0, [side.u0], **given)


def held_at(shell: Shell, problem: Problem, y, vertices: np.ndarray, axes: list[int]) -> Shell:
    """The shell whose supports bring some of the problem's vertices where they are at y."""
    part, u = problem.part, problem.local(y)[0].reshape(-1, 3)
    fixed, motion = shell.fixed.copy(), np.zeros_like(shell.points)
    for vertex, moved in zip(part.vertex[vertices], u[vertices], strict=True):
        fixed[vertex, axes] = True
        motion[vertex, axes] = moved[axes]
    return replace(shell, fixed=fixed, motion=motion)
