"""Solvers: load paths of shells, and discrete frictional contact."""

from voile.solver.friction import solve_friction

__all__ = ["solve_friction"]
