"""`voile friction`: discrete frictional contact problems."""

import argparse
import time
from pathlib import Path

from voile.errors import InputError, NotConverged

TEXT = "one discrete frictional contact problem, FCLIB local form"


def arguments(parser: argparse.ArgumentParser) -> None:
    """Adds the command's arguments."""
    parser.add_argument("problem", type=Path)
    parser.add_argument("-o", "--output", type=Path, help="HDF5 file for the solution")
    parser.add_argument(
        "--tolerance", type=float, default=1e-8, metavar="E", help="error of the natural map (default: 1e-8)"
    )


def run(args: argparse.Namespace) -> None:
    """Solves the problem, prints figures, writes the solution. Raises NotConverged."""
    from voile.contact.law import contact_states
    from voile.files import prove
    from voile.results.friction import read_problem, write_solution
    from voile.solver.friction import FrictionNotConverged, solve_friction

    if not args.tolerance > 0.0:
        raise InputError(f"--tolerance {args.tolerance:g}: allowed: a number > 0")
    problem = read_problem(args.problem)
    W, q, mu = problem
    if args.output:
        prove(args.output)
    failure = None
    began, before = time.perf_counter(), time.process_time()
    try:
        r, info = solve_friction(W, q, mu, args.tolerance)
    except FrictionNotConverged as error:
        failure, r, info = error, error.reaction, error.info
    except InputError as error:
        raise InputError(f"{args.problem}: {error}") from error
    seconds, cpu_seconds = time.perf_counter() - began, time.process_time() - before
    states = contact_states(W, q, mu, r)
    if args.output:
        write_solution(
            args.output,
            args.problem,
            problem,
            r,
            states,
            info,
            converged=failure is None,
            seconds=seconds,
            cpu_seconds=cpu_seconds,
        )
    print(
        f"{args.problem}: {len(mu)} contacts, error {info.error:.2e}, {info.method}\n"
        f"{info.iterations} iterations, {info.factorisations} factorisations, {info.proximal_steps} proximal steps, "
        f"{1e3 * seconds:.1f} ms\n"
        + ", ".join(f"{(states == k).sum()} {name}" for k, name in enumerate(("open", "stick", "slip")))
    )
    if failure:
        kept = f"; the best reactions are kept in {args.output}" if args.output else ""
        raise NotConverged(f"{args.problem}: {failure}{kept}")
