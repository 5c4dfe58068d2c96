"""Direct solvers: which one factors what, and what they say of a matrix."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import scipy.sparse as sp
from mpi4py import MPI
from petsc4py import PETSc

from voile import _projective, launch
from voile.solver.fronts import analysed
from voile.solver.linear import Counts, LinearSolver, Symmetric, factored, symmetric, unsymmetric

SIDE = 20


def laplacian(shift: float = 0.0, side: int = SIDE) -> sp.csr_matrix:
    """Of a square of side^2 points, less a multiple of the identity; at 20 the least are 0.045, twice 0.11."""
    line = sp.diags([-1.0, 2.0, -1.0], [-1, 0, 1], (side, side))
    plane = sp.kron(line, sp.identity(side)) + sp.kron(sp.identity(side), line)
    return sp.csr_matrix(plane - shift * sp.identity(side**2))


def petsc(matrix: sp.csr_matrix) -> PETSc.Mat:
    made = PETSc.Mat().createAIJ(
        matrix.shape, csr=(matrix.indptr, matrix.indices, matrix.data), comm=MPI.COMM_SELF
    )
    made.setAttr("coupled", 0)
    return made


def make() -> LinearSolver:
    return symmetric(MPI.COMM_SELF, PETSc.KSP.Type.PREONLY, 1e-10, Counts())


def error(solver: LinearSolver, matrix: sp.csr_matrix) -> float:
    """Of a solve, relative."""
    right = np.random.default_rng(1).normal(size=matrix.shape[0])
    b, x = (PETSc.Vec().createWithArray(right.copy(), comm=MPI.COMM_SELF) for _ in range(2))
    solver.solve(b, x)
    return float(np.linalg.norm(matrix @ x.array - right) / np.linalg.norm(right))


def test_one_solver_serves_definite_and_indefinite_matrices_in_turn():
    solver = make()
    matrix = petsc(laplacian())
    for shift, negative in ((0.0, 0), (0.08, 1), (0.02, 0), (0.15, 3), (0.0, 0)):
        now = laplacian(shift)
        matrix.setValuesCSR(now.indptr, now.indices, now.data)
        matrix.assemble()
        assert solver.factor(matrix) and solver.negative == negative
        assert error(solver, now) < 1e-11
    assert solver.counts.factorisations == 7  # two where one turns out not to be definite


def test_what_serves_only_if_it_is_definite_is_factored_once():
    solver, counts = make(), Counts()
    solver.counts = counts
    assert not solver.factor_definite(petsc(laplacian(0.08))) and not solver.usable
    assert solver.negative is None and counts.factorisations == 1
    assert solver.factor_definite(petsc(laplacian())) and solver.negative == 0 and counts.factorisations == 2
    assert error(solver, laplacian()) < 1e-11


def test_a_new_pattern_is_analysed_anew():
    solver = make()
    assert solver.factor_definite(petsc(laplacian()))
    wide = sp.csr_matrix(laplacian() @ laplacian())
    assert solver.factor_definite(petsc(wide)) and error(solver, wide) < 1e-10


def test_factors_start_no_threads():
    """CHOLMOD's would start four, whatever OMP_NUM_THREADS says, which wait for each other."""

    def threads() -> str:
        lines = Path("/proc/self/status").read_text().splitlines()
        return next(line for line in lines if line.startswith("Threads"))

    a, before = sp.csr_matrix(laplacian(side=40) @ laplacian(side=40)), threads()
    factor = _projective.Definite(_projective.Fronts(a.indptr, a.indices))
    assert factor.factor(a.data) and threads() == before


@pytest.mark.parametrize("kind", [_projective.Definite, _projective.General])
def test_threads_change_no_digit(kind):
    """Subtrees of fronts in threads; each front adds up what its children give in the same order."""
    a = sp.csr_matrix(laplacian(-0.1, 150) @ laplacian(-0.1, 150))
    b = np.random.default_rng(2).standard_normal(a.shape[0])
    bent = a.data.copy()
    bent[a.indptr[-2] :] *= -1.0 if kind is _projective.Definite else np.nan  # the last row
    found = []
    for threads in (1, 2, 5):
        factor, x = kind(_projective.Fronts(a.indptr, a.indices, threads)), np.empty_like(b)
        assert factor.factor(a.data) and not factor.factor(bent) and factor.factor(a.data)
        factor.solve(b, x)
        found.append(x)
    assert np.linalg.norm(a @ found[0] - b) < 1e-12 * np.linalg.norm(b)
    assert (found[0] == found[1]).all() and (found[0] == found[2]).all()


@pytest.mark.parametrize(
    ("words", "many"), [("3", 3), ("4,2", 4), ("64", 8), ("0", 1), ("x", None), ("", None)]
)
def test_threads_are_those_asked_for(monkeypatch, words, many):
    monkeypatch.setenv("OMP_NUM_THREADS", words)
    monkeypatch.setattr(launch, "launched", lambda: False)
    assert launch.threads() == (many or min(launch.processors(), 8))
    monkeypatch.setattr(launch, "launched", lambda: True)
    assert launch.threads() == (many or 1)


def skewed() -> sp.csr_matrix:
    """The Laplacian with a wind that carries all along."""
    along = sp.kron(sp.diags([-0.9, 0.9], [-1, 1], (SIDE, SIDE)), sp.identity(SIDE))
    return sp.csr_matrix(laplacian() + along)


def test_systems_without_symmetry_are_solved():
    solver = unsymmetric(MPI.COMM_SELF, "friction_", Counts())
    matrix = petsc(laplacian())
    assert solver.factor(matrix) and error(solver, laplacian()) < 1e-12 and solver.negative is None
    now = skewed()
    assert abs(now - now.T).max() > 1.0
    matrix.setValuesCSR(now.indptr, now.indices, now.data)
    matrix.assemble()
    assert solver.factor(matrix) and error(solver, now) < 1e-12
    assert solver.counts.factorisations == 2


@pytest.mark.parametrize("columns", [1, 2, 7])
def test_many_right_hand_sides_are_solved_at_once(columns):
    """By a factor, its transpose, and MUMPS where fronts do not serve."""
    b = np.random.default_rng(4).standard_normal((SIDE**2, columns))
    for solver, a in (
        (make(), laplacian()),
        (make(), laplacian(0.08)),
        (unsymmetric(MPI.COMM_SELF, "friction_", Counts()), skewed()),
    ):
        assert solver.factor(petsc(a)) and solver.solutions(b).shape == b.shape
        size = np.linalg.norm(b)
        assert np.linalg.norm(a @ solver.solutions(b) - b) < 1e-11 * size
        assert np.linalg.norm(a.T @ solver.solutions(b, transposed=True) - b) < 1e-11 * size
        one, x = petsc(a).createVecs()
        one.array[:] = b[:, 0]
        solver.solve_transposed(one, x)
        assert np.linalg.norm(a.T @ x.array_r - b[:, 0]) < 1e-11 * size


def test_pivots_within_fronts_are_found_in_the_transpose_too():
    rng = np.random.default_rng(5)
    a, b = rng.normal(size=(60, 60)), rng.normal(size=(60, 3))
    rows = sp.csr_matrix(a)
    factor, x = _projective.General(_projective.Fronts(rows.indptr, rows.indices)), np.empty_like(b)
    assert factor.factor(rows.data)
    for matrix, transposed in ((a, False), (a.T, True)):
        factor.solve(b, x, transposed)
        assert np.linalg.norm(matrix @ x - b) < 1e-11 * np.linalg.norm(b)


def test_factors_of_one_pattern_share_its_analysis():
    one, other = petsc(laplacian()), petsc(laplacian(0.01))
    found = [analysed(*matrix.getValuesCSR()[:2]) for matrix in (one, other)]
    assert found[0] is found[1]
    wide = sp.csr_matrix(laplacian() @ laplacian())
    assert analysed(wide.indptr, wide.indices) is not found[0]
    definite, general = (kind(found[0]) for kind in (_projective.Definite, _projective.General))
    rows, now = laplacian(), skewed()
    assert definite.factor(rows.data) and general.factor(now.data) and definite.factor(rows.data)
    b, x = np.ones(rows.shape[0]), np.empty(rows.shape[0])
    for factor, matrix in ((definite, rows), (general, now)):
        factor.solve(b, x)
        assert np.linalg.norm(matrix @ x - b) < 1e-12 * np.linalg.norm(b)


def test_a_pattern_without_symmetry_is_refused():
    rows = sp.csr_matrix(np.array([[1.0, 2.0, 0.0], [0.0, 1.0, 3.0], [0.0, 4.0, 1.0]]))
    with pytest.raises(RuntimeError, match="not symmetric"):
        _projective.Fronts(rows.indptr, rows.indices)
    with pytest.raises(RuntimeError, match="not symmetric"):
        _projective.Fronts(*(lambda m: (m.indptr, m.indices))(sp.csr_matrix(rows.T)))


def test_where_pivots_vanish_in_a_front_they_are_sought_elsewhere():
    """Unknowns without a diagonal that feel others only, which come later."""
    rng = np.random.default_rng(3)
    matrix = sp.csr_matrix(np.block([[np.eye(40), rng.normal(size=(40, 40))], [rng.normal(size=(40, 80))]]))
    matrix.data[matrix.indptr[:40]] = 0.0
    solver = unsymmetric(MPI.COMM_SELF, "friction_", Counts())
    assert solver.factor(petsc(matrix)) and error(solver, matrix) < 1e-11
    assert solver.counts.factorisations == 2


def test_options_choose_what_solves_systems_without_symmetry():
    options = PETSc.Options()
    options.setValue("friction_pc_factor_mat_solver_type", "mumps")
    try:
        assert type(unsymmetric(MPI.COMM_SELF, "friction_", Counts())) is LinearSolver
    finally:
        options.delValue("friction_pc_factor_mat_solver_type")


def test_rows_that_do_not_fit_are_refused():
    a = laplacian()
    with pytest.raises(ValueError, match="rows of a sparse matrix"):
        _projective.Fronts(a.indptr[:-1], a.indices)
    factor = _projective.Definite(_projective.Fronts(a.indptr, a.indices))
    with pytest.raises(ValueError, match="value"):
        factor.factor(a.data[1:])


@pytest.mark.parametrize(
    ("words", "which"),
    [
        ((), "Symmetric"),
        (("-pc_factor_mat_solver_type", "mumps"), "LinearSolver"),
        (("-ksp_view",), "Symmetric"),
    ],
)
def test_an_option_that_chooses_a_solver_leaves_that_one_alone(words, which):
    code = (
        "import petsc4py, sys; petsc4py.init(sys.argv); from mpi4py import MPI; import voile.solver.linear as m; "
        "print(type(m.symmetric(MPI.COMM_SELF, 'preonly', 1e-10, m.Counts())).__name__)"
    )
    done = subprocess.run([sys.executable, "-c", code, *words], capture_output=True, text=True, timeout=60)
    assert done.stdout.split()[:1] == [which], done.stderr  # newer PETSc adds a warning


def test_a_shift_below_the_spectrum_is_factored_once():
    """And by L L^T; SLEPc's own solver factored it again."""
    counts, plane = Counts(), petsc(laplacian())
    solver = factored(plane, counts, definite=True)
    assert isinstance(solver, Symmetric) and solver.negative == 0 and counts.factorisations == 1
    assert error(solver, laplacian()) < 1e-11
    assert factored(petsc(laplacian(0.15)), definite=True).negative == 3
