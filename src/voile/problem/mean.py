"""The mean of the elastic force, and of springs', along the way of a step in time.

The mean over x_s = x_0 + s (x - x_0), 0 < s <= 1, works exactly minus the change of the elastic energy (the average
vector field method of Quispel & McLaren 2008), so a scheme that uses it can neither gain nor lose elastic energy,
however stiff the shell is. The force in the middle of the way keeps the angular momentum instead, which turns about
the middle of a step's way (Simo, Tarnow & Wong 1992). Both have a potential in x, the sum of weight/s E(x_s) over the
places s.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from voile import _kernels
from voile.arrays import Ints, Reals
from voile.problem.elastic import Elastic
from voile.problem.matrix import Blocks
from voile.problem.terms import Hessian, Point, Term

Nodes = tuple[tuple[float, float], ...]  # places in [0, 1] along the way, with weights
END: Nodes = ((1.0, 1.0),)


def mean_nodes(share: float) -> Nodes:
    """Gauss' quadrature with two nodes, exact for cubics (the force of a membrane), of `share` times the mean over the
    way plus 1 - share times the value at its end."""
    if not share:
        return END
    m1, m2, m3 = (share / (k + 1.0) + 1.0 - share for k in (1, 2, 3))
    variance = m2 - m1**2
    other = (m3 - 2.0 * m1 * m2 + m1**3) / variance
    jacobi = np.array([[m1, np.sqrt(variance)], [np.sqrt(variance), other]])
    places, vectors = np.linalg.eigh(jacobi)  # Golub & Welsch 1969
    return tuple(zip(places.tolist(), (vectors[0] ** 2).tolist(), strict=True))


def middle_nodes(share: float) -> Nodes:
    """`share` times the value in the middle of the way plus 1 - share times that at its end."""
    return tuple((s, weight) for s, weight in ((0.5, share), (1.0, 1.0 - share)) if weight)


def end_nodes(share: float) -> Nodes:
    """Half of `share` times the value at the start, the rest times that at the end."""
    return tuple((s, weight) for s, weight in ((0.0, 0.5 * share), (1.0, 1.0 - 0.5 * share)) if weight)


@dataclass
class MeanElastic(Term):
    """Of `elastic` along the way from the point `start`. A node at the end (s = 1) is elastic's own kernel, so that end
    moments, which turn its triangles, find it; the others have one each, for it keeps stresses."""

    elastic: Elastic
    start: Point
    nodes: Nodes

    @property
    def stiffness(self) -> float:
        """Share of the elastic Hessian in its own, where that is the same everywhere."""
        return sum(s * weight for s, weight in self.nodes)

    def energies(self, at: Point) -> dict[str, float]:
        total = {"stretching": 0.0, "bending": 0.0}
        for elastic, there, s, weight in self._places(at):
            for name, value in elastic.energies(there).items():
                total[name] += weight / s * value
        return total

    def forces(self, at: Point) -> Reals:
        parts = [weight * elastic.forces(there) for elastic, there, _, weight in self._places(at) if weight]
        found: Reals = np.sum(parts, axis=0)
        return found

    def clamp_work(self, at: Point, since: float, until: float) -> float:
        """That of `elastic`, with the mean of its moments."""
        places = self._places(at)
        return sum(weight * elastic.clamp_work(there, since, until) for elastic, there, _, weight in places)

    def clamp_moments(self, at: Point) -> tuple[Ints, Reals]:
        """Those of `elastic`, the mean of its moments."""
        parts = [(weight, *elastic.clamp_moments(there)) for elastic, there, _, weight in self._places(at)]
        return parts[0][1], np.sum([weight * moments for weight, _, moments in parts], axis=0)

    def scatter(self, at: Point, which: Hessian, scatter: _kernels.Scatter) -> None:
        try:
            for elastic, there, s, weight in self._places(at):
                with elastic.stiffened(s * weight):
                    elastic.scatter(there, which, scatter)
                scatter.adding = True
        finally:
            scatter.adding = False

    def predict(self, at: Point, step: Reals) -> None:
        for elastic, there, s, weight in self._places(at):
            with elastic.stiffened(s * weight):
                elastic.predict(there, s * step)

    def longest_step(self, at: Point, step: Reals, most: float) -> float:
        """What the shape at the end admits, and those on the way."""
        most = self.elastic.longest_step(at, step, most)
        for elastic, there, s, weight in self._places(at):
            if s < 1.0 and weight:
                most = elastic.longest_step(there, s * step, most)
        return most

    def _places(self, at: Point) -> Iterator[tuple[Elastic, Point, float, float]]:
        """(elastic, point, s, weight) of each node."""
        for number, (there, s, weight) in enumerate(_places(self.start, at, self.nodes)):
            yield self.elastic if s == 1.0 else self.elastic.twin(number), there, s, weight


@dataclass
class MeanTerm(Term):
    """The same of another term, such as springs."""

    term: Term
    start: Point
    nodes: Nodes

    def energies(self, at: Point) -> dict[str, float]:
        total: dict[str, float] = {}
        for there, s, weight in _places(self.start, at, self.nodes):
            for name, value in self.term.energies(there).items():
                total[name] = total.get(name, 0.0) + weight / s * value
        return total

    def forces(self, at: Point) -> Reals:
        places = _places(self.start, at, self.nodes)
        found: Reals = np.sum([weight * self.term.forces(there) for there, _, weight in places], axis=0)
        return found

    def blocks(self, at: Point, which: Hessian) -> Blocks:
        places = list(_places(self.start, at, self.nodes))
        for parts in zip(*(self.term.blocks(there, which) for there, _, _ in places), strict=True):
            shares = zip(parts, places, strict=True)
            yield parts[0][0], np.sum([s * weight * values for (_, values), (_, s, weight) in shares], axis=0)


def _places(start: Point, at: Point, nodes: Nodes) -> Iterator[tuple[Point, float, float]]:
    """(point, s, weight) of each node on the way from `start` to `at`, which is that of s = 1 itself."""
    for s, weight in nodes:
        yield at if s == 1.0 else between(start, at, s), s, weight


def between(start: Point, at: Point, s: float) -> Point:
    """The point after a share of the way, 0 to 1, in displacements that count from where those of `at` do."""
    displacement = start.displacement + s * (at.displacement - start.displacement)
    return replace(
        at,
        time=start.time + s * (at.time - start.time),
        u=displacement - (at.displacement - at.u),
        phi=start.phi + s * (at.phi - start.phi),
        displacement=displacement,
        positions=start.positions + s * (at.positions - start.positions),
    )
