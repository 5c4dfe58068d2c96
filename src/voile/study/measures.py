"""What a study measures: figures of summaries, and displacements and forces at selected vertices."""

import difflib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from voile.arrays import Ints, Reals, sums
from voile.errors import InputError
from voile.mesh import Surface, build_topology, read_mesh, refine, select, surface_loops
from voile.results import read_result
from voile.scene import Scene
from voile.scene.reader import KeyPath
from voile.study.problems import FIGURES as OF_PROBLEMS
from voile.study.problems import Problem
from voile.study.schema import Point, Study

FACETS = 1e-6  # of the size: how far midpoints lie off a smooth surface, and not by round-off
DISPLACEMENT, ENERGY = "max_displacement", "energy"
# Figures of summaries: names below each, () where there are none, None where tasks add their own.
_CONTACT = ("active", "stick", "slip", "max_penetration", "friction_error")
_ENERGY = ("stretching", "bending", "gravity", "pressure", "force", "springs")
FIGURES: dict[str, tuple[str, ...] | None] = {
    **dict.fromkeys(("dofs", "steps", "newton_iterations", "linear_solves", "factorisations"), ()),
    **dict.fromkeys(("residual_norm", "residual_tolerance", "peak_memory_mib", "ranks"), ()),
    "energy": _ENERGY,
    "contact": _CONTACT,
    **dict.fromkeys(("contact.obstacles", "supports", "sections", "wall_time_s")),
}
TABLES = {"supports": "fix", "sections": "section"}  # figures of each of these tables of a scene
OF_TASK: dict[str, dict[str, tuple[str, ...] | None]] = {
    "statics": {"load_factor": (), "smallest_eigenvalue": (), "limit_points": None, "bifurcations": None},
    "dynamics": {"dynamics": None},
    "inverse": {"smallest_eigenvalue": (), "inverse": None},
    "modes": {"modes": None, "buckling": None, "smallest_eigenvalue": (), "load_factor": ()},
}


@dataclass(frozen=True)
class Measure:
    """A number of a result: at a point, or a figure."""

    name: str
    point: Point | None


def find_measures(
    study: Study, scene: Scene | Problem, refuse: Callable[[str, KeyPath], InputError]
) -> tuple[Measure, ...]:
    """The study's, as far as its scene tells. Raises `refuse`'s error for one that no run produces."""
    points = {point.name: point for point in study.point}
    if isinstance(scene, Problem):
        if points:
            raise refuse("a friction problem has no points; allowed: [[point]] of a scene", ("point", 0))
        for name in study.study.measures:
            if name not in OF_PROBLEMS:
                problem = f'no friction problem has "{name}"; allowed: {", ".join(OF_PROBLEMS)}'
                raise refuse(problem, ("study", "measure"))
        return tuple(Measure(name, None) for name in study.study.measures)
    surface, tasks = surface_of(scene), _tasks(study, scene)
    touches = scene.obstacle or scene.contact.self_contact
    touches = touches or any(name.startswith(("obstacle", "contact")) for name in study.names)
    known = FIGURES | {name: below for task in tasks for name, below in OF_TASK[task].items()}
    for k, point in enumerate(study.point):
        if _is_figure(point.name, known):
            problem = f'"{point.name}" is a figure of all runs; allowed: another name'
            raise refuse(problem, ("point", k, "name"))
        at: KeyPath = ("point", k, "of")
        if point.of == "velocity" and "dynamics" not in tasks:
            raise refuse(f'"velocity" with task = {scene.scene.task}; allowed with task = dynamics', at)
        if point.of == "reaction" and not touches:
            raise refuse('"reaction" of a scene without [[obstacle]] or self_contact; nothing is touched', at)
        try:
            _selected(surface, point)
        except InputError as error:
            raise refuse(str(error).partition("select: ")[2] or str(error), ("point", k, "select")) from None
    for name in study.study.measures:
        if name not in points and not _is_figure(name, known):
            allowed = [*points, DISPLACEMENT, *_dotted(known)]
            close = difflib.get_close_matches(name, allowed, n=1)
            hint = f' (did you mean "{close[0]}"?)' if close else ""
            raise refuse(f'no run has "{name}"{hint}; allowed: {", ".join(allowed)}', ("study", "measure"))
        head, _, tail = name.partition(".")
        number, count = tail.partition(".")[0], len(getattr(scene, TABLES.get(head, ""), ()))
        if head in TABLES and not (number.isdecimal() and int(number) < count):
            problem = f'no run has "{name}": {scene.path} has {count} [[{TABLES[head]}]]'
            raise refuse(
                f"{problem}; allowed: {head}.0 to {head}.{count - 1}" if count else problem,
                ("study", "measure"),
            )
    return tuple(Measure(name, points.get(name)) for name in study.study.measures)


def _tasks(study: Study, scene: Scene) -> list[str]:
    """Tasks of the study's runs."""
    varied = [*study.vary.get("scene.task", []), *(case.set.get("scene.task") for case in study.case)]
    return [task for task in OF_TASK if task in (scene.scene.task, *varied)]


def _is_figure(name: str, known: dict[str, tuple[str, ...] | None]) -> bool:
    head, _, tail = name.partition(".")
    below = known.get(head, ())
    inside = any(name.startswith(f"{open}.") for open, under in known.items() if under is None)
    return name in (DISPLACEMENT, ENERGY) or inside or (head in known and tail in (below or ("",)))


def _dotted(known: dict[str, tuple[str, ...] | None]) -> list[str]:
    found = []
    for head, below in known.items():
        found += [f"{head}.{tail}" for tail in below] if below else [head if below == () else f"{head}.*"]
    return [ENERGY, *found]


def surface_of(scene: Scene) -> Surface:
    """The scene's mesh. Raises InputError."""
    spec = scene.shell
    surface = read_mesh(spec.mesh, spec.scale, spec.seams, spec.joints)
    return refine(surface, spec.refine, f"{scene.path}: shell.refine", spec.refine_smooth)


def keeps_facets(scene: Scene) -> bool:
    """Whether refinement by midpoints keeps facets, or corners of the border, of a mesh that stands for a smooth shell:
    its limit is theirs."""
    spec = scene.shell
    surface = read_mesh(spec.mesh, spec.scale, spec.seams, spec.joints)
    at = f"{scene.path}: shell.refine"
    middle, smooth = (refine(surface, 1, at, rounded).points for rounded in (False, True))
    return bool(np.abs(smooth - middle).max() > FACETS * np.ptp(surface.points, axis=0).max())


def _selected(surface: Surface, point: Point) -> Ints:
    return select(
        surface,
        surface_loops(surface, build_topology(surface.triangles)),
        point.select,
        f"point {point.name}: select",
    )


def values(
    measures: tuple[Measure, ...], scene: Scene | Problem, folder: Path, summary: dict[str, Any]
) -> dict[str, float | None]:
    """Each measure's value in the results of a scene; None for one that is not there."""
    surface = None
    if isinstance(scene, Scene) and any(m.point for m in measures):
        surface = surface_of(scene)
    found: dict[str, float | None] = {}
    for m in measures:
        if m.point and surface:
            found[m.name] = _at_point(m.point, surface, folder)
        elif m.name == DISPLACEMENT:
            with read_result(folder) as result:
                found[m.name] = float(np.linalg.norm(result.points(-1) - result.start, axis=1).max())
        else:
            found[m.name] = figure(summary, m.name)
    return found


def figure(summary: dict[str, Any], name: str) -> float | None:
    """A figure of a summary by its dotted name, lists by index or their length as vectors; energy is the sum."""
    node: Any = summary
    for part in name.split("."):
        if isinstance(node, dict):
            node = node.get(part)
        elif isinstance(node, list) and part.isdecimal() and int(part) < len(node):
            node = node[int(part)]
        else:
            return None
    if name == ENERGY and isinstance(node, dict):
        node = sum(node.values())
    if isinstance(node, list) and node and all(isinstance(v, int | float) for v in node):
        node = float(np.linalg.norm(node))
    return float(node) if isinstance(node, int | float) and not isinstance(node, bool) else None


def _at_point(point: Point, surface: Surface, folder: Path) -> float:
    """Mean over the selection of a component or length; of reactions that of their sum."""
    chosen = _selected(surface, point)
    with read_result(folder) as result:
        x = result.points(-1)
        fields: dict[str, Callable[[], Reals]] = {
            "displacement": lambda: x - result.start,
            "position": lambda: x,
            "velocity": lambda: result.field("velocity"),
            "reaction": lambda: result.field("reaction"),
        }
        field = fields[point.of]()
    if point.of == "reaction":
        field, weight = field[chosen].sum(axis=0, keepdims=True), np.ones(1)
    else:
        weight = mean_weights(surface, chosen, on_border="boundary" in point.select)
    part = np.linalg.norm(field, axis=1) if point.axis == "norm" else field[:, "xyz".index(point.axis)]
    return float(weight @ part / weight.sum())


def mean_weights(surface: Surface, chosen: Ints, on_border: bool = False) -> Reals:
    """(n,) weights of a mean over selected vertices that finer meshes agree on: by the area of their triangles if each
    is in one, else by the length of their edges on the border, else of all their edges, else all alike; on_border:
    no areas."""
    n, triangles = len(surface.points), surface.triangles
    inside = np.zeros(n, dtype=bool)
    inside[chosen] = True
    topology = build_topology(triangles)
    border = topology.edges[topology.boundary_edges]
    for cells in (border, topology.edges) if on_border else (triangles, border, topology.edges):
        own = cells[inside[cells].all(axis=1)]
        if len(own) and np.isin(chosen, own).all():
            x = surface.points[own]
            size = np.linalg.norm(
                x[:, 1] - x[:, 0] if own.shape[1] == 2 else np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]),
                axis=1,
            )
            return sums(own.ravel(), np.repeat(size / own.shape[1], own.shape[1]), n)
    return inside.astype(float)
