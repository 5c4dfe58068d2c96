"""Layers that supports move: they push what is free out of their way, and end where what is held meets."""

import ipctk
import numpy as np
import pytest
from protocols import UP, held, plate, shell_of

from voile.problem.contact import shell_layers, with_obstacles
from voile.problem.problem import Problem
from voile.solver.path import Path, StaticsOptions
from voile.solver.statics import solve_statics

OFFSET = 5e-4


def lowered(held_to: float) -> Path:
    """Two strips, one above the other, held up to x (m), the upper one lowered there to below the lower one."""
    points, triangles = plate(0.3, 0.1, 0.05)
    both = np.concatenate([points, points + 0.05 * UP + [0.02, 0.01, 0.0]])
    ends = np.flatnonzero(both[:, 0] < held_to)
    lower, upper = ends[ends < len(points)], ends[ends >= len(points)]
    masks = [np.isin(np.arange(len(both)), part) for part in (lower, upper)]
    shell = shell_of(
        both, np.concatenate([triangles, triangles + len(points)]), young=1e6, thickness=1e-3, density=300.0,
        **held(both, (masks[0], np.zeros(3)), (masks[1], np.array([0.0, 0.0, -0.1]))),
    )  # fmt: skip
    problem = Problem(shell)
    problem = with_obstacles(problem, [], OFFSET, shell_layers(shell, OFFSET, 0.0))
    path = solve_statics(problem, StaticsOptions(load_steps=1))
    x, topology = problem.at(path.last.factor).positions(path.state), shell.topology
    assert not ipctk.has_intersections(ipctk.CollisionMesh(x, topology.edges, shell.triangles), x)
    return path


def test_supports_do_not_carry_layers_through_each_other():
    """Triangles that are held come down on others that are: steps get shorter until these meet, predicted ones, too."""
    path = lowered(0.08)
    assert not path.converged and "supports carry layers of the shell through each other" in path.reason
    assert path.last.factor == pytest.approx(0.5, abs=1e-3)


def test_supports_push_layers_out_of_their_way():
    """The upper strip's held edge comes down on what of the lower one is free."""
    path = lowered(0.03)
    assert path.converged and path.stable and len(path.steps) > 1
