"""Quasi-static paths with contact and dry friction: load steps whose order matters, to stable ends."""

from petsc4py import PETSc

from voile.problem.contact import contact_report
from voile.problem.discrete import Problem
from voile.problem.scales import slow_rate
from voile.solver.frictional import FrictionalSolver, Outcome
from voile.solver.newton import Newton
from voile.solver.path import LoadStep, Path, Progress, StaticsOptions, tolerance
from voile.solver.stability import smallest_eigenpair

EASY = 10  # Newton iterations up to which a load step grows
CUTS = 2  # quartered load steps before the ways that leave the branch are tried
ROUNDS = 6  # solves at one load until the tolerance, taken from the state, has settled


def follow_contact(
    problem: Problem,
    snes: PETSc.SNES,
    newton: Newton,
    y: PETSc.Vec,
    options: StaticsOptions,
    path: Path,
    on_step: Progress | None,
) -> None:
    """Load steps of 1/load_steps, no longer: friction depends on the path. Where the semismooth method fails, the
    step is cut; where cuts do not help (buckling, slip that runs away), the other ways take the whole step."""
    solver = FrictionalSolver(problem, snes, newton, options.perturbation)
    factor, nominal = 0.0, 1.0 / options.load_steps
    step, cuts = nominal, 0
    most = CUTS if problem.supported else 0  # a smaller load does not hold what nothing holds
    problem.load_factor = 0.0
    begin(problem, y)
    while factor < 1.0:
        if path.attempts >= options.max_steps:
            path.reason = f"max_steps = {options.max_steps} load steps ended at load factor {factor:g}"
            return
        target = 1.0 if factor + step > 1.0 - 1e-9 else factor + step
        path.attempts += 1
        problem.load_factor = target
        done, outcome = _solve(solver, y, options, path, ways=3 if cuts >= most else 1)
        if done is None:
            problem.load_factor = factor
            if cuts >= most:
                path.reason = f"{outcome.reason}; at load factor {target:g}"
                return
            cuts += 1
            step = nominal if cuts >= most else 0.25 * step
            continue
        factor, cuts = target, 0
        step = min(2.0 * step, nominal) if done.iterations <= EASY else step
        if factor >= 1.0 and options.stability:
            done = _settle(solver, y, done, options, path)
        y.copy(path.state)
        path.steps.append(done)
        if on_step:
            on_step(done, y)
        begin(problem, y)
    path.converged, path.reason = True, "residual below tolerance"


def begin(problem: Problem, y: PETSc.Vec) -> None:
    """Slip is measured from here on."""
    assert problem.contact is not None
    problem.contact.begin(problem.positions(y), problem.load_factor)


def _solve(
    solver: FrictionalSolver, y: PETSc.Vec, options: StaticsOptions, path: Path, ways: int
) -> tuple[LoadStep | None, Outcome]:
    """The equilibrium at the problem's load factor; no step where there is none."""
    problem, snes = solver.problem, solver.snes
    iterations = 0
    for _ in range(ROUNDS):
        outcome = solver.solve(y, tolerance(problem, y, options), ways)
        iterations += solver.iterations
        path.newton_iterations += solver.iterations
        path.seconds |= {"linear_solve": solver.seconds, "contact": solver.contact.seconds}
        if not outcome.converged:
            return None, outcome
        norm, asked = snes.getFunctionNorm(), snes.getTolerances()[1]
        if norm <= tolerance(problem, y, options):
            break
    done = LoadStep(
        problem.load_factor,
        iterations,
        norm,
        asked,
        problem.energies(y),
        solver.semismooth.negative,
        contact_report(problem, y),
        outcome.way,
    )
    return done, outcome


def _settle(
    solver: FrictionalSolver, y: PETSc.Vec, done: LoadStep, options: StaticsOptions, path: Path
) -> LoadStep:
    """Tests the end state on the contacts' tangent space; leaves a saddle, which slip may have hidden so far."""
    path.stable = solver.stable(y)
    if not path.stable and solver.leave(y, done.tolerance):
        problem = solver.problem
        begin(problem, y)
        again, _ = _solve(solver, y, options, path, ways=1)
        done, path.stable = again or done, solver.stable(y)
    if options.eigenvalue or not path.stable:
        scale = 0.0 if path.stable else slow_rate(solver.problem)
        path.smallest_eigenvalue, _ = smallest_eigenpair(solver.problem, solver.stability_matrix(y), scale)
    return done
