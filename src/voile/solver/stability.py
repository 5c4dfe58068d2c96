"""Is an equilibrium a minimum? Inertia of the tangent, its smallest eigenvalue by SLEPc, and the way off a saddle."""

import math

from petsc4py import PETSc

from voile.problem.contact import contact_of
from voile.problem.imperfection import imperfection
from voile.problem.problem import Problem
from voile.problem.scales import slow_rate
from voile.problem.state import State
from voile.solver.linear import Counts, Inverse, LinearSolver, factored
from voile.solver.methods.method import Workspace

KICKS = 5  # attempts to leave a saddle, each four times further
LOWERED = 60  # times that a shift is lowered fourfold until nothing lies below it
NEUTRAL = 1e-6  # slow rates: an eigenvalue nearer to zero is none


def contact_tangent(problem: Problem, y: PETSc.Vec, matrix: PETSc.Mat) -> PETSc.Mat:
    """The exact tangent with sticking vertices held and slipping ones held along the normal."""
    linear = contact_of(problem).linearise(problem.positions(y), problem.time)
    problem.tangent(y, matrix, "exact", linear.held())
    return matrix


def is_stable(work: Workspace, problem: Problem, y: PETSc.Vec) -> bool:
    """Whether the tangent, left in the workspace's matrix, has no negative eigenvalue where contact lets the shell
    move."""
    if problem.contact:
        contact_tangent(problem, y, work.matrix)
    else:
        problem.tangent(y, work.matrix)
    return work.symmetric.positive(work.matrix)


def kick(
    work: Workspace, problem: Problem, y: PETSc.Vec, saddle: State, perturbation: float, attempt: int
) -> float:
    """Puts y off a saddle along its softest mode, `reach` far; the rate (1/s^2) at which that grows. Where it is
    NEUTRAL, as of a spin about a single contact, the saddle is none, and y stays there."""
    problem.restore(y, saddle)
    slow = slow_rate(problem)
    value, mode = smallest_eigenpair(problem, contact_tangent(problem, y, work.matrix), slow, work.counts)
    if value < -NEUTRAL * slow:
        mode.scale(reach(perturbation, attempt))
        y.axpy(problem.longest_step(y, mode), mode)
    return -value


def reach(perturbation: float, attempt: int) -> float:
    """How far an attempt leaves a saddle (m)."""
    return perturbation * 4.0**attempt


def smallest_eigenpair(
    problem: Problem, tangent: PETSc.Mat, scale: float, counts: Counts | None = None
) -> tuple[float, PETSc.Vec]:
    """Smallest omega^2 (1/s^2) of K v = omega^2 M v and its mode (unit largest entry), M = C^T M C; 0 where round-off
    hides its sign, as of a ring that may go anywhere between frictionless plates. The mode's sign, and which one of
    several with the same omega, are those next to the imperfection.

    Shift-and-invert just below the spectrum: the shift -s is lowered from -`scale` until the inertia of K + s M shows
    no negative eigenvalue, so that the eigenvalue nearest to it is the smallest.
    """
    from slepc4py import SLEPc

    counts, mass = counts or Counts(), problem.mass_matrix()
    eps = SLEPc.EPS().create(comm=tangent.comm)
    eps.setOperators(tangent, mass)
    eps.setProblemType(SLEPc.EPS.ProblemType.GHEP)
    eps.setWhichEigenpairs(SLEPc.EPS.Which.TARGET_MAGNITUDE)
    shift, solver = below_spectrum(tangent, mass, -scale, counts)
    eps.setTarget(shift)
    eps.setDimensions(1)
    eps.setTolerances(1e-6, 200)
    st = eps.getST()
    st.setType(SLEPc.ST.Type.SINVERT)
    ksp = st.getKSP()
    ksp.setType(PETSc.KSP.Type.PREONLY)
    ksp.pc.setType(PETSc.PC.Type.PYTHON)
    ksp.pc.setPythonContext(Inverse(solver))
    first = imperfection(problem)
    eps.setInitialSpace([first])
    eps.setFromOptions()
    eps.solve()
    mode = problem.create_vector()
    value = eps.getEigenpair(0, mode).real if eps.getConverged() else math.nan
    eps.destroy()
    solver.destroy()  # eigenvectors ask for solves, too
    if math.isnan(value):
        return value, mode
    if abs(value) <= _round_off(tangent, mass, mode):
        value = 0.0
    sign = math.copysign(1.0, mode.dot(first))
    mode.scale(sign / mode.norm(PETSc.NormType.INFINITY))
    return value, mode


def _round_off(tangent: PETSc.Mat, mass: PETSc.Mat, mode: PETSc.Vec) -> float:
    """Of the Rayleigh quotient of a mode (1/s^2): what the last places of the terms of v.K v make of it."""
    moved, square = mode.duplicate(), mode.duplicate()
    mass.mult(mode, moved)
    square.pointwiseMult(mode, mode)
    return float(math.ulp(1.0) * tangent.getDiagonal().dot(square) / mode.dot(moved))


def below_spectrum(
    stiffness: PETSc.Mat, mass: PETSc.Mat, shift: float, counts: Counts
) -> tuple[float, LinearSolver]:
    """A shift (1/s^2) below all eigenvalues of K v = omega^2 M v, from a negative one on fourfold lower each time, and
    K - shift M, factored; its `negative` is above 0 where LOWERED times do not get there."""
    for _ in range(LOWERED):
        solver = factored_beside(stiffness, mass, shift, counts, definite=True)
        if not solver.negative:
            break
        solver.destroy()
        shift *= 4.0
    return shift, solver


def factored_beside(
    stiffness: PETSc.Mat, other: PETSc.Mat, shift: float, counts: Counts, definite: bool = False
) -> LinearSolver:
    """K - shift G, factored, see `factored`; its matrix belongs to the solver."""
    shifted = stiffness.copy()
    shifted.axpy(-shift, other, structure=PETSc.Mat.Structure.SAME_NONZERO_PATTERN)
    return factored(shifted, counts, definite)
