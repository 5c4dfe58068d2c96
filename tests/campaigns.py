"""Campaigns against the program: damaged results, meshes and scenes, and kills, each with a fixed seed.

A case is a command in a process of its own, forked from one that has imported everything. It may end with 0, 2 or 3; on
standard error it may say one line, which begins with "voile: "; within SECONDS of the processor, and within MEMORY.
"""

from __future__ import annotations

import importlib.util
import json
import os
import resource
import signal
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

SECONDS, MEMORY = 60, 6 << 30  # of the processor, for a case; bytes of address space
IDLE = 10 * SECONDS  # s on the clock, where it waits for nothing or the machine is busy
Case = tuple[str, list[str]]  # what was done, and the command


@dataclass(frozen=True)
class Fault:
    """A case that did not end as it may."""

    case: str
    command: str
    why: str


def judged(name: str, command: list[str]) -> Fault | None:
    """Runs a command of voile in a fork."""
    with tempfile.TemporaryFile("w+") as said:
        child = os.fork()
        if child == 0:
            _run(command, said.fileno())
        code = _waited(child)
        said.seek(0)
        text = said.read()
    lines = text.strip().splitlines()
    if code is None:
        why = f"no end within {IDLE} s"
    elif code == -signal.SIGXCPU:
        why = f"no end within {SECONDS} s of the processor"
    elif code < 0:
        why = f"killed by {signal.Signals(-code).name}"
    elif code not in (0, 2, 3):
        why = f"exit code {code}"
    elif len(lines) > (code != 0) or (code and not text.startswith("voile: ")):
        why = f"exit code {code}, and more than one message"
    elif code and not text.strip().isprintable():
        why = "control characters on the terminal"
    else:
        return None
    return Fault(name, " ".join(command), f"{why}: {text[-400:]}")


def _run(command: list[str], said: int) -> None:
    """The child: never returns."""
    code = 70
    try:
        null = os.open(os.devnull, os.O_RDWR)
        os.dup2(null, 0)
        os.dup2(null, 1)
        os.dup2(said, 2)
        resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
        spent = int(time.process_time())
        resource.setrlimit(resource.RLIMIT_CPU, (spent + SECONDS, spent + SECONDS + 1))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        from voile.cli import main

        code = main(command)
    except SystemExit as ended:
        code = ended.code if isinstance(ended.code, int) else 1
    except BaseException:
        import traceback

        traceback.print_exc()
    finally:
        sys.stderr.flush()
        os._exit(code)


def _waited(child: int) -> int | None:
    """The exit code, minus the signal, or None where it had to be killed."""
    end = time.monotonic() + IDLE
    while time.monotonic() < end:
        done, status = os.waitpid(child, os.WNOHANG)
        if done:
            return os.waitstatus_to_exitcode(status)
        time.sleep(0.01)
    os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
    return None


# ---- damage ----


def damaged(data: bytes, rng: np.random.Generator) -> tuple[str, bytes]:
    """Bytes of a file with a random fault: cut, bits turned, zeros, a piece of it moved."""
    kind = rng.integers(5)
    at = int(rng.integers(len(data)))
    if kind == 0:
        return f"cut to {at}", data[:at]
    changed = np.frombuffer(data, np.uint8).copy()
    if kind == 1:
        changed[at] ^= 1 << int(rng.integers(8))
        return f"bit at {at}", changed.tobytes()
    if kind == 2:
        places = rng.integers(len(data), size=16)
        changed[places] = rng.integers(256, size=16)
        return f"16 bytes from {places[0]}", changed.tobytes()
    size = int(rng.integers(1, 65))
    if kind == 3:
        changed[at : at + size] = rng.choice([0, 255])
        return f"{size} bytes at {at} alike", changed.tobytes()
    other = int(rng.integers(len(data)))
    piece = changed[other : other + size].copy()
    changed[at : at + len(piece)][: len(piece)] = piece[: len(changed[at : at + len(piece)])]
    return f"{size} bytes from {other} to {at}", changed.tobytes()


def edited(path: Path, rng: np.random.Generator) -> str:
    """A result file with one dataset or attribute replaced, as another program might."""
    import h5py

    with h5py.File(path, "r+") as file:
        names: list[str] = []
        file.visititems(lambda name, item: names.append(name) if isinstance(item, h5py.Dataset) else None)
        name = str(rng.choice(names))
        values = file[name][()]
        kind = int(rng.integers(8))
        if kind == 0:
            del file[name]
        elif kind == 1:
            file["VTKHDF/Steps"].attrs["NSteps"] = int(rng.choice([-1, 0, 10**6, 2**62]))
        elif kind == 2:
            del file[name]
            file[name] = h5py.ExternalLink("/etc/passwd", "/x")
        elif kind == 3:
            del file[name]
            file.create_dataset(name, (10**9, 3), "f8", chunks=(1000, 3))
        elif kind == 4:
            del file[name]
            file[name] = "text"
        elif kind == 5:
            del file[name]
            file.create_dataset(
                name, values.shape, values.dtype, external=[("/etc/passwd", 0, h5py.h5f.UNLIMITED)]
            )
        elif kind == 6:
            file["voile"].attrs[str(rng.choice(["versions", "group_names", "format_version"]))] = str(
                rng.choice(["[[[", "3", "\x1b[2J", '{"a": [1]}'])
            )
        else:
            flat = np.ravel(values).copy()
            if flat.size:
                extreme = [np.nan, np.inf, 1e300] if flat.dtype.kind == "f" else [-1, 2**31 - 1]
                extreme = extreme if flat.dtype.kind != "u" else [0, 255]
                flat[rng.integers(flat.size)] = rng.choice(extreme)
            del file[name]
            file[name] = flat.reshape(np.shape(values))
    return f"edit {kind} of {name}"


# ---- campaigns ----


def results(folder: Path, source: Path, count: int, seed: int) -> Iterator[Case]:
    """Damaged copies of the files of a result's folder, read by every command that reads results."""
    rng = np.random.default_rng(seed)
    place = folder / "result"
    commands = [
        ["info", "."], ["export", ".", "shape.obj"], ["export", ".", "shape.vtu"], ["export", ".", "shape.glb"],
        ["export", ".", "shape.ply"], ["plot", "."], ["render", ".", "-o", "a.png"],
        ["render", ".", "--shape", "rest", "-o", "a.png"],
    ]  # fmt: skip
    files = [path for path in sorted(source.iterdir()) if path.suffix in (".vtkhdf", ".json", ".h5")]
    for k in range(count):
        place.mkdir(exist_ok=True)
        for path in files:
            (place / path.name).write_bytes(path.read_bytes())
        victim = files[0] if rng.random() < 0.2 else source / "result.vtkhdf"
        if k % 3 == 2:
            what = edited(place / "result.vtkhdf", rng)
        else:
            what, data = damaged(victim.read_bytes(), rng)
            (place / victim.name).write_bytes(data)
        command = commands[int(rng.integers(len(commands)))]
        if k % 20 == 19:
            command = ["animate", ".", "-o", "a.gif"]
        yield f"{k}: {victim.name}, {what}", [str(place) if c == "." else c for c in command]


def rewritten(text: str, rng: np.random.Generator) -> tuple[str, bytes]:
    """JSON with one value, anywhere in it, replaced, left out or repeated."""
    data = json.loads(text)
    holder, key = data, "pieces"
    for _ in range(int(rng.integers(1, 9))):
        inside = holder[key]
        if not (isinstance(inside, dict | list) and inside):
            break
        keys = list(inside) if isinstance(inside, dict) else list(range(len(inside)))
        holder, key = inside, keys[int(rng.integers(len(keys)))]
    if rng.random() < 0.3:
        holder, key = data, list(data)[int(rng.integers(len(data)))]
    kind = int(rng.integers(len(VALUES) + 2))
    if kind < len(VALUES):
        holder[key] = VALUES[kind]
    elif kind == len(VALUES):
        del holder[key]
    else:
        holder[key] = [holder[key]] * 3
    return f"value {kind} at {key}", json.dumps(data).encode()


VALUES = [
    None, -1, 0, 1, 1e308, 1e-300, 9999.0, float("nan"), float("inf"), "x", "", "\x1b[2J\x00", [], {}, True, 2**70,
    [[1, 2]],
]  # fmt: skip


def patterns(folder: Path, count: int, seed: int) -> Iterator[Case]:
    """Damaged sewing patterns, drawn, laid on fabric and on sheets."""
    from campaign_sources import small_pattern

    from voile.results import write_pattern

    rng, path = np.random.default_rng(seed), folder / "pattern.json"
    commands = [
        ["export", ".", "a.svg"], ["export", ".", "a.dxf"], ["export", ".", "a.png"], ["pattern", ".", "--pages", "a4"],
    ]  # fmt: skip
    for k in range(count):
        write_pattern(folder, small_pattern())
        text = path.read_text()
        what, data = damaged(text.encode(), rng) if k % 4 == 0 else rewritten(text, rng)
        path.write_bytes(data)
        command = commands[int(rng.integers(len(commands)))]
        if k % 20 == 19 and importlib.util.find_spec("spyrrow"):
            command = ["pattern", ".", "--width", "0.5", "--seconds", "0.1"]
        yield f"{k}: {what}", [str(folder) if c == "." else c for c in command]


FORMATS = ("obj", "ply", "stl", "vtk", "vtu", "msh")


def meshes(folder: Path, count: int, seed: int) -> Iterator[Case]:
    """Damaged meshes in six formats, explained: read, checked, and all that is built from them."""
    import meshio

    rng = np.random.default_rng(seed)
    n = 6
    x, y = (a.ravel() for a in np.meshgrid(*2 * [np.linspace(0.0, 0.2, n + 1)], indexing="ij"))
    first = (np.arange(n)[:, None] * (n + 1) + np.arange(n)).ravel()
    triangles = np.concatenate(
        [
            np.column_stack([first, first + n + 1, first + n + 2]),
            np.column_stack([first, first + n + 2, first + 1]),
        ]
    )
    mesh = meshio.Mesh(np.column_stack([x, y, 0.0 * x]), [("triangle", triangles)])
    for k in range(count):
        kind = FORMATS[k % len(FORMATS)]
        path = folder / f"sheet.{kind}"
        _quietly(lambda path=path: mesh.write(path))
        what, data = damaged(path.read_bytes(), rng) if rng.random() < 0.5 else words(path.read_bytes(), rng)
        path.write_bytes(data)
        (folder / "scene.toml").write_text(SCENE.format(mesh=path.name))
        yield f"{k}: {kind}, {what}", ["explain", str(folder / "scene.toml")]


def _quietly(action: Callable[[], None]) -> None:
    import contextlib
    import io

    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
        action()


WORDS = [
    b"nan", b"1e300", b"-1e300", b"1e-150", b"-1", b"0", b"99999999999999999999", b"1e400", b"x", b"\x1b[31m", b"\x00",
    b"", b"1 2", b"4294967296", b"/etc/passwd",
]  # fmt: skip


def words(data: bytes, rng: np.random.Generator) -> tuple[str, bytes]:
    """A text with words replaced."""
    parts = data.split(b" ")
    for _ in range(int(rng.integers(1, 4))):
        parts[int(rng.integers(len(parts)))] = WORDS[int(rng.integers(len(WORDS)))]
    return "words", b" ".join(parts)


SCENE = """
[shell]
mesh = "{mesh}"
young = 1e6
thickness = 1e-3
density = 300.0

[[fix]]
select = {{ box = [[-0.01, -1, -1], [0.01, 1, 1]] }}
clamp = true

[[obstacle]]
shape = "sphere"
center = [0.1, 0.1, -0.06]
radius = 0.05
friction = 0.3
"""


def scenes(folder: Path, count: int, seed: int) -> Iterator[Case]:
    """Mutated scenes, explained."""
    rng = np.random.default_rng(seed)
    next(iter(meshes(folder, 1, 0)))
    import meshio  # a whole mesh in place of the damaged one

    _quietly(
        lambda: meshio.Mesh(
            np.array([[0, 0, 0], [0.2, 0, 0], [0, 0.2, 0], [0.2, 0.2, 0]]),
            [("triangle", np.array([[0, 1, 2], [1, 3, 2]]))],
        ).write(folder / "sheet.obj")
    )
    text = SCENE.format(mesh="sheet.obj").encode()
    for k in range(count):
        what, data = words(text, rng) if k % 2 else damaged(text, rng)
        (folder / "scene.toml").write_bytes(data)
        yield f"{k}: {what}", ["explain", str(folder / "scene.toml")]


def faults(cases: Iterator[Case]) -> Iterator[Fault]:
    """Those of a campaign, as they are found."""
    for name, command in cases:
        fault = judged(name, command)
        if fault:
            yield fault
