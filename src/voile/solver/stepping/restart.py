"""What a path in time goes on from, as arrays by name."""

from dataclasses import fields
from typing import Any

import numpy as np

from voile.arrays import Array
from voile.contact.candidates import Candidates
from voile.contact.history import PER_PARTNER, History
from voile.problem.problem import Problem
from voile.solver.stepping.books import TOTALS, Books
from voile.solver.stepping.schemes import Before, Kinematics
from voile.solver.stepping.time_path import TimePath

FIELDS = ("positions", "velocity", "acceleration", "filtered")
COUNTS = ("factorisations", "solves", "iterations")


def packed(problem: Problem, path: TimePath) -> dict[str, Array]:
    """This rank's arrays of a path."""
    k, contact = path.kinematics, problem.contact
    y = path.state.copy()
    y.axpy(1.0, problem.layout.origin)
    found = {name: getattr(k, name) for name in FIELDS}
    found |= {"y": y.array_r.copy(), "pushed": path.pushed}
    if k.before:
        found |= {"before.positions": k.before.positions, "before.velocity": k.before.velocity}
        found["before.step"] = np.array(k.before.step)
    found["scalars"] = np.array([path.time, path.length, path.largest, path.books.error, path.books.most])
    found["totals"] = np.array([path.books.totals[name] for name in TOTALS])
    found["counts"] = np.array([*(getattr(path.counts, name) for name in COUNTS), path.attempts])
    found["methods"] = np.frombuffer("\n".join(path.methods).encode(), dtype=np.uint8)
    if contact:
        history = contact.history
        for name in PER_PARTNER:
            found |= {f"contact.{name}.{k}": part for k, part in enumerate(getattr(history, name))}
        found |= {"contact.reference": history.reference, "contact.layers": history.layers}
        found["contact.time"] = np.array(history.time)
        found |= {f"candidates.{f.name}": getattr(history.candidates, f.name) for f in fields(Candidates)}
    return found


def unpacked(problem: Problem, found: dict[str, Array]) -> TimePath:
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
    path.methods = found["methods"].tobytes().decode().split("\n") if len(found["methods"]) else []
    *counts, path.attempts = found["counts"].tolist()
    for name, value in zip(COUNTS, counts, strict=True):
        setattr(path.counts, name, value)
    contact = problem.contact
    if contact:
        parts: dict[str, Any] = {
            name: [found[f"contact.{name}.{k}"] for k in range(len(contact.partners))] for name in PER_PARTNER
        }
        near: dict[str, Any] = {f.name: found[f"candidates.{f.name}"] for f in fields(Candidates)}
        near["faces"] = int(near["faces"])
        contact.history = History(
            **parts,
            reference=found["contact.reference"],
            time=float(found["contact.time"]),
            candidates=Candidates(**near),
            layers=found["contact.layers"],
        )
    return path
