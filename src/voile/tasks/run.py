"""What every task shares: the scene's problem, its result file and its summary.

A task is a module beside this one, named as in scenes (scene.task), with `run(job: Run) -> str`: it solves, writes and
gives the reason why it did not converge, or nothing.
"""

import hashlib
import math
import platform
import resource
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy
from mpi4py import MPI
from petsc4py import PETSc

import voile
from voile import blas
from voile.arrays import Array
from voile.contact.candidates import Layers
from voile.contact.obstacles import Obstacle
from voile.errors import on_root
from voile.explain import modelled
from voile.petsc_options import unused_options
from voile.problem.contact import contact_fields, shell_layers, with_obstacles
from voile.problem.problem import Problem
from voile.problem.sections import section_table
from voile.problem.shell import Shell
from voile.problem.stress_fields import shell_fields
from voile.problem.support_forces import Supporting, support_forces, support_table
from voile.results import ResultWriter, StaticMesh, write_summary
from voile.results.folder import RESULT, SUMMARY, set_aside
from voile.results.reader import look_through
from voile.results.restart import Restarts
from voile.results.writer import CAPACITY
from voile.scene import Scene
from voile.solver.path import Arrays, LoadStep
from voile.solver.path import Path as LoadPath
from voile.solver.path_in_time import TimePath
from voile.solver.sewing import sew
from voile.tasks.progress import Progress
from voile.wiring import Model, static_mesh

STORED = "stored"  # the array that says how many steps the result file had
NO_CONTACT = {"active": 0, "stick": 0, "slip": 0, "max_penetration": 0.0, "friction_error": 0.0}


@dataclass
class Run:
    """A scene on its way to results in `folder`; model: the scene's, on rank 0; began: time.perf_counter() at start;
    resumes: goes on from the results there; lasting: all ranks see the folder, and a later run may go on from it;
    restarts: what it keeps for that; found: what it goes on from itself, nothing at a start; so_far: figures that also
    the summary of a stopped run has."""

    scene: Scene
    model: Model | None
    folder: Path
    comm: MPI.Comm
    progress: Progress
    began: float
    writing: float = 0.0  # s
    resumes: bool = False
    lasting: bool = True
    stored: bool = False  # whether the folder's result is this run's
    found: dict[str, Array] = field(default_factory=dict)
    so_far: Callable[[], dict[str, Any]] = dict
    restarts: Restarts = field(init=False)

    def __post_init__(self) -> None:
        self.restarts = Restarts(self.folder, self.comm, self._named(), self.lasting)
        if self.resumes:
            self.found = self.restarts.load()
            self.stored = bool(self.found[STORED] > 0)
        elif self.lasting:
            self.restarts.clear()

    def _named(self) -> str:
        """What tells the run from others whose results may be in its folder."""
        digest = hashlib.sha256(self.scene.text.encode())
        if self.model:
            for array in (self.model.shell.points, self.model.shell.rest_points, self.model.shell.triangles):
                digest.update(numpy.ascontiguousarray(array).data)
        found: str = self.comm.bcast(digest.hexdigest())
        return found

    def keep(self, step: int, arrays: dict[str, Array], stored: int, began: float | None = None) -> None:
        """Keeps what a later run goes on from, after a step and so many stored ones. Collective."""
        self.restarts.save(step, {STORED: numpy.array(stored), **arrays}, began)

    # ---- from the scene to the problem ----

    def sewn(self, shell: Shell | None = None) -> Shell | None:
        """A shell (rank 0's; by default the model's) with its seams closed."""
        return sew(shell or (self.model.shell if self.model else None), self.comm)

    def problem(self, shell: Shell | None) -> Problem:
        """The problem of a sewn shell, whose iterations the progress tells."""
        problem = Problem(shell, self.comm)
        problem.monitor = self.progress.iteration
        return problem

    def bodies(self) -> tuple[list[Obstacle], float]:
        """The obstacles, and how far from the mid-surface they touch (m)."""
        found: tuple[list[Obstacle], float] = self.comm.bcast(
            (self.model.obstacles, self.model.offset) if self.model else None
        )
        return found

    def layers(self, shell: Shell | None) -> Layers | None:
        """The layers of a sewn shell that are in each other's way; None where the scene lets them pass. Adds a note on
        those that are not kept apart."""
        contact, layers = self.scene.contact, None
        if not contact.self_contact:
            return None
        if self.model and shell is not None:
            layers = shell_layers(shell, self.model.offset, contact.self_friction)
            layers.keeps = self.scene.scene.task == "dynamics"
            if layers.caught:
                self.note(
                    f"contact.self_contact: {layers.caught} pairs of vertices start nearer than the seams gape, a "
                    "layer caught between: they are not kept apart"
                )
        found: Layers | None = self.comm.bcast(layers)
        return found

    def prepare(self) -> tuple[Shell | None, Problem]:
        """The scene's shell, sewn, and its problem with all that is in its way."""
        shell = self.sewn()
        return shell, with_obstacles(self.problem(shell), *self.bodies(), self.layers(shell))

    def note(self, text: str) -> None:
        """Something a user should know, for the summary."""
        if self.model:
            self.model.notes.append(text)

    def tell(self, text: str) -> None:
        """A note that the log has, too."""
        self.progress.line(f"note: {text}")
        self.note(text)

    # ---- results ----

    def mesh(self, shell: Shell | None, directors: bool, **point_data: Array | None) -> StaticMesh | None:
        """What the result file holds once, on rank 0."""
        if not (self.model and shell):
            return None
        mesh = static_mesh(self.model, shell, directors)
        given = {name: values for name, values in point_data.items() if values is not None}
        return replace(mesh, point_data={**mesh.point_data, **given})

    @contextmanager
    def results(
        self, mesh: StaticMesh | None, numbered: bool = False, room: int = CAPACITY
    ) -> Iterator[ResultWriter]:
        """The result file; numbered: its values may fall; room: for how many steps at first."""
        path, goes_on = self.folder / RESULT, int(self.found.get(STORED, 0))
        if goes_on and path.is_file():
            on_root(self.comm, lambda: look_through(path))
        with ResultWriter(
            path,
            self.comm,
            mesh=mesh,
            scene_text=self.scene.text,
            versions=versions(),
            goes_on=goes_on,
            gather=not self.lasting,
            numbered=numbered,
            room=room,
        ) as writer:
            try:
                yield writer
            finally:
                self.stored = self.stored or writer.steps > 0

    def forces(self, problem: Problem, path: LoadPath | TimePath) -> dict[str, Any]:
        """What each [[fix]] and what each [[section]]'s cut exerts at the end of a path, on rank 0; nothing where there
        is none or nothing computed. Collective."""
        if path.last is None:
            return {"supports": []}
        at, model, y = problem.at(path.time), self.model, path.state
        found: dict[str, Any] = {"supports": self.supports(at, y, path.supporting)}
        shell = model.shell if model else None
        if self.scene.section:
            found["sections"] = section_table(at, y, shell, model.sections if model else ()) or []
        return found

    def supports(self, problem: Problem, y: PETSc.Vec, given: Supporting | None) -> list[dict[str, Any]]:
        """What each [[fix]] exerts, see support_table: by default at rest. On rank 0. Collective."""
        if not problem.held:
            return []
        shell, holds = (self.model.shell, self.model.holds) if self.model else (None, None)
        return support_table(problem, y, given or support_forces(problem, y), shell, holds) or []

    def support_figures(self, problem: Problem, y: PETSc.Vec) -> dict[str, float]:
        """What each [[fix]] exerts on the shell at rest, its components by name (N). Collective."""
        return {
            f"support_{k}_{axis}": float(force)
            for k, support in enumerate(self.comm.bcast(self.supports(problem, y, None)))
            for axis, force in zip("xyz", support["force"], strict=True)
        }

    def summarise(
        self,
        problem: Problem,
        path: LoadPath | TimePath,
        seconds: dict[str, float] | None = None,
        **more: Any,
    ) -> None:
        """summary.json of a run whose last simulation is `path`. seconds: what took how long beside; more: further
        figures, and others in place of the path's own."""
        if self.model is None:
            return
        last = path.last
        seconds = {**problem.seconds, **path.seconds, "input_output": self.writing, **(seconds or {})}
        summary = {
            "converged": path.converged,
            "reason": path.reason,
            **self._about(),
            "dofs": problem.unknowns,
            "steps": path.count,
            "newton_iterations": path.newton_iterations,
            "linear_solves": path.counts.solves,
            "factorisations": path.counts.factorisations,
            "krylov_iterations": path.counts.krylov,
            "residual_norm": last.residual if last else None,
            "residual_tolerance": last.tolerance if last else None,
            "energy": last.energies if last else {},
            "contact": (last.contact if last else None) or NO_CONTACT,
            "method": path.methods,
            **path.figures,
            "wall_time_s": {**seconds, "total": time.perf_counter() - self.began},
            "peak_memory_mib": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0,
            "ranks": problem.comm.size,
            **more,
        }
        self._tell(summary)

    def refuse(self, reason: str) -> None:
        """summary.json of a run that was stopped, or found nothing in equilibrium."""
        if self.model:
            self._tell({"converged": False, "reason": reason, **self._about(), **self.so_far()})

    def _tell(self, summary: dict[str, Any]) -> None:
        """Writes summary.json; an earlier run's result must not be beside it."""
        if not self.stored:
            set_aside(self.folder / RESULT)
        write_summary(self.folder / SUMMARY, summary)

    def _about(self) -> dict[str, Any]:
        """What every summary tells of its run."""
        assert self.model is not None
        return {
            "task": self.scene.scene.task,
            "name": self.scene.scene.name,
            "versions": versions(),
            "blas": asdict(blas.used()),
            "unused_options": unused_options(),
            "modelled": [name for name, keep, _ in modelled(self.scene, self.model) if keep],
            "notes": self.model.notes,
        }


class Steps:
    """Takes the steps of a path as they come: tells the progress and writes every so many, and the last, at `end` or
    minus that."""

    def __init__(self, run: Run, problem: Problem, writer: ResultWriter, end: float = 1.0):
        self.run, self.problem, self.writer, self.end = run, problem, writer, end
        self.reached, self.over = int(run.found.get("reached", 0)), False

    def __call__(self, step: LoadStep, y: PETSc.Vec) -> None:
        self.reached, self.over = self.reached + 1, abs(step.factor) >= self.end
        if self.over or self.reached % self.run.scene.output.every == 0:
            self._write_step(step, y)
        self.run.progress.step(step)  # what is printed is there

    def pause(self, packed: Callable[[], Arrays]) -> None:
        """Keeps now and then what the path may go on from, and at the end where something was kept."""
        if self.run.restarts.due() or (self.over and self.run.restarts.step >= 0):
            began = time.perf_counter()
            self.run.keep(
                self.reached, {**packed(), "reached": numpy.array(self.reached)}, self.writer.steps, began
            )
            self.run.writing += time.perf_counter() - began

    def finish(self, path: LoadPath) -> None:
        """Writes the last good state of a path that did not reach its end, and where round-off ended it."""
        if path.converged:
            return
        if path.steps and self.reached % self.run.scene.output.every:
            self._write_step(path.steps[-1], path.state)
        if path.blurred:
            step, state = path.blurred
            y = path.state.duplicate()
            self.problem.restore(y, state)
            self._write_step(step, y, converged=0.0)
        elif not self.reached:
            self._write(0.0, path.state, {"residual": math.inf, "converged": 0.0})

    def _write_step(self, step: LoadStep, y: PETSc.Vec, converged: float = 1.0) -> None:
        scalars = {"residual": step.residual, "converged": converged, **step.energies}
        if step.displacement is not None:
            scalars["load_displacement"] = step.displacement
        scalars |= self.run.support_figures(self.problem.at(step.factor), y)
        self._write(step.factor, y, scalars)

    def _write(self, at: float, y: PETSc.Vec, scalars: dict[str, float]) -> None:
        start = time.perf_counter()
        fields = self.run.scene.output.fields
        self.writer.write_step(at, scalars=scalars, **rows(self.problem.at(at), y, fields))
        self.run.writing += time.perf_counter() - start


def rows(problem: Problem, y: PETSc.Vec, fields: tuple[str, ...] = ()) -> dict[str, Any]:
    """What the result file takes of a state: this rank's rows and the obstacles' placements; fields: the scene's
    output.fields."""
    part, (u, phi) = problem.part, problem.local(y)
    own = part.owned_vertices
    values: dict[str, Any] = {
        "points": (part.points + u.reshape(-1, 3))[own],
        "point_index": part.vertex[own],
    }
    if problem.directors:
        values |= {"edge_angles": phi[part.owned_edges], "edge_index": part.edge[part.owned_edges]}
    if fields:
        values["cell_data"], values["cell_index"] = shell_fields(problem, y, fields)
    if problem.contact:
        values["point_data"] = {name: values[own] for name, values in contact_fields(problem, y).items()}
        bodies = problem.contact.obstacles
        values["placements"] = numpy.array([body.motion.matrix(problem.time) for body in bodies])
    return values


def versions() -> dict[str, str]:
    """What a result is computed with."""
    return {
        "voile": voile.__version__,
        "petsc": ".".join(map(str, PETSc.Sys.getVersion())),
        "numpy": numpy.__version__,
        "python": platform.python_version(),
    }
