"""A study's findings as files and as text."""

import csv
import io
import json
from pathlib import Path
from typing import Any

from voile.files import replace
from voile.scene import Scene
from voile.study.analysis import Choice, Findings, Row
from voile.study.execute import CONVERGED, Runs
from voile.study.measures import keeps_facets
from voile.study.schema import EXTRAPOLATE, Known
from voile.study.series import Series
from voile.study.settings import DISCRETE, ITERATION, MODEL, TIME, plain, told

PARTS = (MODEL, DISCRETE, TIME, ITERATION)
DIGITS = 9  # of values in the table, and decimals of errors over the reference: what residuals leave of them


def write_files(findings: Findings, runs: Runs) -> list[Path]:
    """study.csv, study.json and study.png in the study's folder."""
    from voile.study.picture import draw

    files = [runs.out / name for name in ("study.csv", "study.json", "study.png")]
    replace(files[0], _csv(findings, runs).encode())
    figures = json.dumps(_plain(findings, runs), indent=2, allow_nan=False) + "\n"
    replace(files[1], figures.encode())
    draw(findings, files[2])
    return files


def header(findings: Findings) -> list[str]:
    """Columns of the table."""
    names = list(findings.plan.measures)
    kinds = [k for k in PARTS if any(k in p for row in findings.rows for p in row.parts.values())]
    columns = ["run", "status", "changes", *findings.rows[0].run.effective]
    columns += [m.name for m in names] + [f"error {m.name}" for m in names]
    columns += [f"{kind} error {m.name}" for m in names for kind in kinds]
    columns += ["error", "trusted error", "front", "seconds", "wall_seconds", "cpu_seconds", "repeats"]
    return [*columns, "memory_mib", "iterations", "dofs", "folder", "reason"]


def _csv(findings: Findings, runs: Runs) -> str:
    text = io.StringIO()
    table = csv.DictWriter(text, header(findings), lineterminator="\n")
    table.writeheader()
    table.writerows(_cells(findings, row, runs) for row in findings.rows)
    return text.getvalue()


def _cells(findings: Findings, row: Row, runs: Runs) -> dict[str, Any]:
    """A row of the table by column; empty where there is nothing."""
    record = row.record
    cells: dict[str, Any] = {
        "run": row.run.name,
        "status": record.status,
        "changes": what_changes(findings, row),
        "error": _error(row.error, *findings.references.values()),
        "trusted error": _error(row.counted, *findings.references.values()),
        "front": "yes" if row.front else "",
        "seconds": _number(row.seconds, 4),
        "wall_seconds": _number(record.seconds, 4),
        "repeats": record.repeats or "",
        "cpu_seconds": _number(record.cpu_seconds, 4),
        "memory_mib": _number(record.memory_mib, 4),
        "iterations": "" if record.iterations is None else record.iterations,
        "dofs": "" if record.dofs is None else record.dofs,
        "folder": str(runs.folder(row.run).relative_to(runs.out)) if row.run.scene else "",
        "reason": record.reason,
    }
    cells |= _jsonable(row.run.effective)
    for m in findings.plan.measures:
        cells[m.name] = _number(record.values.get(m.name))
        reference = findings.references.get(m.name, 0.0)
        cells[f"error {m.name}"] = _error(row.errors.get(m.name), reference)
        for kind, part in row.parts.get(m.name, {}).items():
            cells[f"{kind} error {m.name}"] = _error(part, reference)
    return cells


def _error(error: float | None, *references: float) -> str:
    """An error over its reference; over none (0) it has digits like a value."""
    return _number(round(error, DIGITS) if error is not None and all(references) else error)


def _number(value: float | None, digits: int = DIGITS) -> str:
    return "" if value is None else f"{value:.{digits}g}"


def what_changes(findings: Findings, row: Row) -> str:
    """What a run changes of the one that the reference is of, by kind of change."""
    if findings.plan.reference is not None and row.run is findings.plan.runs[findings.plan.reference]:
        return "the reference"
    return "; ".join(f"{kind}: {', '.join(names)}" for kind, names in row.changes.items())


def _plain(findings: Findings, runs: Runs) -> dict[str, Any]:
    """What study.json holds."""
    plan, spec = findings.plan, findings.plan.study.study.reference
    kind = "value" if isinstance(spec, Known) else EXTRAPOLATE if spec == EXTRAPOLATE else "run"
    return {
        "study": str(plan.path),
        "scene": str(plan.scene),
        "measures": [m.name for m in plan.measures],
        "reference": {
            "kind": kind,
            "values": findings.references,
            "about": findings.about,
            "guesses": findings.guesses,
            "surer": [_rates(findings, s) for s in findings.surer],
        },
        "rates": [_rates(findings, s) for s in findings.series],
        "pareto": [_brief(row, runs) for row in findings.front],
        "recommended": [_recommended(choice, runs) for choice in findings.choices],
        "runs": [_brief(row, runs) | _more(findings, row) for row in findings.rows],
    }


def _settings(row: Row) -> dict[str, Any]:
    return _jsonable(row.run.effective)


def _jsonable(settings: dict[str, Any]) -> dict[str, Any]:
    return {name: plain(value) for name, value in settings.items()}


def _rates(findings: Findings, s: Series) -> dict[str, Any]:
    return {
        "measure": s.measure,
        "along": s.along,
        "settings": _jsonable(s.settings),
        "sizes": s.sizes,
        "values": s.values,
        "rate": s.rate,
        "extrapolated": s.limit,
        "rate_to_reference": findings.rate(s),
    }


def _brief(row: Row, runs: Runs) -> dict[str, Any]:
    return {
        "run": row.run.name,
        "settings": _settings(row),
        "error": row.error,
        "seconds": row.seconds,
        "memory_mib": row.record.memory_mib,
        "folder": str(runs.folder(row.run).relative_to(runs.out)) if row.run.scene else None,
    }


def _more(findings: Findings, row: Row) -> dict[str, Any]:
    return {
        "status": row.record.status,
        "reason": row.record.reason,
        "values": row.record.values,
        "errors": row.errors,
        "trusted_error": row.counted,
        "parts": row.parts,
        "changes": row.changes,
        "changes_text": what_changes(findings, row),
        "iterations": row.record.iterations,
        "dofs": row.record.dofs,
        "wall_seconds": row.record.seconds,
        "cpu_seconds": row.record.cpu_seconds,
        "repeats": row.record.repeats,
    }


def _recommended(choice: Choice, runs: Runs) -> dict[str, Any]:
    if choice.row is None:
        return {"accuracy": choice.accuracy, "run": None}
    return {
        "accuracy": choice.accuracy,
        **_brief(choice.row, runs),
        "instead": [
            {
                "setting": name,
                "value": plain(value),
                "run": row.run.name,
                "error": row.error,
                "seconds": row.seconds,
            }
            for name, value, row in choice.others
        ],
    }


# ---- text ----


def text(findings: Findings) -> str:
    """The table, rates and recommendations for a terminal."""
    return "\n".join([*_table(findings), "", *_rate_lines(findings), *_advice(findings)])


def _table(findings: Findings) -> list[str]:
    names = [m.name for m in findings.plan.measures]
    lines = [["run", *names, "error", "s", "MiB", "", "changes"]]
    for row in findings.rows:
        record = row.record
        said = (
            what_changes(findings, row) if record.status == CONVERGED else f"{record.status}: {record.reason}"
        )
        lines.append(
            [
                row.run.name,
                *(_number(record.values.get(n), 6) for n in names),
                "" if row.error is None else f"{row.error:.2e}",
                "" if row.seconds is None else f"{row.seconds:.2f}",
                "" if record.memory_mib is None else f"{record.memory_mib:.0f}",
                "*" if row.front else "",
                said,
            ]
        )
    widths = [max(len(line[k]) for line in lines) for k in range(len(lines[0]) - 1)] + [0]
    rows = [
        "  ".join(f"{cell:<{w}}" for cell, w in zip(line, widths, strict=True)).rstrip() for line in lines
    ]
    values = ", ".join(f"{n} {v:.8g}" for n, v in findings.references.items())
    below = [f"* on the front; reference: {values} ({findings.about})"] if values else []
    if left := [n for n in names if n not in findings.references]:
        below.append(f"no reference of {', '.join(left)}: no error counts it")
    if findings.guesses:
        below.append(
            f"the reference of {', '.join(findings.guesses)} is a guess, further off than the value changed last: "
            "finer runs tell more"
        )
    below += [
        f"{s.measure} of {told(_own(findings, s))} goes to {s.limit:.8g}, no guess: "
        "first in its list it is the reference"
        for s in findings.surer
    ]
    return [*rows, *below, *_facets(findings)]


def _facets(findings: Findings) -> list[str]:
    """A line where runs refine a curved mesh and keep its facets."""
    scenes = [row.run.scene for row in findings.rows if "refine" in findings.plan.varied]
    refined = [s for s in scenes if isinstance(s, Scene) and s.shell.refine and not s.shell.refine_smooth]
    if not refined or not keeps_facets(refined[0]):
        return []
    return [
        "refine keeps the facets of a curved mesh, and limits are theirs; shell.refine_smooth = true rounds them"
    ]


def _rate_lines(findings: Findings) -> list[str]:
    lines = []
    for s in findings.series:
        rate = findings.rate(s)
        own = (
            f"rate {s.rate:.2f}, limit {s.limit:.8g}"
            if s.rate and s.limit is not None
            else "no rate of its own"
        )
        to = "" if rate is None else f"; {rate:.2f} to the reference"
        of = _own(findings, s)
        lines.append(f"{s.measure} over {s.along}{f' ({told(of)})' if of else ''}: {own}{to}")
    return lines


def _own(findings: Findings, s: Series) -> dict[str, Any]:
    """What a series does not share with all others."""
    return {n: v for n, v in _jsonable(s.settings).items() if n in findings.plan.varied and v is not None}


def _advice(findings: Findings) -> list[str]:
    lines, guess = [], " over a guess" if findings.guesses else ""
    for choices in _by_row(findings.choices):
        row, accuracies = choices[0].row, ", ".join(f"{choice.accuracy:g}" for choice in choices) + guess
        if row is None:
            lines.append(f"error {accuracies}: no run reaches it")
            continue
        seconds = row.seconds or 0.0
        lines.append(f"error {accuracies}: {row.run.name} ({row.error:.1e} in {seconds:.2f} s)")
        for name, value, other in choices[0].others:
            ratio = (other.seconds or 0.0) / max(seconds, 1e-9)
            lines.append(
                f"    {told({name: plain(value)})} instead: error {other.error:.1e}, {ratio:.2g} times the seconds"
            )
    return lines


def _by_row(choices: list[Choice]) -> list[list[Choice]]:
    """Choices that chose the same row together."""
    found: dict[int, list[Choice]] = {}
    for choice in choices:
        found.setdefault(id(choice.row), []).append(choice)
    return list(found.values())
