"""Equilibria along a load path: adaptive load steps around Newton's method, off unstable branches, to stable ends."""

import math

from petsc4py import PETSc

from voile.problem.discrete import Problem
from voile.problem.imperfection import disturb
from voile.problem.scales import round_off, slow_rate
from voile.solver.newton import NOT_FINITE, Newton, use_cholesky
from voile.solver.path import LoadStep, Path, Progress, StaticsOptions, load_steps, tolerance
from voile.solver.quasistatic import follow_contact
from voile.solver.stability import smallest_eigenpair

EASY = 8  # Newton iterations up to which a load step grows
SMALLEST_STEP = 1e-5
ROUNDS = 6  # solves at one load until the tolerance, taken from the state, has settled
LINEAR = 1e-10  # GMRES' tolerance; preconditioned by the symmetric part's factor it takes 3 to 5 iterations
FAST_CUTS = 2  # failures of the fast steps before the descent method takes over
PATIENT_CUTS = 8  # the same where loads have no potential to descend on


def create_snes(problem: Problem, matrix: PETSc.Mat) -> tuple[PETSc.SNES, Newton]:
    """Newton with MUMPS LDL^T by default; every choice can be changed by PETSc options."""
    snes = PETSc.SNES().create(comm=problem.comm)
    newton = Newton(problem)
    snes.setType(PETSc.SNES.Type.PYTHON)
    snes.setPythonContext(newton)
    snes.setFunction(lambda _, y, f: problem.residual(y, f), problem.create_vector())
    snes.setJacobian(lambda _, y, j, p: problem.tangent(y, p), matrix)
    monitor = problem.monitor
    if monitor:
        snes.setMonitor(lambda _, it, norm: monitor(problem.load_factor, it, norm))
    if problem.conservative:
        snes.setObjective(lambda _, y: problem.energy(y))
    ksp = snes.ksp
    ksp.setType(PETSc.KSP.Type.PREONLY if problem.conservative else PETSc.KSP.Type.GMRES)
    ksp.setTolerances(rtol=LINEAR)
    use_cholesky(ksp.pc)
    options = PETSc.Options()
    for name, value in DEFAULTS.items():
        if not options.hasName(name):
            options.setValue(name, value)
    return snes, newton


# MUMPS: count negative pivots on several ranks too; no pivoting (a positive definite matrix needs none, and an
# indefinite one only has to be recognised); half as much again of work space. SNES: no limit on how far the residual
# may rise, where the potential falls it can.
DEFAULTS = {
    "mat_mumps_icntl_13": "1",
    "mat_mumps_cntl_1": "0.0",
    "mat_mumps_icntl_14": "50",
    "snes_divergence_tolerance": "-3",
}


def solve_statics(
    problem: Problem,
    options: StaticsOptions | None = None,
    *,
    start: PETSc.Vec | None = None,
    on_step: Progress | None = None,
) -> Path:
    """Follows the load from 0 to 1. Calls on_step after each converged step. Does not raise for lack of convergence:
    see Path and `require`."""
    options = options or StaticsOptions()
    snes, newton = create_snes(problem, problem.create_matrix())
    y = problem.create_vector() if start is None else start.copy()
    path = Path(state=y.copy())
    if start is None and not problem.contact:  # friction would remember it
        disturb(problem, y, options.perturbation * problem.thickness())
    try:
        follow = follow_contact if problem.contact else _follow
        follow(problem, snes, newton, y, options, path, on_step)
    finally:
        snes.destroy()  # its callbacks refer back to the problem
    return path


def _follow(problem, snes, newton, y, options, path, on_step) -> None:
    """Steps until the full load. Fast full steps first, in load steps cut where they fail; where that does not help
    (buckling, floppy cloth) the descent method takes over, at once for the whole load unless supports move."""
    first = 1.0 / load_steps(problem, options)
    factor, step, cuts = 0.0, first, 0
    most = FAST_CUTS if problem.conservative else PATIENT_CUTS
    while factor < 1.0:
        if path.attempts >= options.max_steps:
            path.reason = f"max_steps = {options.max_steps} load steps ended at load factor {factor:g}"
            return
        newton.descend = cuts >= most or not options.fast
        target = 1.0 if factor + step > 1.0 - 1e-9 else factor + step
        path.attempts += 1
        done = _advance(problem, snes, newton, y, target, options, path)
        if done is None:
            problem.load_factor = factor
            path.state.copy(y)
            if path.reason:  # round-off: only a larger load, with its larger tolerance, is left to try
                if target == 1.0 or cuts > most:
                    return
                path.reason, step, cuts = "", 1.0, most + 1
                continue
            if step < SMALLEST_STEP:
                path.reason = f"{_reason(snes)} at load factor {target:g}; the smallest load step was reached"
                return
            step *= 0.25
            cuts += 1
            if cuts == most:
                step = first if problem.moves else 1.0
            continue
        factor = target
        if newton.descend or done.iterations <= EASY:
            step *= 2.0
        if factor >= 1.0 and options.stability:
            done = _settle(problem, snes, newton, y, done, options, path)
        y.copy(path.state)
        path.steps.append(done)
        if on_step:
            on_step(done, y)
    path.converged, path.reason = True, "residual below tolerance"


def _advance(problem, snes, newton, y, target, options, path) -> LoadStep | None:
    """Solves at one load factor; None without convergence."""
    problem.load_factor = target
    iterations, rebased = 0, False
    if newton.descend:
        disturb(problem, y, options.perturbation * problem.thickness())
    for _ in range(ROUNDS):  # loads that follow, and reactions, are others at the end than at the start
        wanted = tolerance(problem, y, options)
        if not math.isfinite(wanted):
            snes.setConvergedReason(NOT_FINITE)
            return None
        snes.setTolerances(rtol=0.0, atol=wanted, stol=0.0, max_it=500)
        snes.setFromOptions()
        snes.solve(None, y)
        path.seconds["linear_solve"] = newton.seconds
        iterations += snes.getIterationNumber()
        path.newton_iterations += snes.getIterationNumber()
        if newton.stalled:
            computed = round_off(problem, y)[1] if rebased else 0.0
            if computed > snes.getTolerances()[1]:
                path.reason = f"{_reason(snes)} at load factor {target:g}; round-off is {computed:.1e} N"
                return None
            path.state.axpy(-1.0, y)
            problem.rebase(y)
            y.set(0.0)
            rebased = True
            continue
        if snes.getConvergedReason() <= 0:
            return None
        asked = snes.getTolerances()[1]
        norm = snes.getFunctionNorm()
        if asked != wanted or norm <= tolerance(problem, y, options):
            return LoadStep(target, iterations, norm, asked, problem.energies(y), newton.negative)
    return None


def _settle(problem, snes, newton, y, done, options, path) -> LoadStep:
    """Tests the end state; where it is a saddle, leaves it along its softest mode and minimises again."""
    matrix = snes.getJacobian()[0]
    for attempt in range(6):
        newton.shift, newton.descend = 0.0, True
        path.stable = newton._factor(snes, y, "exact")
        if path.stable or attempt == 5:
            break
        value, mode = smallest_eigenpair(problem, matrix, slow_rate(problem))
        path.smallest_eigenvalue = value
        if not value < 0.0:
            break
        amplitude = options.perturbation * problem.thickness() * 4.0**attempt
        y.copy(path.state)
        y.axpy(amplitude, mode)
        again = _advance(problem, snes, newton, y, 1.0, options, path)
        if again is None:
            path.state.copy(y)
            continue
        done = again
    if path.stable and options.eigenvalue:
        path.smallest_eigenvalue, _ = smallest_eigenpair(problem, matrix, 0.0)
    elif path.stable:
        path.smallest_eigenvalue = None
    return done


def _reason(snes: PETSc.SNES) -> str:
    names = {v: k for k, v in vars(PETSc.SNES.ConvergedReason).items() if isinstance(v, int)}
    norm, tolerance = snes.getFunctionNorm(), snes.getTolerances()[1]
    return f"residual {norm:.3e} N misses {tolerance:.3e} N ({names.get(snes.getConvergedReason(), '?').lower()})"
