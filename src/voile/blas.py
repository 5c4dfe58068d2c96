"""The BLAS: OpenBLAS' kernels chosen before it loads, and what the solvers got in the end.

OpenBLAS chooses its kernels by the processor's model number. A release older than the processor does not know it and
falls back to kernels of 2004 ("Prescott"), several times too slow: Debian 12's 0.3.21 does 9 GFlop/s on Emerald Rapids
where it could do 60. OPENBLAS_CORETYPE overrules the choice, but is read only once, when the library loads: `prepare`
comes before numpy and PETSc. A user's own OPENBLAS_CORETYPE stays.
"""

import ctypes
import importlib.util
import os
import resource
from collections.abc import MutableMapping, Set
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from voile.errors import InputError

# OpenBLAS' kernels for Intel's processors before AVX2: on a processor with AVX2 they are a fallback.
OLD_CORES = {"Prescott", "Core2", "Penryn", "Dunnington", "Nehalem", "Sandybridge"}
# Best first: flags of /proc/cpuinfo, the kernels that need them. Later ones (Cooperlake, SapphireRapids) add nothing in
# double precision.
CORES = (
    ({"avx512f", "avx512cd", "avx512bw", "avx512dq", "avx512vl"}, "SkylakeX"),
    ({"avx2", "fma"}, "Haswell"),
)
# A function that tells whose library it is.
VENDORS = {
    "openblas_get_config": "OpenBLAS",
    "MKL_Get_Version_String": "Intel MKL",
    "bli_info_get_version_str": "BLIS",
}
LEAST_MEMORY = (
    1 << 30
)  # bytes: libraries take 350 MiB, OpenBLAS' buffer 128 MiB, PETSc and small meshes the rest
ROWS, INNER, COLUMNS = 131, 127, 113  # of the product checked: whole blocks of any kernel, and odd rests


@dataclass(frozen=True)
class Blas:
    """The BLAS that PETSc calls: name and version, file, kernels ("" unknown), threads (0 unknown), and a note on what
    makes it slow ("" nothing)."""

    library: str
    file: str
    core: str = ""
    threads: int = 0
    note: str = ""

    def __str__(self) -> str:
        kernels = f", {self.core} kernels" if self.core else ""
        threads = f", {self.threads} thread{'s' * (self.threads > 1)}" if self.threads else ""
        return f"{self.library}{kernels}{threads}; {self.file}"


# ---- before it loads ----


def check_memory() -> None:
    """Raises InputError where OpenBLAS would not get its buffer, for which it asks again without end."""
    limit = resource.getrlimit(resource.RLIMIT_AS)[0]
    if limit != resource.RLIM_INFINITY and limit < LEAST_MEMORY:
        raise InputError(
            f"the address space is limited to {limit / 2**20:.0f} MiB (ulimit -v); allowed: from "
            f"{LEAST_MEMORY / 2**20:.0f} MiB"
        )


def prepare(environment: MutableMapping[str, str] = os.environ) -> None:
    """Sets what OpenBLAS reads when it loads: threads, and kernels where it would fall back to old ones. Takes some 10
    ms, for asking the library."""
    # The ranks are the parallelism, and MUMPS' small dense blocks only lose by more threads.
    environment.setdefault("OPENBLAS_NUM_THREADS", "1")
    suited = suited_core(processor_flags())
    if suited and "OPENBLAS_CORETYPE" not in environment and offered_core() in OLD_CORES:
        environment["OPENBLAS_CORETYPE"] = suited


def processor_flags(cpuinfo: str = "/proc/cpuinfo") -> set[str]:
    """What an x86 processor can do and the system lets it do; empty elsewhere."""
    try:
        lines = Path(cpuinfo).read_text().splitlines()
    except OSError:
        return set()
    return set(next((line.partition(":")[2] for line in lines if line.startswith("flags")), "").split())


def suited_core(flags: Set[str]) -> str:
    """OpenBLAS' kernels for a processor with these flags; "" where its own choice is as good."""
    return next((core for needed, core in CORES if needed <= flags), "")


def offered_core() -> str:
    """The kernels that OpenBLAS takes by itself, "" where there is no OpenBLAS. Loads the library that voile._friction
    is linked with, asks it, and unloads it, so that it reads its settings again."""
    module = importlib.util.find_spec("voile._friction")
    if module is None or module.origin is None:
        return ""
    library = ctypes.CDLL(module.origin)
    try:
        return _text(library, "openblas_get_corename")
    finally:
        ctypes.CDLL(None).dlclose(ctypes.c_void_p(library._handle))


# ---- once it is loaded ----


@cache
def used() -> Blas:
    """The BLAS that PETSc calls in this process. Raises RuntimeError where it multiplies wrongly."""
    import voile._petsc

    dgemm = ctypes.CDLL(voile._petsc.__file__).dgemm_
    file = _file(dgemm)
    library = ctypes.CDLL(file)
    vendor = next((name for function, name in VENDORS.items() if hasattr(library, function)), "")
    if vendor == "OpenBLAS":
        config, core = _text(library, "openblas_get_config"), _text(library, "openblas_get_corename")
        note = complaint(core, "DYNAMIC_ARCH" in config, processor_flags(), os.environ)
        version = " ".join(config.split()[:2])
        blas = Blas(version, file, core, library.openblas_get_num_threads(), note)
    elif vendor:
        blas = Blas(vendor, file)
    else:
        note = f"{file} is not OpenBLAS, Intel MKL or BLIS; the reference BLAS is several times slower"
        blas = Blas("unknown BLAS", file, note=note)
    if not multiplies(dgemm):
        raise RuntimeError(f"the BLAS multiplies matrices wrongly: {blas}")
    return blas


def complaint(core: str, dynamic: bool, flags: Set[str], environment: MutableMapping[str, str]) -> str:
    """Why OpenBLAS uses old kernels on a processor with these flags, and the remedy; "" where it does not."""
    suited = suited_core(flags)
    if not suited or core not in OLD_CORES:
        return ""
    slow = f"OpenBLAS uses its {core} kernels, several times slower here than its {suited} kernels"
    if not dynamic:
        return f"{slow}: it was built with them only (not with DYNAMIC_ARCH)"
    if environment.get("OPENBLAS_CORETYPE", "").lower() == core.lower():
        return f"{slow}: OPENBLAS_CORETYPE asks for them"
    return f"{slow}: set OPENBLAS_CORETYPE={suited}, or import voile before numpy"


def multiplies(dgemm: Any) -> bool:
    """Whether a BLAS' dgemm gives the right product C = A B of small integers: C r = A (B r), exactly (Freivalds)."""
    import numpy as np

    random = np.random.default_rng(1)
    A, B = (random.integers(-9, 10, shape).astype(float) for shape in ((ROWS, INNER), (INNER, COLUMNS)))
    r = random.integers(-9, 10, COLUMNS).astype(float)
    # C, filled with what must be overwritten, is computed column by column as BLAS sees it: C^T = B^T A^T by rows.
    C = np.full((ROWS, COLUMNS), np.nan)
    m, k, n = (ctypes.byref(ctypes.c_int64(size)) for size in (ROWS, INNER, COLUMNS))
    one, zero = ctypes.byref(ctypes.c_double(1.0)), ctypes.byref(ctypes.c_double(0.0))
    a, b, c = (ctypes.c_void_p(matrix.ctypes.data) for matrix in (A, B, C))
    length = ctypes.c_size_t(1)  # of the strings, as Fortran passes them
    dgemm(b"N", b"N", n, m, k, one, b, n, a, k, zero, c, n, length, length)
    return bool(((C * r).sum(axis=1) == (A * (B * r).sum(axis=1)).sum(axis=1)).all())


def _text(library: ctypes.CDLL, function: str) -> str:
    """What a C function without arguments says; "" where the library has no such function."""
    if not hasattr(library, function):
        return ""
    found = getattr(library, function)
    found.restype = ctypes.c_char_p
    values: str = found().decode()
    return values


class _Symbol(ctypes.Structure):
    """Dl_info of dladdr(3)."""

    _fields_ = (
        ("file", ctypes.c_char_p),
        ("base", ctypes.c_void_p),
        ("name", ctypes.c_char_p),
        ("address", ctypes.c_void_p),
    )


def _file(function: Any) -> str:
    """The library that a C function lies in."""
    found = _Symbol()
    ctypes.CDLL(None).dladdr(ctypes.cast(function, ctypes.c_void_p), ctypes.byref(found))
    return os.path.realpath(os.fsdecode(found.file))
