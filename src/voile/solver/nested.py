"""Nested iteration: a coarser level of the shell finds the folds, where an iteration is cheap; the fine one starts
from its shape and reactions, and has only the details left.

A coarse mesh is too stiff to fold: facets of edges H bent by a curvature k strain by (k H)^2, which costs H^4 times
what it costs the smooth surface. A level's membrane is therefore softened by the fourth power of the ratio of the
edges, its bending is not; its folds are then about as deep as those of the fine level.
"""

import copy
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Protocol

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from voile.arrays import Reals, diagonal
from voile.problem.contact import contact_of, vertex_areas, with_obstacles
from voile.problem.levels import coarsen
from voile.problem.partition import gathered
from voile.problem.problem import Problem
from voile.problem.prolongation import Prolongation
from voile.problem.rest import field_vector
from voile.problem.shell import Shell
from voile.solver.methods.method import Method, Outcome

# Of a level under its own weight. Where levels of a dress of 17,562 vertices stretched by 0.75, no fine one could start
# from their shapes.
STRETCH = 0.05


@dataclass
class Options:
    """ratio: of the vertices, from level to level. smallest: vertices that are not worth a level; they take under a
    second. rough: tolerance of a level over its loads, without contact: what is sharper is lost on the next level;
    with 1e-2 folds are not yet made. faint: share of the largest carried reaction that is none."""

    ratio: float = 0.25
    smallest: int = 500
    rough: float = 1e-4
    faint: float = 1e-3


def pays(problem: Problem, options: Options | None = None) -> bool:
    """Whether the mesh is large and only its loads lead the shell: no path of supports or obstacles, which friction
    and branches remember; no layers in each other's way, which a level would carry through each other; no springs
    or local axes of supports, which levels do not have."""
    contact = problem.contact
    led = problem.moves or (contact is not None and (contact.moves or contact.itself is not None))
    count = problem.comm.allreduce(int(problem.own.sum()))
    led = led or problem.turned
    return problem.conservative and not (led or problem.springs) and count > (options or Options()).smallest


class LevelSolver(Protocol):
    """What solves a level: by `level`, a method; `promises`: see Promising."""

    @property
    def level(self) -> Method: ...

    def promises(self, problem: Problem, y: PETSc.Vec, tolerance: float) -> bool: ...


class Nested:
    """Solves the next coarser level by `solver(level)`, which may be nested again, then, from there, the problem by
    `fine`. It does not converge where the level does not, nor where the level's shape, carried over, costs more bending
    than all that the level gained: as of a dress with pleats, whose hinges lie near 180 degrees on coarse levels."""

    def __init__(
        self,
        problem: Problem,
        fine: Method,
        solver: Callable[[Problem], LevelSolver],
        options: Options | None = None,
    ):
        self.problem, self.fine, self.solver = problem, fine, solver
        self.options = options or Options()

    def solve(self, problem: Problem, y: PETSc.Vec, tolerance: float) -> Outcome:
        """See Method."""
        if self.level is None:
            return Outcome(False, "nested", "no coarser level")
        coarse, z, wanted = self._begin(problem, y, tolerance)
        if not coarse.contact:
            wanted = max(self.options.rough * coarse.load_norm(z), wanted)
        before = coarse.energy(z)
        found = self.level[1].level.solve(coarse, z, wanted)
        if not found.converged:
            return replace(found, method="nested", gone=False)
        self._carry(z, y)
        if problem.energies(y)["bending"] > before - coarse.energy(z):
            return Outcome(False, "nested", "a shape of a level costs more bending than it gained there")
        outcome = self.fine.solve(problem, y, tolerance)
        watched = outcome.watched and found.watched
        return replace(outcome, method=f"nested {outcome.method}", watched=watched)

    def promises(self, problem: Problem, y: PETSc.Vec, tolerance: float) -> bool:
        """Whether the first method converges on the coarsest level; it does where there is none."""
        return self.level is None or self.level[1].promises(*self._begin(problem, y, tolerance))

    def _begin(self, problem: Problem, y: PETSc.Vec, tolerance: float) -> tuple[Problem, PETSc.Vec, float]:
        """The level's problem, unknowns and tolerance at those of the problem."""
        assert self.level
        coarse, z = self.level[0].at(problem.time), self._restrict(y)
        full = problem.load_norm(y)
        if full:  # or else the supports' reactions set it
            tolerance *= coarse.load_norm(z) / full
        return coarse, z, tolerance

    @cached_property
    def _coarsened(self) -> tuple[Shell, Prolongation] | None:
        """Rank 0's."""
        made = coarsen(self.problem.shell, self.options.ratio) if self.problem.shell else None
        return made and (softened(made[0], len(made[1].kept) / len(made[1].corners)), made[1])

    @cached_property
    def level(self) -> tuple[Problem, LevelSolver] | None:
        """The next coarser problem and what solves it; None where the mesh has no coarser one."""
        made = self._coarsened
        if not self.problem.comm.bcast(made is not None):
            return None
        coarse, contact = Problem(made and made[0], self.problem.comm), self.problem.contact
        coarse.monitor = self.problem.monitor
        if contact:
            coarse = with_obstacles(coarse, contact.obstacles, np.max(contact.offset, axis=1, keepdims=True))
        return coarse, self.solver(coarse)

    def _restrict(self, y: PETSc.Vec) -> PETSc.Vec:
        """The level's unknowns at the problem's shape, its contact without memory."""
        assert self.level
        coarse, made = self.level[0], self._coarsened
        table = gathered(self.problem, self.problem.positions(y))
        shape = None if table is None or made is None else made[1].restrict(table)
        shape = coarse.comm.bcast(shape)
        z = coarse.create_vector()
        z.axpy(1.0, field_vector(coarse, shape[coarse.part.vertex] - coarse.positions(z)))
        if coarse.contact:
            coarse.contact.begin(coarse.positions(z), coarse.time)
        return z

    def _carry(self, z: PETSc.Vec, y: PETSc.Vec) -> None:
        """y moves to the level's shape; contact gets its reactions, as pressures."""
        assert self.level
        (coarse, _), problem, made = self.level, self.problem, self._coarsened
        contact, columns = coarse.contact, [coarse.positions(z)]
        for k in range(len(contact.obstacles) if contact else 0):
            assert contact is not None
            area = vertex_areas(coarse)[:, None]
            columns += [contact.history.normal[k][:, None] / area, contact.history.friction[k] / area]
        table = gathered(coarse, np.hstack(columns))
        if table is not None and made is not None:
            table = np.hstack([made[1].positions(table[:, :3]), made[1].interpolate(table[:, 3:])])
        table = problem.comm.bcast(table)[problem.part.vertex]
        y.axpy(1.0, field_vector(problem, table[:, :3] - problem.positions(y)))
        if problem.contact:
            self._press(table[:, 3:])

    def _press(self, table: Reals) -> None:
        """Reactions from pressures and shears (local vertices, 4 per obstacle) N/m^2."""
        history, area = contact_of(self.problem).history, vertex_areas(self.problem)
        for k in range(table.shape[1] // 4):
            pressure, shear = table[:, 4 * k], table[:, 4 * k + 1 : 4 * k + 4]
            largest = self.problem.comm.allreduce(float(pressure.max(initial=0.0)), op=MPI.MAX)
            carries = np.where(pressure > self.options.faint * largest, area, 0.0)
            history.normal[k], history.friction[k] = carries * pressure, carries[:, None] * shear


class Promising:
    """A method that is tried at first only where it converges on the coarsest level, at a thousandth of the cost:
    elsewhere ten steps of a cloth of 16,641 vertices took half of the run."""

    def __init__(self, method: Method, nested: Nested):
        self.method, self.nested, self.asked = method, nested, False

    def solve(self, problem: Problem, y: PETSc.Vec, tolerance: float) -> Outcome:
        """See Method."""
        first, self.asked = not self.asked, True
        if first and not self.nested.promises(problem, y, tolerance):
            return Outcome(False, "", "the first method does not converge on the coarsest level")
        return self.method.solve(problem, y, tolerance)


def softened(shell: Shell, share: float) -> Shell:
    """A level with a share of the finer vertices: its membrane divided by 1/share^2 = (H/h)^4, but not so soft that
    its own weight stretches it by more than STRETCH; the bending stiffness and the mass kept."""
    size = diagonal(shell.points)
    weight = float(np.linalg.norm(shell.gravity)) * size * shell.density.mean() / shell.young.mean()
    soft = max(1.0, min(share**-2, STRETCH / max(weight, 1e-300)))
    shell = copy.copy(shell)
    shell.young = shell.young * soft**-1.5
    shell.thickness = shell.thickness * soft**0.5
    shell.density = shell.density * soft**-0.5
    return shell
