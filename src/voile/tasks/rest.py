"""Rest shapes and flat panels of task = inverse: found, and written."""

import math
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from petsc4py import PETSc

from voile.arrays import Ints, Reals
from voile.elastic.weave import turned
from voile.errors import Hinged, on_root
from voile.inverse.flatten import FlatPanels
from voile.inverse.journal import Journal
from voile.inverse.pattern import write_rest_obj
from voile.inverse.result import InverseResult
from voile.inverse.solve import InverseOptions, Told, solve_inverse, solve_panels
from voile.mesh import METRES, Rest, write_obj
from voile.problem.constraints import build_constraints
from voile.problem.partition import gathered
from voile.problem.shell import Shell
from voile.problem.supports import without_flaps
from voile.scene import Scene
from voile.solver.path import Arrays
from voile.tasks.patterns import (
    cut_apart,
    draw,
    evenly,
    first_copies,
    gathered_in,
    lay_flat,
    moved,
    pattern_of_surface,
    write_pattern_files,
)
from voile.tasks.run import Run, rows
from voile.wiring import Model, warp_on

TURNED = np.radians(1.0)  # of the warp: the denim skirt of docs/fabrics.md, 6.9 degrees, hung otherwise

Found = tuple[InverseResult, FlatPanels | None, dict[str, Any] | None]


def find_surface(job: Run, shell: Shell | None, options: InverseOptions) -> Found:
    """The result, None, and the pattern's figures of a rest surface. Flaps that turn freely about a vertex or two are
    left out of the balance."""
    try:
        return _find(job, shell, options)
    except Hinged as flaps:
        if options.developable:
            raise
        job.note(
            f"{len(flaps.parts)} parts of the target hang by one or two vertices and turn freely, the first with "
            f"vertex {min(flaps.parts[0][1])}: they are left out of the balance, their weight hangs on those vertices, "
            "and their rest shape is the target's"
        )
        return _find(job, shell and without_flaps(shell, flaps.parts), options)


def _find(job: Run, shell: Shell | None, options: InverseOptions) -> Found:
    """`find_surface`, whose files are written before its proof: a long simulation may be stopped."""
    problem, figures, rest = job.problem(shell), None, None

    def write(z: PETSc.Vec) -> None:
        nonlocal figures, rest
        rest = gathered(problem, problem.positions(problem.create_vector()) + problem.motion(z))
        figures = on_root(job.comm, lambda: _write_surface(job, shell, rest))

    result = solve_inverse(
        problem,
        shell,
        *job.bodies(),
        options,
        layers=job.layers(shell),
        exempt=_borders(job.model),
        guess=_guess(job),
        told=_told(job, write),
        journal=_journal(job),
    )
    on_root(job.comm, lambda: _tell_of_warp(job, shell, rest))
    return result, None, figures


def _tell_of_warp(job: Run, shell: Shell | None, rest: Reals | None) -> None:
    """A note where the warp, which went along with the triangles, is another than the scene gives the rest shape that
    was found."""
    if job.model is None or shell is None or shell.weave is None or rest is None:
        return
    shape = Rest(rest, shell.triangles, False)
    angle = turned(rest, shell.triangles, shell.weave, warp_on(job.scene, job.model.surface, shape))
    if angle > TURNED:
        job.tell(
            f"the warp went along with its triangles: it lies up to {np.degrees(angle):.1f} degrees off where the "
            "scene's warp is on rest.obj, and so would be in another scene; by texture coordinates it goes along"
        )


def find_panels(job: Run, shell: Shell | None, options: InverseOptions) -> Found:
    """As `find_surface`, of flat panels, the second value (rank 0)."""
    comm = job.comm
    flat, cut = on_root(comm, lambda: _panels(job, shell)) or (None, None)
    problem, figures = job.problem(cut), None
    target = gathered(problem, problem.positions(problem.create_vector()))

    def write(coordinates: Reals) -> None:
        nonlocal flat, figures
        last = flat
        flat = on_root(comm, lambda: last and moved(last, coordinates))
        figures = on_root(comm, lambda: _write_panels(job, shell, flat, target))

    result, _ = solve_panels(
        problem,
        cut,
        flat,
        *job.bodies(),
        options,
        layers=job.layers(cut),
        even=evenly(flat, job.scene, comm),
        ease=gathered_in(flat, job.scene, job.model, comm),
        told=_told(job, write),
        journal=_journal(job),
    )
    return result, flat, figures


def _told(job: Run, found: Callable[..., None]) -> Told:
    """The progress, of steps, and who writes what is found."""
    progress = job.progress
    return Told(progress.fraction, progress.nearest, progress.optimisation, found)


def _journal(job: Run) -> Journal:
    """What the search goes on from, kept now and then; its result file is written at its end."""

    def pause(packed: Callable[[], Arrays]) -> None:
        if job.restarts.due():
            job.keep(job.restarts.step + 1, packed(), 0, time.perf_counter())

    return Journal(pause, job.found)


def _panels(job: Run, shell: Shell | None) -> tuple[FlatPanels, Shell]:
    """The target laid flat as panels, and the shell that they are."""
    assert job.model and shell
    flat = lay_flat(job.model, shell, job.scene, _sewn(shell), cut_overlaps=True)
    return flat, cut_apart(shell, flat)


def _sewn(shell: Shell) -> Reals:
    """(n, 3) the start shape with its seams closed."""
    return shell.points + build_constraints(shell, False).closure[: shell.points.size].reshape(-1, 3)


def _guess(job: Run) -> Reals | None:
    """(n, 3) the rest shape that the scene gives as first guess, None without."""
    return None if job.model is None or job.scene.shell.rest is None else job.model.rest.points


def _borders(model: Model | None) -> Ints | None:
    """Vertices where groups meet and on the scene's seams, which may have an angle defect."""
    if model is None:
        return None
    surface = model.surface
    lowest, highest = np.full(len(surface.points), np.inf), np.full(len(surface.points), -np.inf)
    for corner in surface.triangles.T:
        np.minimum.at(lowest, corner, surface.group)
        np.maximum.at(highest, corner, surface.group)
    return np.union1d(np.flatnonzero(lowest < highest), model.cuts)


def _standing(flat: FlatPanels | None) -> Ints | None:
    """(p,) the surface's vertex that a panel vertex stands for, -1 for further copies; None without panels."""
    if flat is None:
        return None
    vertex = np.full(len(flat.panels.vertex), -1)
    first = first_copies(flat)
    vertex[first] = np.arange(len(first))
    return vertex


def _kept(values: dict[str, Any], keep: Ints | None) -> dict[str, Any]:
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


def _title(scene: Scene) -> str:
    return f"rest shape of {scene.scene.name or scene.path}"


def _up(shell: Shell) -> Reals | None:
    return -shell.gravity if shell.gravity.any() else None


def _write_panels(job: Run, shell: Shell | None, flat: FlatPanels, target: Reals | None) -> dict[str, Any]:
    """rest.obj and the pattern of flat panels, whose vertices the target (p, 3) m has; the pattern's figures."""
    assert job.model and shell is not None and target is not None
    pattern = draw(flat, job.scene, job.model, _up(shell))
    write_rest_obj(
        job.folder / "rest.obj", flat.panels, pattern, target[first_copies(flat)], _title(job.scene)
    )
    return write_pattern_files(job.folder, pattern)


def _write_surface(job: Run, shell: Shell | None, rest: Reals | None) -> dict[str, Any]:
    """rest.obj of a rest shape (n, 3) m, its flat pattern as texture coordinates, and the pattern of least distortion;
    the pattern's figures."""
    assert job.model and shell and rest is not None
    s = job.model.surface
    laid = replace(shell, rest_points=rest)
    spec = job.scene.inverse
    figures, flat, corners = pattern_of_surface(
        job.folder, job.model, laid, rest, job.scene, _up(shell), picture=bool(spec.developable)
    )
    write_obj(
        job.folder / "rest.obj", rest, shell.triangles, flat, corners, groups=(s.group, s.group_names),
        stitches=s.stitches, comment=f"{METRES}\n{_title(job.scene)}",
    )  # fmt: skip
    return figures


def write_result(job: Run, shell: Shell | None, result: InverseResult, flat: FlatPanels | None) -> None:
    """result.vtkhdf: the target, then the simulation from it, with the rest shape found; flat: panels, where they were
    asked for."""
    problem, target, comm = result.target.problem, result.target, job.comm
    keep = comm.bcast(_standing(flat))
    rest = gathered(problem, target.x + problem.motion(result.rest))
    mode = gathered(problem, problem.motion(result.mode))
    if shell is not None:
        if result.trade:
            from voile.post.trade import draw_trade

            draw_trade(job.folder / "developability.png", result.trade)
        if flat:
            assert mode is not None
            mode = mode[first_copies(flat)]
            flat_points = np.column_stack([flat.coordinates, np.zeros(len(flat.coordinates))])
            shell = replace(shell, rest_points=flat_points, rest_triangles=flat.panels.corners, flat=True)
        else:
            assert rest is not None
            shell = replace(shell, rest_points=rest)
    directors = problem.directors and not flat
    with job.results(job.mesh(shell, directors, mode=mode)) as writer:
        at_target = rows(problem, target.rest.state(result.rest))
        if target.contacts:
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
                writer.write_step(
                    step, scalars=scalars, **_kept(rows(simulation.problem, simulation.path.state), keep)
                )
