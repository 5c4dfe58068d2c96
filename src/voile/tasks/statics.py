"""task = statics: the equilibria along the load path."""

import math
from typing import Any

from voile.errors import InputError
from voile.problem.problem import Problem
from voile.problem.shell import Shell
from voile.results.writer import CAPACITY
from voile.scene import Scene
from voile.solver.path import BIFURCATION, LIMIT_POINT, Path, StaticsOptions, load_steps
from voile.solver.statics import solve_statics
from voile.solver.stepping.arc_length import solve_arc
from voile.tasks.run import Run, Steps


def run(job: Run) -> str:
    """Solves a statics scene and writes its results; the reason why it did not converge, or empty."""
    options = options_of(job.scene)
    shell, problem = job.prepare()
    if job.scene.statics.control == "arc-length":
        return _along_the_arc(job, shell, problem, options)
    room = min(len(options.load_factors) or load_steps(problem, options), CAPACITY)
    with job.results(job.mesh(shell, problem.directors), room=room) as writer:
        steps = Steps(job, problem, writer)
        path = solve_statics(problem, options, on_step=steps, on_pause=steps.pause, found=job.found)
        steps.finish(path)
    _tell(job, path)
    job.summarise(problem, path, **job.forces(problem, path))
    return "" if path.converged else path.reason


def _along_the_arc(job: Run, shell: Shell | None, problem: Problem, options: StaticsOptions) -> str:
    """The same along the arc of the path, with its limit points and bifurcations."""
    s = job.scene.statics
    if not problem.load_norm(problem.create_vector()):
        raise InputError(
            f'{job.scene.path}: statics.control = "arc-length" without a load; allowed: with [loads]'
        )
    path = Path(state=problem.create_vector())
    job.so_far = lambda: _critical(path)
    with job.results(job.mesh(shell, problem.directors), numbered=True) as writer:
        steps = Steps(job, problem, writer, s.max_load_factor)
        solve_arc(problem, options, s.max_load_factor, s.branch, steps, steps.pause, job.found, path)
        steps.finish(path)
    bifurcations = len(path.found_by(BIFURCATION))
    if path.converged and s.branch > bifurcations:
        many = f"{bifurcations} bifurcation" + "s" * (bifurcations != 1)
        path.converged, path.reason = False, f"statics.branch = {s.branch}: {many} on the path"
    _tell(job, path)
    job.summarise(problem, path, **job.forces(problem, path), **_critical(path))
    return "" if path.converged else path.reason


def _critical(path: Path) -> dict[str, Any]:
    """The summary's limit points and bifurcations of a path."""
    return {
        f"{kind.replace(' ', '_')}s": [
            {"load_factor": step.factor, "displacement": step.displacement} for step in path.found_by(kind)
        ]
        for kind in (LIMIT_POINT, BIFURCATION)
    }


def options_of(scene: Scene) -> StaticsOptions:
    """Those of a scene's load path."""
    s = scene.statics
    return StaticsOptions(
        s.load_steps,
        s.max_steps,
        s.perturbation,
        s.tolerance,
        s.stability,
        s.eigenvalue,
        nested=s.nested and s.load_steps is None and not s.load_factors,
        load_factors=s.load_factors,
    )


def _tell(job: Run, path: Path) -> None:
    """Notes and says what a user should know of a path that ended well: jumps, and an end that is not stable, or not
    known to be."""
    said = []
    for jump in path.jumps:
        said.append(
            f"between load factors {jump.start:.4g} and {jump.end:.4g} the shell moves by {jump.moved:.3g} of its "
            f"size, {jump.times:.2g} times what the step before let expect: it snaps or buckles there"
        )
    if path.converged and path.stable is False:
        value = path.smallest_eigenvalue
        why = "" if value is None or math.isnan(value) else f", its smallest eigenvalue is {value:.3g} 1/s^2"
        said.append(f"the end state is an equilibrium but not stable{why}: disturbed, the shell leaves it")
    if path.converged and path.stable and path.smallest_eigenvalue == 0.0:
        said.append(
            "the end state is a neutral equilibrium: a motion costs nothing, and round-off chose the place"
        )
    if path.converged and path.stable is None:
        why = "" if job.scene.statics.stability else " (statics.stability = false)"
        said.append(f"whether the end state is stable was not tested{why}")
    for text in said:
        job.tell(text)
