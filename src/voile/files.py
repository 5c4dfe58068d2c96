"""All that voile writes: files whole or not at all, and never through a link that someone has put there."""

from __future__ import annotations

import errno
import mmap
import os
import re
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

from voile.errors import InputError, NotWritten

unfinished: set[Path] = set()  # temporary files that are being written
NO_ROOM = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO)


class Unwritable(InputError):
    """A file that cannot be written; in the midst of a run that is no matter of its input (voile.api.solve)."""


@contextmanager
def replacing(path: str | os.PathLike[str], reserved: bool = False) -> Iterator[IO[bytes]]:
    """A new file, open for writing, that takes the name `path` when the block ends well, else is gone.

    reserved: one with room may be there (`reserve` of `part_of`), which the block truncates.

    What was there stays until then. A link or a pipe of that name, or of the temporary one, is replaced and never
    followed. Libraries that write by name find the file under its `name`. Raises Unwritable, for folders and devices
    of that name before the block begins.
    """
    path = Path(path)
    part = part_of(path)
    try:
        _check(path)
        with (_own(part) if reserved else None) or fresh(part) as file:
            unfinished.add(part)
            try:
                yield file
                file.flush()
                if not os.path.samestat(os.lstat(part), os.fstat(file.fileno())):
                    raise InputError(f"{path}: another process writes it too")
            except BaseException:
                part.unlink(missing_ok=True)
                raise
            finally:
                unfinished.discard(part)
        os.replace(part, path)
    except OSError as error:
        raise Unwritable(f"{path}: cannot be written: {reason(error)}") from error


def replace(path: str | os.PathLike[str], data: bytes | mmap.mmap) -> None:
    """Puts data into a file, all or nothing, as `replacing` does. Raises Unwritable."""
    with replacing(path, reserved=True) as file:
        file.write(data)
        file.truncate()


def prove(path: str | os.PathLike[str]) -> None:
    """Raises Unwritable where no file of that name can be, before what takes long is computed."""
    part = part_of(Path(path))
    try:
        _check(Path(path))
        with fresh(part):
            pass
        part.unlink()
    except OSError as error:
        raise Unwritable(f"{path}: cannot be written: {reason(error)}") from error


def part_of(path: Path) -> Path:
    """The temporary name of a file."""
    return path.with_name(f".{path.name}.part")


def made(folder: str | os.PathLike[str], new: bool = False) -> Path:
    """A folder, which is made where there is none; new: nothing may be there. Raises Unwritable."""
    try:
        Path(folder).mkdir(parents=True, exist_ok=not new)
    except OSError as error:
        raise Unwritable(
            f"{folder}: cannot be written: {reason(error)}; a writable folder expected"
        ) from error
    return Path(folder)


def fresh(path: Path) -> IO[bytes]:
    """A new file in place of what is there, for writing. A link that is there is removed, never followed."""
    path.unlink(missing_ok=True)
    return open(path, "xb")


def lockable(path: Path) -> IO[bytes]:
    """A file that stays, to be locked, for reading and writing; made where there is none. Raises Unwritable, also for
    links."""
    try:
        # without a buffer: what a full disk refuses is refused once, not again when the file is closed
        return os.fdopen(os.open(path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o666), "r+b", buffering=0)
    except OSError as error:
        raise Unwritable(
            f"{path}: cannot be opened ({reason(error)}); a file of voile's own expected"
        ) from error


def reserve(path: Path, size: int) -> None:
    """A new file of a size (bytes) whose room is taken from the disk. Raises OSError where there is none."""
    with fresh(path) as file:
        try:
            take(file, 0, size)
        except OSError:
            path.unlink()
            raise


def take(file: IO[bytes], begin: int, size: int) -> None:
    """Takes room for bytes of a file from the disk, whose contents stay. Raises OSError where there is none."""
    try:
        os.posix_fallocate(file.fileno(), begin, size)
    except OSError as error:
        if error.errno not in (errno.EOPNOTSUPP, errno.EINVAL):  # file systems that cannot tell
            raise


@contextmanager
def told(path: Path, kept: str = "") -> Iterator[None]:
    """What cannot be written within ends with NotWritten."""
    try:
        yield
    except OSError as error:
        raise NotWritten(f"{path}: cannot be written: {reason(error)}{kept}") from None


def reason(error: OSError) -> str:
    """The system's words. HDF5's errors hold them in theirs."""
    found = re.search(r"error message = '(.*?)'", str(error))
    return found[1] if found else error.strerror or str(error)


def _check(path: Path) -> None:
    """OSError where a file would take the place of a folder or a device."""
    try:
        mode = path.lstat().st_mode
    except FileNotFoundError:
        return
    if stat.S_ISDIR(mode):
        raise IsADirectoryError(errno.EISDIR, "a folder is there")
    if stat.S_ISCHR(mode) or stat.S_ISBLK(mode):
        raise OSError(errno.ENOTSUP, "a device is there")


def _own(part: Path) -> IO[bytes] | None:
    """A file of this user that is there, which no one else holds by a link, to be written from its beginning: it may
    have been given room (`reserve`)."""
    try:
        file = os.fdopen(os.open(part, os.O_WRONLY | os.O_NOFOLLOW | os.O_NONBLOCK), "wb")
    except OSError:
        return None
    about = os.fstat(file.fileno())
    if stat.S_ISREG(about.st_mode) and about.st_nlink == 1 and about.st_uid == os.geteuid():
        return file
    file.close()
    return None
