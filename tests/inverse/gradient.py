"""Prints the adjoint method's objective, its derivative along a direction and the Hessian's product, on any ranks."""

import sys

from mpi4py import MPI
from test_adjoint import sample, wave

from voile.inverse.adjoint import Objective


def main(kind: str) -> None:
    """kind as in test_adjoint.sample."""
    comm = MPI.COMM_WORLD
    target = sample(kind, comm)
    target.load(1.0)
    home = target.problem.create_vector()
    with target.obstructed():
        objective = Objective(target, target.rest, home, home, 0.1, 1e-10)
        z, direction, gradient = wave(target, 1.0, 1e-4), wave(target, 1.7, 1e-4), home.duplicate()
        value = objective.evaluate(z, gradient)
        product = home.duplicate()
        objective.mult(None, direction, product)
        figures = value, gradient.dot(direction), direction.dot(product)
        objective.forward.snes.destroy()
    if comm.rank == 0:
        print(*(f"{figure:.12e}" for figure in figures))


if __name__ == "__main__":
    main(sys.argv[1])
