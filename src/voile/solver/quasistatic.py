"""Quasi-static paths with contact and dry friction: load steps whose order matters, to stable ends.

A leap is a step in which the shell moves far more than supports and obstacles do and than the step before lets expect:
either the step was too long and Newton's method fell on another branch, or the shell snaps. Motion along a branch goes
to zero with the load step, that of a snap does not: shorter steps tell them apart, and find where it snaps.
"""

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from voile.problem.anchor import difference
from voile.problem.contact import contact_report
from voile.problem.discrete import Problem
from voile.problem.scales import slow_rate
from voile.solver.frictional import FrictionalSolver, Outcome
from voile.solver.newton import Newton
from voile.solver.path import LoadStep, Path, Progress, StaticsOptions, tolerance
from voile.solver.stability import smallest_eigenpair

EASY = 10  # Newton iterations up to which a load step grows
CUTS = 2  # quartered load steps before the ways that leave the branch are tried
LEAP = 5.0  # times the motion to be expected that a step may make
NOTABLE = 0.01  # sizes of the shell: a smaller motion is none
SHORTEST = 1.0 / 64.0  # of the load steps' length: a leap in less is a snap
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
    step is cut; where cuts do not help (buckling, slip that runs away), the other ways take the whole step. A leap is
    cut, too, until it is certain that the shell snaps."""
    solver = FrictionalSolver(problem, snes, newton, options.perturbation)
    factor, nominal = 0.0, 1.0 / options.load_steps
    step, longest, cuts, rate = nominal, nominal, 0, np.inf
    most = CUTS if problem.supported else 0  # a smaller load does not hold what nothing holds
    problem.load_factor = 0.0
    begin(problem, y)
    while factor < 1.0:
        if path.attempts >= options.max_steps:
            path.reason = f"max_steps = {options.max_steps} load steps ended at load factor {factor:g}"
            return
        target = 1.0 if factor + step > 1.0 - 1e-9 else factor + step
        path.attempts += 1
        problem.load_factor, before = target, solver.contact.state.copy()
        done, outcome = _solve(solver, y, options, path, ways=3 if cuts >= most else 1)
        if done is None:
            problem.load_factor = factor
            if cuts >= most:
                path.reason = f"{outcome.reason}; at load factor {target:g}"
                return
            cuts += 1
            step = longest if cuts >= most else 0.25 * step
            continue
        moved = problem.largest_motion(difference(y, path.state))
        expected = max(rate * (target - factor), _driven(problem, factor, target), NOTABLE / LEAP)
        leaps = moved > LEAP * expected
        if leaps and target - factor > SHORTEST * nominal:
            path.state.copy(y)
            solver.contact.state, problem.load_factor = before, factor
            step = longest = 0.25 * (target - factor)
            continue
        rate = rate if leaps else moved / (target - factor)
        factor, cuts, longest = target, 0, nominal
        step = min(2.0 * step, nominal) if done.iterations <= EASY else step
        if options.stability and (leaps or factor >= 1.0):
            done = _settle(solver, y, done, options, path)
        if factor < 1.0:
            path.stable = path.smallest_eigenvalue = None  # those are the end's
        done.way = f"snap by {done.way}" if leaps else done.way
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


def _driven(problem: Problem, start: float, end: float) -> float:
    """How far supports, and obstacles beside the shell, move between two load factors, in sizes of the shell."""
    assert problem.contact is not None
    state, size = problem.contact.state, problem.size()
    x = state.reference[problem.own]
    paths = [(end - start) * problem.part.lift[: state.reference.size]]
    paths += [(o.carry(x, start, end) - x).ravel() for o in problem.contact.obstacles]
    farthest = max(float(np.abs(path).max(initial=0.0)) for path in paths)
    return problem.comm.allreduce(farthest, op=MPI.MAX) / size


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
