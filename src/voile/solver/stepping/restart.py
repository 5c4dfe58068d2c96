"""What paths in time and of the load go on from, as arrays by name."""

import json
from dataclasses import asdict, fields
from typing import Any

import numpy as np

from voile.arrays import Ints
from voile.contact.candidates import Candidates
from voile.contact.history import PER_PARTNER, History
from voile.problem.problem import Problem
from voile.problem.state import State
from voile.problem.support_forces import Supporting
from voile.solver.path import Arrays, Jump, LoadStep, Path
from voile.solver.path_in_time import TimePath, TimeStep
from voile.solver.stepping.books import TOTALS, Books
from voile.solver.stepping.schemes import Before, Kinematics

FIELDS = ("positions", "velocity", "acceleration", "filtered")
COUNTS = ("factorisations", "solves", "iterations", "krylov")


def packed(problem: Problem, path: TimePath) -> Arrays:
    """This rank's arrays of a path."""
    k, contact = path.kinematics, problem.contact
    y = path.state.copy()
    y.axpy(1.0, problem.layout.origin)
    found = {name: getattr(k, name) for name in FIELDS}
    found |= {"y": y.array_r.copy(), "pushed": path.pushed, "sides": problem.elastic.sides}
    found["coupled"] = problem.assembly.coupled
    if k.before:
        found |= {"before.positions": k.before.positions, "before.velocity": k.before.velocity}
        found["before.step"] = np.array(k.before.step)
    if path.supporting:
        found |= {f"supports.{name}": values for name, values in vars(path.supporting).items()}
    found["scalars"] = np.array([path.time, path.length, path.largest, path.books.error, path.books.most])
    found["totals"] = np.array([path.books.totals[name] for name in TOTALS])
    found["counts"] = np.array([*(getattr(path.counts, name) for name in COUNTS), path.attempts])
    found["methods"] = np.frombuffer("\n".join(path.methods).encode(), dtype=np.uint8)
    found["said"] = _said(last=path.last and asdict(path.last), short=path.short, worst=path.worst)
    return found | (packed_history(contact.history) if contact else {})


def packed_history(history: History) -> Arrays:
    """What contact remembers."""
    found: Arrays = {}
    for name in PER_PARTNER:
        found |= {f"contact.{name}.{k}": part for k, part in enumerate(getattr(history, name))}
    found |= {"contact.reference": history.reference, "contact.layers": history.layers}
    found["contact.time"] = np.array(history.time)
    return found | {
        f"candidates.{f.name}": np.asarray(getattr(history.candidates, f.name)) for f in fields(Candidates)
    }


def unpacked_history(found: Arrays, partners: int) -> History:
    """That of `packed_history`."""
    parts: dict[str, Any] = {
        name: [found[f"contact.{name}.{k}"] for k in range(partners)] for name in PER_PARTNER
    }
    near: dict[str, Any] = {f.name: found[f"candidates.{f.name}"] for f in fields(Candidates)}
    near["faces"] = int(near["faces"])
    return History(
        **parts,
        reference=found["contact.reference"],
        time=float(found["contact.time"]),
        candidates=Candidates(**near),
        layers=found["contact.layers"],
    )


def packed_state(problem: Problem, state: State) -> Arrays:
    """A state's arrays; displacements count from the start shape."""
    y = state.unknowns.array_r + state.origin.array_r
    return {"y": y, "coupled": problem.assembly.coupled} | (
        packed_history(state.history) if state.history else {}
    )


def unpacked_state(problem: Problem, found: Arrays, time: float) -> State:
    """That of `packed_state`, at a time."""
    y, contact = problem.create_vector(), problem.contact
    y.array[:] = found["y"]
    problem.assembly.coupled = found["coupled"]
    history = unpacked_history(found, len(contact.partners)) if contact else None
    return State(y, problem.create_vector(), history, time)


def packed_path(path: Path, **more: Any) -> Arrays:
    """A load path without its state; more: what else is said of it (plain values)."""
    said = {
        "steps": [asdict(step) for step in path.steps],
        "jumps": [asdict(jump) for jump in path.jumps],
        "counts": [getattr(path.counts, name) for name in COUNTS],
        "attempts": path.attempts,
        "stable": path.stable,
        "smallest_eigenvalue": path.smallest_eigenvalue,
        **more,
    }
    return {"said": _said(**said)}


def unpacked_path(found: Arrays, path: Path) -> dict[str, Any]:
    """Fills a path that has begun with that of `packed_path`; what was said of it."""
    said: dict[str, Any] = json.loads(found["said"].tobytes())
    path.steps = [LoadStep(**step) for step in said["steps"]]
    path.jumps = [Jump(**jump) for jump in said["jumps"]]
    path.attempts, path.stable = said["attempts"], said["stable"]
    path.smallest_eigenvalue = said["smallest_eigenvalue"]
    for name, value in zip(COUNTS, said["counts"], strict=True):
        setattr(path.counts, name, value)
    return said


def _said(**values: Any) -> Ints:
    """Plain values as the bytes of their JSON."""
    return np.frombuffer(json.dumps(values, default=_plain).encode(), dtype=np.uint8)


def _plain(value: Any) -> Any:
    """NumPy's arrays and numbers as JSON has them."""
    return value.tolist()


def unpacked(problem: Problem, found: Arrays) -> TimePath:
    """The path of this rank's arrays; also what the problem's contact remembers."""
    y = problem.create_vector()
    y.array[:] = found["y"]
    before = None
    if "before.step" in found:
        before = Before(found["before.positions"], found["before.velocity"], float(found["before.step"]))
    books = Books(problem, dict(zip(TOTALS, found["totals"].tolist(), strict=True)))
    known: dict[str, Any] = {name: found[name] for name in FIELDS}
    path = TimePath(y, Kinematics(**known, before=before), books)
    path.time, path.length, path.largest, books.error, books.most = found["scalars"].tolist()
    path.pushed = found["pushed"]
    if "supports.forces" in found:
        path.supporting = Supporting(*(found[f"supports.{f.name}"] for f in fields(Supporting)))
    problem.elastic.take_sides(found["sides"])
    problem.assembly.coupled = found["coupled"]
    path.methods = found["methods"].tobytes().decode().split("\n") if len(found["methods"]) else []
    said = json.loads(found["said"].tobytes())
    path.last = said["last"] and TimeStep(**said["last"])
    path.short, path.worst = said["short"], said["worst"]
    *counts, path.attempts = found["counts"].tolist()
    for name, value in zip(COUNTS, counts, strict=True):
        setattr(path.counts, name, value)
    if problem.contact:
        problem.contact.history = unpacked_history(found, len(problem.contact.partners))
    return path
