"""`voile run`: solves a scene."""

import argparse
import signal
import time
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path

from voile.commands._scene import load, scene_arguments
from voile.errors import InputError, NotConverged, on_root

TEXT = "solve a scene; PETSc options follow --"


def arguments(parser: argparse.ArgumentParser) -> None:
    """Adds the command's arguments."""
    scene_arguments(parser)
    parser.add_argument(
        "-o", "--output", type=Path, help="result folder (default: the scene's name + -result)"
    )
    parser.add_argument(
        "--resume", action="store_true", help="go on from the last complete step in the result folder"
    )


def run(args: argparse.Namespace) -> None:
    """Solves the scene. Raises NotConverged with what missed which tolerance."""
    began = time.perf_counter()
    from voile import blas
    from voile.petsc_options import start_petsc, unused_options

    start_petsc(args.petsc)
    from mpi4py import MPI

    from voile.results import prepare_output
    from voile.results.restart import newest_step
    from voile.tasks import Progress, Run

    comm = MPI.COMM_WORLD
    scene, model = on_root(comm, lambda: load(args)) or (None, None)
    scene = comm.bcast(scene)
    folder = args.output or Path(f"{args.scene.stem}-result")
    if args.resume and scene.scene.task != "dynamics":
        raise InputError(f"{args.scene}: --resume: allowed with task = dynamics")
    if args.resume:
        newest_step(folder, comm)
    prepare_output(folder, comm)
    progress = Progress(comm)
    if blas.used().note:
        progress.line(f"note: {blas.used().note}")
    job = Run(scene, model, folder, comm, progress, began, resumes=args.resume)
    task = import_module(f"voile.tasks.{scene.scene.task}")
    try:
        with _stoppable():
            failure = task.run(job)
    except (NotConverged, KeyboardInterrupt) as reason:
        failure = str(reason) or "stopped by a signal"
        job.refuse(failure)
    unused = unused_options()
    if unused:
        progress.line(f"PETSc options that nothing used: {', '.join(unused)}")
    progress.line(f"results in {folder}")
    if failure:
        raise NotConverged(f"{args.scene}: {failure}; what was computed is kept in {folder}")


@contextmanager
def _stoppable() -> Iterator[None]:
    """SIGTERM and SIGINT end what runs within by KeyboardInterrupt."""
    told: list[int] = []

    def stop(number: int, _frame) -> None:
        told.append(number)
        raise KeyboardInterrupt

    before = {number: signal.signal(number, stop) for number in (signal.SIGTERM, signal.SIGINT)}
    try:
        yield
    except Exception as other:
        if told:  # newer PETSc loses what a callback raises
            raise KeyboardInterrupt from other
        raise
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
