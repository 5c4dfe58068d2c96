"""The folder of a run: who may write there, what an earlier run left, and files that are written whole or not at all.

`.voile-run` in it is locked (flock) while a run goes, by rank 0: the system ends the lock with the process, however
that ends. It also says of which scene the results are.
"""

from __future__ import annotations

import errno
import fcntl
import json
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

from voile.errors import InputError, on_root
from voile.files import NO_ROOM, Unwritable, fresh, lockable, part_of, reserve
from voile.results.checks import dataset, intact, open_file

if TYPE_CHECKING:
    from mpi4py import MPI

RECORD = ".voile-run"
RESULT, SUMMARY = "result.vtkhdf", "summary.json"
# What runs write, beside pictures: names that must not be those of folders.
FILES = (
    RECORD, RESULT, SUMMARY, "history.h5", "pattern.json", "pattern.svg", "pattern.dxf", "pattern.png", "rest.obj",
    "developability.png", "restart/last", f".{RESULT}.part", f".{SUMMARY}.part",
)  # fmt: skip
SPARE = 1 << 16  # bytes kept for the summary: a hundred times a short one
NO_LOCKS = (errno.ENOSYS, errno.EOPNOTSUPP, errno.ENOLCK)  # of file systems without


def prepare_output(directory: str | os.PathLike[str], comm: MPI.Comm) -> Path:
    """Make the output directory and prove that it can be written, before anything is computed. Collective.

    Touches no result that is there. Raises InputError on every rank.
    """
    directory = Path(directory)

    def probe() -> None:
        try:
            directory.mkdir(parents=True, exist_ok=True)
            trial = directory / ".result.part"
            with fresh(trial):
                pass
            trial.unlink()
        except OSError as error:
            why = error.strerror or str(error)
            raise InputError(
                f"{directory}: cannot write results there ({why}); a writable directory expected"
            ) from None
        for name in FILES:
            if (directory / name).is_dir():
                raise InputError(f"{directory / name}: a folder; runs write a file of that name")
        if (directory / "restart").is_symlink() or (directory / "restart").is_file():
            raise InputError(f"{directory / 'restart'}: no folder; runs write a folder of that name")

    on_root(comm, probe)
    return directory


@contextmanager
def held_output(
    directory: str | os.PathLike[str],
    comm: MPI.Comm,
    scene: Path,
    text: str,
    force: bool = False,
) -> Iterator[Path]:
    """The output directory, made, and locked against other runs; refused where another scene's results are in it.

    scene: its file; text: what results of it store. The same file may run there again, edited or with other overrides,
    also where it moved together with the folder. force: what is there may be replaced. Collective; raises InputError.
    """
    directory = prepare_output(directory, comm)
    record = on_root(comm, lambda: _locked(directory))
    try:
        on_root(comm, lambda: _claim(directory, record, scene, text, force))
        yield directory
    finally:
        if record:
            record.close()
            part_of(directory / SUMMARY).unlink(missing_ok=True)


def recorded_scene(directory: Path) -> str:
    """The scene's file, from the folder of its results; empty where that is not told."""
    try:
        with (directory / RECORD).open("rb") as file:
            return str(_recorded(file).get("scene", ""))
    except OSError:
        return ""


def set_aside(result: Path) -> None:
    """Keeps a result that is there, with what belongs to it, as `*.previous.*`; without a result there is nothing."""
    if not result.exists():
        return
    for old in (result, result.with_name(SUMMARY), result.with_name("history.h5")):
        previous = old.with_name(f"{old.stem}.previous{old.suffix}")
        if old.exists():
            os.replace(old, previous)
        else:
            previous.unlink(missing_ok=True)  # of a run before


def out_of_room(error: Exception) -> str:
    """What to say of a file that cannot be written or a full disk; empty for other errors."""
    full = isinstance(error, Unwritable) or (isinstance(error, OSError) and error.errno in NO_ROOM)
    return f"results cannot be written: {error}" if full else ""


def _locked(directory: Path) -> IO[bytes]:
    """The record of a folder, locked."""
    path = directory / RECORD
    file = lockable(path)
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        if error.errno not in NO_LOCKS:
            who = _recorded(file).get("process", "another process")
            file.close()
            raise InputError(
                f"{directory}: a run is writing there ({who}); allowed: another folder (-o), or wait for its end"
            ) from None
    return file


def _recorded(file: IO[bytes]) -> dict[str, Any]:
    """What a record says, {} where that is nothing."""
    file.seek(0)
    try:
        found = json.loads(file.read(SPARE))
    except (ValueError, RecursionError):
        return {}
    return found if isinstance(found, dict) else {}


def _claim(directory: Path, record: IO[bytes], scene: Path, text: str, force: bool) -> None:
    """Writes into a folder's record of which scene its results are; refuses where they are of another one."""
    name = os.path.relpath(scene.resolve(), directory.resolve())
    found = _recorded(record)
    result = directory / RESULT
    if not force and (result.exists() or (directory / SUMMARY).exists()):
        if "scene" in found:
            other = str(found["scene"])
            same = other == name
        else:
            other = "another scene, or an edited one"
            same = not result.exists() or stored_text(result).split("# --set")[0] == text.split("# --set")[0]
        if not same:
            raise InputError(
                f"{directory}: holds results of {other!r}; allowed: another folder (-o), or --force to replace them"
            )
    try:
        record.seek(0)
        record.write(
            json.dumps({"scene": name, "process": f"process {os.getpid()} on {os.uname().nodename}"}).encode()
        )
        record.truncate()
        record.flush()
        reserve(part_of(directory / SUMMARY), SPARE)
    except OSError as error:
        raise InputError(
            f"{directory}: cannot write results there ({error.strerror}); a writable directory expected"
        ) from None


def stored_text(result: Path) -> str:
    """The scene's text in a result file, empty where it cannot be read."""

    try:
        with intact(result), open_file(result) as file:
            found: str = dataset(result, file, "voile/scene", "indices", 0)[()].tobytes().decode("utf-8")
            return found
    except InputError:
        return ""
