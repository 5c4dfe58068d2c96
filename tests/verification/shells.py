"""Shells with known answers: the large displacements of Sze, Liu & Lo (2004, Finite Elem. Anal. Des. 40, 1551-1569)
and inflated membranes. Builders return a Shell and the vertices where it is measured; cases return rows."""

import time
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from membranes import inflated, sphere_pressure
from mesh_helpers import generator
from mpi4py import MPI

from voile.elastic import model_name
from voile.problem.problem import Problem
from voile.problem.shell import Shell
from voile.solver.path import Path, StaticsOptions, require
from voile.solver.statics import solve_statics
from voile.validate import shells as cases
from voile.validate.shapes import shared_by_length
from voile.validate.shells import Case, only


class Row(NamedTuple):
    """One line of the verification table; error is relative unless the case says otherwise."""

    name: str
    mesh: str
    computed: float
    reference: float
    error: float


class Solution(NamedTuple):
    """Displacements (n, 3) at the full load, the load path, CPU seconds from arrays to the solution."""

    u: np.ndarray
    path: Path
    seconds: float
    triangles: int


def solve(shell: Shell, load_steps: int = 4) -> Solution:
    """Equilibrium on one process; raises NotConverged."""
    began = time.process_time()
    problem = Problem(shell, MPI.COMM_SELF)
    path = require(solve_statics(problem, StaticsOptions(load_steps=load_steps)))
    u = np.zeros_like(shell.points)
    u[problem.part.vertex] = problem.local(path.state)[0].reshape(-1, 3)
    return Solution(u, path, time.process_time() - began, len(shell.triangles))


def row(name: str, mesh: str, computed: float, reference: float) -> Row:
    return Row(name, mesh, float(computed), reference, abs(float(computed) / reference - 1.0))


def rates(rows: list[Row], sizes: list[float]) -> list[float]:
    """Observed order between consecutive meshes with sizes falling."""
    errors = np.log([r.error for r in rows])
    return list(np.diff(errors) / np.diff(np.log(sizes)))


def make(
    points, triangles, fixed, clamped, *, thickness, young, poisson, model="koiter", bending="tan", **given
):
    """A Shell of one fabric at rest where it starts. fixed: mask of vertices (n,) or axes (n, 3); clamped: masks
    (n,) of lines of vertices whose edges are held."""
    one = np.ones(len(triangles))
    shell = Shell(
        points=points,
        triangles=triangles.astype(np.int32),
        rest_points=points,
        rest_triangles=triangles.astype(np.int32),
        flat=bool(np.ptp(points[:, 2]) == 0.0),
        model=model_name(model, bending, given.pop("material", "stvk")),
        thickness=thickness * one,
        young=young * one,
        poisson=poisson * one,
        density=1000.0 * one,
        fixed=fixed if fixed.ndim == 2 else np.repeat(fixed[:, None], 3, axis=1),
        motion=np.zeros_like(points),
        **given,
    )
    edges = shell.topology.edges
    held = [line[edges].all(axis=1) for line in clamped]
    shell.clamped_edges = (
        np.flatnonzero(np.any(held, axis=0)).astype(np.int32) if held else np.zeros(0, np.int32)
    )
    return shell


def of_case(case: Case, load: float = 1.0, **given) -> Shell:
    """The Shell of a case under `load` times its forces; given: what differs."""
    fabric = {name: case.material[name] for name in ("thickness", "young", "poisson")}
    force = load * case.force if case.force.any() else None
    given = {"force": force, **fabric, **given}
    return make(case.mesh.points, case.mesh.triangles, case.fixed, case.clamped, **given)


def slit_annulus(radial: int, around: int, diagonals: str = "crossed", load: float = 1.0):
    """Shell, inner and outer vertex of the loaded lip."""
    case = cases.slit_annulus(radial, around, diagonals)
    return of_case(case, load), case.marks["inner"], case.marks["outer"]


def lifted_lip(points, triangles, loaded, clamped, bending: str = "tan", load: float = 1.0):
    """The annular plate with its force along one lip; shell, inner and outer vertex of that lip."""
    lip = np.flatnonzero(loaded)
    lip = lip[np.argsort(points[lip, 0])]
    force = shared_by_length(points, loaded, np.array([0.0, 0.0, 0.8 * 4.0 * load]))
    fabric = {"thickness": 0.03, "young": 21e6, "poisson": 0.0}
    shell = make(points, triangles, clamped, [clamped], bending=bending, force=force, **fabric)
    return shell, lip[0], lip[-1]


def irregular_annulus(size: float, bending: str):
    """The slit annular plate on an unstructured mesh; as slit_annulus."""
    points, triangles = generator("slit_annulus").slit_annulus(size=size, irregular=True)
    cut = (np.abs(points[:, 1]) < 1e-9) & (points[:, 0] > 0.0)
    above = np.zeros(len(points), dtype=bool)
    above[triangles[points[triangles].mean(axis=1)[:, 1] > 0.0]] = True
    return lifted_lip(points, triangles, cut & above, cut & ~above, bending=bending)


def pulled_cylinder(around: int, along: int, diagonals: str = "right", load: float = 1.0):
    """Shell (an eighth) and its points A under the force, B at 90 degrees, C at the free end above B."""
    case = cases.pulled_cylinder(around, along, diagonals)
    return of_case(case, load), *case.marks.values()


def pinched_hemisphere(around: int, up: int, diagonals: str = "right", bending: str = "tan"):
    """Shell (a quarter) and the vertices pulled outward (x axis) and pushed inward (y axis)."""
    case = cases.pinched_hemisphere(around, up, diagonals)
    return of_case(case, bending=bending), *case.marks.values()


def sphere_octant(n: int, thickness: float, pressure: float, model: str, material: str):
    """An eighth of the unit sphere on its planes of symmetry, n edges a side; E = 1e6, nu = 0.3."""
    place = [(i, j) for i in range(n + 1) for j in range(n + 1 - i)]
    number = {ij: k for k, ij in enumerate(place)}
    up = [(number[i, j], number[i + 1, j], number[i, j + 1]) for i, j in place if i + j < n]
    down = [(number[i + 1, j], number[i + 1, j + 1], number[i, j + 1]) for i, j in place if i + j < n - 1]
    points = np.array([(i, j, n - i - j) for i, j in place]) / n
    fixed = points == 0.0
    points = np.sin(0.5 * np.pi * points)
    points /= np.linalg.norm(points, axis=1)[:, None]
    return make(
        points,
        np.array(up + down),
        fixed,
        list(fixed.T),
        thickness=thickness,
        young=1e6,
        poisson=0.3,
        model=model,
        material=material,
        pressure=pressure,
    )


def inflated_cap(size: float, pressure: float, model: str):
    """Cap of the unit sphere, 30 degrees from pole to rim, pinned at the rim; E = 1e6, nu = 0.3, h = 1e-3."""
    points, triangles = generator("spherical_cap").spherical_cap(1.0, 30.0, size)
    rim = points[:, 2] < 1e-9
    shell = make(
        points, triangles, rim, [], thickness=1e-3, young=1e6, poisson=0.3, model=model, pressure=pressure
    )
    return shell, only(np.hypot(*points[:, :2].T) < 1e-9)


ANNULUS_LIMIT = 13.85, 17.48  # inner, outer: NGSolve's nonlinear Kirchhoff-Love shell, refined
ANNULUS_PATH = {0.1: (4.277, 5.876), 0.5: (10.468, 13.768), 1.0: (13.891, 17.528)}  # Sze, Liu & Lo 2004
CYLINDER_PATH = {
    0.25: (2.18, 3.087, 3.31),
    0.5: (2.473, 3.653, 3.718),
    1.0: (2.768, 4.551, 3.269),
}  # the same
CYLINDER_LIMIT = 2.736, 4.554, 3.287  # A, B, C: NGSolve's nonlinear Kirchhoff-Love shell, its finest mesh
HEMISPHERE = 4.067, 8.178  # outward, inward: the same
HEMISPHERE_LIMIT = 4.073, 8.143  # NGSolve, refined


def annulus_path() -> list[Row]:
    """Slit annular plate against the published path."""
    rows = []
    for load, published in ANNULUS_PATH.items():
        shell, inner, outer = slit_annulus(8, 96, load=load)
        u = solve(shell).u
        for name, at, value in zip(("inner", "outer"), (inner, outer), published, strict=True):
            rows.append(
                row(f"slit annulus, {name} lift at {load:g} of the load", "8x96 crossed", u[at, 2], value)
            )
    return rows


def annulus_refined(meshes=((3, 24), (6, 48), (12, 96))) -> list[Row]:
    """The inner lift on finer and finer meshes against NGSolve's limit."""
    rows = []
    for n in meshes:
        shell, inner, _ = slit_annulus(*n)
        name = f"{n[0]}x{n[1]} crossed"
        rows.append(row("slit annulus, inner lift", name, solve(shell, 2).u[inner, 2], ANNULUS_LIMIT[0]))
    return rows


def annulus_irregular(bending: str, sizes=(1.0, 0.5, 0.25)) -> list[Row]:
    """The inner lift on unstructured meshes (gmsh)."""
    rows = []
    for size in sizes:
        shell, inner, _ = irregular_annulus(size, bending)
        name = f"slit annulus, inner lift ({bending})"
        rows.append(row(name, f"irregular, edges {size:g}", solve(shell).u[inner, 2], ANNULUS_LIMIT[0]))
    return rows


def cylinder_path() -> list[Row]:
    """Open cylinder pulled out against the published path, before and after it snaps near 0.515 of the load."""
    rows = []
    for load, published in CYLINDER_PATH.items():
        shell, a, b, c = pulled_cylinder(24, 24, load=load)
        u = solve(shell).u
        measured = u[a, 0], -u[b, 1], -u[c, 1]
        for name, value, expected in zip(
            ("A outward", "B inward", "C inward"), measured, published, strict=True
        ):
            rows.append(
                row(f"pulled cylinder, {name} at {load:g} of the load", "24x24 right", value, expected)
            )
    return rows


def cylinder_end() -> list[Row]:
    """Open cylinder at its full load against a Kirchhoff-Love program (the published values allow shear)."""
    shell, a, b, c = pulled_cylinder(24, 24)
    u = solve(shell).u
    measured = zip(
        ("A outward", "B inward", "C inward"), (u[a, 0], -u[b, 1], -u[c, 1]), CYLINDER_LIMIT, strict=True
    )
    return [row(f"pulled cylinder, {name}", "24x24 right", value, limit) for name, value, limit in measured]


def hemisphere_refined(meshes=(16, 32, 64), diagonals: str = "crossed") -> list[Row]:
    """Pushed point of the hemisphere against NGSolve's limit."""
    rows = []
    for n in meshes:
        shell, _, pushed = pinched_hemisphere(n, n, diagonals)
        value = -solve(shell).u[pushed, 1]
        rows.append(row("pinched hemisphere, inward", f"{n}x{n} {diagonals}", value, HEMISPHERE_LIMIT[1]))
    return rows


def hemisphere_published() -> list[Row]:
    """Both points of the hemisphere against the published values."""
    shell, pulled, pushed = pinched_hemisphere(24, 24)
    u = solve(shell).u
    return [
        row("pinched hemisphere, outward", "24x24 right", u[pulled, 0], HEMISPHERE[0]),
        row("pinched hemisphere, inward", "24x24 right", -u[pushed, 1], HEMISPHERE[1]),
    ]


def sphere_refined(
    model: str, material: str, thickness: float, stretch: float, meshes=(4, 8, 16)
) -> list[Row]:
    """Radius of an inflated sphere against its closed form."""
    rows = []
    pressure = sphere_pressure(stretch, thickness, material, bends=model == "koiter")
    for n in meshes:
        shell = sphere_octant(n, thickness, pressure, model, material)
        radius = np.linalg.norm(shell.points + solve(shell).u, axis=1).mean()
        name = f"inflated sphere, radius ({model}, {material}, h/R = {thickness:g})"
        rows.append(row(name, f"octant, {n} edges a side", radius, stretch))
    return rows


def cap_refined(model: str, meshes=(6, 12, 24)) -> list[Row]:
    """Height of an inflated cap against the membrane solution."""
    rows = []
    pressure = 0.1 * 1e6 * 1e-3  # a tenth of E h / R
    _, height = inflated(0.1, 1.0, np.pi / 6)
    for rings in meshes:
        shell, pole = inflated_cap(np.pi / 6 / rings, pressure, model)
        value = shell.points[pole, 2] + solve(shell).u[pole, 2]
        rows.append(row(f"inflated cap, height ({model})", f"{rings} rings", value, height))
    return rows


CASES: dict[str, Callable[[], list[Row]]] = {
    "slit annulus: load path": annulus_path,
    "slit annulus: refinement": annulus_refined,
    "slit annulus: irregular meshes": lambda: annulus_irregular("tan"),
    "slit annulus: irregular meshes, average": lambda: annulus_irregular("average"),
    "pulled cylinder: load path": cylinder_path,
    "pulled cylinder: full load": cylinder_end,
    "pinched hemisphere: published": hemisphere_published,
    "pinched hemisphere: refinement": hemisphere_refined,
    "inflated sphere: membrane, stvk": lambda: sphere_refined("membrane", "stvk", 1e-3, 1.5),
    "inflated sphere: membrane, neo-hookean": lambda: sphere_refined("membrane", "neo-hookean", 1e-3, 1.2),
    "inflated sphere: thin koiter": lambda: sphere_refined("koiter", "stvk", 1e-4, 1.5),
    "inflated cap: membrane": lambda: cap_refined("membrane"),
    "inflated cap: koiter": lambda: cap_refined("koiter"),
}
