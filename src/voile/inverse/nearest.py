"""The stable shape nearest to a target that cannot be stable itself, with its rest shape.

The shape x in equilibrium is the unknown; its rest shape z(x) follows by the direct method. Among the target's
neighbours

    min_x  |x - x_t|^2 / 2 + mu sum_i phi((lambda_i - m)/c),   phi(t) = -(1 - t)^2 log t for t < 1, else 0

over the eigenvalues lambda_i of K(x; z(x)) v = lambda M v is solved by an interior point method: every iterate is a
stable equilibrium, with a margin m. The barrier (Li et al. 2020) is smooth where eigenvalues cross and silent beyond c.
The norm counts displacements and, over a short length, their gradients: in that of displacements alone the answer is
rough from vertex to vertex. The path starts where the direct method stopped and follows the load to its full value.

Each step minimises a model in which the stiffness projected on the lowest modes, V^T K V, is affine in x: modes repel
each other, which the slopes of the eigenvalues do not tell. A trust region bounds moves (Conn, Gould and Toint 2000).
"""

import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np
from petsc4py import PETSc

from voile.arrays import Flags, Reals
from voile.inverse.direct import Direct, DirectPath
from voile.inverse.journal import Journal, Keep
from voile.inverse.kept import packed_search, unpacked_search
from voile.inverse.moves import LEAST_WEIGHT, Move
from voile.inverse.nearest_path import Local, NearestPath, NearestStep, Trial
from voile.inverse.neighbours import Checkpoint, Neighbours
from voile.inverse.spectral import Model, barrier
from voile.inverse.target import CLEARANCE, Target
from voile.inverse.verify import sag
from voile.solver.path import Arrays

MARGIN, LEAST_MARGIN = 8.0, 1.0  # over g/L, of the way, and where it is given up
LESS, MORE = 6 * (0.5,), 4 * (2.0,)  # margins tried in turn, over the one before
SLIGHT = 1e-4  # sag over the size from which less margin is not tried, nor a nearer shape
IDLE = 0.8  # of the sag: a smaller margin that leaves more wins little
SHARES = 1.0, 0.002  # mu over half the squared distance, on the way and at its end
FALL = 0.2  # of mu in a step, at the end of the way
SMALL = 0.7, 0.01  # thicknesses: distance from the target that mu counts at least
NOTHING = 1e-16  # a merit from which there is nothing more to win
SHORTEST = 1e-3  # thicknesses: radius of the trust region, which begins with one thickness
STALLS = 0.05  # thicknesses: radius on the way from which the rest shape's moves count less
KEEP = 0.5  # of the lowest eigenvalue above the margin that a step without load would have: one with load keeps it
STUCK = 1e-3  # of the way: a shorter step of load is none
POOR, FAIR, GOOD = 0.2, 0.4, 0.7  # quality of a step
ANEW = 2  # proposals after one whose eigenvalues sank too far, before the radius shrinks
SHARP = 5.0  # cuts within a thickness: what sinks faster is a mode that the model does not know
# Of the merit that a step could win: sag slight; another margin tried; way; answer.
SETTLED, ROUGH, FINE, EXACT = 0.3, 0.1, 0.02, 0.005
STEPS, EXTRA = 300, 30  # of the way to the full load; from one margin to the next
TRIED = 10  # of the latter, after which it is seen whether they will do
PRECISE = 1e-5  # residual over the loads' norm, on the way


Progress = Callable[[NearestStep], None]
Stays = Callable[[PETSc.Vec, float], bool]  # of a rest shape and the sag of its equilibrium


class Nearest:
    """Path of nearest stable shapes of a target on which the direct method has stopped."""

    def __init__(self, direct: Direct, on_step: Progress | None, journal: Journal):
        self.target, self.problem, self.clock = direct.target, direct.problem, direct.target.clock
        self.journal = journal
        self.on_step, self.steps, self.budget = on_step, list[NearestStep](), STEPS
        target = self.target
        self.floor = [np.minimum(target.offset, body.gap(target.x, 0.0)) for body in target.obstacles]
        self.neighbours = Neighbours(direct, target.touching())
        self.first = self.problem.thickness() / self.problem.size()
        self.last: Checkpoint | None = None
        self.radius, self.sink, self.mu = self.first, 0.0, math.inf

    # ---- the path ----

    def advance(
        self, point: Checkpoint, fraction: float, margin: float, exact: float = FINE
    ) -> tuple[Checkpoint, bool]:
        """From a point to the nearest one at a fraction of the load with a margin and True, or the last one found on
        the way. It is settled where a step could win no more than a share `exact`."""

        def work(kept: Arrays, keep: Keep) -> Arrays:
            if kept:
                here = unpacked_search(self, kept)[0]
            else:
                here = replace(point, margin=min(point.margin, margin))
                self.radius = max(self.radius, 0.1 * self.first)
            return packed_search(self, *self._advance(here, fraction, margin, exact, keep))

        return unpacked_search(self, self.journal.call(work))

    def _advance(
        self, point: Checkpoint, fraction: float, margin: float, exact: float, keep: Keep
    ) -> tuple[Checkpoint, bool]:
        while self._goes_on():
            self.budget -= 1
            trial, settled = self._step(point, fraction, margin, exact)
            if trial is None:
                return point, settled
            point = trial.point
            if trial.share == 1.0:  # without round-off
                point.fraction, point.margin = fraction, margin
            self._note(point)
            keep(partial(packed_search, self, point))
        return point, point.fraction == fraction and point.margin == margin

    def _goes_on(self) -> bool:
        """Whether there are steps and time left. Collective."""
        return self.budget > 0 and not self.clock.over()

    def _step(
        self, point: Checkpoint, fraction: float, margin: float, exact: float
    ) -> tuple[Trial | None, bool]:
        """The next point; None where there is none, and whether that is because little is left to win."""
        way = (fraction - point.fraction, margin - point.margin)
        enough = SETTLED if not any(way) and self._sag(point) <= SLIGHT else exact
        local, tries = self._model(point, way), 0
        while local and self.radius >= SHORTEST * self.first and not self.clock.over():
            trial = self._propose(local, point, way)
            if trial is None:
                return None, False
            if not trial.share and local.merit - trial.merit <= enough * max(local.merit, NOTHING):
                if any(way) or self.mu <= local.end:
                    return None, not any(way)
                self.mu = max(local.end, FALL * self.mu)
                local.model.mu = self.mu
                local.merit = local.half + local.model.value(np.zeros(len(local.model.pull)))
                continue
            inside = self._entering(trial.point)
            if not self.problem.everywhere(not inside.any()):
                self.neighbours.moves.hold(inside)
                local = self._model(point, way)
                continue
            quality = self._quality(trial, local)
            if quality > POOR:
                self._control_step(quality, trial.length)
                return trial, False
            if trial.sink is not None:
                tries += 1
                if tries <= ANEW and (trial.sink - self.sink) * self.first**2 <= SHARP:
                    self.sink = trial.sink
                    continue
            self.radius, tries = 0.4 * min(self.radius, trial.length), 0
            if any(way) and self.radius < STALLS * self.first and self.neighbours.moves.loosen():
                self.radius = self.first
                local = self._model(point, way)
        return None, False

    def _control_step(self, quality: float, length: float) -> None:
        """The radius after a step of some quality and length."""
        if quality > GOOD and length > 0.5 * self.radius:
            self.radius *= 2.0
        elif quality < FAIR:
            self.radius = 0.5 * min(self.radius, length)

    def _model(self, point: Checkpoint, way: tuple[float, float]) -> Local | None:
        """Linearises at a point; way: what is left of fraction and margin."""
        near, k = self.neighbours, len(point.modes)
        if not near.linearise(point):
            return None
        slopes, cut = near.slopes(point), near.cut
        pull = Move(near.moves.weigh(point.s), self.problem.create_vector())
        force = near.load_slope(point) if way[0] else self.problem.create_vector()
        force.scale(-way[0])
        tangent, loaded = near.moves.tangent(pull, slopes, force)
        rows, columns = np.array(list(slopes)).T
        turn, ahead = np.zeros((tangent.s.shape[1], k, k)), np.zeros((k, k))
        turn[:, rows, columns] = turn[:, columns, rows] = tangent.slopes[:, 1:]
        ahead[rows, columns] = ahead[columns, rows] = [slope.dot(loaded) for slope in slopes.values()]
        half, matrix = 0.5 * point.s.dot(pull.s), np.diag(point.values - point.margin) / cut
        start, end = (
            share * max(half, (small * self.first) ** 2) for share, small in zip(SHARES, SMALL, strict=True)
        )
        mu = self.mu = start if any(way) else min(self.mu, max(end, FALL * self.mu))
        model = Model(matrix, turn / cut, tangent.slopes[:, 0], mu, tangent.form)
        rise = (ahead - way[1] * np.eye(k)) / cut
        merit = half + model.value(np.zeros(len(turn)))
        return Local(model, cut, rise, merit, half, tangent, loaded, near.moves.length(loaded), end)

    def _propose(self, local: Local, point: Checkpoint, way: tuple[float, float]) -> Trial | None:
        """The minimiser of the model within the radius, as far ahead as half of the stability is kept that it has
        without load; None where there is none."""

        def ahead(share: float) -> tuple[Model, Reals | None]:
            left = self.radius**2 - (share * local.reach) ** 2
            lost = self.sink * (share * local.reach) ** 2 * np.eye(len(local.rise))
            matrix = local.model.matrix + share * local.rise - lost
            model = replace(local.model, matrix=matrix, sink=self.sink)
            return model, model.within(math.sqrt(left)) if left > 0.0 else None

        model, c = ahead(0.0)
        if c is None:
            return None
        share, far, least = 0.0, 1.0 if any(way) else 0.0, KEEP * model.lowest(c)
        while far >= STUCK:
            there, d = ahead(far)
            if d is not None and there.lowest(d) >= least:
                model, c, share = there, d, far
                break
            far *= 0.5
        move = self.neighbours.moves.move(local.tangent.s @ c, local.tangent.z @ c)
        move.axpy(share, local.loaded)
        return Trial(
            point.beside(move, share * way[0], share * way[1]),
            share,
            math.hypot(float(np.linalg.norm(c)), share * local.reach),
            local.half + model.value(c),
            model.lowest(c),
        )

    def _quality(self, trial: Trial, local: Local) -> float:
        """How well a trial keeps what the model promised, 1: the lowest eigenvalue ahead, or the decrease of the merit
        here; negative where it is not stable."""
        point = trial.point
        if not self.neighbours.settle(point):
            return -math.inf
        above = (point.values - point.margin) / local.cut
        trial.sink = max(self.sink + (trial.lowest - float(above[0])) / trial.length**2, 0.0)
        if above[0] <= 0.0:
            return -math.inf
        self.sink = max(trial.sink, 0.5 * self.sink)
        if trial.share:
            return float(above[0]) / trial.lowest
        half = 0.5 * point.s.dot(self.neighbours.moves.weigh(point.s))
        merit = half + local.model.mu * float(barrier(above)[0].sum())
        return float((local.merit - merit) / (local.merit - trial.merit))

    def _entering(self, point: Checkpoint) -> Flags:
        """(n,) the local vertices that a point has inside an obstacle."""
        self.neighbours.go_to(point)
        x = self.problem.positions(self.neighbours.direct.state(point.z))
        inside = np.zeros(len(x), dtype=bool)
        for body, floor in zip(self.target.obstacles, self.floor, strict=True):
            inside |= body.gap(x, 0.0) < floor - CLEARANCE * self.problem.thickness()
        found: Flags = inside & self.target.movable
        return found

    def reach(self, path: DirectPath, margin: float) -> tuple[Checkpoint, bool]:
        """`advance` from where the direct method stopped to the full load. Where the way ends more modes are told, and
        the margin rises no more; where it ends again there is less margin."""
        point = Checkpoint(self.problem.create_vector(), path.rest.copy(), path.fraction, 0.0)
        if not (self.neighbours.linearise(point) and self.neighbours.settle(point)):
            return point, False
        point, reached = self.advance(point, 1.0, margin)
        if not reached and self._goes_on() and self.neighbours.tell_more(point):
            point, reached = self.advance(point, 1.0, point.margin)
        while not reached and point.margin >= 2.0 * LEAST_MARGIN * self.neighbours.slow and self._goes_on():
            point, reached = self.advance(point, 1.0, 0.5 * point.margin)
        return point, reached

    def confirm(self, first: Checkpoint, stays: Stays) -> Checkpoint:
        """The point of least margin, half by half, that stays, or the first firmer one; this one where none does."""
        weight = self.neighbours.moves.weight  # with which it was found

        def firm(point: Checkpoint) -> bool:
            self.neighbours.polish(point)
            return self.journal.flag(lambda: stays(point.z, self._sag(point)))

        if self.clock.over():
            return first
        found, holds = first, firm(first)
        for factor in LESS if holds else MORE:
            if holds and self._sag(found) <= SLIGHT:
                break
            trial, reached = self._with(factor * found.margin, found)
            if not reached or self.clock.over() or (holds and self._sag(trial) > IDLE * self._sag(found)):
                break
            if firm(trial) != holds:
                return found if holds else trial
            found = trial
        return found if holds else self.nearer(first, weight)

    def _with(self, margin: float, found: Checkpoint) -> tuple[Checkpoint, bool]:
        """From a point to the nearest one with another margin and True, or to where it was given up: after a third of
        the steps where these led less than a third of the way, or to one that wins little."""
        self.budget = TRIED
        trial, reached = self.advance(found, 1.0, margin, ROUGH)
        done = (trial.margin - found.margin) / (margin - found.margin)
        little = reached and margin < found.margin and self._sag(trial) > math.sqrt(IDLE) * self._sag(found)
        if little or done <= TRIED / EXTRA:
            return trial, False
        self.budget += EXTRA - TRIED
        return self.advance(trial, 1.0, margin)

    def nearer(self, point: Checkpoint, weight: float) -> Checkpoint:
        """From a point that simulations leave, with whatever margin: the nearest that steps find which count the rest
        shape's moves the least; weight: with which it was found."""
        if weight <= LEAST_WEIGHT:  # the way has led along those
            return point
        while self.neighbours.moves.loosen():
            pass
        self.budget, self.radius = EXTRA, max(self.radius, self.first)
        self.mu = SHARES[0] * 0.5 * point.s.dot(self.neighbours.moves.weigh(point.s))
        return self.advance(point, 1.0, point.margin, EXACT)[0]

    def settled(self, point: Checkpoint, margin: float) -> Checkpoint:
        """The nearest point with a margin, as near as steps bring there."""
        self.budget = EXTRA
        return self.advance(point, 1.0, margin, EXACT)[0]

    def outcome(self, point: Checkpoint) -> NearestPath:
        """A point as result, and its last step."""
        if self.last is not point:
            self._note(point)
        self.neighbours.polish(point)
        state = self.neighbours.go_to(point)
        lowest, mode = float(point.values[0]), point.modes[0].copy()
        mode.scale(1.0 / mode.norm(PETSc.NormType.INFINITY))
        margin = point.margin / self.neighbours.slow
        return NearestPath(
            point.z.copy(), state, sag(self.target, state), lowest, mode, margin, list(self.steps), point.fraction,
            self.clock.ended,
        )  # fmt: skip

    def _sag(self, point: Checkpoint) -> float:
        """Largest displacement from the target over the size."""
        self.neighbours.go_to(point)
        return sag(self.target, self.neighbours.direct.state(point.z))

    def _note(self, point: Checkpoint) -> None:
        self.last = point
        self.steps.append(NearestStep(point.fraction, self._sag(point), float(point.values[0]), point.margin))
        if self.on_step:
            self.on_step(self.steps[-1])


def approach(
    target: Target,
    path: DirectPath,
    margin: float,
    stays: Stays,
    on_step: Progress | None = None,
    journal: Journal | None = None,
) -> NearestPath | None:
    """From where the direct method stopped to the nearest stable shape under the full load, with a smallest eigenvalue
    of `margin` times the weight's rate g/L, or less where the way there ends; margin 0: the least, doubled or halved
    from that of the way, at which stays(rest shape, sag) says that simulations from the target end there. When the
    target's clock is over it ends with the last stable shape. None where the full load is not reached before
    that, or nothing is free to move."""
    clock, stable = target.clock, list[tuple[Nearest, Checkpoint]]()
    turned_back = path.critical is None  # far from a loss of stability: less margin first
    for first in (LEAST_MARGIN, MARGIN) if turned_back and not margin else (margin or MARGIN,):
        search = Nearest(Direct(target, PRECISE), on_step, journal or Journal())
        if not search.neighbours.moves.movable:  # all of it touches
            return None
        point, reached = search.reach(path, first * search.neighbours.slow)
        if reached:
            point = search.settled(point, margin * search.neighbours.slow or point.margin)
            return search.outcome(point if margin else search.confirm(point, stays))
        if len(point.values):
            stable.append((search, point))
        if clock.over() and stable:
            search, point = max(stable, key=lambda each: each[1].fraction)
            return search.outcome(point)
    return None
