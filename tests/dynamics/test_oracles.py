"""PETSc's own integrators (TSALPHA2, TSBDF) on shells without contact: the same motion, to their order."""

import numpy as np
import pytest
from moving import cloth, move
from mpi4py import MPI
from petsc4py import PETSc
from test_problem import sheet

from voile.problem.problem import Problem

DURATION = 0.1
POINTS, TRIANGLES = sheet(3, 2)
SHELL = cloth(POINTS, TRIANGLES, np.flatnonzero(POINTS[:, 0] < 1e-9), young=1e4, model="koiter/average/stvk")


def second_order(problem: Problem, h: float) -> np.ndarray:
    """Positions at the end by TSALPHA2 of M a + grad(potential) = 0."""
    matrix, mass = problem.create_matrix(), problem.mass_matrix()

    def balance(ts, t, x, v, a, f):
        problem.residual(x, f)
        mass.multAdd(a, f, f)

    def tangent(ts, t, x, v, a, along_v, along_a, jacobian, _):
        problem.tangent(x, jacobian, shift=along_a)

    ts = PETSc.TS().create(comm=MPI.COMM_SELF)
    ts.setType("alpha2")
    ts.setI2Function(balance, problem.create_vector())
    ts.setI2Jacobian(tangent, matrix, matrix)
    x, v = problem.create_vector(), problem.create_vector()
    ts.setSolution2(x, v)
    return run(ts, h, x, problem)


def first_order(problem: Problem, h: float) -> np.ndarray:
    """Positions at the end by TSBDF of order 2, for (x, v): M v' + grad(potential) = 0 and x' = v."""
    n = problem.unknowns
    start, column, value = problem.mass_matrix().getValuesCSR()
    mass = np.zeros((n, n))
    mass[np.repeat(np.arange(n), np.diff(start)), column] = value
    matrix = problem.create_matrix()

    def balance(ts, t, y, dy, f):
        x, force = problem.create_vector(), problem.create_vector()
        x.array[:] = y.array_r[:n]
        problem.residual(x, force)
        f.array[:] = np.concatenate([mass @ dy.array_r[n:] + force.array_r, dy.array_r[:n] - y.array_r[n:]])

    def tangent(ts, t, y, dy, shift, jacobian, _):
        x, stiffness = problem.create_vector(), np.zeros((n, n))
        x.array[:] = y.array_r[:n]
        problem.tangent(x, matrix)
        first, at, entry = matrix.getValuesCSR()
        stiffness[np.repeat(np.arange(n), np.diff(first)), at] = entry
        one = np.eye(n)
        jacobian.setValues(
            range(2 * n), range(2 * n), np.block([[stiffness, shift * mass], [shift * one, -one]])
        )
        jacobian.assemble()

    y = PETSc.Vec().createSeq(2 * n, comm=MPI.COMM_SELF)
    dense = PETSc.Mat().createDense((2 * n, 2 * n), comm=MPI.COMM_SELF)
    dense.setUp()
    ts = PETSc.TS().create(comm=MPI.COMM_SELF)
    ts.setType("bdf")
    ts.setIFunction(balance, y.duplicate())
    ts.setIJacobian(tangent, dense, dense)
    ts.setSolution(y)
    PETSc.Options().setValue("oracle_ts_bdf_order", 2)
    x = problem.create_vector()
    run(ts, h, y, problem)
    x.array[:] = y.array_r[:n]
    return problem.positions(x)


def run(ts: PETSc.TS, h: float, y: PETSc.Vec, problem: Problem) -> np.ndarray:
    ts.setOptionsPrefix("oracle_")
    options = PETSc.Options()
    options.setValue("oracle_ts_adapt_type", "none")
    options.setValue("oracle_snes_rtol", 1e-12)
    options.setValue("oracle_ksp_type", "preonly")
    options.setValue("oracle_pc_type", "lu")
    ts.setTimeStep(h)
    ts.setMaxTime(DURATION)
    ts.setExactFinalTime(PETSc.TS.ExactFinalTime.MATCHSTEP)
    ts.setFromOptions()
    ts.solve(y)
    return problem.positions(y) if y.getSize() == problem.unknowns else POINTS


@pytest.mark.parametrize(
    ("scheme", "oracle"), [("generalized-alpha", second_order), ("bdf2", first_order)], ids=["alpha2", "bdf"]
)
def test_petsc_finds_the_same_motion(scheme, oracle):
    problem = Problem(SHELL, MPI.COMM_SELF).at(0.0)
    other = oracle(problem, 1e-3)
    away = [np.abs(move(SHELL, scheme, h, DURATION).end - other).max() for h in (4e-3, 2e-3)]
    moved = np.abs(other - POINTS).max()
    assert moved > 0.01
    assert away[1] < 1e-2 * moved and away[1] < 0.4 * away[0]
