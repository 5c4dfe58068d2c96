"""task = inverse: rest shapes, flat panels, parameters."""

import time
from dataclasses import replace
from pathlib import Path

from voile.tasks.common import gathered, rows, summarise, versions
from voile.tasks.progress import Progress


def run_inverse(scene, model, folder: Path, comm, progress: Progress, began: float) -> str:
    """As `run_statics` for the rest shape of an inverse scene, whose mesh is the target."""
    if scene.inverse.estimate:
        return _run_estimation(scene, model, folder, comm, progress, began)
    from voile.inverse.solve import InverseOptions, inverse_report, solve_inverse
    from voile.problem.discrete import Problem
    from voile.solver.sewing import sew

    spec = scene.inverse
    shell = sew(_target_shell(model), comm) if model else sew(None, comm)
    problem = Problem(shell, comm)
    bodies, offset = comm.bcast((model.obstacles, model.offset) if model else None)
    options = InverseOptions(
        spec.friction,
        spec.contact_tolerance,
        spec.tolerance,
        spec.method,
        spec.regularisation,
        spec.iterations,
    )
    result = solve_inverse(problem, shell, bodies, offset, options, progress.fraction, progress.optimisation)
    start = time.perf_counter()
    _write_rest(scene, model, shell, folder, result, comm)
    report = inverse_report(result)
    seconds = {**problem.seconds, **result.seconds, "input_output": time.perf_counter() - start}
    summarise(
        scene, model, problem, result.simulation.path, folder, seconds, began, result=result, inverse=report
    )
    progress.line(
        f"sag {report['sag']:.2e} of the size, {report['sag_disturbed']:.2e} after a disturbance; "
        f"{result.reason}"
    )
    return "" if result.converged else result.reason


def _run_estimation(scene, model, folder: Path, comm, progress: Progress, began: float) -> str:
    """Parameters of the shell from its observed shape, the scene's mesh, and its known rest shape."""
    from voile.inverse.estimate import Estimation
    from voile.problem.discrete import Problem
    from voile.results import ResultWriter
    from voile.solver.path import Path as LoadPath
    from voile.solver.sewing import sew
    from voile.wiring import static_mesh

    shell = sew(model.shell if model else None, comm)
    problem = Problem(shell, comm)
    estimation = Estimation(problem, scene.inverse.estimate, scene.inverse.tolerance)
    found = estimation.solve(progress.estimate)
    mesh = static_mesh(model, shell, problem.directors) if shell is not None else None
    with ResultWriter(
        folder / "result.vtkhdf", comm, mesh=mesh, scene_text=scene.text, versions=versions()
    ) as writer:
        writer.write_step(1.0, scalars={"misfit": found.misfit}, **rows(problem, found.state))
    report = {
        "estimate": {
            name: {"value": value, "deviation": found.deviations[name]}
            for name, value in found.values.items()
        },
        "misfit": found.misfit,
        "forward_solves": found.forward_solves,
    }
    for name, value in found.values.items():
        progress.line(f"{name} = {value:.6g}, standard deviation {found.deviations[name]:.2g}")
    path = LoadPath(found.state, converged=True, reason="estimate settled", stable=True)
    summarise(scene, model, problem, path, folder, dict(problem.seconds), began, inverse=report)
    return ""


def _target_shell(model):
    """The model's shell with the target as rest shape: where the search starts."""
    s = model.shell
    return replace(s, rest_points=s.points, rest_triangles=s.triangles, flat=False)


def _write_rest(scene, model, shell, folder: Path, result, comm) -> None:
    """result.vtkhdf (the target, then the simulation from it, with the rest shape found) and rest.obj."""
    import numpy as np

    from voile.mesh import METRES, write_obj
    from voile.results import ResultWriter
    from voile.wiring import static_mesh

    problem, target = result.target.problem, result.target
    part, own = problem.part, problem.part.owned_vertices
    rest = gathered(problem, target.x + problem.motion(result.rest))
    mode = gathered(problem, problem.motion(result.mode))
    mesh = None
    if comm.rank == 0:
        mesh = static_mesh(model, replace(shell, rest_points=rest), problem.directors)
        mesh = replace(mesh, point_data={**mesh.point_data, "mode": mode})
        s = model.surface
        write_obj(
            folder / "rest.obj", rest, shell.triangles, groups=(s.group, s.group_names), stitches=s.stitches,
            comment=f"{METRES}\nrest shape of {scene.scene.name or scene.path}",
        )  # fmt: skip
    with ResultWriter(
        folder / "result.vtkhdf", comm, mesh=mesh, scene_text=scene.text, versions=versions()
    ) as writer:
        at_target = rows(problem, target.rest.state(result.rest))
        fields = {name: values[own] for name, values in target.fields().items()}
        if fields:
            at_target |= {"point_data": fields}
            at_target["placements"] = np.array([body.motion.matrix(0.0) for body in target.obstacles])
        writer.write_step(0.0, scalars={"residual": result.residual, "converged": 1.0}, **at_target)
        simulated, path = at_target, result.simulation.path
        with target.obstructed():
            simulated = rows(problem, path.state)
        writer.write_step(1.0, scalars={"residual": 0.0, "converged": float(path.converged)}, **simulated)
    assert part is problem.part
