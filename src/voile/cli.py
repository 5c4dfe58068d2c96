"""The command line: the only place that wires scenes, problems, solvers, results and post-processing together."""

import argparse
import os
import platform
import resource
import sys
import time
import traceback
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # one thread per rank; before numpy loads its BLAS

from voile.errors import InputError, NotConverged

NO_CONTACT = {"active": 0, "stick": 0, "slip": 0, "max_penetration": 0.0, "friction_error": 0.0}
DESCRIPTION = "Equilibria of thin elastic shells: garments, sheets, strips."


def main(argv: list[str] | None = None) -> int:
    """Runs a command; returns 0 done, 2 bad input, 3 not converged, 1 anything else."""
    argv = list(sys.argv[1:] if argv is None else argv)
    split = argv.index("--") if "--" in argv else len(argv)
    args = _parser().parse_args(argv[:split])
    args.petsc = argv[split + 1 :]
    try:
        return args.command(args) or 0
    except (InputError, NotConverged) as error:
        if _first_rank():
            print(f"voile: {error}", file=sys.stderr)
        return error.exit_code
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
    sub = command("info", _info, "figures of a result")
    sub.add_argument("file", type=Path)
    sub = command("render", _render, "a PNG picture of a result")
    sub.add_argument("file", type=Path)
    sub.add_argument("-o", "--output", type=Path, help="default: FIELD.png beside the result")
    sub.add_argument(
        "--field",
        default="strain",
        help="colours: displacement, strain, curvature or a stored field (contact, gap, reaction)",
    )
    sub.add_argument("--step", type=int, default=-1)
    sub.add_argument("--view", help="front, back, left, right, top, oblique")
    sub = command("export", _export, "a shape as obj, ply, vtu or glb")
    sub.add_argument("file", type=Path)
    sub.add_argument("output", type=Path)
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


def _render(args: argparse.Namespace) -> None:
    from voile.post import render

    folder = args.file if args.file.is_dir() else args.file.parent
    out = args.output or folder / f"{args.field}.png"
    render(args.file, out, field=args.field, step=args.step, view=args.view)
    print(out)


def _export(args: argparse.Namespace) -> None:
    from voile.post import export

    print(export(args.file, args.output, args.step))


def _read(args: argparse.Namespace):
    from voile.scene import read_scene, unsupported

    scene = read_scene(args.scene, args.set)
    missing = unsupported(scene)
    if missing:
        raise InputError(f"{args.scene}: this version cannot run {'; '.join(missing)}")
    return scene


def _explain(args: argparse.Namespace) -> None:
    from voile.explain import explain
    from voile.wiring import build_model

    scene = _read(args)
    print(explain(scene, build_model(scene)))


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
    import petsc4py

    petsc4py.init(["voile", *args.petsc])
    from mpi4py import MPI

    from voile.results import prepare_output

    comm = MPI.COMM_WORLD
    scene, model = _collective(comm, lambda: _load(args))
    folder = args.output or Path(f"{args.scene.stem}-result")
    prepare_output(folder, comm)
    progress = Progress(comm)
    path, problem, seconds = _solve(scene, model, folder, comm, progress)
    seconds["total"] = time.perf_counter() - began
    if comm.rank == 0:
        _summarise(scene, model, path, problem, folder, seconds, comm)
        progress.line(f"results in {folder}")
    if not path.converged:
        raise NotConverged(f"{args.scene}: {path.reason}; what was computed is kept in {folder}")
    return 0


def _load(args: argparse.Namespace):
    from voile.wiring import build_model

    scene = _read(args)
    return scene, build_model(scene)


def _collective(comm, action):
    """Runs on rank 0; every rank gets the scene, rank 0 the model too, or all of them the error."""
    outcome = error = None
    if comm.rank == 0:
        try:
            outcome = action()
        except Exception as caught:
            error = caught
    error = comm.bcast(error)
    if error is not None:
        raise error
    scene = comm.bcast(outcome[0] if outcome else None)
    return scene, outcome[1] if outcome else None


def _solve(scene, model, folder: Path, comm, progress: "Progress"):
    from voile.problem.contact import attach
    from voile.problem.discrete import Problem
    from voile.results import ResultWriter
    from voile.solver.path import StaticsOptions
    from voile.solver.sewing import sew
    from voile.solver.statics import solve_statics
    from voile.wiring import static_mesh

    s = scene.statics
    options = StaticsOptions(
        s.load_steps, s.max_steps, s.perturbation, s.tolerance, s.stability, s.eigenvalue
    )
    shell = sew(model.shell if model else None, comm)
    problem = Problem(shell, comm)
    attach(problem, *comm.bcast((model.obstacles, model.offset) if model else None))
    mesh = static_mesh(model, shell, problem.directors) if shell is not None else None
    writing, reached = 0.0, 0
    with ResultWriter(
        folder / "result.vtkhdf", comm, mesh=mesh, scene_text=scene.text, versions=_versions()
    ) as writer:

        def write(factor: float, y, scalars: dict[str, float]) -> None:
            nonlocal writing
            start = time.perf_counter()
            writer.write_step(factor, scalars=scalars, **_rows(problem, y))
            writing += time.perf_counter() - start

        def keep(step, y) -> None:
            write(step.factor, y, {"residual": step.residual, "converged": 1.0})

        def on_step(step, y) -> None:
            nonlocal reached
            progress.step(step)
            reached += 1
            if step.factor >= 1.0 or reached % scene.output.every == 0:
                keep(step, y)

        path = solve_statics(problem, options, on_step=on_step, monitor=progress.iteration)
        if not path.converged and not reached:
            write(0.0, path.state, {"residual": float("inf"), "converged": 0.0})
        elif not path.converged and reached % scene.output.every:
            keep(path.steps[-1], path.state)  # the last good one
    seconds = {**problem.seconds, **path.seconds, "input_output": writing}
    return path, problem, seconds


def _rows(problem, y) -> dict:
    """What the result file takes of a state: this rank's rows and the obstacles' placements."""
    import numpy as np

    from voile.problem.contact import contact_fields

    part, (u, phi) = problem.part, problem.local(y)
    own = part.owned_vertices
    rows = {"points": (part.points + u.reshape(-1, 3))[own], "point_index": part.vertex[own]}
    if problem.directors:
        rows |= {"edge_angles": phi[part.owned_edges], "edge_index": part.edge[part.owned_edges]}
    if problem.contact:
        rows["point_data"] = {name: values[own] for name, values in contact_fields(problem, y).items()}
        bodies = problem.contact.obstacles
        rows["placements"] = np.array([body.motion.matrix(problem.load_factor) for body in bodies])
    return rows


def _summarise(scene, model, path, problem, folder: Path, seconds: dict[str, float], comm) -> None:
    from voile.explain import modelled
    from voile.results import write_summary

    last = path.steps[-1] if path.steps else None
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
    write_summary(
        folder / "summary.json",
        {
            "converged": path.converged,
            "reason": path.reason,
            "task": scene.scene.task,
            "name": scene.scene.name,
            "dofs": problem.unknowns,
            "steps": len(path.steps),
            "load_factor": last.factor if last else 0.0,
            "newton_iterations": path.newton_iterations,
            "residual_norm": last.residual if last else None,
            "residual_tolerance": last.tolerance if last else None,
            "energy": last.energies if last else {},
            "contact": (last.contact if last else None) or NO_CONTACT,
            "ways": [step.way for step in path.steps],
            "stable": path.stable,
            "smallest_eigenvalue": path.smallest_eigenvalue,
            "wall_time_s": seconds,
            "peak_memory_mib": memory,
            "ranks": comm.size,
            "versions": _versions(),
            "modelled": [name for name, keep, _ in modelled(scene, model) if keep],
            "notes": model.notes,
        },
    )


def _versions() -> dict[str, str]:
    """What a result is computed with."""
    import numpy
    from petsc4py import PETSc

    import voile

    return {
        "voile": voile.__version__,
        "petsc": ".".join(map(str, PETSc.Sys.getVersion())),
        "numpy": numpy.__version__,
        "python": platform.python_version(),
    }


class Progress:
    """Live on a terminal, plain lines (at most one every few seconds between steps) elsewhere."""

    QUIET = 5.0  # s between lines of a batch log

    def __init__(self, comm):
        self.quiet = comm.rank != 0
        self.live = sys.stdout.isatty() and comm.size == 1  # mpirun lends its ranks a terminal
        self.began = self.last = time.perf_counter()

    def line(self, text: str) -> None:
        """A line that stays."""
        if not self.quiet:
            print(("\r\033[K" if self.live else "") + text, flush=True)

    def iteration(self, factor: float, iteration: int, residual: float) -> None:
        """One Newton iteration at a load factor."""
        now = time.perf_counter()
        if self.quiet or (not self.live and now - self.last < self.QUIET):
            return
        self.last = now
        text = (
            f"load {factor:.4f}  Newton {iteration:3d}  residual {residual:.2e} N  {now - self.began:.1f} s"
        )
        print(f"\r\033[K{text}" if self.live else f"  ... {text}", end="" if self.live else "\n", flush=True)

    def step(self, step) -> None:
        """One converged load step."""
        energy = sum(step.energies.values())
        self.line(
            f"load {step.factor:.4f}  Newton {step.iterations:3d}  residual {step.residual:.2e} N "
            f"(<= {step.tolerance:.2e})  energy {energy:.6e} J  {_touching(step)}"
            f"{time.perf_counter() - self.began:.1f} s"
        )


def _touching(step) -> str:
    """What a step's contact is, for a line of progress; empty without."""
    c = step.contact
    return f"contact {c['active']} ({c['slip']} slip, {step.way})  " if c else ""


if __name__ == "__main__":
    sys.exit(main())
