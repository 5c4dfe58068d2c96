"""Runs that differ in one setting that has a size: observed rates and limits (Richardson's extrapolation)."""

import math
from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq

from voile.study.execute import CONVERGED, Record
from voile.study.plan import Run
from voile.study.problems import TOLERANCE
from voile.study.settings import Settings

MESH, REFINE, TIME_STEP = "shell.mesh", "refine", "dynamics.time_step"
SIZED = (REFINE, MESH, TIME_STEP)
# Settings that end iterations, and whether the exact end is the largest value.
ENDS = {
    "dynamics.tolerance": False,
    "statics.tolerance": False,
    "inverse.tolerance": False,
    TOLERANCE: False,
    "dynamics.iterations": True,
    "inverse.iterations": True,
}
RATES = (
    0.1,
    8.0,
)  # that are looked for; differences that fit none have not come to their limit's neighbourhood
NEAR = 1e-9  # of the value: differences within what residuals leave of it, as in the table


@dataclass(frozen=True)
class Series:
    """Converged runs that differ in the setting `along` only, coarsest first: their numbers, sizes and values of a
    measure; the limit and rate that the finest three tell, None where they tell none."""

    along: str
    settings: Settings
    measure: str
    members: tuple[int, ...]
    sizes: tuple[float, ...]
    values: tuple[float, ...]
    limit: float | None
    rate: float | None


def extrapolate(sizes: tuple[float, ...], values: tuple[float, ...]) -> tuple[float | None, float | None]:
    """Limit and rate p of values v = limit + c size^p, from the last three; None, None where they fit none."""
    if len(values) < 3:
        return None, None
    (h1, h2, h3), (v1, v2, v3) = sizes[-3:], values[-3:]
    if abs(v2 - v3) <= NEAR * abs(v3):
        return v3, None
    ratio = (v1 - v2) / (v2 - v3)

    def off(p: float) -> float:
        return float((h1**p - h2**p) / (h2**p - h3**p) - ratio)

    if not (h1 > h2 > h3 and math.isfinite(ratio) and off(RATES[0]) * off(RATES[1]) < 0.0):
        return None, None
    p = float(brentq(off, *RATES, xtol=1e-12))
    return v3 - (v2 - v3) * h3**p / (h2**p - h3**p), p


def size(along: str, run: Run, record: Record) -> float:
    """What an error shrinks with: time step, edges' length over the coarsest mesh's, or as the unknowns tell it."""
    if along == TIME_STEP:
        return float(run.effective[along])
    return float(2.0 ** -run.effective[along] if along == REFINE else (record.dofs or 1) ** -0.5)


def siblings(runs: tuple[Run, ...], records: list[Record], along: str) -> list[list[int]]:
    """Groups of converged runs that differ in one setting only."""
    groups: dict[str, list[int]] = {}
    for k, (run, record) in enumerate(zip(runs, records, strict=True)):
        if record.status == CONVERGED and run.effective.get(along) is not None:
            others = {n: v for n, v in run.effective.items() if n != along}
            groups.setdefault(repr(others), []).append(k)
    return [group for group in groups.values() if len(group) > 1]


def find_series(runs: tuple[Run, ...], records: list[Record], measure: str) -> list[Series]:
    """All series of a measure, of two runs or more."""
    found = []
    for along in SIZED:
        for group in siblings(runs, records, along):
            group = [k for k in group if records[k].values.get(measure) is not None]
            order = sorted(group, key=lambda k: -size(along, runs[k], records[k]))
            if len(order) < 2:
                continue
            sizes = tuple(size(along, runs[k], records[k]) for k in order)
            values = tuple(float(records[k].values[measure]) for k in order)  # type: ignore[arg-type]
            settings = {n: v for n, v in runs[order[0]].effective.items() if n != along}
            found.append(
                Series(along, settings, measure, tuple(order), sizes, values, *extrapolate(sizes, values))
            )
    return found


def ends(runs: tuple[Run, ...], records: list[Record]) -> dict[int, int]:
    """Run -> the one that iterates furthest among those that differ in where iterations end."""
    found: dict[int, int] = {}
    for along, largest in ENDS.items():
        for group in siblings(runs, records, along):
            order = sorted(group, key=lambda k: float(runs[k].effective[along]))
            best = order[-1 if largest else 0]
            found |= {k: best for k in group if k not in found}
    return found


def better(runs: tuple[Run, ...], records: list[Record]) -> dict[int, set[int]]:
    """Run -> those that differ in one setting only and are discretised finer or iterate further by it."""
    found: dict[int, set[int]] = {}
    for along in (*SIZED, *ENDS):
        for group in siblings(runs, records, along):
            grade = {
                k: -float(runs[k].effective[along]) * (-1.0 if ENDS[along] else 1.0)
                if along in ENDS
                else -size(along, runs[k], records[k])
                for k in group
            }
            for k in group:
                found.setdefault(k, set()).update(other for other in group if grade[other] > grade[k])
    return found


def rate_to(reference: float, sizes: tuple[float, ...], values: tuple[float, ...]) -> float | None:
    """Rate at which the last two values come nearer to a reference; None where one is there."""
    errors = np.abs(np.array(values[-2:]) - reference)
    if errors.min() <= NEAR * abs(reference):
        return None
    return float(np.log(errors[0] / errors[1]) / np.log(sizes[-2] / sizes[-1]))
