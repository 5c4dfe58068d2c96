"""`voile validate`: physics protocols against their references."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from voile.errors import InputError, NotConverged

if TYPE_CHECKING:
    from collections.abc import Sequence

    from voile.validate.protocol import Protocol

TEXT = "physics protocols against their references, a table and a plot each"


def arguments(parser: argparse.ArgumentParser) -> None:
    """Adds the command's arguments."""
    parser.add_argument("name", nargs="*", help="protocols to run (default: all)")
    parser.add_argument("--list", action="store_true", help="name the protocols and what they claim")
    parser.add_argument("--quick", action="store_true", help="smaller meshes and fewer points: seconds each")
    parser.add_argument("--json", type=Path, metavar="FILE", help="the table as JSON")
    parser.add_argument(
        "-o", "--output", type=Path, default=Path("validation"), help="folder for plots, scenes and results"
    )


def run(args: argparse.Namespace) -> None:
    """Runs protocols and prints their table. Raises NotConverged where a figure misses its bound."""
    from voile.validate import all_protocols

    protocols = all_protocols()
    for name in args.name:
        if name not in protocols:
            raise InputError(f"validate: unknown protocol {name!r}; allowed: {', '.join(protocols)}")
    if args.list:
        width = max(map(len, protocols))
        print("\n".join(f"{name:<{width}}  {protocol.text}" for name, protocol in protocols.items()))
        return
    _perform([protocols[name] for name in args.name or protocols], args)


def _perform(chosen: Sequence[Protocol], args: argparse.Namespace) -> None:
    from mpi4py import MPI

    from voile.files import made, prove
    from voile.petsc_options import start_petsc
    from voile.results.summary import write_summary
    from voile.tasks.run import versions
    from voile.validate import Bench, perform, report

    if MPI.COMM_WORLD.size > 1:
        raise InputError(f"validate: {MPI.COMM_WORLD.size} ranks; allowed: one process")
    start_petsc()
    made(args.output)
    if args.json:
        prove(args.json)
    verdicts = []
    print(report.heading())
    for protocol in chosen:
        folder = args.output / protocol.name
        verdict = perform(protocol, Bench(folder, args.quick))
        verdicts.append(verdict)
        print("\n".join(report.lines(verdict)), flush=True)
        if verdict.plot:
            report.draw(args.output / f"{protocol.name}.png", verdict.plot, protocol.text)
    if args.json:
        write_summary(args.json, report.summary(verdicts, args.quick, versions()))
    print(f"plots, scenes and results in {args.output}")
    missed = [check for verdict in verdicts for check in verdict.checks if not check.passed]
    failed = [verdict.protocol.name for verdict in verdicts if not verdict.passed]
    if failed:
        count = sum(len(verdict.checks) + bool(verdict.failure) for verdict in verdicts)
        wrong = len(missed) + sum(bool(verdict.failure) for verdict in verdicts)
        raise NotConverged(f"validate: {wrong} of {count} figures miss their bounds, in {', '.join(failed)}")
