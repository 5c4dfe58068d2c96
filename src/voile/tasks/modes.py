"""task = modes: natural frequencies about the equilibrium that statics finds, or the load factors of buckling."""

import math
from dataclasses import replace

import numpy as np

from voile.arrays import Reals
from voile.errors import InputError, NotConverged
from voile.problem.problem import Problem
from voile.problem.shell import Shell
from voile.problem.supports import free_motions
from voile.solver.modes import Modes, buckling, free_displacements, vibrations
from voile.solver.path import LoadStep, Path, tolerance
from voile.solver.statics import solve_statics
from voile.tasks.run import Run, Steps, rows
from voile.tasks.statics import options_of


def run(job: Run) -> str:
    """Finds the equilibrium and its modes, writes both; the reason why there are none, or empty."""
    spec = job.scene.modes
    shell, problem = job.prepare()
    _check(job, problem)
    still, path = _equilibrium(job, shell, problem, spec.about)
    problem = problem.at(spec.about)
    if not path.converged:
        with job.results(job.mesh(shell, problem.directors)) as writer:
            Steps(job, problem, writer).finish(path)
        job.summarise(problem, path)
        return path.reason
    if spec.buckling:
        modes = buckling(still, path.state, spec.count, path.counts)
    else:
        modes = vibrations(still, path.state, spec.count, path.counts, _rigid(shell, still, path))
    path.seconds["linear_solve"] = path.counts.seconds
    _write(job, shell, problem, path, modes)
    if not len(modes.values):
        path.converged, path.reason = (
            False,
            "modes.buckling: nothing buckles under these loads, at any factor above 0"
            if spec.buckling
            else "modes: contacts hold the shell everywhere, so nothing vibrates",
        )
    figures = modes.values if spec.buckling else modes.frequencies
    path.stable = spec.buckling or bool(modes.values.min(initial=0.0) >= 0.0)
    _tell(job, figures)
    job.summarise(problem, path, modes={"buckling" if spec.buckling else "frequencies": figures})
    return "" if path.converged else path.reason


def _check(job: Run, problem: Problem) -> None:
    """Raises InputError for what has no modes."""
    scene, spec = job.scene, job.scene.modes
    most = free_displacements(problem)
    if spec.count > most:
        raise InputError(
            f"{scene.path}: modes.count = {spec.count}; allowed: at most {most}, the displacements that are free"
        )
    if not problem.conservative:
        raise InputError(
            f"{scene.path}: loads.pressure: up to a free boundary it has no potential, so the shell has no natural "
            "modes; allowed with task = modes: pressure on a shell that is closed, or whose boundary is held or "
            "slides in planes or along an axis"
        )
    if spec.buckling and problem.loads.pressed and problem.moves:
        raise InputError(
            f"{scene.path}: loads.pressure: allowed with modes.buckling = true: supports that do not move"
        )


def _equilibrium(job: Run, shell: Shell | None, problem: Problem, about: float) -> tuple[Problem, Path]:
    """The problem at a load factor, without obstacles that nothing presses it on, and the path to its equilibrium: of
    no steps where the shell starts in it."""
    start, y = problem.at(about), problem.create_vector()
    idle = problem.load_norm(y) == 0.0 and not problem.moves
    if idle:
        start = start.with_contact(None)
    options = options_of(job.scene)
    residual, wanted = problem.create_vector(), tolerance(start, y, options)
    start.residual(y, residual)
    if not math.isfinite(wanted):
        raise NotConverged("the loads are not finite")
    if not start.contact and residual.norm() <= wanted:
        here = LoadStep(about, 0, residual.norm(), wanted, start.energies(y), method="start")
        return start, Path(y, True, here.reason, [here])
    if about == 0.0:
        raise InputError(
            f"{job.scene.path}: modes.load_factor = 0: without loads the start shape is not in equilibrium; allowed: "
            "above 0, or shell.rest = shell.mesh"
        )
    scaled = problem if about == 1.0 else job.problem(_scaled(shell, about))
    path = solve_statics(scaled, options, on_step=lambda step, _: job.progress.step(step))
    for step in path.steps:
        step.factor *= about
    return start, path


def _rigid(shell: Shell | None, problem: Problem, path: Path) -> Reals | None:
    """(local vertices, 3, k) rigid motions that supports leave: they cost nothing where nothing loads the shell."""
    if problem.load_norm(path.state) or problem.moves or problem.contact:
        return None
    motions = problem.comm.bcast(None if shell is None else free_motions(shell))
    found: Reals | None = motions[problem.part.vertex]
    return found


def _scaled(shell: Shell | None, factor: float) -> Shell | None:
    """The shell with loads and motions times a factor."""
    if shell is None:
        return None
    patch, force = (None if v is None else factor * v for v in (shell.patch_pressure, shell.force))
    return replace(
        shell,
        gravity=factor * np.asarray(shell.gravity),
        pressure=factor * shell.pressure,
        patch_pressure=patch,
        motion=factor * shell.motion,
        force=force,
    )


def _write(job: Run, shell: Shell | None, problem: Problem, path: Path, modes: Modes) -> None:
    """One step: the equilibrium, with a shape (`mode_000` ..) and its figure for each mode."""
    kind, figures = (
        ("load_factor", modes.values) if job.scene.modes.buckling else ("frequency", modes.frequencies)
    )
    here = rows(problem, path.state)
    own = problem.part.owned_vertices
    shapes = {f"mode_{k:03d}": shape[own] for k, shape in enumerate(modes.shapes)}
    here["point_data"] = here.get("point_data", {}) | shapes
    scalars = {f"{kind}_{k:03d}": float(figure) for k, figure in enumerate(figures)}
    with job.results(job.mesh(shell, problem.directors)) as writer:
        writer.write_step(problem.time, scalars=scalars, **here)


def _tell(job: Run, figures: Reals) -> None:
    """What was found, in lines of the progress; what a user should know of it in notes."""
    spec = job.scene.modes
    unit = "load factor" if spec.buckling else "Hz"
    for k, figure in enumerate(figures):
        job.progress.line(f"mode {k:3d}  {figure:.6g} {unit}")
    if len(figures) < spec.count:
        job.note(f"modes.count: only {len(figures)} modes of {spec.count} asked for exist")
    if not spec.buckling and (figures < 0.0).any():
        job.note(
            "modes: the equilibrium is not stable; a negative frequency f stands for growth at the rate 2 pi |f|"
        )
