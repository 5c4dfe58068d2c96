"""`voile run`: solves a scene."""

import argparse
import gc
import time
from pathlib import Path

from voile.commands._scene import load, scene_arguments
from voile.errors import NotConverged, on_root

TEXT = "solve a scene; PETSc options follow --"


def arguments(parser: argparse.ArgumentParser) -> None:
    """Adds the command's arguments."""
    scene_arguments(parser)
    parser.add_argument(
        "-o", "--output", type=Path, help="result folder (default: the scene's name + -result)"
    )
    parser.add_argument(
        "--force", action="store_true", help="replace results of another scene in the result folder"
    )
    parser.add_argument(
        "--resume",
        action="store_true",
        help="go on from the last complete step in the result folder, anew where it has none",
    )


def run(args: argparse.Namespace) -> None:
    """Solves the scene. Raises NotConverged with what missed which tolerance."""
    began = time.perf_counter()
    gc.disable()  # modules are no garbage: a tenth of a short run's time
    from voile.petsc_options import start_petsc

    start_petsc(args.petsc)
    from mpi4py import MPI

    from voile import api, signals
    from voile.results import held_output
    from voile.results.restart import begun, newest_step
    from voile.tasks import Progress

    gc.freeze()
    gc.enable()
    comm = MPI.COMM_WORLD
    with signals.stoppable(together=comm.size > 1) as told:
        scene, model = on_root(comm, lambda: load(args)) or (None, None)
        scene = comm.bcast(scene)
        folder = args.output or Path(f"{args.scene.stem}-result")
        progress, resumes = Progress(comm), args.resume and begun(folder, comm)
        if resumes:
            newest_step(folder, comm)
        elif args.resume:
            progress.line(f"note: {folder} has no step to go on from: the run starts anew")
        with held_output(folder, comm, args.scene, scene.text, args.force):
            failure = api.solve(scene, model, folder, progress, began, resumes=resumes, told=told)
    gc.collect()  # what holds PETSc's objects goes round in circles, and must not outlive MPI
    progress.line(f"results in {folder}")
    if failure:
        raise NotConverged(f"{args.scene}: {failure}; what was computed is kept in {folder}")
