"""Is an equilibrium a minimum? Inertia of the tangent and its smallest eigenvalue by SLEPc."""

import math

from petsc4py import PETSc
from slepc4py import SLEPc

from voile.problem.discrete import Problem
from voile.problem.imperfection import imperfection
from voile.solver.newton import add_mass, negative_pivots, use_cholesky


def factored(matrix: PETSc.Mat) -> PETSc.PC:
    """LDL^T of a matrix by MUMPS; raises PETSc.Error if it fails."""
    pc = PETSc.PC().create(comm=matrix.comm)
    pc.setOperators(matrix)
    use_cholesky(pc)
    pc.setFromOptions()
    pc.setUp()
    return pc


def smallest_eigenpair(problem: Problem, tangent: PETSc.Mat, scale: float) -> tuple[float, PETSc.Vec]:
    """Smallest omega^2 (1/s^2) of K v = omega^2 M v and its mode (unit largest entry), M the lumped mass. The mode's
    sign, and which one of several with the same omega, are those next to the imperfection.

    Shift-and-invert just below the spectrum: the shift -s is lowered from -`scale` until the inertia of K + s M shows
    no negative eigenvalue, so that the eigenvalue nearest to it is the smallest.
    """
    mass = problem.mass()
    shift = scale
    for _ in range(60):
        shifted = tangent.copy()
        add_mass(shifted, mass, shift)
        pc = factored(shifted)
        below = negative_pivots(pc)
        pc.destroy()
        shifted.destroy()
        if below == 0:
            break
        shift *= 4.0
    weights = PETSc.Mat().createAIJ(tangent.getSizes(), nnz=1, comm=tangent.comm)
    weights.setUp()
    weights.setDiagonal(mass)
    weights.assemble()
    eps = SLEPc.EPS().create(comm=tangent.comm)
    eps.setOperators(tangent, weights)
    eps.setProblemType(SLEPc.EPS.ProblemType.GHEP)
    eps.setWhichEigenpairs(SLEPc.EPS.Which.TARGET_MAGNITUDE)
    eps.setTarget(-shift)
    eps.setDimensions(1)
    eps.setTolerances(1e-6, 200)
    st = eps.getST()
    st.setType(SLEPc.ST.Type.SINVERT)
    ksp = st.getKSP()
    ksp.setType(PETSc.KSP.Type.PREONLY)
    use_cholesky(ksp.pc)
    first = imperfection(problem)
    eps.setInitialSpace([first])
    eps.setFromOptions()
    eps.solve()
    if eps.getConverged() < 1:
        return math.nan, problem.create_vector()
    mode = problem.create_vector()
    value = eps.getEigenpair(0, mode).real
    sign = math.copysign(1.0, mode.dot(first))
    mode.scale(sign / mode.norm(PETSc.NormType.INFINITY))
    return value, mode
