"""A small imperfection: it, not round-off, which differs between numbers of ranks, chooses where a shell buckles to."""

import numpy as np
from petsc4py import PETSc

from voile.arrays import Flags, Ints, Reals, area_vectors
from voile.problem.problem import Problem
from voile.problem.rest import field_vector

WAVES = 12
SHORTEST = 0.1  # sizes of the shell
SMALL = 1e-3  # of the perturbation off saddles


def imperfection(problem: Problem, x: Reals | None = None, still: Flags | None = None) -> PETSc.Vec:
    """A displacement of about 1 m, smooth and without symmetry: waves of fixed directions and phases, from the shell's
    size down to a tenth of it; with positions x (local vertices, 3) only along the normals there; none where
    `still` (local vertices,). The same for all meshes and numbers of ranks."""
    part, random = problem.part, np.random.default_rng(0)
    waves, sizes = random.standard_normal((2, WAVES, 3))
    waves *= (2.0 * np.pi / np.geomspace(1.0, SHORTEST, WAVES) / np.linalg.norm(waves, axis=1))[:, None]
    phases = random.uniform(0.0, 2.0 * np.pi, WAVES)
    field = np.cos(part.points @ waves.T / problem.size() + phases) @ sizes / np.sqrt(WAVES)
    if x is not None:
        normals = _normals(x, part.corners)
        field = (field * normals).sum(axis=1)[:, None] * normals
    if still is not None:
        field[still] = 0.0
    return field_vector(problem, field)


def perturb(problem: Problem, y: PETSc.Vec, perturbation: float) -> None:
    """Moves a start of a descent off symmetry by more than round-off does; perturbation in m. What bears on an obstacle
    stays there: its weight may be less than its contact makes of so small a motion."""
    small = imperfection(problem, problem.positions(y), _pressed(problem))
    small.scale(SMALL * perturbation)
    y.axpy(problem.longest_step(y, small), small)


def _pressed(problem: Problem) -> Flags:
    """(local vertices,) marks those that bear on an obstacle."""
    pressed, contact = np.zeros(len(problem.part.vertex), dtype=bool), problem.contact
    for normal in contact.history.normal[: len(contact.obstacles)] if contact else ():
        pressed |= normal > 0.0
    return pressed


def _normals(points: Reals, corners: Ints) -> Reals:
    """(n, 3) unit normals of the vertices; zero where there is none."""
    normals = np.zeros_like(points)
    np.add.at(normals, corners, area_vectors(points, corners)[:, None])
    found: Reals = normals / np.maximum(np.linalg.norm(normals, axis=1), 1e-300)[:, None]
    return found
