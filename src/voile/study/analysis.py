"""What a study's runs tell: errors and what they are made of, the Pareto front, and what to choose."""

import math
from dataclasses import dataclass, field
from typing import Any

from voile.study.execute import CONVERGED, Record
from voile.study.plan import Plan, Run, changed
from voile.study.problems import Problem
from voile.study.schema import Known
from voile.study.series import (
    ENDS,
    MESH,
    REFINE,
    SIZED,
    TIME_STEP,
    Series,
    better,
    ends,
    find_series,
    rate_to,
)
from voile.study.settings import (
    DISCRETE,
    ITERATION,
    MODEL,
    NORMALS,
    SMOOTH,
    TIME,
    Settings,
    changes,
    different,
    told,
)

# As slow as another run, as far as clocks tell: within this factor, and s that starting a program takes more or less.
ALIKE, SCATTER = 1.25, 0.25
LIMIT = "extrapolated"
SAME = 1e-9  # of an error: another run's is the same
FAR = 1.5  # of a value's last change: limits further off are guesses; at first order they are once as far


@dataclass
class Row:
    """A run and its record; the error of each measure over the reference's size (absolute for 0) and the largest of
    them, None without; trusted: the largest of its own and of runs resolved better, as what grows then was small by
    chance; the seconds that count; parts of errors by what they come from; what the run changes of the reference."""

    run: Run
    record: Record
    errors: dict[str, float] = field(default_factory=dict)
    error: float | None = None
    trusted: float | None = None
    seconds: float | None = None
    parts: dict[str, dict[str, float]] = field(default_factory=dict)
    changes: dict[str, list[str]] = field(default_factory=dict)
    front: bool = False

    @property
    def counted(self) -> float | None:
        """The error that front and choice go by."""
        return None if self.error is None else max(self.error, self.trusted or 0.0)


@dataclass
class Choice:
    """What to choose for an accuracy: the row, and what another value of each of its settings costs instead."""

    accuracy: float
    row: Row | None
    others: list[tuple[str, object, Row]] = field(default_factory=list)


@dataclass
class Findings:
    """All that a study found; references by measure, of which of them the limit is a guess, and series of other models
    or methods whose limits are none."""

    plan: Plan
    rows: list[Row]
    references: dict[str, float]
    guesses: list[str]
    surer: list[Series]
    about: str
    series: list[Series]
    front: list[Row]
    choices: list[Choice]

    @property
    def varied(self) -> list[str]:
        """Settings that differ between runs that have an error."""
        runs = [row.run.effective for row in self.rows if row.error is not None]
        return [n for n in self.plan.varied if len({repr(settings[n]) for settings in runs}) > 1]

    def rate(self, series: Series) -> float | None:
        """Rate at which a series comes nearer to the reference."""
        reference = self.references.get(series.measure)
        return None if reference is None else rate_to(reference, series.sizes, series.values)


def analyse(plan: Plan, records: list[Record]) -> Findings:
    """The findings of a plan's records."""
    cpu = plan.study.study.clock == "cpu"
    rows = [
        Row(run, record, seconds=record.cpu_seconds if cpu else record.seconds)
        for run, record in zip(plan.runs, records, strict=True)
    ]
    names = [m.name for m in plan.measures]
    series = [s for name in names for s in find_series(plan.runs, records, name)]
    origin = _origin(plan, records)
    references, about = {}, ""
    for name in names:
        found = _reference(plan, records, series, name, origin)
        if found:
            references[name], about = found
    last = ends(plan.runs, records)
    for k, row in enumerate(rows):
        row.changes = changed(row.run, plan.runs[origin])
        if not set(row.changes.get(MODEL, [])) - {NORMALS}:
            _tell_by_limits(row.changes, _same_limits(plan, records, series, k, origin))
        if k != plan.reference and row.record.status == CONVERGED:
            _measure(k, row, rows, references, series, last)
    for k, others in better(plan.runs, records).items():
        errors = [error for j in (k, *others) if (error := rows[j].error) is not None]
        rows[k].trusted = max(errors) if rows[k].error is not None else None
    solved = isinstance(plan.runs[origin].scene, Problem)  # only the solver's own seconds count
    scatter = 0.0 if solved else SCATTER
    front = _front(rows, scatter)
    for row in front:
        row.front = True
    choices = [_choice(accuracy, rows, front) for accuracy in plan.study.study.accuracy]
    asked = min(plan.study.study.accuracy) if about.startswith(LIMIT) else math.inf
    poor = [s for name in references for s in _limits(series, name, origin) if _far(s, asked)]
    guesses = [name for name in references if any(s.measure == name for s in poor)]
    surer = [s for s in series if any(_beside(s, other) for other in poor) and not _far(s, asked)]
    return Findings(plan, rows, references, guesses, surer, about, series, front, choices)


def _origin(plan: Plan, records: list[Record]) -> int:
    """The run that variants are told from: the reference's, else the best discretised and iterated one of the first
    model that converged."""
    if plan.reference is not None:
        return plan.reference
    first = {name: repr(values[0]) for name, values in plan.study.vary.items() if name not in (*SIZED, *ENDS)}
    first = {name: value for name, value in first.items() if changes(name) in (MODEL, DISCRETE, ITERATION)}

    def rank(k: int) -> tuple[Any, ...]:
        now = plan.runs[k].effective
        others = sum(repr(now[name]) != value for name, value in first.items())
        fine = [-float(now.get(REFINE) or 0), float(now.get(TIME_STEP) or 0)]
        fine += [
            float(v) * (-1 if largest else 1) for n, largest in ENDS.items() if (v := now.get(n)) is not None
        ]
        return records[k].status != CONVERGED, others, fine, -(records[k].dofs or 0)

    return min(range(len(plan.runs)), key=rank)


def _reference(
    plan: Plan, records: list[Record], series: list[Series], name: str, origin: int
) -> tuple[float, str] | None:
    """The reference value of a measure, and what it is; None where there is none."""
    spec = plan.study.study.reference
    if isinstance(spec, Known):
        known = spec.of(name)
        return None if known is None else (known, "given")
    value = records[origin].values.get(name)
    if value is None:
        return None
    if plan.reference is not None:
        return value, f"the run {told(plan.runs[origin].settings)}"
    limit, along = _limit(records, series, name, origin)
    if limit is None:
        return None
    return limit, f"{LIMIT} over {' and '.join(along)} from {plan.runs[origin].name}"


def _limits(series: list[Series], name: str, origin: int) -> list[Series]:
    """The series of a measure with a limit that a run belongs to."""
    return [s for s in series if s.measure == name and origin in s.members and s.limit is not None]


def _limit(records: list[Record], series: list[Series], name: str, k: int) -> tuple[float | None, list[str]]:
    """What a measure of a run goes to, and along what; None where nothing tells."""
    limits, value = _limits(series, name, k), records[k].values.get(name)
    if value is None or not limits:
        return None, []
    return value + sum((s.limit or 0.0) - value for s in limits), [s.along for s in limits]


def _same_limits(
    plan: Plan, records: list[Record], series: list[Series], one: int, other: int
) -> bool | None:
    """Whether two runs go to the same values on finer meshes, as far as the study asks; None where nothing tells."""
    asked, same = min(plan.study.study.accuracy), True
    for measure in plan.measures:
        (a, along), (b, _) = (_limit(records, series, measure.name, k) for k in (one, other))
        if a is None or b is None or not {REFINE, MESH} & set(along):
            return None
        same &= abs(a - b) <= asked * abs(b)
    return same


def _tell_by_limits(changes: dict[str, list[str]], same: bool | None) -> None:
    """Moves what is a discretisation on some meshes and a model on others to where limits, if any, show it to be."""
    if same is None:
        return
    name, of, to = (NORMALS, MODEL, DISCRETE) if same else (SMOOTH, DISCRETE, MODEL)
    if name in changes.get(of, []):
        changes.setdefault(to, []).append(name)
        changes[of].remove(name)
        if not changes[of]:
            del changes[of]


def _far(s: Series, asked: float) -> bool:
    """Whether the limit of a series lies much further off than the value changed last, and than what is asked for."""
    limit = s.limit or 0.0
    return abs(limit - s.values[-1]) > max(FAR * abs(s.values[-1] - s.values[-2]), asked * abs(limit))


def _beside(s: Series, other: Series) -> bool:
    """Whether a series has a limit and differs from another one in one setting alone that has no order."""
    apart = different(s.settings, other.settings)
    alike = s.measure == other.measure and s.along == other.along and s.limit is not None
    return alike and len(apart) == 1 and apart[0] not in (*SIZED, *ENDS)


def _measure(
    k: int,
    row: Row,
    rows: list[Row],
    references: dict[str, float],
    series: list[Series],
    last: dict[int, int],
) -> None:
    """Errors of a row, and their parts: from its series' limits, from the run that iterates furthest, and the rest."""
    for name, reference in references.items():
        value = row.record.values.get(name)
        if value is None:
            continue
        scale = abs(reference) or 1.0
        row.errors[name] = abs(value - reference) / scale
        parts: dict[str, float] = {}
        for s in series:
            if s.measure == name and k in s.members:
                limit = s.limit if s.limit is not None else s.values[-1]
                if s.limit is not None or k != s.members[-1]:
                    kind = TIME if s.along == TIME_STEP else DISCRETE
                    parts[kind] = value - limit
        if k in last:
            parts[ITERATION] = value - (rows[last[k]].record.values.get(name) or value)
        if parts:
            parts[MODEL] = value - sum(parts.values()) - reference
        row.parts[name] = {kind: abs(part) / scale for kind, part in parts.items()}
    if len(row.errors) == len(references) > 0:
        row.error = max(row.errors.values())


def _rated(rows: list[Row]) -> list[tuple[Row, float, float]]:
    """Rows with an error, the one that counts and their seconds."""
    return [(r, e, r.seconds) for r in rows if (e := r.counted) is not None and r.seconds is not None]


def _alike(seconds: float, others: float, scatter: float) -> bool:
    """Whether seconds are not clearly more than others."""
    return seconds <= ALIKE * others + scatter


def _front(rows: list[Row], scatter: float) -> list[Row]:
    """The most exact of the fastest rows (alike counts as as fast), then that of those more exact, and so on. Of rows
    as exact the study's first."""
    left, front = _rated(rows), list[Row]()
    while left:
        fastest = min(seconds for _, _, seconds in left)
        alike = [(row, error) for row, error, seconds in left if _alike(seconds, fastest, scatter)]
        least = min(error for _, error in alike)
        front.append(next(row for row, error in alike if error <= least * (1.0 + SAME)))
        left = [rated for rated in left if rated[1] < least * (1.0 - SAME)]
    return front


def _choice(accuracy: float, rows: list[Row], front: list[Row]) -> Choice:
    """The fastest row of the front that meets an accuracy, not by chance, and its neighbours in one setting."""
    chosen = next((row for row in front if (row.counted or 0.0) <= accuracy), None)
    if chosen is None:
        return Choice(accuracy, None)
    others = []
    for name in chosen.run.effective:
        for row, _, _ in _rated(rows):
            if _only(name, row.run.effective, chosen.run.effective):
                others.append((name, row.run.effective[name], row))
    return Choice(accuracy, chosen, others)


def _only(name: str, one: Settings, other: Settings) -> bool:
    """Whether settings differ in this one alone."""
    return different(one, other) == [name]
