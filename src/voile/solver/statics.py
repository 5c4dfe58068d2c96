"""Equilibria along a load path."""

from petsc4py import PETSc

from voile.problem.imperfection import perturb
from voile.problem.problem import Problem
from voile.solver.linear import Counts
from voile.solver.path import Arrays, Path, Pause, Progress, StaticsOptions
from voile.solver.stepping.load_path import LoadPath


def solve_statics(
    problem: Problem,
    options: StaticsOptions | None = None,
    *,
    start: PETSc.Vec | None = None,
    on_step: Progress | None = None,
    on_pause: Pause | None = None,
    found: Arrays | None = None,
    counts: Counts | None = None,
) -> Path:
    """Follows the load from 0 to 1. Calls on_step after each converged step, then on_pause; found: what that was given,
    from which the path goes on; counts: of the run that it is a part of. Does not raise for lack of convergence: see
    Path and `require`."""
    options = options or StaticsOptions()
    y = problem.create_vector() if start is None else start.copy()
    path = Path(state=y.copy(), counts=counts or Counts())
    run = LoadPath(problem, y, options, path)
    if start is None and not found and not problem.contact:  # friction would remember it
        run.settle_unloaded()
        perturb(problem, y, options.perturbation * problem.thickness())
    run.follow(on_step, on_pause, found)
    return path
