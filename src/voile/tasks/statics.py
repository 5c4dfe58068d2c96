"""task = statics: the equilibria along the load path."""

from voile.scene import Scene
from voile.solver.path import StaticsOptions
from voile.solver.statics import solve_statics
from voile.tasks.run import Run, Steps


def run(job: Run) -> str:
    """Solves a statics scene and writes its results; the reason why it did not converge, or empty."""
    options = options_of(job.scene)
    shell, problem = job.prepare()
    with job.results(job.mesh(shell, problem.directors)) as writer:
        steps = Steps(job, problem, writer)
        path = solve_statics(problem, options, on_step=steps)
        steps.finish(path)
    job.summarise(problem, path)
    return "" if path.converged else path.reason


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
        nested=s.nested and s.load_steps is None,
    )
