"""What parts of a search keep in its journal: paths of the direct method, points beside the target, iterates."""

from __future__ import annotations

from dataclasses import asdict
from typing import Protocol

import numpy as np
from petsc4py import PETSc

from voile.arrays import Array
from voile.inverse.direct import DirectPath, DirectStep
from voile.inverse.journal import BULKY, columns, heard, said
from voile.inverse.nearest_path import NearestStep
from voile.inverse.neighbours import Checkpoint, Neighbours
from voile.inverse.target import Target
from voile.problem.problem import Problem
from voile.solver.path import Arrays

PLAIN = "fraction", "converged", "reason", "critical", "residual", "iterations", "step"


class Search(Protocol):
    """A search for the nearest stable shape, as far as it is kept."""

    target: Target
    problem: Problem
    neighbours: Neighbours
    radius: float
    sink: float
    mu: float
    budget: int
    steps: list[NearestStep]
    last: Checkpoint | None


def vector(like: PETSc.Vec, values: Array) -> PETSc.Vec:
    """A vector on another one's layout."""
    made = like.duplicate()
    made.array[:] = values
    return made


def packed_direct(path: DirectPath) -> Arrays:
    """A path of the direct method."""
    vectors = {"rest": path.rest, "mode": path.mode, "lost": path.lost}
    figures = {name: getattr(path, name) for name in PLAIN}
    return said(**figures, steps=[asdict(step) for step in path.steps]) | {
        name: each.array_r.copy() for name, each in vectors.items() if each is not None
    }


def unpacked_direct(problem: Problem, found: Arrays) -> DirectPath:
    """That of `packed_direct`."""
    zero, figures = problem.create_vector(), heard(found)
    steps = [DirectStep(**step) for step in figures.pop("steps")]
    vectors = {name: vector(zero, found[name]) for name in ("rest", "mode", "lost") if name in found}
    return DirectPath(**vectors, **figures, steps=steps)


def packed_search(search: Search, point: Checkpoint, reached: bool = False) -> Arrays:
    """A search for the nearest stable shape at a point; reached: where it was to lead."""
    near, bounds = search.neighbours, search.target.bounds
    return {
        **said(
            control=[search.radius, search.sink, search.mu, search.budget],
            beside=[near.moves.weight, near.cut],
            bounds=[bounds.breaches, bounds.last],
            steps=[asdict(step) for step in search.steps],
            point=[point.fraction, point.margin, search.last is point, reached],
        ),
        "s": point.s.array_r.copy(),
        "z": point.z.array_r.copy(),
        "values": point.values,
        "modes": columns(point.modes),
        "free": near.moves.free.copy(),
        f"{BULKY}.block": near.modes.block,
    }


def unpacked_search(search: Search, found: Arrays) -> tuple[Checkpoint, bool]:
    """Brings a search to where `packed_search` was called: the point, and whether it was to lead there."""
    near, bounds, figures = search.neighbours, search.target.bounds, heard(found)
    search.radius, search.sink, search.mu, search.budget = figures["control"]
    weight, near.cut = figures["beside"]
    while near.moves.weight > weight and near.moves.loosen():
        pass
    bounds.breaches, bounds.last = figures["bounds"]
    if not search.problem.everywhere(np.array_equal(near.moves.free, found["free"])):
        near.moves.restrict(found["free"])
    near.modes.block = found.get(f"{BULKY}.block", near.modes.block)
    search.steps[:] = [NearestStep(**step) for step in figures["steps"]]
    fraction, margin, noted, reached = figures["point"]
    zero = search.problem.create_vector()
    modes = [vector(zero, mode) for mode in found["modes"]]
    point = Checkpoint(
        vector(zero, found["s"]), vector(zero, found["z"]), fraction, margin, found["values"], modes
    )
    search.last = point if noted else None
    return point, reached
