"""Bounds that keep rest triangles valid: areas and edges over those of the target's, or of the first panels, of which
none may turn over."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from mpi4py import MPI

from voile.arrays import Reals
from voile.problem.problem import Problem

AREAS = 0.1, 10.0
EDGES = 0.1, 10.0


class Design(Protocol):
    """Rest triangles that can be measured."""

    problem: Problem

    def ratios(self) -> tuple[Reals, Reals]:
        """Areas (m,), negative where turned over, and edges (m, 3) of local rest triangles over the first ones."""


@dataclass
class Bounds:
    """Counts the rest shapes that bounds turned away, and says what was wrong with the last one."""

    breaches: int = 0
    last: str = ""

    def broken(self, design: Design) -> str:
        """Which bound the present rest shape breaks, where, and what is allowed; empty where it keeps them all."""
        part, found = design.problem.part, []
        areas, edges = design.ratios()
        for ratios, (low, high), what in (
            (areas[:, None], AREAS, "{:.2g} times its area"),
            (edges, EDGES, "an edge {:.2g} times as long"),
        ):
            outside = ~((ratios >= low) & (ratios <= high))
            if outside.any():
                rows = np.flatnonzero(outside.any(axis=1))
                row = rows[part.triangle[rows].argmin()]
                text = f"{what.format(ratios[row][outside[row]][0])}; allowed: {low:g} to {high:g}"
                found.append((int(part.triangle[row]), text))
        found = [breach for rank in design.problem.comm.allgather(found) for breach in rank]
        if not found:
            return ""
        self.breaches += 1
        self.last = "rest triangle {} would have {}".format(*min(found))
        return self.last

    def told(self) -> str:
        """What to say of an answer that the bounds may have kept away from a better one."""
        return (
            f"; bounds turned {self.breaches} rest shape(s) away, the last one: {self.last}"
            if self.last
            else ""
        )


def area_range(design: Design) -> list[float]:
    """Least and largest area of a rest triangle over that of the target's or the first panels'."""
    areas, comm = design.ratios()[0], design.problem.comm
    return [
        comm.allreduce(float(areas.min()), op=MPI.MIN),
        comm.allreduce(float(areas.max()), op=MPI.MAX),
    ]
