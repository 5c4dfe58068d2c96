"""Bounds on rest triangles: what breaks them is named, counted, and told of an answer that they hold back."""

import re

import numpy as np
import pytest
from inverse_shells import hanging_sheet
from mpi4py import MPI
from test_direct import pleated_strip, solve
from test_panels import cone_skirt

from voile.inverse.bounds import AREAS, EDGES, Bounds, area_range
from voile.problem.problem import Problem
from voile.problem.rest import PanelRest, RestShape


def moved(design, vertex, to):
    """The design with a vertex at `to` (m)."""
    z = design.create()
    field = np.zeros((len(design.problem.part.points), 3))
    field[vertex] = to - design.base[vertex]
    for k in range(3):  # all unknowns of a vertex that is not sewn
        z.array[design.problem.part.matrix[3 * vertex + k].indices] = field[vertex, k]
    design.set(z)


@pytest.mark.parametrize(
    "share, shear, what, limits",
    [
        (0.02, 0.0, "0.02 times its area", AREAS),
        (30.0, 0.0, "30 times its area", AREAS),
        (1.0, 30.0, "times as long", EDGES),
    ],
)
def test_a_breach_is_named_with_its_triangle_and_counted(share, shear, what, limits):
    """The corner of a sheet, moved from and to the edge across, and along it."""
    sheet = hanging_sheet()
    rest, bounds = RestShape(Problem(sheet, MPI.COMM_SELF)), Bounds()
    assert bounds.broken(rest) == "" and bounds.told() == ""
    corner = int(np.flatnonzero(np.bincount(sheet.triangles.ravel()) == 1)[-1])
    row = int(np.flatnonzero((sheet.triangles == corner).any(axis=1))[0])
    ends = sheet.points[np.setdiff1d(sheet.triangles[row], corner)]
    middle, along = ends.mean(axis=0), ends[1] - ends[0]
    local = rest.problem.part.vertex.tolist().index(corner)
    moved(rest, local, middle + share * (sheet.points[corner] - middle) + shear * along)
    said = bounds.broken(rest)
    assert said.startswith(f"rest triangle {row} would have") and what in said
    assert said.endswith(f"allowed: {limits[0]:g} to {limits[1]:g}")
    assert bounds.breaches == 1 and bounds.told().endswith(said)
    assert share in [pytest.approx(ratio, rel=1e-6) for ratio in area_range(rest)]


def test_a_panel_triangle_that_turns_over_is_a_breach():
    whole, flat = cone_skirt(12, 4)
    panels = PanelRest(Problem(whole, MPI.COMM_SELF), flat.coordinates)
    z = panels.create()
    z.array[::2] = -2.0 * flat.coordinates[:, 0]  # the mirror image
    panels.set(z)
    assert re.search(r"rest triangle 0 would have -1 times its area", Bounds().broken(panels))


def test_an_answer_that_bounds_hold_back_says_so():
    """sin(angle / 2) is flat at 180 degrees: a pleat that has to bear there takes a wild rest shape."""
    result = solve(pleated_strip("sin"), method="direct")
    assert not result.converged
    assert re.search(r"rest triangle \d+ would have .*; allowed: ", result.reason)
