"""task = dynamics: the motion in time from the scene's start."""

from voile.problem.damping import Damping
from voile.problem.problem import Problem
from voile.scene.tasks import Dynamics
from voile.solver.methods.local_global import LocalGlobal
from voile.solver.methods.local_global import Options as LocalGlobalOptions
from voile.solver.path_in_time import TimeOptions
from voile.solver.stepping.blame import depth_inside
from voile.solver.stepping.newton_step import NewtonStep
from voile.solver.stepping.schemes import SCHEMES, SchemeOptions
from voile.solver.stepping.time_path import Stepper, StepSolver, let_out
from voile.tasks.in_time import TimeSteps, air, begun, figures
from voile.tasks.run import Run


def run(job: Run) -> str:
    """Solves a dynamics scene and writes its results; the reason why it did not reach its end, or empty."""
    d = job.scene.dynamics
    job.progress.parameter = "time"
    scheme = SCHEMES[d.scheme](SchemeOptions(d.spectral_radius, d.theta, d.keeps))
    options = TimeOptions(
        scheme,
        d.time_step,
        d.duration,
        d.tolerance,
        air(job),
        Damping(d.damping.mass, d.damping.stiffness),
        accuracy=d.accuracy if d.adaptive else 0.0,
        stop_at_rest=d.stop_at_rest,
        advice=_advice(d),
    )
    shell, problem = job.prepare()
    problem = problem.at(0.0)
    path = begun(job, problem)
    deep, body = depth_inside(problem, path.state) if not path.count else (0.0, "")
    if deep:
        job.tell(
            f"the shell starts up to {deep:.3g} m deep in {body}, half its thickness counted: it is let out within "
            f"{let_out(problem):.3g} s"
        )
    with job.results(job.mesh(shell, problem.directors)) as writer:
        steps = TimeSteps(job, problem, writer, path, d.duration)
        Stepper(problem, options, step_solver(job, problem), path).follow(steps)
        steps.finish(path)
    if path.short:
        told, by = (
            f"{path.short} of {path.count} steps",
            f"above their tolerance, by up to {path.worst:.1e} times",
        )
        if d.solver == "local-global":
            told += f" end {by}, stopped by count, dynamics.iterations = {d.iterations}"
            path.reason += f"; {told}"
        else:  # Newton's method ends a step there for nothing else
            told += f" converged to round-off, {by}"
        job.tell(f"{told}; history.h5: residual")
    job.summarise(problem, path, dynamics=figures(problem, path), **job.forces(problem, path))
    return "" if path.converged else path.reason


def _advice(d: Dynamics) -> str:
    """What helps where energy comes from nowhere."""
    ways = ["a shorter dynamics.time_step"]
    if d.solver == "local-global":
        ways += ["more dynamics.iterations", "dynamics.solver = newton"]
    if d.scheme == "generalized-alpha":
        ways.append("a smaller dynamics.spectral_radius")
    if d.scheme != "implicit-euler":
        ways.append("dynamics.scheme = implicit-euler")
    return ", ".join(ways[:-1]) + f" or {ways[-1]}" if len(ways) > 1 else ways[0]


def step_solver(job: Run, problem: Problem) -> StepSolver:
    """What the scene asks to solve its steps with."""
    d = job.scene.dynamics
    if d.solver == "local-global":
        return LocalGlobal(problem, LocalGlobalOptions(iterations=d.iterations))
    return NewtonStep(problem)
