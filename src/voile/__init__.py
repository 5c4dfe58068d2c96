"""Equilibria and inverse design of thin elastic shells with contact and friction, on PETSc."""

from voile import blas

blas.prepare()  # before numpy loads it

__version__ = "0.1.0"
