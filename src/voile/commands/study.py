"""`voile study`: a scene in many variants, their errors and costs, and what to choose for an accuracy."""

from __future__ import annotations

import argparse
import os
import shlex
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from voile.errors import InputError
from voile.launch import processors, started
from voile.signals import stoppable

if TYPE_CHECKING:
    from voile.study.execute import Record, Runs
    from voile.study.plan import Run

TEXT = "convergence and speed-for-accuracy studies: a table, a picture, what to choose for an accuracy"


def arguments(parser: argparse.ArgumentParser) -> None:
    """Adds the command's arguments."""
    parser.add_argument("study", type=Path)
    parser.add_argument("-o", "--output", type=Path, help="folder (default: the study's name + -result)")
    parser.add_argument("--jobs", type=int, default=1, metavar="N", help="runs at a time (default: 1)")
    alone = parser.add_mutually_exclusive_group()
    alone.add_argument(
        "--list-runs",
        action="store_true",
        help="print one shell command per run that is missing or failed, and run nothing",
    )
    alone.add_argument("--run", type=int, metavar="K", help="only the run of this number, from 1")


def run(args: argparse.Namespace) -> int:
    """Runs what is missing of a study and writes its files; 3 where nothing converged. Raises NotConverged."""
    from voile.study.execute import Runs
    from voile.study.plan import read_plan

    if (ranks := started()) > 1:
        raise InputError(
            f"study: {ranks} ranks; allowed: one process, which starts the runs (ranks in [vary])"
        )
    if args.jobs < 1:
        raise InputError(f"--jobs {args.jobs}: allowed: 1 or more")
    plan = read_plan(args.study)
    runs = Runs(plan, args.output or Path(f"{args.study.stem}-result"))
    if args.list_runs:
        _list(args, runs)
        return 0
    with stoppable():
        try:
            return _all(args, runs) if args.run is None else _one(args, runs)
        except KeyboardInterrupt:
            raise runs.stopped() from None


def _list(args: argparse.Namespace, runs: Runs) -> None:
    """One line per run that is not complete, or failed."""
    words = [
        sys.executable,
        "-m",
        "voile.cli",
        "study",
        str(args.study.resolve()),
        "-o",
        str(runs.out.resolve()),
    ]
    for k, each in enumerate(runs.plan.runs, 1):
        if runs.record(each, retry=True) is None:
            print(f"{shlex.join(words)} --run {k}")


def _one(args: argparse.Namespace, runs: Runs) -> int:
    """The run of a number, if it is missing or failed."""
    count = len(runs.plan.runs)
    if not 1 <= args.run <= count:
        raise InputError(f"--run {args.run}: allowed: 1 to {count}, the runs of {args.study}")
    runs.all(1, _tell, [runs.plan.runs[args.run - 1]], retry=True)
    return 0


def _all(args: argparse.Namespace, runs: Runs) -> int:
    from voile.study.analysis import analyse
    from voile.study.execute import CONVERGED, figures_of, missing
    from voile.study.report import text, write_files

    os.environ.setdefault("OMP_NUM_THREADS", str(max(processors() // args.jobs, 1)))  # of each run
    records = runs.all(args.jobs, _tell)
    absent = missing(runs.plan.measures, records)
    if absent:
        found = ", ".join(figures_of(runs, records))
        raise InputError(f"{args.study}: study.measure: no run has {', '.join(absent)}; allowed: {found}")
    findings = analyse(runs.plan, records)
    print(text(findings))
    for file in write_files(findings, runs):
        print(file)
    return 0 if any(record.status == CONVERGED for record in records) else 3


def _tell(each: Run, found: Record, new: bool) -> None:
    """A line on standard error."""
    from voile.study.execute import CONVERGED

    came = f"{found.seconds:.2f} s" if found.status == CONVERGED else f"{found.status}: {found.reason}"
    print(f"{each.name}: {came}{'' if new else ', known'}", file=sys.stderr, flush=True)
