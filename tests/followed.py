"""Follows the hinges of a run through all shapes of which Newton's methods ask the forces.

python tests/followed.py SCENE OUT prints how many pass 180 degrees. In stored load steps a hinge that snaps through
flat looks like one that turns over; from one of those shapes to the next none turns by nearly as much.
"""

import sys

import numpy as np
from hinges import fold_angles

from voile.cli import main
from voile.problem.problem import Problem

UNSEEN = np.radians(170.0)  # a change from a shape to the next that may be either way round


class Follower:
    """Fold angles of a problem's shapes one after the other, unwrapped; passed: hinges that are, or may be, beyond 180
    degrees at some."""

    def __init__(self) -> None:
        self.angles, self.passed = np.zeros(0), np.zeros(0, dtype=bool)

    def see(self, points: np.ndarray, triangles: np.ndarray) -> None:
        """The next shape; on another mesh a level of it, the first."""
        found = fold_angles(points, triangles)
        if len(found) != len(self.angles):
            self.angles, self.passed = found, np.zeros(len(found), dtype=bool)
        change = (found - self.angles + np.pi) % (2.0 * np.pi) - np.pi
        self.angles = self.angles + change
        self.passed |= (np.abs(self.angles) > np.pi) | (np.abs(change) > UNSEEN)


if __name__ == "__main__":
    follower, residual = Follower(), Problem.residual

    def seen(problem: Problem, y: object, *others: object) -> None:
        """The residual of a shape that is looked at."""
        follower.see(problem.positions(y), problem.part.corners)
        residual(problem, y, *others)

    Problem.residual = seen
    main(["run", sys.argv[1], "-o", sys.argv[2]])
    print(f"hinges past 180 degrees: {follower.passed.sum()}")
