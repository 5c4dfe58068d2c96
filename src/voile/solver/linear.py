"""Factorisations: which solver, what it says of the matrix, and how many of them a run took.

On one rank fronts factor what is positive definite or not symmetric; MUMPS all others, and on several ranks all.
"""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from mpi4py import MPI
from petsc4py import PETSc

from voile import _projective
from voile.arrays import Reals
from voile.errors import InputError
from voile.problem.lifetime import until_the_end
from voile.solver.columns import solutions
from voile.solver.fronts import Fronts

BROKEN = 71, 81  # of PETSc: a zero pivot of LU; of Cholesky, for CHOLMOD one that is not positive
NO_SOLVER = 92  # PETSc's error for a solver that it does not have for a matrix
WORK_SPACE, MOST_WORK_SPACE = (-8, -9), 1000  # MUMPS' errors for too little of it; ICNTL(14) in per cent

# MUMPS: count negative pivots on several ranks too; no pivoting (a positive definite matrix needs none, and an
# indefinite one only has to be recognised), and so no scaling, which only pivoting feels (a fifth of the time at 1,600
# unknowns); half as much again of work space.
DEFAULTS = {
    "mat_mumps_icntl_13": "1",
    "mat_mumps_cntl_1": "0.0",
    "mat_mumps_icntl_8": "0",
    "mat_mumps_icntl_14": "50",
    "mat_cholmod_print": "0",  # it would print a line for every indefinite matrix
}
FACTORISES = PETSc.Log.Event("MatCholFctrNum")  # as PETSc logs its own
CHOICES = "ksp_type", "pc_type", "pc_factor_"  # options that begin so choose a solver
INERTIA = "inertia_"  # prefix of factorisations that count negative eigenvalues


@dataclass
class Counts:
    """What a run did, failed attempts included: numeric factorisations, incomplete ones too, solves with them, Newton
    iterations; seconds spent in the first two; Krylov's iterations with incomplete factors."""

    factorisations: int = 0
    solves: int = 0
    iterations: int = 0
    seconds: float = 0.0
    krylov: int = 0

    def add(self, other: "Counts") -> None:
        """What another part of the same run did."""
        for name, value in vars(other).items():
            setattr(self, name, getattr(self, name) + value)

    @contextmanager
    def factorising(self) -> Iterator[None]:
        """Counts one factorisation and its time."""
        self.factorisations += 1
        yield from self._timed()

    @contextmanager
    def solving(self) -> Iterator[None]:
        """Counts one solve and its time."""
        self.solves += 1
        yield from self._timed()

    def _timed(self) -> Iterator[None]:
        began = time.perf_counter()
        yield
        self.seconds += time.perf_counter() - began


def set_defaults(values: dict[str, str]) -> None:
    """Puts options into PETSc's database where a user has not."""
    options = PETSc.Options()
    for name, value in values.items():
        if not options.hasName(name):
            options.setValue(name, value)


def hand_on(prefix: str) -> None:
    """Options of SNES without prefix hold for a method where it has none of its own."""
    given = PETSc.Options().getAll()
    set_defaults({prefix + name: value for name, value in given.items() if name.startswith("snes_")})


def use_cholesky(pc: PETSc.PC) -> None:
    """LDL^T by MUMPS; options may choose otherwise."""
    pc.setType(PETSc.PC.Type.CHOLESKY)
    pc.setFactorSolverType("mumps")


def use_lu(pc: PETSc.PC) -> None:
    """LU by MUMPS; options may choose otherwise."""
    pc.setType(PETSc.PC.Type.LU)
    pc.setFactorSolverType("mumps")


def factorisation_error(pc: PETSc.PC) -> int:
    """MUMPS' error code of the last factorisation, negative (users' guide, INFOG(1)); 0 without one."""
    if pc.getType() not in (PETSc.PC.Type.CHOLESKY, PETSc.PC.Type.LU) or pc.getFactorSolverType() != "mumps":
        return 0
    return int(min(pc.getFactorMatrix().getMumpsInfog(1), 0))


def negative_pivots(pc: PETSc.PC) -> int | None:
    """Negative eigenvalues counted by the factorisation (at least 1 where it broke down); None where the
    preconditioner does not tell."""
    if pc.getType() != PETSc.PC.Type.CHOLESKY:
        return None
    factor = pc.getFactorMatrix()
    if pc.getFactorSolverType() == "mumps":  # INFOG(1): error, INFOG(12): negative pivots
        return 1 if factor.getMumpsInfog(1) < 0 else factor.getMumpsInfog(12)
    try:
        return int(factor.getInertia()[0])
    except PETSc.Error:
        return None


class LinearSolver:
    """The systems of one kind of matrix: `factor` it, `solve` with it as often as wanted, count both.

    After `factor`, `usable` says whether it can solve and `negative` how many eigenvalues are negative (None where the
    preconditioner does not tell).
    """

    def __init__(self, ksp: PETSc.KSP, counts: Counts):
        self.ksp, self.counts = ksp, counts
        self.usable = True
        self.negative: int | None = None
        self._coupled: int | None = None

    @property
    def indefinite(self) -> "LinearSolver":
        """What solves systems that are not positive definite."""
        return self

    @property
    def leaves(self) -> float:
        """What a solve leaves of a right-hand side, beyond round-off."""
        return 0.0

    def factor(self, matrix: PETSc.Mat, operator: PETSc.Mat | None = None) -> bool:
        """Factors the matrix, which preconditions systems with `operator` (by default the matrix itself); `usable`."""
        pc = self.ksp.pc
        if pc.getType() == PETSc.PC.Type.MG:
            raise InputError(
                "PETSc options: pc_type mg has no levels here; allowed: in load steps of statics without contact"
            )
        with self.counts.factorising():
            # A MUMPS instance that failed once stays as it is; PETSc 3.26 on several ranks keeps a pattern outgrown.
            if not self.usable or self._coupled != matrix.getAttr("coupled"):
                pc.reset()
            self._coupled = matrix.getAttr("coupled")
            self.ksp.setOperators(operator or matrix, matrix)
            try:
                pc.setUp()
            except PETSc.Error as error:
                if error.ierr in BROKEN:
                    self.usable, self.negative = False, 1
                    return False
                if error.ierr != NO_SOLVER:
                    raise
                kind, ranks = pc.getFactorSolverType(), matrix.comm.size
                raise InputError(
                    f"PETSc options: pc_factor_mat_solver_type {kind} cannot factor here (ranks: {ranks}); allowed: a "
                    "solver that PETSc has for them, such as mumps"
                ) from None
            while factorisation_error(pc) in WORK_SPACE and self._more_work_space():
                pc.reset()
                self.ksp.setOperators(operator or matrix, matrix)
                pc.setUp()
        self.usable = not factorisation_error(pc)
        self.negative = negative_pivots(pc)
        return self.usable

    def factor_definite(self, matrix: PETSc.Mat, operator: PETSc.Mat | None = None) -> bool:
        """As `factor`, of a matrix that serves only if it is positive definite: whether it is, as far as is known
        before a solve. `negative` is not counted where it is not."""
        definite = self.factor(matrix, operator) and not self.negative
        if not definite:
            self.usable, self.negative = False, None
        return definite

    def forget(self) -> None:
        """Drops what former matrices have taught."""

    def aim(self, tolerance: float) -> None:
        """Told what norm (N) a nonlinear solve is to reach: iterations need not go far below."""

    def solve(self, b: PETSc.Vec, x: PETSc.Vec) -> None:
        """x = A^-1 b with the last matrix."""
        with self.counts.solving():
            self.ksp.solve(b, x)

    def solve_transposed(self, b: PETSc.Vec, x: PETSc.Vec) -> None:
        """x = A^-T b."""
        with self.counts.solving():
            self.ksp.solveTranspose(b, x)

    def solutions(self, columns: Reals, transposed: bool = False) -> Reals:
        """A^-1 columns (own, p) with the last factor, or A^-T columns, all at once."""
        with self.counts.solving():
            return solutions(self.ksp.pc, columns, transposed)

    def positive(self, matrix: PETSc.Mat) -> bool:
        """Whether the matrix is positive definite, by its inertia: by a factor of its own where this one, chosen by
        options, does not count."""
        self.factor(matrix)
        if self.negative is not None:
            return self.negative == 0
        solver = factored(matrix, self.counts)
        negative = solver.negative
        solver.destroy()
        return negative == 0

    def destroy(self) -> None:
        """Frees the factor."""
        self.ksp.destroy()

    def _more_work_space(self) -> bool:
        """Doubles what the next factorisation may use beyond its estimate; False where that would be absurd."""
        pc = self.ksp.pc
        percent = 2 * max(pc.getFactorMatrix().getMumpsIcntl(14), 20)
        PETSc.Options(pc.getOptionsPrefix() or "").setValue("mat_mumps_icntl_14", percent)
        return bool(percent <= MOST_WORK_SPACE)


class Inverse:
    """Context of a PETSc PC of type python: a matrix that is factored, so that its solves are counted."""

    def __init__(self, solver: LinearSolver):
        self.solver = solver

    def apply(self, _: PETSc.PC, b: PETSc.Vec, x: PETSc.Vec) -> None:
        """x = A^-1 b."""
        self.solver.solve(b, x)


class ByFronts(LinearSolver):
    """Systems on one rank by fronts, and by `indefinite` where these do not serve."""

    def __init__(self, kind: type, indefinite: LinearSolver, ksp: PETSc.KSP):
        """kind: `_projective.Definite` or `General`."""
        super().__init__(ksp, indefinite.counts)
        self._indefinite, self._fronts = indefinite, Fronts(kind)
        self._served = False  # the last matrix
        until_the_end(ksp).pc.setType(PETSc.PC.Type.PYTHON)
        ksp.pc.setPythonContext(self._fronts)

    @property
    def indefinite(self) -> LinearSolver:
        """See LinearSolver."""
        return self._indefinite

    def _by_fronts(self, matrix: PETSc.Mat, operator: PETSc.Mat | None) -> bool:
        with self.counts.factorising(), FACTORISES:
            self._served = self.usable = self._fronts.factor(matrix)
        self.negative = None
        self.ksp.setOperators(operator or matrix, matrix)
        return self._served

    def _otherwise(self, matrix: PETSc.Mat, operator: PETSc.Mat | None) -> bool:
        self._served = False
        self.usable = self.indefinite.factor(matrix, operator)
        self.negative = self.indefinite.negative
        return self.usable

    def solve(self, b: PETSc.Vec, x: PETSc.Vec) -> None:
        """See LinearSolver."""
        if self._served:
            super().solve(b, x)
        else:
            self.indefinite.solve(b, x)

    def solve_transposed(self, b: PETSc.Vec, x: PETSc.Vec) -> None:
        """See LinearSolver."""
        if self._served:
            super().solve_transposed(b, x)
        else:
            self.indefinite.solve_transposed(b, x)

    def solutions(self, columns: Reals, transposed: bool = False) -> Reals:
        """See LinearSolver."""
        if not self._served:
            return self.indefinite.solutions(columns, transposed)
        with self.counts.solving():
            return self._fronts.solutions(columns, transposed)

    def destroy(self) -> None:
        """Frees both factors."""
        super().destroy()
        self.indefinite.destroy()


class Unsymmetric(ByFronts):
    """Systems on one rank by L U, with pivots sought within fronts, and by `indefinite`, which seeks them everywhere,
    where one vanishes."""

    def __init__(self, indefinite: LinearSolver, ksp: PETSc.KSP):
        super().__init__(_projective.General, indefinite, ksp)

    def factor(self, matrix: PETSc.Mat, operator: PETSc.Mat | None = None) -> bool:
        """See LinearSolver."""
        return self._by_fronts(matrix, operator) or self._otherwise(matrix, operator)


class Symmetric(ByFronts):
    """Symmetric systems on one rank: L L^T, and by `indefinite` where a matrix is not positive definite."""

    def __init__(self, indefinite: LinearSolver, ksp: PETSc.KSP):
        super().__init__(_projective.Definite, indefinite, ksp)
        # Whether the last matrix of `factor` was not definite: the next one mostly is not, either.
        self._doubtful = False

    def factor(self, matrix: PETSc.Mat, operator: PETSc.Mat | None = None) -> bool:
        """See LinearSolver."""
        if not self._doubtful and self.factor_definite(matrix, operator):
            return True
        self._otherwise(matrix, operator)
        self._doubtful = bool(self.negative)
        return self.usable

    def factor_definite(self, matrix: PETSc.Mat, operator: PETSc.Mat | None = None) -> bool:
        """See LinearSolver."""
        definite = self._by_fronts(matrix, operator)
        self.negative = 0 if definite else None
        return definite

    def forget(self) -> None:
        """See LinearSolver."""
        self._doubtful = False

    def positive(self, matrix: PETSc.Mat) -> bool:
        """See LinearSolver."""
        return self.factor_definite(matrix)


def symmetric(comm: MPI.Comm, kind: str, tolerance: float, counts: Counts, prefix: str = "") -> LinearSolver:
    """What solves symmetric systems by a KSP of a kind, as options of a prefix say; without such by L L^T first where
    one rank does it all."""
    return _solver(Symmetric, use_cholesky, comm, kind, tolerance, counts, prefix)


def unsymmetric(comm: MPI.Comm, prefix: str, counts: Counts) -> LinearSolver:
    """What solves systems without symmetry, as options with a prefix say; without such by fronts first where one rank
    does it all."""
    return _solver(Unsymmetric, use_lu, comm, PETSc.KSP.Type.PREONLY, None, counts, prefix)


def _solver(
    by_fronts: Callable[[LinearSolver, PETSc.KSP], LinearSolver],
    use: Callable[[PETSc.PC], None],
    comm: MPI.Comm,
    kind: str,
    tolerance: float | None,
    counts: Counts,
    prefix: str,
) -> LinearSolver:
    """tolerance: of the KSP, None for PETSc's; use: chooses the factor where fronts do not serve."""

    def ksp() -> PETSc.KSP:
        made = PETSc.KSP().create(comm=comm)
        made.setOptionsPrefix(prefix)
        made.setType(kind)
        made.setTolerances(rtol=tolerance)
        use(made.pc)
        made.setFromOptions()
        return made

    direct = LinearSolver(ksp(), counts)
    return direct if _chosen(prefix) or comm.size > 1 else by_fronts(direct, ksp())


def _chosen(prefix: str = "") -> bool:
    """Whether options with a prefix choose a solver."""
    return any(name.startswith(tuple(prefix + word for word in CHOICES)) for name in PETSc.Options().getAll())


def counting(comm: MPI.Comm, counts: Counts | None = None) -> LinearSolver:
    """What factors symmetric matrices and counts their negative eigenvalues: options of the systems' solver, which may
    not, do not hold for it but by its own prefix."""
    set_defaults({INERTIA + name: value for name, value in DEFAULTS.items()})
    return symmetric(comm, PETSc.KSP.Type.PREONLY, 0.0, counts or Counts(), INERTIA)


def factored(matrix: PETSc.Mat, counts: Counts | None = None, definite: bool = False) -> LinearSolver:
    """A solver of one symmetric matrix that counts its negative eigenvalues; definite: where it mostly has none."""
    solver = counting(matrix.comm, counts)
    solver = solver if definite else solver.indefinite
    solver.factor(matrix)
    return solver


def add_mass(matrix: PETSc.Mat, mass: PETSc.Vec, shift: float) -> None:
    """Adds shift times the diagonal mass to a tangent."""
    shifted = mass.copy()
    shifted.scale(shift)
    matrix.setDiagonal(shifted, addv=PETSc.InsertMode.ADD_VALUES)
