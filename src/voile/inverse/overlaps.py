"""Panels that lie flat without overlapping: those that do are cut in two, again and again."""

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import dijkstra

from voile.arrays import Flags, Ints, Reals
from voile.inverse.flatten import FlatPanels, flatten, overlaps
from voile.inverse.panels import Groups, Panels, split
from voile.mesh import build_topology

SOURCES = 60  # points of an outline from which a cut is tried


def split_overlaps(
    triangles: Ints,
    points: Reals,
    groups: Groups | None = None,
    seams: Ints | None = None,
    cut_open: bool | None = None,
    middle: Flags | None = None,
) -> FlatPanels:
    """As `split` and `flatten`, with more cuts: each panel that overlaps itself in the plane is cut in two.

    The cut is the path of least length / (s (1 - s))^2, s the share of the outline on one side.
    Raises InputError and NotConverged as they do.
    """
    panels = split(triangles, points, groups, seams, cut_open, middle=middle)
    while True:
        flat = flatten(panels)
        paths = [
            _halving(panels, k)
            for k, outline in enumerate(panels.outlines)
            if overlaps(flat.coordinates[outline])
        ]
        if not paths:
            return flat
        runs = [panels.vertex[run] for run in [seam.sides[0] for seam in panels.seams] + paths]
        pairs = np.concatenate([np.column_stack([run[:-1], run[1:]]) for run in runs])
        panels = split(triangles, points, groups, pairs, cut_open, middle=middle)


def _halving(panels: Panels, k: int) -> Ints:
    """The path (panel vertices) through the inside of panel k that parts it best."""
    outline, x = panels.outlines[k], panels.points[panels.vertex]
    count = len(outline)
    length = np.linalg.norm(x[np.roll(outline, -1)] - x[outline], axis=1)
    arc = (np.cumsum(length) - length) / length.sum()
    topology = build_topology(panels.corners[panels.panel == k])
    inner = topology.edges[np.setdiff1d(np.arange(len(topology.edges)), topology.boundary_edges)]
    weight = np.linalg.norm(np.diff(x[inner], axis=1)[:, 0], axis=1)
    ways, weights = np.concatenate([inner, inner[:, ::-1]]), np.tile(weight, 2)
    border = np.zeros(len(x), dtype=bool)
    border[outline] = True
    best, path = np.inf, outline[:0]
    for i in range(0, count, max(1, count // SOURCES)):
        use = ~border[ways[:, 0]] | (ways[:, 0] == outline[i])  # a path ends where it meets the outline
        graph = sparse.csr_matrix((weights[use], (ways[use, 0], ways[use, 1])), shape=(len(x), len(x)))
        distance, before = dijkstra(graph, indices=outline[i], return_predecessors=True)
        share = abs(arc - arc[i])
        share[i] = np.nan
        cost = distance[outline] / (share * (1 - share)) ** 2
        j = int(np.nanargmin(cost))
        if cost[j] < best:
            best, steps = cost[j], [int(outline[j])]
            while before[steps[-1]] >= 0:
                steps.append(int(before[steps[-1]]))
            path = np.array(steps)
    return path
