"""Hinges that turn through 180 degrees in time, where no layer is in their way: cloth that lies folded on a floor.

There the half angle jumps from one sign to the other, and with it the energy; a shape that rests at exactly 180 degrees
would have round-off choose. So a hinge beyond 90 degrees goes on from the side on which a step found it.
"""

from dataclasses import dataclass

import numpy as np
from mpi4py import MPI

from voile.problem.problem import Problem
from voile.problem.terms import Point


@dataclass
class Folds:
    """Those of a path. lost (J): elastic energy of hinges that have come round since the last step that was taken; its
    sign is any."""

    lost: float = 0.0

    def follow(self, problem: Problem, start: Point) -> None:
        """Chooses the sides from which a step goes on that begins at a point."""
        elastic = problem.elastic
        sides = elastic.sides_at(start)
        if problem.everywhere(np.array_equal(sides, elastic.sides)):
            return
        before = sum(elastic.energies(start).values())
        elastic.take_sides(sides)
        self.lost += problem.comm.allreduce(before - sum(elastic.energies(start).values()), op=MPI.SUM)
