"""task = statics."""

import time
from pathlib import Path

from voile.tasks.common import find_layers, rows, summarise, versions
from voile.tasks.progress import Progress


def run_statics(scene, model, folder: Path, comm, progress: Progress, began: float) -> str:
    """Solves a statics scene (model: rank 0's) and writes its results to `folder`; the reason why it did not converge,
    or empty."""
    from voile.problem.contact import attach
    from voile.problem.discrete import Problem
    from voile.results import ResultWriter
    from voile.solver.path import StaticsOptions
    from voile.solver.sewing import sew
    from voile.solver.statics import solve_statics
    from voile.wiring import static_mesh

    s = scene.statics
    options = StaticsOptions(
        s.load_steps, s.max_steps, s.perturbation, s.tolerance, s.stability, s.eigenvalue
    )
    shell = sew(model.shell if model else None, comm)
    problem = Problem(shell, comm)
    problem.monitor = progress.iteration
    layers = find_layers(scene, model, shell, comm)
    bodies, offset = comm.bcast((model.obstacles, model.offset) if model else None)
    attach(problem, bodies, offset, layers)
    mesh = static_mesh(model, shell, problem.directors) if shell is not None else None
    writing, reached = 0.0, 0
    with ResultWriter(
        folder / "result.vtkhdf", comm, mesh=mesh, scene_text=scene.text, versions=versions()
    ) as writer:

        def write(factor: float, y, scalars: dict[str, float]) -> None:
            nonlocal writing
            start = time.perf_counter()
            writer.write_step(factor, scalars=scalars, **rows(problem, y))
            writing += time.perf_counter() - start

        def keep(step, y) -> None:
            write(step.factor, y, {"residual": step.residual, "converged": 1.0})

        def on_step(step, y) -> None:
            nonlocal reached
            progress.step(step)
            reached += 1
            if step.factor >= 1.0 or reached % scene.output.every == 0:
                keep(step, y)

        path = solve_statics(problem, options, on_step=on_step)
        if not path.converged and not reached:
            write(0.0, path.state, {"residual": float("inf"), "converged": 0.0})
        elif not path.converged and reached % scene.output.every:
            keep(path.steps[-1], path.state)  # the last good one
    seconds = {**problem.seconds, **path.seconds, "input_output": writing}
    summarise(scene, model, problem, path, folder, seconds, began)
    return "" if path.converged else path.reason
