"""Discrete friction problems (`voile friction`) in place of scenes: what of them varies, what is measured."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from voile.errors import InputError
from voile.keys import File, Number, Table, key
from voile.results.friction import read_problem, read_solution

TOLERANCE = "tolerance"
SOLUTION = "solution.h5"  # in a run's folder
STATES = ("open", "stick", "slip")
FIGURES = ("normal_force", "friction_force", *STATES, "error", "newton_iterations")


@dataclass(frozen=True, kw_only=True)
class Problem:
    """A friction problem and what it is solved with."""

    file: Path = key(File(), "friction problem")
    tolerance: float = key(Number(above=0), "error of the natural map", default=1e-8)


KEYS = {TOLERANCE: Table(Problem).keys[TOLERANCE]}


def is_problem(path: Path) -> bool:
    """Whether a file is a friction problem, not a scene."""
    return path.is_file() and bool(h5py.is_hdf5(path))


def find_problem(path: Path, settings: dict[str, Any]) -> Problem:
    """The problem of a file with a study's settings. Raises InputError."""
    read_problem(path)
    for name in settings:
        if name not in KEYS:
            raise InputError(f"{path}: a friction problem has no {name}; allowed: {', '.join(KEYS)}")
    return Problem(file=path, **settings)


def command(problem: Problem, folder: Path) -> list[str]:
    """The arguments of `voile` that solve a problem into a folder."""
    words = ["friction", problem.file.resolve(), "-o", folder.resolve() / SOLUTION]
    return [*map(str, words), "--tolerance", repr(problem.tolerance)]


def figures(folder: Path) -> dict[str, Any]:
    """What a summary would tell of the solution in a folder: FIGURES, of forces the sums over all contacts, and what it
    cost. Raises InputError where there is none."""
    solution = read_solution(folder / SOLUTION)
    return {
        "normal_force": float(solution.r[:, 0].sum()),
        "friction_force": float(np.linalg.norm(solution.r[:, 1:], axis=1).sum()),
        **{name: int((solution.state == k).sum()) for k, name in enumerate(STATES)},
        "error": solution.error,
        "newton_iterations": solution.iterations,
        "dofs": solution.r.size,
        "wall_time_s": {"total": solution.seconds},
        "cpu_seconds": solution.cpu_seconds,
    }
