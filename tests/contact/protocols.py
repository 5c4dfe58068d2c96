"""Protocols of contact and friction with known answers, for tests and for scripts/contact-table."""

import json
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path as File

import numpy as np
from mesh_helpers import generator

from voile.contact.obstacles import Box, Cylinder, Motion, Obstacle, Plane, Sphere
from voile.problem.contact import contact_fields, with_obstacles
from voile.problem.problem import Problem
from voile.problem.shell import Shell
from voile.solver.path import Path, StaticsOptions
from voile.solver.statics import solve_statics

CURVES = File(__file__).parents[3] / "shared" / "reference" / "strip-curves.json"
GRAVITY = 9.81
UP = np.array([0.0, 0.0, 1.0])


def shell_of(
    points, triangles, *, rest=None, young, thickness, density, fixed=None, motion=None, **more
) -> Shell:
    one, triangles = np.ones(len(triangles)), np.asarray(triangles, dtype=np.int32)
    more = {"model": "koiter/tan/stvk", "gravity": -GRAVITY * UP, "flat": True} | more
    return Shell(
        points=points,
        triangles=triangles,
        rest_points=points if rest is None else rest,
        rest_triangles=triangles,
        thickness=thickness * one,
        young=young * one,
        poisson=0.0 * one,
        density=density * one,
        fixed=np.zeros(points.shape, dtype=bool) if fixed is None else fixed,
        motion=np.zeros_like(points) if motion is None else motion,
        **more,
    )


def solve(shell: Shell, obstacle: Obstacle, steps: int = 1, offset: float = 0.0, on_step=None, history=None):
    """The path and its problem; on_step(problem, step, y); history: the problem, of the same mesh, whose contact
    forces this one starts from."""
    problem = Problem(shell)
    problem = with_obstacles(problem, [obstacle], offset)
    if history is not None:
        problem.contact.history = history.contact.history.copy()
    watch = (lambda step, y: on_step(problem.at(step.factor), step, y)) if on_step else None
    return solve_statics(problem, StaticsOptions(load_steps=steps), on_step=watch), problem


def plate(length: float, width: float, size: float):
    return generator("plate").plate(length, width, size)


def held(points: np.ndarray, *places: tuple[np.ndarray, np.ndarray]) -> dict:
    """Supports of shell_of: (mask (n,), displacement (3,)) each, all axes."""
    fixed, motion = np.zeros(points.shape, dtype=bool), np.zeros_like(points)
    for mask, displacement in places:
        fixed[mask], motion[mask] = True, displacement
    return {"fixed": fixed, "motion": motion}


# ---- heavy strip on a plane, one end lifted ----


@dataclass
class Lifted:
    """length (m) of the free part, first: that of the vertices which do not touch, and lifting force (N/m) with their
    closed forms; touching (n,) vertices."""

    path: Path
    points: np.ndarray
    touching: np.ndarray
    fields: dict
    first: float
    length: float
    exact_length: float
    force: float
    exact_force: float
    size: float


def lifted_strip(cells: int) -> Lifted:
    """Free length l = (24 B delta / (rho g h))^(1/4), lifting force rho g h l / 2 per unit width.

    A beam comes to lie down with a force at one point, the edge of contact, which the mesh spreads over some vertices:
    the edge is the centre of what they carry beyond their own weight."""
    length, width, thickness, young, density, lift = 1.0, 2.0 / cells, 1e-3, 1e9, 1000.0, 2e-3
    stiffness, weight = young * thickness**3 / 12, density * GRAVITY * thickness
    free = (24 * stiffness * lift / weight) ** 0.25
    points, triangles = plate(length, width, length / cells)
    supports = held(points, (points[:, 0] < 1e-9, lift * UP))
    shell = shell_of(points, triangles, young=young, thickness=thickness, density=density, **supports)
    path, problem = solve(shell, Plane(name="floor", point=np.zeros(3), normal=UP))
    fields = contact_fields(problem, path.state)
    touching = fields["contact"] > 0
    force = problem.reactions(path.state)[:, 2].sum() / width
    own = -problem.loads.weight[: points.size].reshape(-1, 3)[:, 2]
    beyond = (fields["reaction"][:, 2] - own)[touching]
    edge = beyond @ points[touching, 0] / beyond.sum()
    first = points[touching, 0].min()
    return Lifted(path, points, touching, fields, first, edge, free, force, weight * free / 2, length / cells)


# ---- incline ----


def incline(angle: float, cells: int, thickness: float, share: float):
    """A square sheet on a slope of `angle` degrees with mu = share tan(angle): path, problem, start, way down."""
    a = np.radians(angle)
    down, normal = np.array([np.cos(a), 0.0, -np.sin(a)]), np.array([np.sin(a), 0.0, np.cos(a)])
    points, triangles = plate(0.5, 0.5, 0.5 / cells)
    points = points[:, :1] * down + points[:, 1:2] * np.array([0.0, 1.0, 0.0])
    shell = shell_of(points, triangles, young=1e6, thickness=thickness, density=300.0)
    slope = Plane(name="slope", friction=share * np.tan(a), point=np.zeros(3), normal=normal)
    path, problem = solve(shell, slope)
    return path, problem, points, down


# ---- work, energy and dissipation ----


@dataclass
class Balance:
    """Work of the supports, gain of elastic energy and friction's dissipation mu N path (J) in each load step, by the
    trapezoidal rule: exact where forces and motions are linear in the load factor. Call it after each step."""

    x: np.ndarray  # (n, 3) m, as all below at the end of the last step
    elastic: float = 0.0
    force: np.ndarray | float = 0.0  # (n, 3) N, of the supports
    bound: np.ndarray | float = 0.0  # (n,) N, mu N of the vertices that slip
    steps: list[tuple[float, float, float]] = field(default_factory=list)

    def __call__(self, problem: Problem, y) -> None:
        x, force = problem.positions(y), problem.reactions(y)
        bound, way = np.zeros(len(x)), np.zeros(len(x))
        for pairs in problem.contact.pairs(x, problem.time):
            friction = problem.contact.obstacles[pairs.index].friction
            normal = pairs.project()[0]
            bound[pairs.vertex] = friction * normal * pairs.slips
            moved = (x - self.x)[pairs.vertex]
            sideways = moved - (moved * pairs.unit).sum(axis=1)[:, None] * pairs.unit
            way[pairs.vertex] = np.linalg.norm(sideways, axis=1)
        energies = problem.energies(y)
        elastic = energies["stretching"] + energies["bending"]
        work = 0.5 * ((force + self.force) * (x - self.x)).sum()
        lost = 0.5 * ((bound + self.bound) * way).sum()
        self.steps.append((float(work), elastic - self.elastic, float(lost)))
        self.x, self.elastic, self.force, self.bound = x, elastic, force, bound

    def totals(self) -> tuple[float, float, float]:
        work, gain, lost = np.sum(self.steps, axis=0)
        return work, gain, lost


def dragged(friction: float, cells: int, steps: int) -> tuple[Path, Balance, list[float]]:
    """A stiff sheet on a plane whose edge is pulled sideways while its weight grows: path, balance, and pull over
    the floor's force after each step, which is mu."""
    points, triangles = plate(0.5, 0.5, 0.5 / cells)
    edge = points[:, 0] > 0.5 - 1e-9
    supports = held(points, (edge, np.array([0.05, 0.0, 0.0])))
    shell = shell_of(points, triangles, young=1e9, thickness=5e-2, density=300.0, **supports)
    balance, pulls = Balance(points), []

    def record(problem, step, y):
        balance(problem, y)
        pulls.append(balance.force[:, 0].sum() / step.contact["obstacles"][0]["force"][2])

    floor = Plane(name="floor", friction=friction, point=np.zeros(3), normal=UP)
    path, _ = solve(shell, floor, steps, on_step=record)
    return path, balance, pulls


# ---- capstan ----


@dataclass
class Capstan:
    """Ratios of the tensions at the pulled and the held end after each step, while pulled and while let back."""

    path: Path
    balance: Balance
    pulled: list[float]
    back: list[float]


def capstan(degrees: float, friction: float, cells: int, steps: int = 5, back: float = 0.0) -> Capstan:
    """A strip around a drum, stretched from one end while the other is held, then let go by a share `back` of it."""
    angle, radius, tail, thickness, width = np.radians(degrees), 0.1, 0.03, 1e-4, 0.01
    length = radius * angle + 2 * tail
    plane, triangles = generator("patterns").grid(cells, 2, "alternating")
    along, across = plane[:, 0] * length, plane[:, 1] * width
    t = np.clip((along - tail) / radius, 0.0, angle)
    tangent = np.column_stack([-np.sin(t), 0 * t, np.cos(t)])
    beyond = np.minimum(along - tail, 0.0) + np.maximum(along - tail - radius * angle, 0.0)
    start = radius * np.column_stack([np.cos(t), 0 * t, np.sin(t)]) + beyond[:, None] * tangent
    start[:, 1] = across
    hold, pull = along < 1e-12, along > length - 1e-12
    balance = Balance(start)
    drum = Cylinder(
        name="drum", friction=friction, center=np.zeros(3), axis=np.array([0.0, 1.0, 0.0]), radius=radius
    )

    def turn(points, motion, history=None):
        ratios = []

        def record(problem, step, y):
            balance(problem, y)
            ends = [np.linalg.norm(balance.force[end].sum(axis=0)) for end in (pull, hold)]
            ratios.append(ends[0] / ends[1])

        shell = shell_of(
            points,
            triangles,
            rest=start,
            flat=False,
            young=1e8,
            thickness=thickness,
            density=1.0,
            gravity=np.zeros(3),
            model="koiter/average/stvk",
            **held(points, (hold, np.zeros(3)), (pull, motion * tangent[pull][0])),
        )
        path, problem = solve(shell, drum, steps, on_step=record, history=history)
        return path, problem, ratios

    stretch = 2e-3 * radius
    path, problem, pulled = turn(start, stretch)
    if not back or not path.converged:
        return Capstan(path, balance, pulled, [])
    path, _, returned = turn(problem.positions(path.state), -back * stretch, problem)
    return Capstan(path, balance, pulled, returned)


# ---- stick and slip ----


@dataclass
class Slip:
    """Lowerings over length between which the tip leaves its place (nan if it does not), and the path."""

    path: Path
    before: float
    after: float
    landed: (
        float  # lowering over length at which the strip's belly lies on the plane, nan if it does not before
    )


def lowered_strip(friction: float, low: float, cells: int, steps: int) -> Slip:
    """A weightless strip clamped upright above a plane that its tip stands on; the clamp is lowered by low lengths."""
    length, thickness = 1.0, 1e-3
    points, triangles = plate(length, 2 * length / cells, length / cells)
    points = np.column_stack([0 * points[:, 0], points[:, 1], points[:, 0]])
    top, tip = points[:, 2] > length - 1e-9, points[:, 2] < 1e-9
    shell = shell_of(
        points,
        triangles,
        young=1e9,
        thickness=thickness,
        density=1.0,
        gravity=np.zeros(3),
        **held(points, (top, -low * length * UP)),
    )
    shell.clamped_edges = np.flatnonzero(top[shell.topology.edges].all(axis=1)).astype(np.int32)
    seen = []

    def record(problem, step, y):
        x = problem.positions(y)
        seen.append((low * step.factor, abs(x[tip, 0].mean()), x[~tip, 2].min() < 1e-9 * length))

    floor = Plane(name="floor", friction=friction, point=np.zeros(3), normal=UP)
    path, _ = solve(shell, floor, steps, on_step=record)
    gone = next((k for k, row in enumerate(seen) if row[1] > 0.01 * length), None)
    held_on = seen[:gone]
    landed = next((row[0] for row in held_on if row[2]), np.nan)
    return Slip(path, held_on[-1][0], np.nan if gone is None else seen[gone][0], landed)


def slips() -> list[dict]:
    """The onsets that slip_onset gives, where the shared folder is."""
    return json.loads(CURVES.read_text())["stick_slip"] if CURVES.exists() else []


# ---- drapes ----


BALL = {"name": "ball", "center": np.zeros(3), "radius": 0.2}
BOX = {"name": "box", "center": np.zeros(3), "sizes": np.array([0.15, 0.15, 0.19])}


def drape(
    name: str, cells: int, friction: float = 0.5, depth: float = 0.0, **fabric
) -> tuple[Path, Problem, float]:
    """A square sheet of 0.6 m let down on a sphere or a box from just above it, or from `depth` (m) inside: path,
    problem, weight (N)."""
    on_box = name == "box"
    obstacle = Box(friction=friction, **BOX) if on_box else Sphere(friction=friction, **BALL)
    fabric = {"young": 1e6, "thickness": 2e-3} | fabric
    points, triangles = plate(0.6, 0.6, 0.6 / cells)
    shell = shell_of(points - [0.3, 0.3, depth - 0.2005], triangles, density=300.0, **fabric)
    path, problem = solve(shell, obstacle, offset=1e-2 if on_box else 0.0)
    return path, problem, 300.0 * 0.36 * fabric["thickness"] * GRAVITY


def pressed(travel: float, steps: int = 1, friction: float = 0.3, cells: int = 20) -> tuple[Path, Problem]:
    """A square sheet of 1 m held at two edges; a ball of 0.2 m across comes from below by `travel` (m)."""
    points, triangles = plate(1.0, 1.0, 1.0 / cells)
    edges = np.abs(points[:, 0] - 0.5) > 0.5 - 1e-9
    supports = held(points, (edges, np.zeros(3)))
    shell = shell_of(points, triangles, young=1e6, thickness=2e-3, density=300.0, **supports)
    motion = Motion(displacement=travel * UP)
    ball = Sphere(
        name="ball", friction=friction, center=np.array([0.5, 0.5, -0.15]), radius=0.1, motion=motion
    )
    return solve(shell, ball, steps)


def extremes() -> dict:
    """Hard cases by name: functions that return path and problem first."""
    cases = {}
    for name in ("sphere", "box"):
        cases |= {
            f"{name}, mu = {friction:g}": partial(drape, name, 14, friction)
            for friction in (0.0, 1e-3, 1.0, 10.0)
        }
        cases |= {
            f"{name}, E = {young:.0e} Pa": partial(drape, name, 14, young=young) for young in (1e3, 1e11)
        }
        cases[f"{name}, thickness 1e-6 of the size"] = partial(drape, name, 14, young=1e9, thickness=8.5e-7)
        cases[f"{name}, starts 2 % of the size inside"] = partial(drape, name, 14, depth=0.017)
    for friction in (0.0, 0.3):
        cases[f"ball, half its length in one step, mu = {friction:g}"] = partial(pressed, 0.1, 1, friction)
    cases["block on a plane, 625 contacts, mu = 0.9"] = partial(incline, 5.0, 24, 5e-2, 10.0)
    return cases
