"""Why no step leads on from a shape, where that can be seen."""

from mpi4py import MPI
from petsc4py import PETSc

from voile.problem.contact import contact_of
from voile.problem.problem import Problem
from voile.problem.scales import least_area

CRUSHED = 0.1  # of a triangle's area at rest, which is blamed for a failure


def crushed(problem: Problem, y: PETSc.Vec) -> str:
    """Names a triangle without area at y; empty where there is none."""
    share = least_area(problem, y)
    if share > CRUSHED:
        return ""
    return f"; a triangle is crushed to {share:.2g} of its area at rest, which material = neo-hookean resists"


def depth_inside(problem: Problem, y: PETSc.Vec) -> tuple[float, str]:
    """How deep (m) the shell at y is in an obstacle, and which; 0 where it is in none."""
    if not problem.contact:
        return 0.0, ""
    contact, x = contact_of(problem), problem.positions(y)
    inside = problem.own & contact.movable
    depths = [
        problem.comm.allreduce(-float(contact.gap(k, x, problem.time)[inside].min(initial=0.0)), op=MPI.MAX)
        for k in range(len(contact.obstacles))
    ]
    depth = max(depths, default=0.0)
    if depth <= contact.touch:
        return 0.0, ""
    return depth, contact.obstacles[depths.index(depth)].name
