"""task = inverse with inverse.estimate: parameters from observed equilibria."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

from voile.arrays import Reals
from voile.errors import InputError, NotConverged, on_root
from voile.inverse.estimate import Estimate, Estimation
from voile.inverse.observation import Observation, UnknownRest
from voile.mesh import METRES, read_rest, write_obj
from voile.problem.lifetime import Clock, TimeIsOver, until
from voile.problem.shell import Shell
from voile.scene import Scene, read_scene, unsupported
from voile.solver.linear import Counts
from voile.solver.path import Path as LoadPath
from voile.solver.sewing import sew
from voile.tasks.run import Run, rows
from voile.wiring import Model, build_model

if TYPE_CHECKING:
    from voile.contact.obstacle import Obstacle

FABRIC = "model", "bending", "material", "young", "poisson", "thickness", "density"


def estimate(job: Run) -> str:
    """As a task, for the parameters of a shell, from the scene's observation and those of inverse.also."""
    scene, model, comm = job.scene, job.model, job.comm
    found = on_root(comm, lambda: _further(scene, model) if model else [])
    others = found or [None] * len(scene.inverse.also)
    shell, unknown, observations, counts = None, None, [], Counts()
    if scene.shell.rest is None:
        shell = job.sewn()
        unknown = UnknownRest(job.problem(shell), shell, counts)
    else:
        others = [(scene, model), *others] if model else [None, *others]
    for other in others:
        sewn, observation = _observation(other, job, counts)
        observations.append(observation)
        shell = shell or sewn
    search = Estimation(observations, scene.inverse.estimate, scene.inverse.tolerance, unknown)
    try:
        with until(Clock(comm, scene.inverse.max_seconds)):
            result = search.solve(job.progress.estimate)
    except TimeIsOver:
        last = search.history[-1][1] if search.history else {}
        at = " at " * bool(last) + ", ".join(f"{name} = {value:.6g}" for name, value in last.items())
        raise NotConverged(f"estimation: inverse.max_seconds ended it{at}") from None
    problem = (unknown.observation if unknown else observations[0]).problem
    state = problem.create_vector() if unknown else result.states[0]
    if shell is not None and result.rest is not None:
        shell = replace(shell, rest_points=result.rest)
        write_obj(job.folder / "rest.obj", result.rest, shell.triangles, comment=f"{METRES}\nrest shape")
    with job.results(job.mesh(shell, problem.directors)) as writer:
        writer.write_step(1.0, scalars={"misfit": result.misfit}, **rows(problem, state))
    for name, value in result.values.items():
        job.progress.line(f"{name} = {value:.6g}, standard deviation {result.deviations[name]:.2g}")
    stable = all(observation.stable for observation in observations)
    path = LoadPath(state, converged=True, reason="estimate settled", counts=counts, stable=stable)
    job.summarise(
        problem, path, {"linear_solve": counts.seconds}, inverse=_figures(result, len(scene.inverse.also) + 1)
    )
    return ""


def _figures(result: Estimate, observations: int) -> dict[str, Any]:
    """What the summary tells of an estimation."""
    return {
        "estimate": {
            name: {"value": value, "deviation": result.deviations[name]}
            for name, value in result.values.items()
        },
        "misfit": result.misfit,
        "observations": observations,
        "forward_solves": result.forward_solves,
    }


def _further(scene: Scene, model: Model) -> list[tuple[Scene, Model]]:
    """Scenes and models of inverse.also. Raises InputError for one that cannot tell of the same fabric."""
    _check_start(scene)
    found = []
    for path in scene.inverse.also:
        other = read_scene(path)
        if other.scene.task != "inverse":
            raise InputError(
                f'{path}: scene.task is "{other.scene.task}"; allowed in inverse.also: "inverse"'
            )
        missing = unsupported(other)
        if missing:
            raise InputError(f"{path}: this version cannot run {'; '.join(missing)}")
        if (other.shell.rest is None) != (scene.shell.rest is None):
            raise InputError(
                f"{path}: shell.rest: allowed: the known rest shape in all scenes of an estimation, or in none"
            )
        _check_start(other)
        found.append((other, build_model(other)))
        triangles = found[-1][1].shell.triangles
        if scene.shell.rest is None and not (
            triangles.shape == model.shell.triangles.shape and (triangles == model.shell.triangles).all()
        ):
            raise InputError(f"{path}: shell.mesh: allowed without shell.rest: the triangles of {scene.path}")
        model.notes += _another_fabric(scene, other)
    return found


def _another_fabric(scene: Scene, other: Scene) -> list[str]:
    """Notes on what another scene knows differently of the shell."""
    known = {key: (getattr(scene.shell, key), getattr(other.shell, key)) for key in FABRIC}
    return [
        f"inverse.also: {other.path}: shell.{key} = {there} there, {here} here: another fabric, taken as given"
        for key, (here, there) in known.items()
        if key not in scene.inverse.estimate and here != there
    ]


def _check_start(scene: Scene) -> None:
    """Raises InputError for supports or bodies that only the shape before the observed one can place."""
    if scene.inverse.observed:
        return
    for k, fix in enumerate(scene.fix):
        if fix.clamp or fix.move:
            key = "clamp holds directors as they are in" if fix.clamp else "move leads away from"
            raise InputError(
                f"{scene.path}: fix.{k}.{key} the mesh; allowed with an estimation: the mesh from before, and "
                "inverse.observed"
            )
    for k, body in enumerate(scene.obstacle):
        if body.move:
            raise InputError(
                f"{scene.path}: obstacle.{k}.move leads away from the mesh; allowed with an estimation: the mesh from "
                "before, and inverse.observed"
            )


def _observation(
    other: tuple[Scene, Model] | None, job: Run, counts: Counts
) -> tuple[Shell | None, Observation]:
    """A scene's sewn shell (rank 0's) and what was observed of it; other: scene and model, on rank 0; counts: of the
    run."""
    comm = job.comm
    observed, steps, obstacles, offset = comm.bcast(on_root(comm, lambda: _seen(*other) if other else None))
    shell = sew(other[1].shell if other else None, comm)
    problem = job.problem(shell)
    local = None if observed is None else observed[problem.part.vertex]
    tables = (job.scene.shell, *job.scene.fabric)
    names = ("shear", "bending_warp", "bending_weft", "bending_twist")
    ruled = [name for name in names if all(getattr(table, name) is None for table in tables)]
    return shell, Observation(problem, local, obstacles, offset, steps, ruled, counts)


def _seen(scene: Scene, model: Model) -> tuple[Reals | None, int | None, tuple[Obstacle, ...], float]:
    """Observed positions (n, 3) m or None for the start shape, load steps from there, obstacles and offset (m)."""
    file, bodies = scene.inverse.observed, tuple(model.obstacles)
    if file is None:
        return None, 1, bodies, model.offset
    shape = read_rest(file, model.surface, scene.path.parent, scene.shell.scale).points
    return shape, scene.statics.load_steps, bodies, model.offset
