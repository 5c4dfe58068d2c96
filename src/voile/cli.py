"""The command line: the only place that wires scenes, problems, solvers, results and post-processing together."""

import argparse
import os
import signal
import sys
import time
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path

if not any(name.startswith(("OMPI_COMM_WORLD", "PMI_", "PMIX_")) for name in os.environ):
    # Without a launcher Open MPI need not start a daemon and look for networks, which takes 0.3 s.
    os.environ.setdefault("OMPI_MCA_ess_singleton_isolated", "1")
    os.environ.setdefault("OMPI_MCA_pml", "ob1")

from voile.errors import InputError, NotConverged, on_root

DESCRIPTION = "Equilibria of thin elastic shells: garments, sheets, strips."


def main(argv: list[str] | None = None) -> int:
    """Runs a command; returns 0 done, 2 bad input, 3 not converged, 1 anything else."""
    argv = list(sys.argv[1:] if argv is None else argv)
    split = argv.index("--") if "--" in argv else len(argv)
    args = _parser().parse_args(argv[:split])
    args.petsc = argv[split + 1 :]
    try:
        code = args.command(args) or 0
        sys.stdout.flush()
        return code
    except (InputError, NotConverged) as error:
        if _first_rank():
            print(f"voile: {error}", file=sys.stderr)
        return error.exit_code
    except BrokenPipeError:  # who reads has read enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except Exception as error:
        if args.debug:
            raise
        print(f"voile: {type(error).__name__}: {error}  (--debug shows where)", file=sys.stderr)
        if "mpi4py.MPI" in sys.modules and sys.modules["mpi4py.MPI"].COMM_WORLD.size > 1:
            traceback.print_exc()
            sys.modules["mpi4py.MPI"].COMM_WORLD.Abort(1)
        return 1


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="voile", description=DESCRIPTION)
    parser.add_argument("--debug", action="store_true", help="show where an error came from")
    commands = parser.add_subparsers(required=True, metavar="COMMAND")

    def command(name: str, function, text: str) -> argparse.ArgumentParser:
        sub = commands.add_parser(name, help=text, description=text)
        sub.set_defaults(command=function)
        return sub

    for name, function, text in (
        ("run", _run, "solve a scene; PETSc options follow --"),
        ("explain", _explain, "what a scene will model and why; solves nothing"),
    ):
        sub = command(name, function, text)
        sub.add_argument("scene", type=Path)
        sub.add_argument(
            "--set", action="append", default=[], metavar="KEY=VALUE", help="override a scene key"
        )
        if name == "run":
            sub.add_argument(
                "-o", "--output", type=Path, help="result folder (default: the scene's name + -result)"
            )
            sub.add_argument(
                "--resume", action="store_true", help="go on from the last complete step in the result folder"
            )
    sub = command("info", _info, "figures of a result")
    sub.add_argument("file", type=Path)
    sub = command("render", _render, "a PNG picture of a result")
    sub.add_argument("file", type=Path)
    sub.add_argument("-o", "--output", type=Path, help="default: FIELD.png beside the result")
    sub.add_argument(
        "--field",
        default="strain",
        help="colours: displacement, strain, curvature or a stored field (contact, gap, margin, reaction)",
    )
    sub.add_argument("--step", type=int, default=-1)
    sub.add_argument(
        "--shape", choices=("step", "rest"), default="step", help="what is drawn (default: a step)"
    )
    sub.add_argument("--view", help="front, back, left, right, top, oblique")
    sub = command("animate", _animate, "a film of a run over time or load: mp4, gif or webp")
    sub.add_argument("file", type=Path)
    sub.add_argument("-o", "--output", type=Path, help="default: film.mp4 beside the result")
    sub.add_argument("--field", default="strain", help="colours, as for render")
    sub.add_argument("--fps", type=float, help="frames a second (default: 25; along a load path 5 steps)")
    sub.add_argument("--speed", type=float, help="seconds of the run in a second of film (default: 1)")
    sub.add_argument("--view", help="as for render")
    sub = command("plot", _plot, "quantities of a result against time or load, as PNG")
    sub.add_argument("file", type=Path)
    sub.add_argument(
        "quantity", nargs="*", help="energies (default), contact_force, ...; FIELD:VERTEX at a vertex"
    )
    sub.add_argument(
        "-o", "--output", type=Path, help="default: the quantities' names .png beside the result"
    )
    sub = command("export", _export, "a shape as obj, ply, vtu or glb, a sewing pattern as svg, dxf or png")
    sub.add_argument("file", type=Path)
    where = sub.add_mutually_exclusive_group(required=True)
    where.add_argument("output", type=Path, nargs="?")
    where.add_argument("--to", metavar="FORMAT", help="written beside the result, as shape or pattern")
    sub.add_argument("--step", type=int, default=-1)
    sub = command("friction", _friction, "one discrete frictional contact problem, FCLIB local form")
    sub.add_argument("problem", type=Path)
    sub.add_argument("-o", "--output", type=Path, help="HDF5 file for the solution")
    command("schema", _schema, "JSON schema of the scene file")
    return parser


def _first_rank() -> bool:
    mpi = sys.modules.get("mpi4py.MPI")
    return mpi is None or mpi.COMM_WORLD.rank == 0


# ---- commands that solve nothing ----


def _schema(args: argparse.Namespace) -> None:
    import json

    from voile.scene import json_schema

    print(json.dumps(json_schema(), indent=2))


def _info(args: argparse.Namespace) -> None:
    from voile.post import info

    print(info(args.file))


def _folder(result: Path) -> Path:
    """That of a result, which may be given by its file."""
    return result if result.is_dir() else result.parent


def _render(args: argparse.Namespace) -> None:
    from voile.post import render

    folder = _folder(args.file)
    out = args.output or folder / f"{args.field}.png"
    render(args.file, out, field=args.field, step=args.step, view=args.view, shape=args.shape)
    print(out)


def _animate(args: argparse.Namespace) -> None:
    from voile.post.film import animate

    def tell(frame: int, count: int) -> None:
        if sys.stderr.isatty():
            print(f"\r\033[Kframe {frame} of {count}", end="", file=sys.stderr, flush=True)

    folder = _folder(args.file)
    film = animate(
        args.file,
        args.output or folder / "film.mp4",
        field=args.field,
        fps=args.fps,
        speed=args.speed,
        view=args.view,
        on_frame=tell,
    )
    if sys.stderr.isatty():
        print("\r\033[K", end="", file=sys.stderr, flush=True)
    if not film.ended:
        print("note: the run has not ended; the film shows its steps so far")
    print(film.path)


def _plot(args: argparse.Namespace) -> None:
    from voile.post.plot import plot

    folder = _folder(args.file)
    names = args.quantity or ["energies"]
    default = folder / ("-".join(names).replace(":", "-") + ".png")
    print(plot(args.file, args.output or default, names))


def _export(args: argparse.Namespace) -> None:
    from voile.post.export import PATTERNS, export

    folder = _folder(args.file)
    name = "pattern" if f".{args.to}" in PATTERNS else "shape"
    print(export(args.file, args.output or folder / f"{name}.{args.to}", args.step))


def _read(args: argparse.Namespace):
    from voile.scene import read_scene, unsupported

    scene = read_scene(args.scene, args.set)
    missing = unsupported(scene)
    if missing:
        raise InputError(f"{args.scene}: this version cannot run {'; '.join(missing)}")
    return scene


def _explain(args: argparse.Namespace) -> None:
    from voile.explain import explain

    print(explain(*_load(args)))


# ---- friction ----


def _friction(args: argparse.Namespace) -> None:
    from voile.contact.law import contact_states
    from voile.results.friction import prepare_solution, read_problem, write_solution
    from voile.solver.friction import FrictionNotConverged, solve_friction

    problem = read_problem(args.problem)
    W, q, mu = problem
    if args.output:
        prepare_solution(args.output)
    failure = None
    began = time.perf_counter()
    try:
        r, info = solve_friction(W, q, mu)
    except FrictionNotConverged as error:
        failure, r, info = error, error.reaction, error.info
    except InputError as error:
        raise InputError(f"{args.problem}: {error}") from error
    milliseconds = 1e3 * (time.perf_counter() - began)
    states = contact_states(W, q, mu, r)
    if args.output:
        write_solution(args.output, args.problem, problem, r, states, info, converged=failure is None)
    print(
        f"{args.problem}: {len(mu)} contacts, error {info.error:.2e}, {info.method}\n"
        f"{info.iterations} iterations, {info.factorisations} factorisations, {info.proximal_steps} proximal steps, "
        f"{milliseconds:.1f} ms\n"
        + ", ".join(f"{(states == k).sum()} {name}" for k, name in enumerate(("open", "stick", "slip")))
    )
    if failure:
        kept = f"; the best reactions are kept in {args.output}" if args.output else ""
        raise NotConverged(f"{args.problem}: {failure}{kept}")


# ---- run ----


def _run(args: argparse.Namespace) -> int:
    began = time.perf_counter()
    from voile import blas
    from voile.petsc_options import start_petsc, unused_options

    start_petsc(args.petsc)
    from mpi4py import MPI

    from voile.results import prepare_output
    from voile.tasks import Progress, Run

    comm = MPI.COMM_WORLD
    scene, model = on_root(comm, lambda: _load(args)) or (None, None)
    scene = comm.bcast(scene)
    folder = args.output or Path(f"{args.scene.stem}-result")
    if args.resume and scene.scene.task != "dynamics":
        raise InputError(f"{args.scene}: --resume: allowed with task = dynamics")
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
    return 0


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


def _load(args: argparse.Namespace):
    from voile import blas
    from voile.petsc_options import check_words
    from voile.wiring import build_model

    check_words(args.petsc)
    scene = _read(args)
    model = build_model(scene)
    if blas.used().note:
        model.notes.append(blas.used().note)
    return scene, model


if __name__ == "__main__":
    sys.exit(main())
