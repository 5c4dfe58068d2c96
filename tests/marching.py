"""Implicit Euler steps of a problem with a given method, for tests of step methods."""

from collections.abc import Callable

import numpy as np

from voile.problem.inertia import Inertia
from voile.problem.load import Load
from voile.problem.loads import LOADS
from voile.problem.problem import Problem


class Full(Load):
    """A load that acts wholly at all times."""

    def factor(self, t: float) -> float:
        return 1.0


ALWAYS = {name: Full() for name in LOADS}


class March:
    """Positions x (local vertices, 3) m and velocity (m/s) of a problem, step by step. scale (N): what tolerances are
    relative to; outcome: of the last step."""

    def __init__(self, problem: Problem, velocity: np.ndarray, h: float, tolerance: float = 1e-10):
        self.problem, self.h, self.tolerance, self.time = problem, h, tolerance, 0.0
        self.y = problem.create_vector()
        self.x = problem.at(0.0).positions(self.y)
        self.velocity = np.broadcast_to(velocity, self.x.shape).copy()
        self.scale = problem.norm((problem.vertex_mass()[:, None] * np.ones(3))[problem.own].ravel()) * 9.81

    def step(self, solve: Callable) -> None:
        """solve(problem, y, tolerance in N): a method's."""
        problem = self.problem.at(self.time + self.h)
        if problem.contact:
            problem.contact.begin(self.x, self.time)
        predicted = self.x + self.h * self.velocity
        inertia = Inertia(problem.vertex_mass(), problem.own, self.h**-2, predicted)
        self.outcome = solve(problem.with_terms(inertia), self.y, self.tolerance * self.scale)
        assert self.outcome.converged, self.outcome
        x = problem.positions(self.y)
        self.velocity, self.x, self.time = (x - self.x) / self.h, x, problem.time

    def run(self, solve: Callable, steps: int) -> "March":
        for _ in range(steps):
            self.step(solve)
        return self
