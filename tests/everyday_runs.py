"""Runs everyday scenes through the command line, and says from the results alone how they ended."""

import itertools
import json
import math
import os
import resource
import signal
import subprocess
import tempfile
import threading
import time
from collections.abc import Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from everyday import Everyday
from hinges import crossings, fold_angles, inside_out

from voile.elastic import evaluate
from voile.results import Result, read_result

GRAVITY = np.array([0.0, -9.81, 0.0])  # m/s^2, the default of a scene
GOOD = ("stable", "slides")
PATIENCE = 10.0  # seconds by the clock per second of a processor: more than busy machines take


@dataclass(frozen=True)
class Run:
    """What a command cost and said; code: None where it was killed; seconds: by the clock, cpu_s: of the user's."""

    code: int | None
    seconds: float
    cpu_s: float
    memory_mib: float
    said: str


@dataclass(frozen=True)
class Ending:
    """How a scene ended. residual: of the shape stored, over the load; fold: largest fold angle (degrees); turned:
    hinges and vertices that show a fold past 180 degrees; method: those that found the load steps."""

    name: str
    vertices: int
    outcome: str  # stable, slides, unstable, not converged, timeout, error
    seconds: float
    cpu_s: float
    newton_iterations: int | None = None
    method: str = ""
    energy: float | None = None
    residual: float | None = None
    penetration: float | None = None
    fold: float | None = None
    turned: int | None = None
    reason: str = ""


def run(command: list[str], folder: Path, limit: float, patience: float = PATIENCE) -> Run:
    """Runs a command in a folder with the environment of a user. It is killed once it has used `limit` seconds of a
    processor, with its children after `patience` times as long by the clock."""
    ours = ("OPENBLAS_", "OMP_", "OMPI_", "PMIX_", "PYTHONDONTWRITEBYTECODE")
    environment = {name: value for name, value in os.environ.items() if not name.startswith(ours)}
    late = threading.Event()
    with (folder / "said").open("w+") as said:
        began = time.perf_counter()
        process = subprocess.Popen(
            command, cwd=folder, env=environment, stdout=said, stderr=said, start_new_session=True
        )
        seconds = math.ceil(limit)
        resource.prlimit(process.pid, resource.RLIMIT_CPU, (seconds, seconds))

        def kill() -> None:
            late.set()
            os.killpg(process.pid, signal.SIGKILL)

        timer = threading.Timer(patience * limit, kill)
        timer.start()
        _, status, usage = os.wait4(process.pid, 0)
        timer.cancel()
        process.returncode = os.waitstatus_to_exitcode(status)
        elapsed = time.perf_counter() - began
        said.seek(0)
        text = said.read()
    killed = late.is_set() or process.returncode in (-signal.SIGXCPU, -signal.SIGKILL)
    return Run(
        None if killed else process.returncode, elapsed, usage.ru_utime, usage.ru_maxrss / 1024.0, text
    )


def end(everyday: Everyday, python: str | Path, limit: float) -> Ending:
    """Runs a scene by the program that belongs to an interpreter."""
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        command = [
            str(Path(python).absolute()),
            "-m",
            "voile.cli",
            "run",
            everyday.write(folder).name,
            "-o",
            "out",
        ]
        done = run(command, folder, limit)
        ending = Ending(everyday.name, len(everyday.mesh[0]), "error", done.seconds, done.cpu_s)
        summary = folder / "out" / "summary.json"
        if done.code is None:
            return replace(ending, outcome="timeout", reason=f"no end within {limit:g} s of a processor")
        if done.code not in (0, 3) or not summary.is_file():
            return replace(ending, reason=" ".join(done.said.split()[-40:]))
        ending = told(ending, json.loads(summary.read_text()))
        if ending.outcome == "slides" and everyday.held:
            return replace(ending, outcome="error", reason=f"held, but {ending.reason}")
        if not (folder / "out" / "result.vtkhdf").is_file():
            return ending
        with read_result(folder / "out") as result:
            ending = seen(ending, everyday, result)
        return replace(ending, turned=followed(command, folder, limit)) if ending.turned else ending


def followed(command: list[str], folder: Path, limit: float) -> int:
    """How many hinges pass 180 degrees in a run that looks as if some did: tests/followed.py, in ten times the time."""
    again = [command[0], str(Path(__file__).with_name("followed.py")), command[4], "followed"]
    done = run(again, folder, 10.0 * limit)
    assert done.code == 0, done.said
    return int(done.said.rpartition("hinges past 180 degrees: ")[2])


def told(ending: Ending, summary: dict) -> Ending:
    """What a summary says."""
    outcome = "unstable"
    if not summary["converged"]:
        outcome = "slides" if "slides" in summary["reason"] else "not converged"
    elif summary["stable"]:
        outcome = "stable"
    methods = summary.get("method", summary.get("ways", []))
    return replace(
        ending,
        outcome=outcome,
        newton_iterations=summary.get("newton_iterations"),
        method=methods if isinstance(methods, str) else " ".join(dict.fromkeys(methods)),
        energy=sum(summary.get("energy", {}).values()) if summary["converged"] else None,
        reason=summary["reason"],
    )


def seen(ending: Ending, everyday: Everyday, result: Result) -> Ending:
    """What the shapes stored show."""
    shapes = [result.start, *(result.points(step) for step in range(result.n_steps))]
    folds = [fold_angles(shape, result.triangles) for shape in shapes]
    passed = sum(crossings(*pair) for pair in itertools.pairwise(folds))
    ending = replace(
        ending,
        fold=float(np.degrees(np.abs(folds[-1]).max())),
        turned=passed + len(inside_out(shapes[-1], result.triangles)),
    )
    if ending.outcome not in ("stable", "unstable"):
        return ending
    gap = float(result.field("gap").min())
    return replace(ending, residual=unbalanced(everyday, result), penetration=max(0.0, -gap))


def unbalanced(everyday: Everyday, result: Result) -> float:
    """Norm of the forces on what is free, over that of its weight."""
    shell = everyday.scene["shell"]
    e = evaluate(
        result.rest, result.points(), result.triangles, edge_angles=result.edge_angles(),
        thickness=shell["thickness"], young=shell["young"], poisson=0.3,
    )  # fmt: skip
    a, b, c = (result.rest[result.triangles[:, k]] for k in range(3))
    area = 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)
    mass = np.bincount(
        result.triangles.ravel(), np.repeat(shell["density"] * shell["thickness"] * area / 3, 3)
    )
    weight = mass[:, None] * GRAVITY
    free = np.ones(len(mass), dtype=bool)
    for fix in everyday.scene.get("fix", []):
        low, high = np.array(fix["select"]["box"])
        held = ((everyday.mesh[0] >= low) & (everyday.mesh[0] <= high)).all(axis=1)
        for _ in range(
            2 * fix.get("clamp", False)
        ):  # `evaluate` knows no clamps, which act on two rows of triangles
            held[result.triangles[held[result.triangles].any(axis=1)]] = True
        free &= ~held
    force = (e.gradient - weight - result.field("reaction"))[free]
    return float(np.linalg.norm(force) / np.linalg.norm(weight[free]))


def study(scenes: Iterable[Everyday], python: str | Path, limit: float, jobs: int) -> Iterator[Ending]:
    """The ends of many scenes, in their order, so many at a time."""
    with ThreadPoolExecutor(jobs) as pool:
        yield from pool.map(lambda everyday: end(everyday, python, limit), scenes)


SHARE = 0.99  # of the scenes end well, as are the limits below what issue-wide was asked
MEDIAN, LONGEST = 1.0, 10.0  # s of user CPU
UNBALANCED, INSIDE = (
    1e-6,
    1e-9,
)  # of the weight; m: the run's own tolerance is 1e-8, the shapes stored round it


def faults(ends: list[Ending]) -> list[str]:
    """What of many scenes misses what is asked, empty where nothing does."""
    bad = [f"{e.name}: {e.outcome}, {e.reason}" for e in ends if e.outcome not in GOOD]
    found = bad if len(bad) > (1.0 - SHARE) * len(ends) else []
    times = sorted(e.cpu_s for e in ends)
    if times[len(times) // 2] > MEDIAN:
        found.append(f"median of {times[len(times) // 2]:.2f} s; asked: {MEDIAN:g}")
    for e in ends:
        if e.cpu_s > LONGEST:
            found.append(f"{e.name}: {e.cpu_s:.1f} s; asked: {LONGEST:g}")
        if e.turned:
            found.append(f"{e.name}: {e.turned} signs of hinges past 180 degrees")
        if e.outcome == "stable" and not (
            (e.residual or 0.0) < UNBALANCED and (e.penetration or 0.0) < INSIDE
        ):
            found.append(
                f"{e.name}: not an equilibrium: {e.residual:.1e} unbalanced, {e.penetration:.1e} m inside"
            )
    return found
