"""Elasticity of a part of a shell."""

import time
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import scipy  # its parts load when they are asked for

from voile import _kernels
from voile.arrays import Ints, Reals
from voile.problem.partition import Part
from voile.problem.terms import Hessian, Point, Term

SHORTEST = 1e-6  # step length under which a hinge is at 180 degrees already


class Elastic(Term):
    """The energy of a model, by its kernel; flat: the rest shape has no folds. `stiffness`: a factor on it, 1 but while
    a step in time is damped. `sides` (m, 3) marks the half edges whose hinges go on through 180 degrees, and from which
    side. `seconds`: spent in it, and in what goes into the matrix with it."""

    def __init__(self, part: Part, model: str, flat: bool):
        self.part, self.model, self.flat = part, model, flat
        self.seconds, self.stiffness = 0.0, 1.0
        self._twins: list[Elastic] = []
        self.sides: Ints = np.zeros((len(part.corners), 3), dtype=np.int32)
        self._time, self._turns = 0.0, bool((part.half_edge_clamp[:, 7] >= 0.0).any())
        self.count_from(part.points)

    def count_from(self, start: Reals) -> None:
        """Displacements count from `start` (local vertices, 3) m."""
        self._start = start
        for twin in self._twins:
            twin.count_from(start)
        vars(self).pop("kernel", None)  # or else there are two for a moment: 500 bytes for each triangle
        self.kernel = make_kernel(self.part, self.model, start, self.flat, self._time)
        self.kernel.set_sides(self.sides)
        if self.stiffness != 1.0:
            self._stiffen()

    def set_rest(self, flat: bool) -> None:
        """Takes the part's present rest shape."""
        self.flat = flat
        self.kernel.set_rest(self.part.rest_points, self.part.rest_corners, flat)

    def at(self, time: float) -> _kernels.Elastic:
        """The kernel with its clamps as they are at a time."""
        if self._turns and time != self._time:
            self._time = time
            _set_clamps(self.kernel, self.part, time)
            self.kernel.set_rest(self.part.rest_points, self.part.rest_corners, self.flat)
        return self.kernel

    def twin(self, number: int) -> "Elastic":
        """The same with a kernel of its own, for what is evaluated at several points."""
        while len(self._twins) <= number:
            twin = Elastic(self.part, self.model, self.flat)
            twin.take_sides(self.sides)
            twin.count_from(self._start)
            self._twins.append(twin)
        return self._twins[number]

    def sides_at(self, at: Point) -> Ints:
        """`sides` for what goes on from a point: of the hinges within 90 degrees of 180 there. One that has come from
        the other side by 270 degrees has folded to this one by 90."""
        found: Ints = self.at(at.time).fold_sides(at.u, at.phi) if at.passes else np.zeros_like(self.sides)
        return found

    def take_sides(self, sides: Ints) -> None:
        """Hinges go on from these sides."""
        self.sides = sides
        self.kernel.set_sides(sides)
        for twin in self._twins:
            twin.take_sides(sides)

    @contextmanager
    def stiffened(self, factor: float) -> Iterator[None]:
        """Its energy is a multiple meanwhile."""
        self.stiffness = factor
        self._stiffen()
        try:
            yield
        finally:
            self.stiffness = 1.0
            self._stiffen()

    def _stiffen(self) -> None:
        thickness, young, poisson = self.part.fabric[:3]
        self.kernel.set_fabric(
            np.ascontiguousarray(thickness), self.stiffness * young, np.ascontiguousarray(poisson)
        )

    @contextmanager
    def timed(self) -> Iterator[None]:
        """Counts the time as assembly."""
        began = time.perf_counter()
        yield
        self.seconds += time.perf_counter() - began

    def energies(self, at: Point) -> dict[str, float]:
        with self.timed():
            stretching, bending = self.at(at.time).energy(at.u, at.phi)
        return {"stretching": stretching, "bending": bending}

    def forces(self, at: Point) -> Reals:
        gradient, count = np.zeros(len(at.u) + len(at.phi)), len(at.u)
        with self.timed():
            self.at(at.time).gradient(at.u, at.phi, gradient[:count], gradient[count:])
        return np.negative(gradient, out=gradient)

    def clamp_work(self, at: Point, since: float, until: float) -> float:
        """J that this rank's clamps work on the shell as they rotate between two times (s), with their moments at a
        point."""
        if not self._turns or since == until:
            return 0.0
        part, total = self.part, 0.0
        row, moment = self.clamp_moments(at)
        for k, motion in enumerate(part.turns):
            turned = scipy.spatial.transform.Rotation.from_matrix(
                motion.turn(until) @ motion.turn(since).T
            ).as_rotvec()
            total += float(moment[part.half_edge_clamp[row, 7] == k].sum(axis=0) @ turned)
        return total

    def clamp_moments(self, at: Point) -> tuple[Ints, Reals]:
        """(k,) rows of part.half_edge_clamp whose triangles count on this rank, and the moments (k, 3) N m on the shell
        of these clamps: about the edge, what keeps its half hinge angle."""
        part = self.part
        half = part.half_edge_clamp[:, 0].astype(np.int64)
        row = np.flatnonzero(part.weight[half // 3] > 0.0)
        half = half[row]
        if not len(row):
            return row, np.zeros((0, 3))
        slope = self.at(at.time).stresses(at.u, at.phi)[:, 5:].ravel()[half]  # dW/dalpha
        start, end = (at.positions[part.corners[half // 3, (half + turn) % 3]] for turn in (1, 2))
        along = (end - start) / np.linalg.norm(end - start, axis=1, keepdims=True)
        return row, slope[:, None] * along

    def scatter(self, at: Point, which: Hessian, scatter: _kernels.Scatter) -> None:
        self.at(at.time).hessian(at.u, at.phi, which.kind, scatter, which.share)

    def predict(self, at: Point, step: Reals) -> None:
        self.at(at.time).predict(at.u, at.phi, step[: len(at.u)], step[len(at.u) :])

    def longest_step(self, at: Point, step: Reals, most: float) -> float:
        """None on which a hinge turns through 180 degrees or that ends beyond a barrier of the model; 0 where even a
        millionth does."""
        du, dphi = step[: len(at.u)], step[len(at.u) :]
        while not self._admits(at, at.u + most * du, at.phi + most * dphi):
            most *= 0.5
            if most < SHORTEST:
                return 0.0
        return most

    def _admits(self, at: Point, u: Reals, phi: Reals) -> bool:
        """Whether the way to displacements u and director angles phi is one."""
        kernel = self.at(at.time)
        folds = not at.passes and kernel.folds_over(at.u, at.phi, u, phi)
        return not folds and bool(np.isfinite(sum(kernel.energy(u, phi))))


def make_kernel(part: Part, model: str, start: Reals, flat: bool, time: float) -> _kernels.Elastic:
    """The model with displacements that count from `start` (local vertices, 3) m and clamps as they are at a time;
    flat: its rest shape has no folds."""
    kernel = _kernels.Elastic(
        model,
        part.corners,
        part.triangle_edges,
        part.signs,
        part.across,
        len(part.edge),
        np.ascontiguousarray(start),
    )
    if len(part.half_edge_clamp):
        _set_clamps(kernel, part, time)
    kernel.set_rest(part.rest_points, part.rest_corners, flat)
    kernel.set_fabric(*(np.ascontiguousarray(row) for row in part.fabric[:3]))
    if part.weave.size:
        kernel.set_weave(np.ascontiguousarray(part.weave))
    kernel.set_weights(part.weight)
    return kernel


def _set_clamps(kernel: _kernels.Elastic, part: Part, time: float) -> None:
    """Gives a kernel the clamps of a part as they are at a time."""
    clamp = part.half_edge_clamp
    half_edge, conormal, at_rest = np.ascontiguousarray(clamp[:, :3].astype(np.int32).T)
    vectors = clamp[:, 3:6].copy()
    for k, motion in enumerate(part.turns):
        mine = clamp[:, 7] == k
        vectors[mine] = vectors[mine] @ motion.turn(time).T
    kernel.set_clamps(half_edge, conormal, at_rest, vectors, clamp[:, 6].copy())
