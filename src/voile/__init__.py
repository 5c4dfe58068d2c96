"""Equilibria and inverse design of thin elastic shells with contact and friction, on PETSc."""

import os

# One BLAS thread per rank: the ranks are the parallelism, and MUMPS's small dense blocks only lose by more
# threads. Set here because the BLAS reads it when numpy loads it.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

__version__ = "0.1.0"
