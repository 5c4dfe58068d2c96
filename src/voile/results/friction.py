"""Discrete frictional contact problems and their solutions in HDF5.

Two layouts are read: W as compressed rows (W/data, W/indices, W/indptr, W/shape), q and mu at the root; and FCLIB's
local form (https://frictionalcontactlibrary.github.io): group fclib_local with spacedim, W/{m, n, nz, nzmax, p, i, x}
(nz >= 0: that many triplets, -1: compressed columns, -2: compressed rows) and vectors/{q, mu}.
"""

import os
from pathlib import Path
from typing import Any, NamedTuple

import h5py
import numpy as np
import scipy.sparse as sp

from voile.arrays import Array, Ints, Reals
from voile.errors import InputError
from voile.files import replace
from voile.results.checks import intact, member, open_file


class FrictionProblem(NamedTuple):
    """u = W r + q in frames (normal, tangent 1, tangent 2): W (3c, 3c), q (3c,), mu (c,)."""

    W: sp.csr_matrix
    q: Reals
    mu: Reals


class FrictionSolution(NamedTuple):
    """What `write_solution` wrote: r (c, 3) N, state (c,), the numbers of its attributes."""

    r: Reals
    state: Ints
    error: float
    iterations: int
    seconds: float
    cpu_seconds: float


def read_problem(path: str | os.PathLike[str]) -> FrictionProblem:
    """Reads either layout; InputError names the file and what is missing, malformed or beyond this program."""
    path = Path(path)
    if not path.is_file():
        raise InputError(f"{path}: no such file")
    if not h5py.is_hdf5(path):
        raise InputError(f"{path}: not an HDF5 file")
    try:
        with open_file(path) as file:
            local = member(path, file, "fclib_local")
            if local is not None:
                return _read_fclib(local)
            if "fclib_global" in file:
                raise InputError("fclib_global (bodies and contacts) is not read; only the local form is")
            return _read_rows(file)
    except InputError as error:
        told = str(error).removeprefix(f"{path}: ")
        raise InputError(f"{path}: {told}") from error
    except Exception as error:  # h5py and scipy raise anything at a damaged file
        raise InputError(f"{path}: malformed problem: {' '.join(str(error).split())}") from error


def _read_rows(file: h5py.File) -> FrictionProblem:
    rows, columns = (int(size) for size in _values(file, "W/shape", 2))
    q = _motion(file, "q", rows, columns)
    W = _compressed(sp.csr_matrix, file, "W/indptr", "W/indices", "W/data", (rows, columns))
    return FrictionProblem(W, q, _values(file, "mu"))


def _read_fclib(group: h5py.Group) -> FrictionProblem:
    dimension = int(_values(group, "spacedim", 1)[0])
    if dimension != 3:
        raise InputError(f"fclib_local/spacedim is {dimension}; only 3 is solved")
    if "V" in group or "R" in group:
        raise InputError("fclib_local has equality constraints (V, R, s); only problems without are solved")
    rows, columns, kind = (int(_values(group, f"W/{name}", 1)[0]) for name in ("m", "n", "nz"))
    q = _motion(group, "vectors/q", rows, columns)
    if kind >= 0:
        places, values = (
            (_values(group, "W/p", kind), _values(group, "W/i", kind)),
            _values(group, "W/x")[:kind],
        )
        W = sp.coo_matrix((values, places), shape=(rows, columns)).tocsr()
    elif kind in (-1, -2):
        form = sp.csc_matrix if kind == -1 else sp.csr_matrix
        W = _compressed(form, group, "W/p", "W/i", "W/x", (rows, columns)).tocsr()
    else:
        raise InputError(f"fclib_local/W/nz is {kind}; it must be -2, -1 or a number of triplets")
    return FrictionProblem(W, q, _values(group, "vectors/mu"))


def _motion(group: h5py.Group, name: str, rows: int, columns: int) -> Array:
    """q, of as many entries as W has rows and columns: so these are as many as the file can hold."""
    if rows != columns:
        raise InputError(f"W is {rows} x {columns}; as many rows as columns are needed")
    return _values(group, name, rows)


def _values(group: h5py.Group, name: str, size: int | None = None) -> Array:
    """The dataset as a flat array; of that size where given."""
    found = member(Path(group.file.filename), group, name)
    if not isinstance(found, h5py.Dataset):
        raise InputError(f"{group.name.rstrip('/')}/{name} is missing")
    values: Array = np.atleast_1d(found[()]).ravel()
    if values.dtype.kind not in "iuf":
        raise InputError(f"{group.name.rstrip('/')}/{name} must hold numbers")
    if size is not None and len(values) != size:
        raise InputError(f"{group.name.rstrip('/')}/{name} has {len(values)} entries; {size} are needed")
    return values


def _compressed(
    form: type, group: h5py.Group, start: str, index: str, value: str, shape: tuple[int, int]
) -> Any:
    """A compressed matrix whose arrays were checked, as scipy itself would read outside of them."""
    starts = _values(group, start, shape[1 if form is sp.csc_matrix else 0] + 1)
    entries = int(starts[-1])
    matrix = form((_values(group, value)[:entries], _values(group, index)[:entries], starts), shape=shape)
    matrix.check_format(full_check=True)
    return matrix


def write_solution(
    path: Path,
    source: Path,
    problem: FrictionProblem,
    r: Reals,
    states: Ints,
    info: Any,
    *,
    converged: bool,
    seconds: float,
    cpu_seconds: float,
) -> None:
    """Group `solution` as FCLIB names it (r, u), with mu, state (0 open, 1 stick, 2 slip) and the error's history; the
    problem's file, the error, the numbers of `info` and the seconds it took, on the wall and of the processor, as its
    attributes. Raises InputError where it cannot be written."""
    with h5py.File(
        path.name, "w", driver="core", backing_store=False
    ) as file:  # HDF5 does not survive a full disk
        group = file.create_group("solution")
        group["r"], group["u"] = r, problem.W @ r + problem.q
        group["mu"], group["state"], group["history"] = problem.mu, states, info.history
        group.attrs["problem"] = str(source.resolve())
        group.attrs["converged"] = converged
        group.attrs["seconds"], group.attrs["cpu_seconds"] = seconds, cpu_seconds
        for name in ("error", "iterations", "factorisations", "proximal_steps", "method"):
            group.attrs[name] = getattr(info, name)
        file.flush()
        image = file.id.get_file_image()
    replace(path, image)


def read_solution(path: Path) -> FrictionSolution:
    """That of `write_solution`. Raises InputError where there is none."""
    if not path.is_file():
        raise InputError(f"{path}: no such file")
    with intact(path), open_file(path) as file:
        group = member(path, file, "solution")
        told = group.attrs
        return FrictionSolution(
            _values(group, "r").reshape(-1, 3),
            _values(group, "state"),
            float(told["error"]),
            int(told["iterations"]),
            float(told["seconds"]),
            float(told["cpu_seconds"]),
        )
