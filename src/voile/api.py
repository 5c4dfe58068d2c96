"""Voile from Python: `load` a scene, `run` it, `read` a result. The commands take the same way.

import voile

scene = voile.load("scene.toml", {"shell.young": 2e6})
result = voile.run(scene)
print(result.summary["energy"], result.positions[:, 2].min())
result.render("a.png", field="reaction")
"""

from __future__ import annotations

import gc
import io
import os
import shutil
import tempfile
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import cached_property
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

import voile.results
from voile.afterwards import Stresses, scene_of
from voile.arrays import Array, Reals
from voile.elastic.stresses import FIELDS, lacking
from voile.errors import InputError, NotConverged, on_root
from voile.results import held_output, open_result, read_summary, result_file
from voile.results.history import read_history
from voile.scene import Scene, read_scene, unsupported

if TYPE_CHECKING:
    from mpi4py import MPI
    from PIL.Image import Image

    from voile.tasks import Progress
    from voile.wiring import Model

IN_MEMORY = "result in memory"
STRESSES = tuple(name for written in FIELDS.values() for name in written)
PIECE = 1 << 28  # bytes that travel between ranks at once


class Result(voile.results.Result):
    """A result of `run` or `read`: what the result file holds, and pictures. In a notebook it shows itself.

    summary: the figures of summary.json; history: those of every step in time, arrays by name, {} without time;
    scene: of `run`, or what `read` was given.

    Steps count from 0, -1 is the last. Also `points(step)`, `start`, `rest`, `triangles` (arrays), `point_fields`,
    `cell_fields`, `unit(name)`, `scalars(step)`, `figures()`, `bodies`; `n_steps`, `n_points`, `n_cells` (numbers).
    """

    computed_fields = STRESSES

    def __init__(
        self,
        path: Path,
        file: Any,
        summary: dict[str, Any],
        history: dict[str, Array],
        scene: Scene | None = None,
    ):
        super().__init__(path, file)
        self.summary, self.history, self.scene = summary, history, scene

    @property
    def positions(self) -> Reals:
        """(n, 3) positions at the last step, m, in the order of the mesh's vertices; of another: `points(step)`."""
        return self.points()

    @property
    def times(self) -> Reals:
        """(n_steps,) times of the steps (s), or their load factors."""
        return self.values

    def field(self, name: str, step: int = -1) -> Array:
        """Point data (n, ...) or cell data (m, ...) at a step: what the file holds; else computed from the shapes
        (displacement, strain, curvature, mean_curvature) or, of `output.fields`, from the scene's model; smooth_*: at
        vertices.

        Raises KeyError that names what there is; InputError where the scene or its meshes are not found.
        """
        from voile.post.quantities import quantity

        if name in self.point_fields + self.cell_fields:
            return super().field(name, step)
        if name in self.computed_fields:
            return self._stresses.field(name, self._step(step))
        return quantity(self, name, step).values

    @property
    def known_fields(self) -> tuple[str, ...]:
        """All names that `field` takes, those that it computes too."""
        from voile.post.quantities import known
        from voile.post.recovery import TENSORS

        scene = self.scene or scene_of(self)
        searched = scene.scene.task == "inverse"
        lacks = FIELDS if searched else lacking(scene.shell.model, scene.shell.material)
        missing = {name for what in lacks for name in FIELDS[what]}.difference(self.cell_fields)
        return tuple(name for name in known(self) if missing.isdisjoint([name, *TENSORS.get(name, ())]))

    @cached_property
    def _stresses(self) -> Stresses:
        return Stresses(self, self.scene or scene_of(self))

    def unit(self, name: str) -> str:
        """SI unit of a field, "" where it has none."""
        from voile.post.quantities import unit

        return unit(name) or super().unit(name)

    def section(self, step: int = -1, **keys: Any) -> dict[str, Any]:
        """What the rest of the shell exerts at a step across a cut on what lies inside: `force` (3,) N, `moment` (3,)
        N m about `about` (3,) m. keys: of a scene's [[section]], such as point=[0, 0, 0], normal=[1, 0, 0].

        Raises InputError for a cut that cuts nothing, or where the scene or its meshes are not found.
        """
        return self.sections(step, **keys)[0]

    def sections(self, step: int = -1, **keys: Any) -> list[dict[str, Any]]:
        """As `section`; without keys of the cuts that the scene has, in its order."""
        return self._stresses.sections(keys, self._step(step))

    def render(self, png: str | os.PathLike[str], **how: Any) -> Path:
        """Draws a step into a PNG file; returns its path. how: field, step, view, size, outline, shape as of
        `voile.post.render`."""
        from voile.post import render

        return render(self, png, **how)

    def picture(self, **how: Any) -> Image:
        """A step drawn, as `render` does, as an image of Pillow; notebooks show it."""
        from voile.post.render import picture

        return picture(self, **how)

    def _repr_png_(self) -> bytes:
        data = io.BytesIO()
        self.picture(size=(1000, 750)).save(data, "png")
        return data.getvalue()

    def __repr__(self) -> str:
        end = f"{self.n_steps} steps to {self.times[-1]:.6g}"
        return f"<voile result: {self.path}, {self.n_points} vertices, {self.n_cells} triangles, {end}>"


def load(
    scene: str | os.PathLike[str] | Mapping[str, Any], overrides: Iterable[str] | Mapping[str, Any] = ()
) -> Scene:
    """A scene from a file, or from a dict of its tables in place of the file.

    In a dict, a mesh may be arrays: "mesh": (points, triangles), points (n, 3) in units of shell.scale (m), triangles
    (m, 3) integers from 0; relative paths count from the working folder. overrides: {"shell.young": 2e6} or
    ["shell.young=2e6"]. Raises InputError as the command line does: key, what is wrong, what is allowed.
    """
    read = read_scene(scene if isinstance(scene, Mapping) else os.fspath(scene), overrides)
    missing = unsupported(read)
    if missing:
        raise InputError(f"{read.path}: this version cannot run {'; '.join(missing)}")
    return read


def modelled(scene: Scene, petsc: Sequence[str] = ()) -> Model:
    """A scene's meshes read and checked, with all that is built from them. Raises InputError; petsc: further options of
    PETSc, whose form is checked."""
    from voile import blas
    from voile.petsc_options import check_words
    from voile.wiring import build_model

    check_words(petsc)
    model = build_model(scene)
    if blas.used().note:
        model.notes.append(blas.used().note)
    return model


def run(
    scene: Scene | str | os.PathLike[str] | Mapping[str, Any],
    output: str | os.PathLike[str] | None = None,
    comm: MPI.Comm | None = None,
    *,
    petsc: Sequence[str] = (),
    progress: bool = False,
    force: bool = False,
) -> Result:
    """Solves a scene of `load`, or what `load` takes. Collective over comm (default: all ranks); the result is on all
    of them.

    output: folder for the result's files; without, the result is in memory. It may hold results of the same scene file,
    or of dicts; force: of others, too. petsc: options for this run, such as
    ["-snes_max_it", "50"]; PETSc's database is afterwards as before. progress: print what the command line prints.
    Raises InputError; NotConverged, whose `result` holds what was computed, None where that is nothing.
    """
    from voile.petsc_options import start_petsc

    start_petsc()
    from mpi4py import MPI

    from voile.tasks import Progress

    comm = MPI.COMM_WORLD if comm is None else comm
    began = time.perf_counter()
    source = scene

    def prepare() -> tuple[Scene, Model]:
        loaded = source if isinstance(source, Scene) else load(source)
        return loaded, modelled(loaded, petsc)

    loaded, model = on_root(comm, prepare) or (None, None)
    loaded = comm.bcast(loaded)
    told = Progress(comm, quiet=not progress)
    with _folder(output, comm, loaded, force) as folder:
        failure = solve(loaded, model, folder, told, began, petsc=petsc, lasting=output is not None)
        found = _found(folder, loaded, comm, in_memory=output is None)
    gc.collect()  # what holds PETSc's objects goes round in circles
    if failure:
        kept = f"; what was computed is kept in {output}" if output else ""
        raise NotConverged(f"{loaded.path}: {failure}{kept}", found)
    assert found
    return found


def solve(
    scene: Scene,
    model: Model | None,
    folder: Path,
    progress: Progress,
    began: float,
    *,
    petsc: Sequence[str] = (),
    resumes: bool = False,
    lasting: bool = True,
    told: list[int] | None = None,
) -> str:
    """Solves a scene into a folder, which exists: what `voile run` and `run` share. Returns why it did not converge, or
    nothing. Collective.

    model: the scene's, on rank 0; began: time.perf_counter() at start; resumes: goes on from the results there;
    lasting: all ranks see the folder, and a later run may go on from it; told: signals that end it (voile.signals).
    """
    from voile import blas, signals
    from voile.petsc_options import options_of_run, unused_options
    from voile.problem.lifetime import run_of_its_own
    from voile.results.folder import out_of_room
    from voile.tasks import Run

    if blas.used().note:
        progress.line(f"note: {blas.used().note}")
    comm, ending = progress.comm, [] if told is None else told  # grows
    job = Run(scene, model, folder, comm, progress, began, resumes=resumes, lasting=lasting)
    task = import_module(f"voile.tasks.{scene.scene.task}")
    with options_of_run(petsc):
        try:
            with signals.not_lost(ending), run_of_its_own(comm.size, ending):
                failure: str = task.run(job)
        except NotConverged as reason:
            failure = str(reason)
            job.refuse(failure)
        except (OSError, InputError) as error:
            failure = out_of_room(error)
            if not failure:
                raise
            job.refuse(failure)
        except KeyboardInterrupt:
            failure = "stopped by a signal"
            job.refuse(failure)
            if told is None:
                raise
        unused = unused_options()
    if unused:
        progress.line(f"PETSc options that nothing used: {', '.join(unused)}")
    return failure


def read(
    result: str | os.PathLike[str],
    scene: Scene | str | os.PathLike[str] | Mapping[str, Any] | None = None,
) -> Result:
    """The result in a folder, or of a file `result.vtkhdf`. scene: that of the run, or what `load` takes, which section
    forces and stresses are computed with afterwards; needed where its files have moved, or its meshes were arrays.
    Raises InputError where there is none."""
    scene = scene if scene is None or isinstance(scene, Scene) else load(scene)
    path = result_file(result)
    file = open_result(path)
    beside = path.with_name("summary.json")
    summary = read_summary(beside) if beside.is_file() else {}
    history = read_history(path.parent) if path.with_name("history.h5").is_file() else {}
    return Result(path, file, summary, history, scene)


@contextmanager
def _folder(
    output: str | os.PathLike[str] | None, comm: MPI.Comm, scene: Scene, force: bool
) -> Iterator[Path]:
    """Where a run writes: its output, or a folder that is gone afterwards."""
    if output is not None:
        with held_output(output, comm, scene.path, scene.text, force) as folder:
            yield folder
        return
    made = on_root(comm, lambda: tempfile.mkdtemp(prefix="voile-"))
    try:
        yield Path(comm.bcast(made))
    finally:
        if made:
            shutil.rmtree(made, ignore_errors=True)


def _found(folder: Path, scene: Scene, comm: MPI.Comm, in_memory: bool) -> Result | None:
    """The result that a run of a scene left in a folder, None where it wrote none. Collective."""

    def written() -> tuple[dict[str, Any], dict[str, Array]] | None:
        if not result_file(folder).is_file():
            return None
        with read(folder) as found:
            return (found.summary, found.history) if found.scene_text == scene.text else None

    figures = comm.bcast(on_root(comm, written))
    if not figures:
        return None
    if not in_memory:
        return read(folder, scene)
    data = _everywhere(on_root(comm, result_file(folder).read_bytes), comm)
    import h5py

    summary, history = figures
    return Result(Path(IN_MEMORY), h5py.File(io.BytesIO(data), "r"), summary, history, scene)


def _everywhere(data: bytes | None, comm: MPI.Comm) -> bytes:
    """Rank 0's bytes on all ranks: messages count in 32 bits, so long ones go in pieces."""
    if comm.size == 1:
        return data or b""
    shared = np.frombuffer(data, dtype=np.uint8).copy() if data else np.empty(0, dtype=np.uint8)
    size = comm.bcast(len(shared))
    shared = shared if comm.rank == 0 else np.empty(size, dtype=np.uint8)
    for begin in range(0, size, PIECE):
        comm.Bcast(shared[begin : begin + PIECE])
    return shared.tobytes()
