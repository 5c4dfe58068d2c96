"""Files that other people made, before meshio reads them: nothing of other files, and an end."""

import contextlib
import os
import resource
import signal
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from voile.errors import InputError

PATIENCE, SPEED = 5.0, 1e5  # s, bytes/s: the slowest reader, of 3 MB of text a second, many times over

LONG = 10  # s of the processor, for what takes HDF5 milliseconds
SMALL = 1 << 16  # bytes: HDF5 keeps what is smaller among what describes it
CRASHES = (signal.SIGSEGV, signal.SIGBUS, signal.SIGABRT, signal.SIGFPE, signal.SIGILL, signal.SIGXCPU)


@contextlib.contextmanager
def ending(path: Path) -> Iterator[None]:
    """Raises TimeoutError in what takes longer (s of the processor): some of meshio's readers miss a file's end."""
    seconds = PATIENCE + path.stat().st_size / SPEED
    if threading.current_thread() is not threading.main_thread():
        yield  # only the main thread gets signals
        return

    def stop(*_: object) -> None:
        raise TimeoutError(f"no end of it found within {seconds:.0f} s")

    before = signal.signal(signal.SIGPROF, stop)
    signal.setitimer(signal.ITIMER_PROF, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.signal(signal.SIGPROF, before)


def check_xdmf(path: Path) -> None:
    """InputError where an XDMF file takes data from elsewhere than the HDF5 file of its own name beside it."""
    beside = path.with_suffix(".h5")
    try:
        root = ElementTree.parse(path).getroot()
    except (ElementTree.ParseError, ValueError, RecursionError) as error:
        raise InputError(f"{path}: cannot be read as a mesh: {' '.join(str(error).split())}") from error
    for item in root.iter():
        kind, name = item.get("Format", "XML").upper(), (item.text or "").strip().split(":")[0]
        foreign = kind not in ("XML", "HDF") or (kind == "HDF" and name != beside.name)
        if foreign or item.tag.endswith("include"):
            raise InputError(f"{path}: takes data from {name!r} ({kind}); allowed: from {beside.name} only")
    if beside.exists():
        refuse_references(beside)


def refuse_references(path: Path) -> None:
    """InputError where an HDF5 file takes data from other files: any file of this machine might be one."""
    with open(path, "rb") as file:
        if file.read(8) != b"\x89HDF\r\n\x1a\n":
            return
    send_ahead(path)
    import h5py

    def check(name: str, item: Any) -> None:
        if isinstance(item, h5py.Dataset) and (
            item.is_virtual or item.id.get_create_plist().get_external_count()
        ):
            raise InputError(f"{path}: {name} is stored in another file; allowed: data of the file itself")
        for key in item if isinstance(item, h5py.Group) else ():
            if isinstance(item.get(key, getlink=True), h5py.ExternalLink):
                raise InputError(
                    f"{path}: {name}/{key} is a link to another file; allowed: data of the file itself"
                )

    try:
        with h5py.File(path, "r", locking=False) as hdf:
            check("", hdf)
            hdf.visititems(check)
    except InputError:
        raise
    except Exception as error:  # h5py raises anything at a broken file
        raise InputError(f"{path}: cannot be read as a mesh: {' '.join(str(error).split())}") from error


def send_ahead(path: Path) -> None:
    """InputError for a file on which HDF5 crashes, or without end: a child looks at all that describes it first."""
    child = os.fork()
    if not child:
        try:
            resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
            resource.setrlimit(resource.RLIMIT_CPU, (LONG, LONG + 1))
            for each in CRASHES:  # others' handlers would tell
                signal.signal(each, signal.SIG_DFL)
            _look_at_all(path)
        finally:  # an exception comes again where it is told
            os._exit(0)
    if os.WIFSIGNALED(os.waitpid(child, 0)[1]):
        raise InputError(f"{path}: damaged file: HDF5 crashes on it")


def _look_at_all(path: Path) -> None:
    import h5py

    def look(_name: str, item: Any) -> None:
        list(item.attrs.values())
        if isinstance(item, h5py.Dataset) and item.size * item.dtype.itemsize <= SMALL:
            item[()]

    with h5py.File(path, "r", locking=False) as file:
        look("", file)
        file.visititems(look)
