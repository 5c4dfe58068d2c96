"""task = statics: the equilibria along the load path."""

from voile.solver.path import StaticsOptions
from voile.solver.statics import solve_statics
from voile.tasks.run import Run, Steps


def run(job: Run) -> str:
    """Solves a statics scene and writes its results; the reason why it did not converge, or empty."""
    s = job.scene.statics
    options = StaticsOptions(
        s.load_steps,
        s.max_steps,
        s.perturbation,
        s.tolerance,
        s.stability,
        s.eigenvalue,
        nested=s.nested and s.load_steps is None,
    )
    shell, problem = job.prepare()
    with job.results(job.mesh(shell, problem.directors)) as writer:
        steps = Steps(job, problem, writer)
        path = solve_statics(problem, options, on_step=steps)
        steps.finish(path)
    job.summarise(problem, path)
    return "" if path.converged else path.reason
