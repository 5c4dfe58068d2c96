"""A campaign that ends runs by signals at random times, and lets them go on."""

from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from campaign_sources import OFTEN, STRIP
from campaigns import IDLE, Fault, judged

from voile.study.execute import unmarked

PATHS = {
    "dynamics": ("dynamics", "[dynamics]\nduration = 0.5\ntime_step = 0.005\n"),
    "load steps": ("statics", "[statics]\nload_steps = 60\n"),
    "arc length": ("statics", '[statics]\nload_steps = 60\ncontrol = "arc-length"\n'),
    "nearest shape": ("inverse", ""),
    "panels": ("inverse", '[inverse]\ndevelopable = "panels"\n'),
}
KILLED = """
[shell]
mesh = "strip.obj"
young = 6e6
thickness = 1e-3
density = 300.0
[[fix]]
select = { box = [[-0.01, -1, -1], [0.01, 1, 1]] }
clamp = true
"""
SIGNALS = signal.SIGKILL, signal.SIGTERM, signal.SIGINT
NEAR = 1e-8  # m, between the end of a run and that of its parts
PRINTED = 5e-5  # load factors are printed with four digits
APART = 0.02  # m, of searches on two ranks, of which no two are alike: MUMPS adds in the order in which messages come


def kills(folder: Path, count: int, seed: int, names: Sequence[str] = tuple(PATHS)) -> Iterator[Fault]:
    """Ends runs of every task that goes on (or of those named), on one and two ranks, by a signal at a random time;
    reads what they left, lets them go on, and compares the end with that of a whole run."""
    rng, whole, out = (
        np.random.default_rng(seed),
        dict[tuple[str, int], tuple[int, float, np.ndarray]](),
        folder / "out",
    )
    (folder / "strip.obj").write_text(STRIP)
    for k in range(count):
        name, ranks = str(rng.choice(names)), int(rng.integers(1, 3))
        task, keys = PATHS[name]
        scene = folder / f"{name.replace(' ', '-')}.toml"
        scene.write_text(f'[scene]\ntask = "{task}"\n{keys}{KILLED}')
        if (name, ranks) not in whole:
            began, rest = time.monotonic(), folder / f"whole-{scene.stem}-{ranks}"
            code, said = _ran(scene, rest, ranks)
            assert (rest / "result.vtkhdf").exists(), f"{name}, {ranks} ranks: exit code {code}: {said}"
            whole[name, ranks] = code, time.monotonic() - began, _end(rest)
        code, seconds, end = whole[name, ranks]
        shutil.rmtree(out, ignore_errors=True)
        number, after = SIGNALS[int(rng.integers(len(SIGNALS)))], seconds * float(rng.uniform(0.1, 1.0))
        what = f"{k}: {name}, {ranks} ranks, {number.name} after {after:.2f} s"
        command, (printed, said) = f"run {scene.name}", _killed(scene, out, ranks, number, after)
        if "Traceback" in said:
            yield Fault(what, command, said[-400:])
        if (out / "result.vtkhdf").exists():
            fault = judged(what, ["info", str(out)])
            if fault:
                yield fault
        if task != "inverse" and _last_printed(printed) > _last_stored(out) + PRINTED:
            yield Fault(what, command, f"printed {_last_printed(printed)}, stored {_last_stored(out)}")
        if not (out / ".voile-run").exists():
            continue  # ended before it had begun
        again, said = _ran(scene, out, ranks, "--resume")
        if again != code or "Traceback" in said:
            yield Fault(what, f"{command} --resume", f"exit code {again}, a whole run {code}: {said[-400:]}")
        elif np.abs(_end(out) - end).max() > (APART if task == "inverse" and ranks > 1 else NEAR):
            yield Fault(
                what, f"{command} --resume", f"ends {np.abs(_end(out) - end).max():.1e} m off a whole run"
            )


def tears(folder: Path, count: int, seed: int) -> Iterator[Fault]:
    """Kills runs of one rank at a byte of what they write, any; reads what they left, lets them go on, and compares."""
    rng, out, library = np.random.default_rng(seed), folder / "out", folder / "torn.so"
    source = Path(__file__).with_name("torn.c")
    subprocess.run(["cc", "-shared", "-fPIC", "-o", library, source, "-ldl"], check=True)
    (folder / "strip.obj").write_text(STRIP)
    name = "load steps"
    task, keys = PATHS[name]
    scene = folder / "scene.toml"
    scene.write_text(f'[scene]\ntask = "{task}"\n{keys.replace("60", "12")}{KILLED}')
    torn = {"LD_PRELOAD": str(library), "TORN_IN": str(out), "TORN_TO": "1"}
    with _started(scene, out, 1, environment=torn) as process:
        size, code, end = int(process.communicate(timeout=IDLE)[0].split()[-1]), process.returncode, _end(out)
    for k in range(count):
        shutil.rmtree(out, ignore_errors=True)
        at = int(rng.integers(1, size))
        what, command = f"{k}: killed at byte {at} of {size}", f"run {scene.name}"
        with _started(scene, out, 1, environment=torn | {"TORN_AT": str(at)}) as process:
            said = process.communicate(timeout=IDLE)[1]
        if process.returncode != -signal.SIGKILL:
            yield Fault(what, command, f"not killed: exit code {process.returncode}: {said[-400:]}")
        if (out / "result.vtkhdf").exists():
            fault = judged(what, ["info", str(out)])
            if fault:
                yield fault
        again, said = _ran(scene, out, 1, *(["--resume"] if (out / ".voile-run").exists() else []))
        if again != code or "Traceback" in said:
            yield Fault(what, f"{command} --resume", f"exit code {again}, a whole run {code}: {said[-400:]}")
        elif np.abs(_end(out) - end).max() > NEAR:
            yield Fault(what, command, f"ends {np.abs(_end(out) - end).max():.1e} m off a whole run")


def _started(
    scene: Path, out: Path, ranks: int, *more: str, environment: dict[str, str] | None = None
) -> subprocess.Popen[str]:
    """A run in a group of processes of its own."""
    launch = ["mpirun", "--allow-run-as-root", "--oversubscribe", "-n", str(ranks)] if ranks > 1 else []
    return subprocess.Popen(
        [*launch, sys.executable, "-c", OFTEN, "run", str(scene), "-o", str(out), *more],
        stdout=subprocess.PIPE if environment is not None else subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        # where a test has begun MPI in its own process, mpirun would take its marks for those of a rank
        env=unmarked() | (environment or {}),
    )


def _ran(scene: Path, out: Path, ranks: int, *more: str) -> tuple[int, str]:
    """Exit code, and what it said."""
    with _started(scene, out, ranks, *more) as process:
        said = process.communicate(timeout=IDLE)[1]
        return process.returncode, said


def _killed(scene: Path, out: Path, ranks: int, number: signal.Signals, after: float) -> tuple[str, str]:
    """What a run printed and said that got a signal after so many seconds; one of its ranks, where it has several."""
    with _started(scene, out, ranks, environment={}) as process:
        time.sleep(after)
        inside = Path(f"/proc/{process.pid}/task/{process.pid}/children")
        try:
            told = int(inside.read_text().split()[-1]) if ranks > 1 else process.pid
            os.kill(told, number)
        except (OSError, IndexError, ValueError):
            pass  # it has ended, or has not begun
        return process.communicate(timeout=IDLE)


def _last_printed(printed: str) -> float:
    """Time or load factor of the last whole line that tells of a step; -1 without one."""
    told = re.findall(r"^(?:load|time)\s+(\S+).*\n", printed, re.MULTILINE)
    return max(map(float, told), default=-1.0)


def _last_stored(out: Path) -> float:
    """Time or load factor of the last step in a result; -1 without one."""
    from voile.results import read_result

    if not (out / "result.vtkhdf").exists():
        return -1.0
    with read_result(out) as result:
        return float(result.values.max())


def _end(out: Path) -> np.ndarray:
    from voile.results import read_result

    with read_result(out) as result:
        return np.concatenate([result.points(), result.rest])
