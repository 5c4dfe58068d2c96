"""What a stored step says of stresses, computed afterwards: its shape, put into the scene's own model."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Mapping
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from voile.arrays import Array
from voile.elastic.stresses import FIELDS, lacking
from voile.errors import InputError
from voile.keys import Rejected, Table
from voile.keys.overrides import overridden
from voile.results import Result
from voile.results.folder import recorded_scene
from voile.scene import Scene, read_scene
from voile.scene.plain import ARRAYS
from voile.scene.section import Section

if TYPE_CHECKING:
    from voile.problem.problem import Problem
    from voile.wiring import Model

SAME = 1e-9  # of the size: how far the rest shape of a run may lie from that of its scene


def scene_of(result: Result) -> Scene:
    """The scene of a result, from its text there; files that it names are sought from where the run had its scene, the
    shell of a run with arrays is the result's own. Raises InputError."""
    found = recorded_scene(result.path.parent)
    path = Path(os.path.normpath(result.path.parent / found)) if found else Path("scene")
    tree = overridden(result.scene_text)
    shell = tree.get("shell", {})
    for key, points in (("mesh", result.start), ("rest", result.rest)):
        if str(shell.get(key, "")).startswith(ARRAYS):
            shell[key] = points / shell.get("scale", 1.0), result.triangles
    return dataclasses.replace(read_scene(tree, folder=path.parent), path=path)


class Stresses:
    """The model of a scene in the shapes of a result's steps. Each rank computes for itself.

    Raises InputError where the scene's shell is not the result's, or was not known before the run: inverse design.
    """

    def __init__(self, result: Result, scene: Scene):
        if scene.scene.task == "inverse":
            raise InputError(
                f"{result.path}: stresses afterwards are those of a shell that the scene gives; "
                "allowed: results of statics, dynamics and modes"
            )
        self.result, self.scene = result, scene

    @cached_property
    def _problem(self) -> tuple[Model, Problem]:
        from mpi4py import MPI

        from voile.petsc_options import start_petsc
        from voile.problem.problem import Problem
        from voile.solver.sewing import sew
        from voile.wiring import build_model

        start_petsc()
        try:
            model = build_model(self.scene)
        except InputError as error:
            raise InputError(
                f"{self.result.path}: its scene is not to be had any more: {error}; allowed: given anew, as --scene or "
                "as `scene` of voile.read"
            ) from None
        self._check(model)
        return model, Problem(sew(model.shell, MPI.COMM_SELF), MPI.COMM_SELF)

    def _check(self, model: Model) -> None:
        result, shell = self.result, model.shell
        same = (
            np.array_equal(result.triangles, shell.triangles) and result.rest.shape == shell.rest_points.shape
        )
        size = np.ptp(shell.rest_points, axis=0).max()
        if not (same and np.abs(result.rest - shell.rest_points).max() <= SAME * size):
            raise InputError(
                f"{result.path}: the shell that {self.scene.shell.mesh} gives now is not that of the run; "
                "allowed: the scene and meshes of the run"
            )

    def at(self, step: int) -> tuple[Problem, Any]:
        """The problem at a step's time or load factor, and the unknowns there, counted from its shape."""
        problem = self._problem[1].at(float(self.result.values[step]))
        part, points, angles = problem.part, self.result.points(step), self.result.edge_angles(step)
        phi = np.zeros(len(part.edge)) if angles is None else angles[part.edge]
        problem.layout.stand_at((points[part.vertex] - part.points).ravel(), phi, problem.time)
        problem.elastic.count_from(points[part.vertex])
        return problem, problem.create_vector()

    def field(self, name: str, step: int) -> Array:
        """(m, ...) a cell field of `output.fields` at a step."""
        from voile.problem.stress_fields import shell_fields

        group = next(group for group, written in FIELDS.items() if name in written)
        why = lacking(self.scene.shell.model, self.scene.shell.material).get(group)
        if why:
            raise InputError(f'{self.result.path}: field "{name}": {why}')
        found, triangle = shell_fields(*self.at(step), (group,))
        values = np.empty_like(found[name])
        values[triangle] = found[name]
        return values

    def sections(self, table: Mapping[str, Any], step: int) -> list[dict[str, Any]]:
        """At a step, of the cut with these keys of [[section]], or of the scene's own where they are none: name, force
        (N) and moment (N m) of the rest of the shell on what lies inside, and the point that it counts about (m)."""
        from voile.held import sections_of
        from voile.mesh import build_topology, surface_loops
        from voile.problem.sections import section_table

        specs = (_read(table),) if table else self.scene.section
        if not specs:
            raise InputError(f"{self.scene.path}: no [[section]]; allowed: the keys of one")
        (model, _), (problem, y) = self._problem, self.at(step)
        loops = surface_loops(model.surface, build_topology(model.surface.triangles))
        cuts = sections_of(dataclasses.replace(self.scene, section=specs), model.surface, loops)
        return section_table(problem, y, problem.shell, cuts) or []


def _read(table: Mapping[str, Any]) -> Section:
    try:
        found: Section = Table(Section).read(dict(table))
    except Rejected as error:
        where = ".".join(map(str, ("section", *error.path)))
        raise InputError(f"{where}: {error.problem}") from None
    return found
