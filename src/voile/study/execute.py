"""Runs of a study as processes of their own: locked, recorded once they are complete, and not run again then."""

import fcntl
import json
import os
import re
import shlex
import shutil
import signal
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_EXCEPTION, ThreadPoolExecutor, wait
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass, field
from pathlib import Path
from threading import Event
from typing import Any

from voile.errors import InputError, NotConverged
from voile.files import fresh, lockable, made, replace
from voile.results import read_summary
from voile.study import problems
from voile.study.measures import Measure, values
from voile.study.plan import Plan, Run
from voile.study.settings import overrides

SHORT = 2.0  # s: runs under it are measured several times, as start-up and other programs weigh in
# s between looks at what is waited for: a signal that comes just before Python begins to wait is handled only when that
# wait ends, and nothing wakes who waits for another process's lock.
WAKE = 0.1
STOPPED = "stopped by a signal"  # what `voile run` says then
# What an MPI process tells its children: an mpirun started from one takes itself for a rank.
MPI_PREFIXES = (
    *("OMPI_COMM", "OMPI_APP", "OMPI_MCA_ess", "OMPI_MCA_pml", "OMPI_MCA_pmix", "OMPI_MCA_orte"),
    *("PMIX_", "ORTE_", "OPAL_", "PMI_", "PRTE_"),
)
CONVERGED, NOT_CONVERGED, REFUSED, FAILED, SLOW = (
    "converged",
    "not converged",
    "refused",
    "failed",
    "too long",
)
STATUS = {0: CONVERGED, 3: NOT_CONVERGED, 2: REFUSED}  # by exit code


def unmarked() -> dict[str, str]:
    """The environment for a process that may start ranks of its own."""
    return {name: value for name, value in os.environ.items() if not name.startswith(MPI_PREFIXES)}


@dataclass
class Record:
    """What came of a run: status, why it is not CONVERGED, values of measures, median wall time and CPU time (s)
    of so many repeats, peak memory (MiB, of the first rank), iterations and unknowns; None where there is none."""

    key: str
    status: str
    reason: str = ""
    values: dict[str, float | None] = field(default_factory=dict)
    seconds: float | None = None
    repeats: int = 0
    cpu_seconds: float | None = None
    memory_mib: float | None = None
    iterations: int | None = None
    dofs: int | None = None


class Runs:
    """The runs of a plan in the folder `out`."""

    def __init__(self, plan: Plan, out: Path):
        self.plan, self.out = plan, out
        made(out / "runs")
        self.children: set[subprocess.Popen[bytes]] = set()
        self.stopping = Event()

    def folder(self, run: Run) -> Path:
        """Where a run's results are."""
        return self.out / "runs" / run.folder

    def record(self, run: Run, retry: bool = False) -> Record | None:
        """What is known of a run: its record, if it is complete and measures what the study does. retry: a run that
        failed (a machine without memory, an MPI that did not start) is not known."""
        if run.scene is None:
            return Record(run.key, REFUSED, run.refused)
        try:
            found = Record(**json.loads(self._file(run).read_text()))
        except (OSError, ValueError, TypeError):
            return None
        if found.key != run.key or (found.status == SLOW and self._allows_longer(found)):
            return None
        if retry and found.status == FAILED:
            return None
        if found.status == CONVERGED and set(found.values) != {m.name for m in self.plan.measures}:
            return self._measured(run, found)
        return found

    def _measured(self, run: Run, found: Record) -> Record | None:
        """A record with the values that the study now asks for, from the results that are there."""
        try:
            summary = summary_of(self.folder(run))
            assert run.scene is not None
            found.values = values(self.plan.measures, run.scene, self.folder(run), summary)
        except InputError:
            return None
        return found

    def all(
        self,
        jobs: int,
        tell: Callable[[Run, Record, bool], None],
        runs: Sequence[Run] | None = None,
        retry: bool = False,
    ) -> list[Record]:
        """Records of the runs, by default of all, of which those that are missing are run, `jobs` at a time, in threads
        that no signal interrupts. tell(run, record, new). retry: those that failed, too."""

        def one(run: Run) -> Record:
            known = self.record(run, retry)
            found = known or self.run(run, retry)
            tell(run, found, known is None)
            return found

        pool = ThreadPoolExecutor(jobs)
        try:
            futures = [pool.submit(one, run) for run in (self.plan.runs if runs is None else runs)]
            going = set(futures)
            while going:
                done, going = wait(going, WAKE, FIRST_EXCEPTION)
                for each in done:
                    each.result()
            return [each.result() for each in futures]
        except BaseException:
            self.stop()
            raise
        finally:
            pool.shutdown(wait=True, cancel_futures=True)

    def stop(self) -> None:
        """Ends what runs."""
        self.stopping.set()
        for child in list(self.children):
            with suppress(ProcessLookupError):  # it has just ended
                os.kill(child.pid, signal.SIGTERM)

    def stopped(self) -> NotConverged:
        """What a study that was told to end says."""
        return NotConverged(f"stopped; complete runs are kept in {self.out}, the same command goes on")

    def run(self, run: Run, retry: bool = False) -> Record:
        """Runs one, unless another process has meanwhile. Raises NotConverged if it was stopped."""
        with self._lock(run) as lock:
            return self.record(run, retry) or self._run(run, lock)

    def _run(self, run: Run, lock: int) -> Record:
        folder, spec = self.folder(run), self.plan.study.study
        shutil.rmtree(folder, ignore_errors=True)
        made(folder, new=True)
        found = self._once(run, lock)
        times = [(found.seconds or 0.0, found.cpu_seconds or 0.0)]
        while found.status == CONVERGED and times[0][0] < SHORT and len(times) < spec.repeats:
            again = self._once(run, lock)
            times.append((again.seconds or 0.0, again.cpu_seconds or 0.0))
        found.seconds, found.cpu_seconds = (statistics.median(each) for each in zip(*times, strict=True))
        found.repeats = len(times)
        replace(self._file(run), (json.dumps(asdict(found), indent=2) + "\n").encode())
        return found

    def _once(self, run: Run, lock: int) -> Record:
        """One process. The lock is its own too: it stays locked should this process be killed."""
        if self.stopping.is_set():
            raise self.stopped()
        folder, limit = self.folder(run), self.plan.study.study.max_seconds
        began = time.perf_counter()
        with fresh(folder / "log.txt") as log:
            child = subprocess.Popen(
                command(self.plan, run, folder),
                stdout=log,
                stderr=subprocess.STDOUT,
                stdin=subprocess.DEVNULL,
                pass_fds=(lock,),
                env=unmarked(),
                start_new_session=True,
            )
        self.children.add(child)
        if self.stopping.is_set():  # since before it was there to be ended
            self.stop()
        try:
            code, cpu = _wait(child, limit)
        finally:
            self.children.discard(child)
        seconds = time.perf_counter() - began
        if self.stopping.is_set() or (
            code < 0 and -code in (signal.SIGINT, signal.SIGTERM) and seconds < (limit or 1e300)
        ):
            raise self.stopped()
        return self._found(run, code, seconds, cpu, bool(limit) and seconds >= limit)

    def _found(self, run: Run, code: int, seconds: float, cpu: float, late: bool) -> Record:
        folder = self.folder(run)
        status = SLOW if late else STATUS.get(code, FAILED)
        found = Record(run.key, status, "", seconds=seconds, cpu_seconds=cpu)
        try:
            summary = summary_of(folder)
        except InputError:
            summary = {}
        if status == SLOW:
            found.reason = f"ended after study.max_seconds = {self.plan.study.study.max_seconds:g} s"
        elif status != CONVERGED:
            found.reason = _last_line(folder / "log.txt", code)
            if code == 3:
                found.reason = summary.get("reason", found.reason)
        if found.reason == STOPPED:
            raise self.stopped()
        found.seconds = summary.get("wall_time_s", {}).get("total", seconds)
        found.memory_mib, found.dofs = summary.get("peak_memory_mib"), summary.get("dofs")
        found.iterations = summary.get("newton_iterations")
        found.cpu_seconds = summary.get("cpu_seconds", cpu)
        if status == CONVERGED and run.scene:
            found.values = values(self.plan.measures, run.scene, folder, summary)
        return found

    def _allows_longer(self, found: Record) -> bool:
        """Whether a run that took too long may now go on longer."""
        limit = self.plan.study.study.max_seconds
        return not limit or limit > (found.seconds or 0.0)

    def _file(self, run: Run) -> Path:
        return self.folder(run) / "run.json"

    @contextmanager
    def _lock(self, run: Run) -> Iterator[int]:
        """Only one process at a time runs a run; the system ends a lock with those who hold it."""
        with lockable(self.out / "runs" / f"{run.folder}.lock") as file:
            while not _locked(file.fileno()):
                if self.stopping.wait(WAKE):
                    raise self.stopped()
            yield file.fileno()


def _locked(file: int) -> bool:
    """Whether a lock is ours now."""
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True


def command(plan: Plan, run: Run, folder: Path) -> list[str]:
    """What runs a run."""
    words = [sys.executable, "-m", "voile.cli"]
    if isinstance(run.scene, problems.Problem):
        return words + problems.command(run.scene, folder)
    words += ["run", str(plan.scene.resolve()), "-o", str(folder.resolve())]
    for text in overrides(run.settings):
        words += ["--set", text]
    return [*launcher(plan.study.study.launcher, run.ranks), *words]


def summary_of(folder: Path) -> dict[str, Any]:
    """The figures of the run in a folder. Raises InputError where there are none."""
    solved = (folder / problems.SOLUTION).is_file()
    return problems.figures(folder) if solved else read_summary(folder / "summary.json")


def launcher(given: str, ranks: int) -> list[str]:
    """What starts so many MPI processes; nothing for one, unless a study gives its own. Raises InputError without."""
    if given:
        try:
            words = shlex.split(given.replace("{ranks}", str(ranks)))
        except ValueError as error:
            raise InputError(f"study.launcher: {given}: {error}") from None
        if unknown := re.search(r"\{\w*\}", given.replace("{ranks}", "")):
            raise InputError(f"study.launcher: {given}: {unknown[0]} stands for nothing; allowed: {{ranks}}")
        if words and shutil.which(words[0]) is None:
            raise InputError(f"study.launcher: {words[0]} is not on the PATH; allowed: a program that is")
        return words
    if ranks == 1:
        return []
    program = shutil.which("mpirun")
    if program is None:
        raise InputError(
            "ranks: mpirun is not on the PATH; allowed: study.launcher, such as 'srun -n {ranks}'"
        )
    about = subprocess.run([program, "--version"], capture_output=True, text=True).stdout
    crowded = ["--allow-run-as-root", "--oversubscribe"] if "Open MPI" in about else []
    return [program, *crowded, "-n", str(ranks)]


def _wait(child: subprocess.Popen[bytes], limit: float) -> tuple[int, float]:
    """Exit code and CPU seconds of a process, ended after `limit` seconds (0: never)."""
    ends = time.monotonic() + limit if limit else None
    while True:
        pid, status, usage = os.wait4(child.pid, os.WNOHANG if ends else 0)
        if pid:
            child.returncode = os.waitstatus_to_exitcode(status)
            return child.returncode, usage.ru_utime + usage.ru_stime
        if ends and time.monotonic() > ends:
            os.killpg(child.pid, signal.SIGKILL)
            ends = None
        else:
            time.sleep(0.02)


def _last_line(log: Path, code: int) -> str:
    """What a process said last, without the program's name; the program, if it did, before mpirun."""
    lines = log.read_text(errors="replace").splitlines()
    lines = [line for line in lines if any(sign.isalnum() for sign in line)]  # mpirun draws lines, too
    if code < 0:
        return f"ended by signal {-code} ({signal.Signals(-code).name})"
    lines = [line for line in lines if line.startswith("voile: ")] or lines
    return lines[-1].removeprefix("voile: ") if lines else f"exit code {code}"


def missing(measures: tuple[Measure, ...], records: list[Record]) -> list[str]:
    """Measures that no converged run produced, if any converged."""
    done = [r for r in records if r.status == CONVERGED]
    return [m.name for m in measures if done and all(r.values.get(m.name) is None for r in done)]


def figures_of(runs: Runs, records: list[Record]) -> list[str]:
    """Dotted names of the numbers in the summary of the first run that converged."""
    run = next(run for run, record in zip(runs.plan.runs, records, strict=True) if record.status == CONVERGED)
    return sorted(_numbers(summary_of(runs.folder(run)), ""))


def _numbers(node: object, name: str) -> Iterator[str]:
    if isinstance(node, dict | list):
        items = node.items() if isinstance(node, dict) else enumerate(node)
        for key, value in items:
            yield from _numbers(value, f"{name}.{key}" if name else str(key))
    elif isinstance(node, int | float) and not isinstance(node, bool):
        yield name
