"""Prints the adjoint method's objective, its derivative along a direction, the Hessian's product and the order of the
objective's Taylor remainder along it, on any ranks."""

import math
import sys

from inverse_shells import nearest_to
from mpi4py import MPI
from test_adjoint import sample, wave
from test_panels import cone_target

from voile.inverse.direct import Direct
from voile.problem.rest import PanelRest


def main(kind: str) -> None:
    """kind: as in test_adjoint.sample, or panels."""
    comm = MPI.COMM_WORLD
    if kind == "panels":
        target, flat = cone_target(comm)
        design = PanelRest(target.problem, flat)
        home, z, direction = (design.create() for _ in range(3))
        first, last = z.getOwnershipRange()
        for vector, frequency in ((z, 1.0), (direction, 1.7)):
            vector.array[:] = [1e-4 * math.sin(frequency * k) for k in range(first, last)]
        state = target.problem.create_vector()
    else:
        target = sample(kind, comm)
        target.load(1.0)
        contact = kind == "contact"
        design, home = (
            target.rest,
            Direct(target).follow().rest if contact else target.problem.create_vector(),
        )
        size = 1e-5 if contact else 1e-4  # reactions stay inside their cones
        z, direction, state = home + wave(target, 1.0, size), wave(target, 1.7, size), target.rest.state(home)
    objective = nearest_to(target, design, home, state, 0.1, 1e-10)
    gradient = z.duplicate()
    value = objective.evaluate(z, gradient)
    product = z.duplicate()
    objective.mult(None, direction, product)
    slope, curvature, left = gradient.dot(direction), direction.dot(product), []
    for h in (1e-1, 1e-2):
        left.append(abs(objective.evaluate(z + h * direction, z.duplicate()) - value - h * slope))
    if comm.rank == 0:
        print(f"{value:.12e} {slope:.12e} {curvature:.12e} {math.log10(left[0] / left[1]):.3f}")


if __name__ == "__main__":
    main(sys.argv[1])
