"""Factors by fronts, in CHOLMOD's order, on one rank.

`_projective.Definite` factors positive definite matrices in 0.4 to 0.8 of MUMPS' time (700 to 30,000 unknowns,
Cooperlake kernels) and solves in a third to two thirds; one that is indefinite it leaves at a negative pivot. `General`
factors without symmetry in half of MUMPS' time.
"""

from hashlib import blake2b
from typing import Any
from weakref import WeakValueDictionary

import numpy as np
from petsc4py import PETSc

from voile import _projective
from voile._petsc import aij_arrays
from voile.arrays import Ints, Reals
from voile.launch import threads

SOLVES = PETSc.Log.Event("MatSolve")  # as PETSc logs its own
_ANALYSES: "WeakValueDictionary[bytes, Any]" = WeakValueDictionary()


def analysed(start: Ints, column: Ints) -> Any:
    """The fronts of a pattern, which all its factors share."""
    key = blake2b(column.data, key=blake2b(start.data).digest()).digest()
    found = _ANALYSES.get(key)
    if found is None:
        found = _ANALYSES[key] = _projective.Fronts(start, column, threads())
    return found


class Fronts:
    """Context of a PETSc PC of type python: L L^T (`_projective.Definite`) or L U (`General`), by threads, to the same
    digits."""

    def __init__(self, kind: type) -> None:
        self._kind = kind
        self._factor: Any = None
        self._pattern: tuple[int, object] | None = None

    def factor(self, matrix: PETSc.Mat) -> bool:
        """Whether the matrix is definite, or has no pivot that vanishes."""
        start, column, value = aij_arrays(matrix.handle)[0]
        pattern = matrix.handle, matrix.getAttr("coupled")
        if self._factor is None or self._pattern != pattern:
            self._factor, self._pattern = self._kind(analysed(start, column)), pattern
        return bool(self._factor.factor(value))

    def apply(self, _: PETSc.PC, b: PETSc.Vec, x: PETSc.Vec) -> None:
        """x = A^-1 b with the last factor."""
        assert self._factor
        with SOLVES:
            self._factor.solve(b.array_r, x.array_w)

    def applyTranspose(self, _: PETSc.PC, b: PETSc.Vec, x: PETSc.Vec) -> None:  # PETSc's name
        """x = A^-T b."""
        assert self._factor
        with SOLVES:
            self._factor.solve(b.array_r, x.array_w, True)

    def solutions(self, columns: Reals, transposed: bool = False) -> Reals:
        """A^-1 columns, or A^-T columns."""
        assert self._factor
        out = np.empty(columns.shape)
        self._factor.solve(np.ascontiguousarray(columns), out, transposed)
        return out
