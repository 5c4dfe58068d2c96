"""A run of Projective Dynamics on any number of ranks: local_global_ranks.py CASE STEPS OUT.npz."""

import sys

import numpy as np
import protocols
from falling import Slope, cloth, turning_sphere
from marching import March
from mpi4py import MPI

from voile.problem.contact import shell_layers, with_obstacles
from voile.problem.partition import gathered
from voile.problem.problem import Problem
from voile.problem.shell import Shell
from voile.solver.methods.local_global import LocalGlobal, Options

OFFSET = 5e-4


def stack(count: int = 2, apart: float = 2e-3) -> Shell:
    """Sheets (0.2 m) above a floor and each other (m), the upper ones smaller."""
    parts, faces = [], []
    for k in range(count):
        points, triangles = protocols.plate(0.2 - 0.03 * k, 0.2 - 0.03 * k, 0.02)
        faces.append(triangles + sum(map(len, parts)))
        parts.append(points + np.array([0.015 * k, 0.012 * k, apart * (k + 1)]))
    return cloth(np.concatenate(parts), np.concatenate(faces).astype(np.int32))


def case(name: str, rank: int) -> tuple[Problem, np.ndarray, float]:
    """A problem, its start's velocity and the step (s)."""
    if name == "layers":
        shell = stack()
        layers = shell_layers(shell, OFFSET, 0.4) if rank == 0 else None
        layers = MPI.COMM_WORLD.bcast(layers)
        problem = with_obstacles(
            Problem(shell if rank == 0 else None), [Slope(0.1).plane(0.5)], OFFSET, layers
        )
        return problem, np.zeros(3), 2e-3
    points, triangles = protocols.plate(1.0, 1.0, 0.1)
    fixed = np.repeat((points[:, :1] + points[:, 1:2] < 0.05) & (name == "free"), 3, axis=1)
    shell = cloth(points - [0.45, 0.48, 0.0], triangles, young=2e4, fixed=fixed)
    problem = Problem(shell if rank == 0 else None)
    if name == "sphere":
        problem = with_obstacles(problem, [turning_sphere(0.3, 0.3, -0.02, 2.857)], OFFSET)
    return problem, np.zeros(3), 0.01


def main() -> None:
    name, steps, out = sys.argv[1:]
    problem, velocity, h = case(name, MPI.COMM_WORLD.rank)
    march = March(problem, velocity, h, 1e-10)
    march.run(LocalGlobal(problem, Options(iterations=2000)).solve, int(steps))
    reaction = np.zeros_like(march.x)
    if problem.contact:
        reaction = problem.contact.reactions(march.x, march.time)
    x, reaction = gathered(problem, march.x), gathered(problem, reaction)
    if x is not None:
        np.savez(out, x=x, reaction=reaction)


if __name__ == "__main__":
    main()
