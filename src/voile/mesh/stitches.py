"""Seams: `stitch` records as exact linear constraints between vertices."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from voile.arrays import Ints, Reals
from voile.errors import InputError


@dataclass(frozen=True)
class Stitches:
    """s records x_slave = (1 - weight) x_first + weight x_second.

    slave, first, second (s,) int32 vertices; weight (s,) float64 in [0, 1]. A vertex may be the slave of
    several records as seams meet in it, and of a slave in turn (a chain): see sewing_matrix.
    """

    slave: Ints
    first: Ints
    second: Ints
    weight: Reals

    def __len__(self) -> int:
        return len(self.slave)


def sewing_matrix(
    stitches: Stitches, count: int, name: Callable[[int], str] = "stitch {}".format
) -> tuple[sparse.csr_matrix, Ints]:
    """Elimination of all stitches of a mesh of `count` vertices: x = P x[free].

    Returns P (count, f) in CSR form, whose rows are non-negative and sum to 1, and the free vertices (f,)
    int32. Records of weight 0 or 1 join vertices, in any number and order, to one free vertex, the smallest;
    the others hang a joined vertex on an edge, and chains of them are followed to their ends.
    Raises InputError, with name(record), where a vertex hangs on itself (a cycle), or on two edge points.
    """
    label, hangs = join(stitches, count)
    joined = np.flatnonzero(np.bincount(label[stitches.slave[hangs]], minlength=count) > 0)
    slave, ends = (
        label[stitches.slave[hangs]],
        label[np.column_stack([stitches.first, stitches.second])[hangs]],
    )
    weight = stitches.weight[hangs]
    flip = ends[:, 0] > ends[:, 1]  # the same edge point can be recorded from either end
    ends = np.where(flip[:, None], ends[:, ::-1], ends)
    weight = np.where(flip, 1 - weight, weight)
    order = np.argsort(slave, kind="stable")
    again = order[1:][slave[order[1:]] == slave[order[:-1]]]
    first_of = np.full(count, -1)
    first_of[slave[order[::-1]]] = order[::-1]
    for i in again:
        j = first_of[slave[i]]
        if (ends[i] != ends[j]).any() or abs(weight[i] - weight[j]) > 1e-9:
            raise InputError(
                f"{name(hangs[i])}: vertex {stitches.slave[hangs[i]]} already hangs on another edge point "
                f"by {name(hangs[j])}; a vertex may hang on one"
            )
    row = first_of[joined]
    step = sparse.csr_matrix(
        (
            np.concatenate([1 - weight[row], weight[row]]),
            (np.tile(joined, 2), np.concatenate([ends[row, 0], ends[row, 1]])),
        ),
        shape=(count, count),
    )
    _refuse_cycle(step, first_of, hangs, name)
    free = np.setdiff1d(np.unique(label), joined)
    place = sparse.csr_matrix((np.ones(len(free)), (free, np.arange(len(free)))), shape=(count, len(free)))
    # P = place + step P, and step is nilpotent: one product per link of the longest chain
    matrix, link = place, step @ place
    while link.nnz:
        matrix, link = matrix + link, step @ link
    return sparse.csr_matrix(matrix[label]), free.astype(np.int32)


def join(stitches: Stitches, count: int) -> tuple[Ints, Ints]:
    """Vertices made one by the stitches: (count,) smallest vertex joined to each; the (k,) records that hang.

    A hanging record whose two ends are joined is itself a join, so this repeats until nothing changes.
    """
    label = np.arange(count)
    while True:
        first, second = label[stitches.first], label[stitches.second]
        joins = (stitches.weight == 0) | (stitches.weight == 1) | (first == second)
        end = np.where(stitches.weight == 1, second, first)[joins]
        slave = label[stitches.slave[joins]]
        graph = sparse.coo_matrix((np.ones(len(end)), (slave, end)), shape=(count, count))
        _, component = connected_components(graph, directed=False)
        _, smallest = np.unique(component, return_index=True)
        joined = smallest[component][label]
        if np.array_equal(joined, label):
            return label, np.flatnonzero(~joins)
        label = joined


def circular(stitches: Stitches, count: int) -> int:
    """How many records of weight 0 or 1 join vertices along directed circles, as a to b and b to a."""
    joins = (stitches.weight == 0) | (stitches.weight == 1)
    slave = stitches.slave[joins]
    end = np.where(stitches.weight == 1, stitches.second, stitches.first)[joins]
    graph = sparse.coo_matrix((np.ones(len(end)), (slave, end)), shape=(count, count))
    _, component = connected_components(graph, connection="strong")
    return int((component[slave] == component[end]).sum())


def _refuse_cycle(step: sparse.csr_matrix, first_of: Ints, hangs: Ints, name: Callable[[int], str]) -> None:
    _, component = connected_components(step, connection="strong")
    cyclic = np.flatnonzero((np.bincount(component)[component] > 1) | (step.diagonal() != 0))
    if len(cyclic):
        members = cyclic[component[cyclic] == component[cyclic[0]]]
        chain = ", ".join(str(v) for v in members[:8])
        raise InputError(
            f"{name(hangs[first_of[members[0]]])}: the stitches of vertices {chain} form a cycle; "
            "a vertex may not hang on itself, directly or through others"
        )
