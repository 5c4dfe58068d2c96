"""task = inverse: rest shapes, flat panels."""

import math
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from voile.errors import on_root
from voile.inverse.pattern import write_rest_obj
from voile.mesh import METRES, write_obj
from voile.problem.partition import gathered
from voile.results import ResultWriter, StaticMesh
from voile.tasks.common import find_layers, rows, summarise, versions
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

HOVERS = 1e-4  # sizes: gaps of contacts that bear
LOOSE = 1e-3  # sizes: a sag of panels that their seams may be to blame for


def run_inverse(scene, model, folder: Path, comm, progress: Progress, began: float) -> str:
    """As `run_statics` for the rest shape of an inverse scene, whose mesh is the target."""
    if scene.inverse.estimate:
        return run_estimation(scene, model, folder, comm, progress, began)
    from voile.inverse.result import inverse_report
    from voile.inverse.solve import InverseOptions
    from voile.solver.sewing import sew

    spec = scene.inverse
    shell = sew(_target_shell(model) if model else None, comm)
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
    start = time.perf_counter()
    solve = _solve_panels if spec.developable == "panels" else _solve_surface
    result, flat, figures = solve(scene, model, shell, folder, options, comm, progress)
    problem, report = result.target.problem, inverse_report(result) | {"pattern": figures}
    if model and result.tolerance > spec.tolerance:
        model.notes.append(
            f"inverse.tolerance: double precision holds the balance at the target to {result.residual:.1e} N, "
            f"{result.tolerance:.1e} of the loads; simulations are asked for no more"
        )
    (sunk, hover), size = report["reactions"].get("gaps") or (0.0, 0.0), problem.size()
    if model and max(-sunk, hover) > HOVERS * size:
        model.notes.append(
            f"what bears in the target lies {sunk:.2g} to {hover:.2g} m off what it touches: simulations here keep the "
            "gaps, a scene of statics closes them"
        )
    loose = spec.developable == "panels" and not scene.shell.seam_bending
    if model and loose and (report["sag"] or 1.0) > LOOSE:
        model.notes.append(
            "shell.seam_bending = false: the panels turn freely at their seams; true lets seams bend like the cloth, "
            "and panels hang nearer to the target"
        )
    _write_result(scene, model, shell, folder, result, flat, comm)
    rest = time.perf_counter() - start - sum(result.seconds.values())
    seconds = {**problem.seconds, **result.seconds, "input_output": rest}
    summarise(
        scene, model, problem, result.simulation.path, folder, seconds, began, result=result, inverse=report
    )
    sag, disturbed = (
        "none" if value is None else f"{value:.2e} of the size"
        for value in (report["sag"], report["sag_disturbed"])
    )
    beside = report["disturbance"]
    after = f"{disturbed} after a disturbance" if beside else "nothing is free to be disturbed"
    progress.line(f"sag {sag}, {after}; {result.reason}")
    return "" if result.converged else result.reason


def _solve_surface(scene, model, shell, folder: Path, options, comm, progress: Progress) -> tuple:
    """The result, None, and the pattern's figures of a rest surface, whose files are written before its proof: a long
    simulation may be stopped."""
    from voile.inverse.solve import solve_inverse
    from voile.problem.discrete import Problem

    problem, figures = Problem(shell, comm), None
    problem.monitor = progress.iteration
    bodies, offset = comm.bcast((model.obstacles, model.offset) if model else None)

    def write(z) -> None:
        nonlocal figures
        rest = gathered(problem, problem.positions(problem.create_vector()) + problem.motion(z))
        figures = on_root(comm, lambda: _write_surface(scene, model, shell, folder, rest))

    result = solve_inverse(
        problem,
        shell,
        bodies,
        offset,
        options,
        progress.fraction,
        progress.optimisation,
        _borders(model),
        _guess(scene, model),
        progress.nearest,
        find_layers(scene, model, shell, comm),
        write,
    )
    return result, None, figures


def _solve_panels(scene, model, shell, folder: Path, options, comm, progress: Progress) -> tuple:
    """As `_solve_surface`, of flat panels, the second value (rank 0)."""
    from voile.inverse.solve import solve_panels
    from voile.problem.discrete import Problem

    flat = on_root(comm, lambda: lay_flat(model, shell, _sewn(shell), apart=True))
    cut, figures = on_root(comm, lambda: cut_apart(shell, flat)), None
    problem = Problem(cut, comm)
    problem.monitor = progress.iteration
    bodies, offset = comm.bcast((model.obstacles, model.offset) if model else None)
    target = gathered(problem, problem.positions(problem.create_vector()))

    def write(coordinates: np.ndarray) -> None:
        nonlocal flat, figures
        flat = on_root(comm, lambda: moved(flat, coordinates))
        figures = on_root(comm, lambda: _write_panels(scene, shell, folder, flat, target))

    result, _ = solve_panels(
        problem,
        cut,
        flat,
        bodies,
        offset,
        options,
        progress.fraction,
        progress.optimisation,
        find_layers(scene, model, cut, comm),
        write,
    )
    return result, flat, figures


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
    """Vertices where groups meet and on the scene's seams, which may have an angle defect."""
    if model is None:
        return None
    surface = model.surface
    lowest, highest = np.full(len(surface.points), np.inf), np.full(len(surface.points), -np.inf)
    for corner in surface.triangles.T:
        np.minimum.at(lowest, corner, surface.group)
        np.maximum.at(highest, corner, surface.group)
    return np.union1d(np.flatnonzero(lowest < highest), model.cuts)


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


def _title(scene) -> str:
    return f"rest shape of {scene.scene.name or scene.path}"


def _up(shell) -> np.ndarray | None:
    return -shell.gravity if shell.gravity.any() else None


def _write_panels(scene, shell, folder: Path, flat, target: np.ndarray) -> dict:
    """rest.obj and the pattern of flat panels, whose vertices the target (p, 3) m has; the pattern's figures."""
    pattern = draw(flat, scene.inverse.seam_allowance, _up(shell))
    write_rest_obj(folder / "rest.obj", flat.panels, pattern, target[first_copies(flat)], _title(scene))
    return write_pattern_files(folder, pattern)


def _write_surface(scene, model, shell, folder: Path, rest: np.ndarray) -> dict:
    """rest.obj of a rest shape (n, 3) m, its flat pattern as texture coordinates, and the pattern of least distortion;
    the pattern's figures."""
    s = model.surface
    laid = replace(shell, rest_points=rest)
    spec = scene.inverse
    figures, flat, corners = pattern_of_surface(
        folder, model, laid, rest, spec.seam_allowance, _up(shell), picture=bool(spec.developable)
    )
    write_obj(
        folder / "rest.obj", rest, shell.triangles, flat, corners, groups=(s.group, s.group_names), stitches=s.stitches,
        comment=f"{METRES}\n{_title(scene)}",
    )  # fmt: skip
    return figures


def _write_result(scene, model, shell, folder: Path, result, flat, comm) -> None:
    """result.vtkhdf: the target, then the simulation from it, with the rest shape found; flat: panels, where they were
    asked for."""
    problem, target = result.target.problem, result.target
    keep = comm.bcast(_standing(flat))
    rest = gathered(problem, target.x + problem.motion(result.rest))
    mode = gathered(problem, problem.motion(result.mode))
    mesh: StaticMesh | None = None
    if comm.rank == 0:
        if result.trade:
            from voile.post.trade import draw_trade

            draw_trade(folder / "developability.png", result.trade)
        if flat:
            mode = mode[first_copies(flat)]
            flat_points = np.column_stack([flat.coordinates, np.zeros(len(flat.coordinates))])
            shell = replace(shell, rest_points=flat_points, rest_triangles=flat.panels.corners, flat=True)
        else:
            shell = replace(shell, rest_points=rest)
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
        residual = result.residual if result.exact else math.nan
        scalars = {"residual": residual, "converged": float(result.exact)}
        writer.write_step(0.0, scalars=scalars, **_kept(at_target, keep))
        for step, simulation in ((0.5, result.held), (1.0, result.simulation)):
            if simulation:
                path = simulation.path
                residual = path.steps[-1].residual if path.steps else math.nan
                scalars = {"residual": residual, "converged": float(path.converged)}
                writer.write_step(step, scalars=scalars, **_kept(_at_end(problem, simulation), keep))
