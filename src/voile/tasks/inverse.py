"""task = inverse: rest shapes, flat panels."""

import math
import time
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from voile.inverse.pattern import write_rest_obj
from voile.mesh import METRES, write_obj
from voile.results import ResultWriter, StaticMesh
from voile.tasks.common import find_layers, gathered, on_root, rows, summarise, versions
from voile.tasks.estimate import run_estimation
from voile.tasks.patterns import (
    cut_apart,
    draw,
    first_copies,
    lay_flat,
    moved,
    pattern_of_surface,
    write_pattern_files,
)
from voile.tasks.progress import Progress
from voile.wiring import static_mesh


def run_inverse(scene, model, folder: Path, comm, progress: Progress, began: float) -> str:
    """As `run_statics` for the rest shape of an inverse scene, whose mesh is the target."""
    if scene.inverse.estimate:
        return run_estimation(scene, model, folder, comm, progress, began)
    from voile.inverse.solve import InverseOptions, inverse_report, solve_inverse, solve_panels
    from voile.problem.discrete import Problem
    from voile.solver.sewing import sew

    spec = scene.inverse
    shell = sew(_target_shell(model) if model else None, comm)
    bodies, offset = comm.bcast((model.obstacles, model.offset) if model else None)
    layers_of = partial(find_layers, scene, model, comm=comm)
    options = InverseOptions(
        spec.friction,
        spec.contact_tolerance,
        spec.tolerance,
        spec.method,
        spec.margin,
        spec.regularisation,
        spec.iterations,
        developable=spec.developable == "constraint",
    )
    says = progress.fraction, progress.optimisation
    flat = None
    if spec.developable == "panels":
        flat = on_root(
            comm, lambda: lay_flat(model, shell, _sewn(shell), apart=True) if shell is not None else None
        )
        cut = cut_apart(shell, flat) if shell is not None and flat else None
        problem = Problem(cut, comm)
        coordinates = comm.bcast(flat.coordinates if flat else None)
        result, found = solve_panels(
            problem, cut, coordinates, bodies, offset, options, *says, layers=layers_of(cut)
        )
        flat = moved(flat, found) if flat else None
    else:
        problem = Problem(shell, comm)
        result = solve_inverse(
            problem,
            shell,
            bodies,
            offset,
            options,
            *says,
            _borders(model),
            _guess(scene, model),
            progress.nearest,
            layers_of(shell),
        )
    start = time.perf_counter()
    report = inverse_report(result)
    report["pattern"] = _write_rest(scene, model, shell, folder, result, flat, comm)
    seconds = {**problem.seconds, **result.seconds, "input_output": time.perf_counter() - start}
    summarise(
        scene, model, problem, result.simulation.path, folder, seconds, began, result=result, inverse=report
    )
    progress.line(
        f"sag {report['sag']:.2e} of the size, {report['sag_disturbed']:.2e} after a disturbance; "
        f"{result.reason}"
    )
    return "" if result.converged else result.reason


def _target_shell(model):
    """The model's shell with the target as rest shape: where the search starts."""
    s = model.shell
    return replace(s, rest_points=s.points, rest_triangles=s.triangles, flat=False)


def _sewn(shell) -> np.ndarray:
    """(n, 3) the start shape with its seams closed."""
    from voile.problem.constraints import build_constraints

    return shell.points + build_constraints(shell, False).gap[: shell.points.size].reshape(-1, 3)


def _guess(scene, model) -> np.ndarray | None:
    """(n, 3) the rest shape that the scene gives as first guess, None without."""
    return None if model is None or scene.shell.rest is None else model.rest.points


def _borders(model) -> np.ndarray | None:
    """Vertices where groups meet: seams, which may have an angle defect."""
    if model is None:
        return None
    surface = model.surface
    lowest, highest = np.full(len(surface.points), np.inf), np.full(len(surface.points), -np.inf)
    for corner in surface.triangles.T:
        np.minimum.at(lowest, corner, surface.group)
        np.maximum.at(highest, corner, surface.group)
    return np.flatnonzero(lowest < highest)


def _standing(flat) -> np.ndarray | None:
    """(p,) the surface's vertex that a panel vertex stands for, -1 for further copies; None without panels."""
    if flat is None:
        return None
    vertex = np.full(len(flat.panels.vertex), -1)
    first = first_copies(flat)
    vertex[first] = np.arange(len(first))
    return vertex


def _at_end(problem, simulation) -> dict:
    """As `rows`, of a simulation's end."""
    problem.contact = simulation.contact
    try:
        return rows(problem, simulation.path.state)
    finally:
        problem.contact = None


def _kept(values: dict, keep: np.ndarray | None) -> dict:
    """A step's rows for the surface's own vertices; panels have no director angles to store."""
    if keep is None:
        return values
    stands = keep[values["point_index"]] >= 0
    kept = {"points": values["points"][stands], "point_index": keep[values["point_index"]][stands]}
    if "point_data" in values:
        kept["point_data"] = {name: rows[stands] for name, rows in values["point_data"].items()}
    if "placements" in values:
        kept["placements"] = values["placements"]
    return kept


def _write_rest(scene, model, shell, folder: Path, result, flat, comm) -> dict | None:
    """result.vtkhdf (the target, then the simulation from it, with the rest shape found), rest.obj and the pattern;
    flat: panels, where they were asked for. The pattern's figures."""
    problem, target = result.target.problem, result.target
    keep = comm.bcast(_standing(flat))
    start = gathered(problem, target.x)
    rest = gathered(problem, target.x + problem.motion(result.rest))
    mode = gathered(problem, problem.motion(result.mode))
    mesh: StaticMesh | None = None
    figures: dict | None = None
    if comm.rank == 0:
        if result.trade:
            from voile.post.trade import draw_trade

            draw_trade(folder / "developability.png", result.trade)
        s, name = model.surface, f"rest shape of {scene.scene.name or scene.path}"
        up: np.ndarray | None = -shell.gravity if shell.gravity.any() else None
        allowance = scene.inverse.seam_allowance
        if flat:
            first = first_copies(flat)
            start, mode = start[first], mode[first]
            flat_points = np.column_stack([flat.coordinates, np.zeros(len(flat.coordinates))])
            shell = replace(shell, rest_points=flat_points, rest_triangles=flat.panels.corners, flat=True)
            pattern = draw(flat, allowance, up)
            figures = write_pattern_files(folder, pattern)
            write_rest_obj(folder / "rest.obj", flat.panels, pattern, start, name)
        else:
            shell = replace(shell, rest_points=rest)
            assert rest is not None  # gathered here
            figures = pattern_of_surface(folder, model, shell, rest, allowance, up)
            write_obj(
                folder / "rest.obj", rest, shell.triangles, groups=(s.group, s.group_names), stitches=s.stitches,
                comment=f"{METRES}\n{name}",
            )  # fmt: skip
        mesh = static_mesh(model, shell, problem.directors and not flat)
        mesh = replace(mesh, point_data={**mesh.point_data, "mode": mode})
    with ResultWriter(
        folder / "result.vtkhdf", comm, mesh=mesh, scene_text=scene.text, versions=versions()
    ) as writer:
        at_target = rows(problem, target.rest.state(result.rest))
        if target.touches:
            own = problem.part.owned_vertices
            at_target["point_data"] = {name: values[own] for name, values in target.fields().items()}
            at_target["placements"] = np.array([body.motion.matrix(0.0) for body in target.obstacles])
        writer.write_step(
            0.0, scalars={"residual": result.residual, "converged": 1.0}, **_kept(at_target, keep)
        )
        for step, simulation in ((0.5, result.held), (1.0, result.simulation)):
            if simulation:
                path = simulation.path
                residual = path.steps[-1].residual if path.steps else math.nan
                scalars = {"residual": residual, "converged": float(path.converged)}
                writer.write_step(step, scalars=scalars, **_kept(_at_end(problem, simulation), keep))
    return figures
