"""The stable shape nearest to a target that cannot be stable itself, with its rest shape.

The shape x in equilibrium is the unknown; its rest shape z(x) follows by the direct method. Among the target's
neighbours

    min_x  |x - x_t|^2 / 2 + mu sum_i phi((lambda_i - m)/c),   phi(t) = -(1 - t)^2 log t for t < 1, else 0

over the eigenvalues lambda_i of K(x; z(x)) v = lambda M v is solved by an interior point method: every iterate is a
stable equilibrium, with a margin m. The barrier (Li et al. 2020) is smooth where eigenvalues cross and silent beyond c.
The norm counts displacements and, over a short length, their gradients: in that of displacements alone the answer is
rough from vertex to vertex. The path starts where the direct method stopped and follows the load to its full value.

Each step minimises a model in which the stiffness projected on the lowest modes, V^T K V, is affine in x: modes repel
each other, which the slopes of the eigenvalues do not tell.
"""

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from petsc4py import PETSc

from voile.inverse.direct import Direct, DirectPath
from voile.inverse.neighbours import Move, Neighbours, Place
from voile.inverse.spectral import Model, barrier
from voile.inverse.target import CLEARANCE, Target
from voile.inverse.verify import sag
from voile.problem.problem import Problem

MARGIN, LEAST_MARGIN = 16.0, 1.0  # over g/L, of the way, and where it is given up
LESS, MORE = 6 * (0.5,), 3 * (2.0,)  # margins tried in turn, over the one before
SLIGHT = 1e-4  # sag over the size from which less margin is not tried, nor a nearer shape
IDLE = 0.98  # of the sag: a smaller margin that leaves more wins nothing
SHARES = 0.05, 0.002  # mu over half the squared distance, on the way and at its end
LEAST = 1e-8, 1e-10  # mu at least
NOTHING = 1e-16  # a merit from which there is nothing more to win
FIRST, SHORTEST = 0.1, 1e-4  # of the way: steps
STIFFEST = 1e8  # damping
POOR, FAIR, GOOD = 0.2, 0.4, 0.7  # quality of a step
SETTLED, FINE = 0.3, 0.02  # of the merit that a step could still win: on the way, and where that fails
EXACT = 1e-3  # and in the answer
STEPS, EXTRA = 300, 100  # of the way to the full load; from one margin to the next
INDEPENDENT = 1e-10  # eigenvalues of scaled products, over the largest


@dataclass
class NearestStep:
    """An accepted step: fraction of the load, largest displacement from the target over the size, smallest eigenvalue
    and the margin asked for (1/s^2)."""

    fraction: float
    sag: float
    eigenvalue: float
    margin: float


@dataclass
class NearestPath:
    """The outcome: rest displacements with director angles, the equilibrium found with its sag (over the size), its
    smallest eigenvalue (1/s^2) and mode (unknowns, largest entry 1), the margin (over g/L), the steps, the fraction of
    the load, and whether time ended the search."""

    rest: PETSc.Vec
    state: PETSc.Vec
    sag: float
    eigenvalue: float
    mode: PETSc.Vec
    margin: float
    steps: list[NearestStep]
    fraction: float = 1.0
    timed_out: bool = False


@dataclass
class Local:
    """The model at a place, in units of `cut` (1/s^2), what a step of 1 along the way adds to its matrix, the merit
    there and the distance's part of it; moves are `basis` @ `ortho` @ coordinates, and `loaded` for a step of 1 along
    the way of load and margin."""

    model: Model
    cut: float
    rise: np.ndarray
    merit: float
    half: float
    basis: list[Move]
    ortho: np.ndarray
    loaded: Move
    way: tuple[float, float]


@dataclass
class Trial:
    """A place proposed (None: none), the merit and the lowest eigenvalue above the margin that its model has there, in
    cuts."""

    place: Place | None
    merit: float
    lowest: float


@dataclass
class Pace:
    """How the next step goes. left: of the way; share: of the way, for a step along it (`moving`), else the step stays
    where the last one ended; damping: of its move; enough: share of the merit that a step must win there; mu: the last
    one at the end of the way; settled: whether that end is reached."""

    left: float = 1.0
    share: float = FIRST
    damping: float = 0.0
    moving: bool = True
    enough: float = SETTLED
    mu: float = math.inf
    settled: bool = False

    @property
    def at_end(self) -> bool:
        return not self.left

    @property
    def step(self) -> float:
        return min(self.share, self.left) if self.moving else 0.0

    def slower(self) -> bool:
        """After a step that failed; whether there is another to try."""
        if self.moving and self.enough > FINE:
            self.moving, self.enough = False, FINE
            return True
        self.damping = max(4.0 * self.damping, 0.1)
        self.share *= 0.5 if self.moving else 1.0
        return self.share >= SHORTEST and self.damping <= STIFFEST

    def after(self, quality: float) -> None:
        """After a step of some quality."""
        if self.moving:
            self.left -= self.step
            self.share *= 2.0 if quality > GOOD else 1.0
            self.enough = SETTLED
        elif quality > GOOD:
            self.damping = 0.5 * self.damping if self.damping > 0.05 else 0.0
        elif quality < FAIR:
            self.damping = max(2.0 * self.damping, 0.1)
        self.moving = False


class Clock:
    """Wall time that a search may take (s; 0: no limit), the same on all ranks. ended: whether it was found over."""

    def __init__(self, problem: Problem, seconds: float):
        self.problem, self.end = problem, time.perf_counter() + (seconds or math.inf)
        self.ended = False

    def over(self) -> bool:
        """Whether the time is over on any rank. Collective."""
        if self.end < math.inf and not self.ended:
            self.ended = not self.problem.everywhere(time.perf_counter() < self.end)
        return self.ended


Progress = Callable[[NearestStep], None]
Stays = Callable[[PETSc.Vec, float], bool]  # of a rest shape and the sag of its equilibrium


class Nearest:
    """Path of nearest stable shapes of a target on which the direct method has stopped."""

    def __init__(self, direct: Direct, clock: Clock, on_step: Progress | None = None):
        self.target, self.problem, self.clock = direct.target, direct.problem, clock
        self.on_step, self.steps, self.budget = on_step, list[NearestStep](), STEPS
        target = self.target
        self.floor = [np.minimum(target.offset, body.gap(target.x, 0.0)) for body in target.obstacles]
        self.beside = Neighbours(direct, target.touching())

    # ---- the path ----

    def advance(
        self, place: Place, fraction: float, margin: float, exact: float = FINE
    ) -> tuple[Place, bool]:
        """From a settled place on the straight way to a fraction of the load and a margin: the nearest stable place
        there and True, or the last one found on the way. A step of the way is followed by steps where it ends, until
        those win little; less, where the next step of the way fails, and no more than a share `exact` at its end, where
        the sag is more than slight and so many steps are left."""
        way = (fraction - place.fraction, margin - place.margin)
        pace = Pace() if any(way) else Pace(left=0.0, moving=False)
        while self._goes_on():
            self.budget -= 1
            if pace.at_end:
                pace.enough = SETTLED if self._sag(place) <= SLIGHT else exact
            trial = self._step(place, way, pace)
            if trial is None or trial.place is None:
                return place, pace.settled
            place = trial.place
            if pace.at_end:
                place.fraction, place.margin = fraction, margin  # without round-off
            self._note(place)
        return place, pace.at_end

    def _goes_on(self) -> bool:
        """Whether there are steps and time left. Collective."""
        return self.budget > 0 and not self.clock.over()

    def _step(self, place: Place, way: tuple[float, float], pace: Pace) -> Trial | None:
        """The next place, at a pace that is changed on the way there; None where there is none."""
        local = self._model(place, way, pace)
        while local:
            trial = self._propose(local, place, pace)
            if not pace.moving and local.merit - trial.merit <= pace.enough * max(local.merit, NOTHING):
                if pace.at_end:
                    pace.settled = True
                    return None
                pace.moving = True
                continue
            inside = self._entering(trial.place) if trial.place else np.zeros(0, dtype=bool)
            if not self.problem.everywhere(not inside.any()):
                self.beside.hold(inside)
                local = self._model(place, way, pace)
                continue
            quality = self._quality(trial, local, pace.moving)
            if quality > POOR:
                pace.after(quality)
                return trial
            if not pace.slower():
                return None
        return None  # nothing can be factored here

    def _model(self, place: Place, way: tuple[float, float], pace: Pace) -> Local | None:
        """Linearises at a place; way: of the fraction and the margin, for a step of 1."""
        beside, k = self.beside, len(place.values)
        if not beside.linearise(place):
            return None
        slopes, cut = beside.slopes(place), beside.cut
        gradients = [Move(beside.weigh(place.s), self.problem.create_vector()), *slopes.values()]
        basis = beside.moves(gradients)
        gram = np.array([[g.dot(b) for b in basis] for g in gradients])
        ortho = _orthonormal(0.5 * (gram + gram.T))
        force = beside.load_slope(place)
        force.scale(-way[0])
        (loaded,) = beside.moves([beside.still()], residual=force)
        rows, columns = np.array(list(slopes)).T
        turn, ahead = np.zeros((ortho.shape[1], k, k)), np.zeros((k, k))
        turn[:, rows, columns] = turn[:, columns, rows] = (gram[1:] @ ortho).T
        ahead[rows, columns] = ahead[columns, rows] = [slope.dot(loaded) for slope in slopes.values()]
        half, matrix = 0.5 * place.s.dot(gradients[0].s), np.diag(place.values - place.margin) / cut
        mu = max(SHARES[pace.at_end] * half, LEAST[pace.at_end])
        if pace.at_end:  # the steps there would not settle if it rose
            mu = pace.mu = min(mu, pace.mu)
        model = Model(matrix, turn / cut, gram[0] @ ortho, mu)
        rise = (ahead - way[1] * np.eye(k)) / cut
        merit = half + model.value(np.zeros(ortho.shape[1]))
        return Local(model, cut, rise, merit, half, basis, ortho, loaded, way)

    def _propose(self, local: Local, place: Place, pace: Pace) -> Trial:
        """The minimiser of the model a step ahead."""
        step = pace.step
        model = replace(local.model, matrix=local.model.matrix + step * local.rise)
        c = model.minimise(pace.damping)
        if c is None:
            return Trial(None, math.inf, math.nan)
        move = self.beside.still()
        for weight, b in zip([*(local.ortho @ c), step], [*local.basis, local.loaded], strict=True):
            move.axpy(weight, b)
        there = place.beside(move, step * local.way[0], step * local.way[1])
        lowest = float(np.linalg.eigvalsh(model.at(c))[0])
        return Trial(there, local.half + model.value(c), lowest)

    def _quality(self, trial: Trial, local: Local, moving: bool) -> float:
        """How well a trial keeps what the model promised, 1: the lowest eigenvalue ahead, or the decrease of the merit
        here; negative where it is not stable."""
        place = trial.place
        if place is None or not self.beside.settle(place):
            return -1.0
        above = (place.values - place.margin) / local.cut
        if moving:
            return float(above[0]) / trial.lowest
        half = 0.5 * place.s.dot(self.beside.weigh(place.s))
        merit = half + local.model.mu * float(barrier(above)[0].sum())
        return (local.merit - merit) / (local.merit - trial.merit)

    def _entering(self, place: Place) -> np.ndarray:
        """(n,) the local vertices that a place has inside an obstacle."""
        self.beside.go_to(place)
        x = self.problem.positions(self.beside.direct.state(place.z))
        inside = np.zeros(len(x), dtype=bool)
        for body, floor in zip(self.target.obstacles, self.floor, strict=True):
            inside |= body.gap(x, 0.0) < floor - CLEARANCE * self.problem.thickness()
        return inside & self.target.movable

    def reach(self, path: DirectPath, margin: float) -> tuple[Place, bool]:
        """`advance` from where the direct method stopped to the full load, with less margin where the way ends."""
        place = Place(self.problem.create_vector(), path.rest.copy(), path.fraction, 0.0)
        if not (self.beside.linearise(place) and self.beside.settle(place)):
            return place, False
        # the way is easier away from the loss of stability
        place, _ = self.advance(place, place.fraction, margin)
        place, reached = self.advance(place, 1.0, place.margin)
        while not reached and place.margin >= 2.0 * LEAST_MARGIN * self.beside.slow and self._goes_on():
            place.margin *= 0.5
            place, reached = self.advance(place, 1.0, place.margin)
        return place, reached

    def confirm(self, first: Place, stays: Stays) -> Place:
        """The place of least margin, half by half, that stays, or the first firmer one; this one where none does."""

        def firm(place: Place) -> bool:
            return stays(place.z, self._sag(place))

        if self.clock.over():
            return first
        found, holds = first, firm(first)
        for factor in LESS if holds else MORE:
            if holds and self._sag(found) <= SLIGHT:
                break
            self.budget = EXTRA
            trial, reached = self.advance(found, 1.0, factor * found.margin)
            if not reached:
                break
            if firm(trial) != holds:
                return found if holds else trial
            wins = self._sag(trial) <= IDLE * self._sag(found)
            found = trial
            if holds and not wins:
                break
        return found if holds else first

    def settled(self, place: Place) -> Place:
        """The nearest place with the same margin, as near as steps bring there."""
        self.budget = EXTRA
        return self.advance(place, 1.0, place.margin, EXACT)[0]

    def outcome(self, place: Place) -> NearestPath:
        """A place as result."""
        state = self.beside.go_to(place)
        lowest, mode = float(place.values[0]), place.modes[0].copy()
        mode.scale(1.0 / mode.norm(PETSc.NormType.INFINITY))
        margin = place.margin / self.beside.slow
        return NearestPath(
            place.z.copy(), state, sag(self.target, state), lowest, mode, margin, list(self.steps), place.fraction,
            self.clock.ended,
        )  # fmt: skip

    def _sag(self, place: Place) -> float:
        """Largest displacement from the target over the size."""
        self.beside.go_to(place)
        return sag(self.target, self.beside.direct.state(place.z))

    def _note(self, place: Place) -> None:
        self.steps.append(NearestStep(place.fraction, self._sag(place), float(place.values[0]), place.margin))
        if self.on_step:
            self.on_step(self.steps[-1])


def _orthonormal(gram: np.ndarray) -> np.ndarray:
    """(p, q) combinations of p vectors with these products that are orthonormal, dependent ones left out."""
    size = np.sqrt(np.maximum(np.diag(gram), 0.0))
    scale = np.divide(1.0, size, out=np.zeros_like(size), where=size > 0.0)
    theta, q = np.linalg.eigh(gram * scale * scale[:, None])
    kept = theta > INDEPENDENT * theta[-1]
    return scale[:, None] * q[:, kept] / np.sqrt(theta[kept])


def approach(
    target: Target,
    path: DirectPath,
    margin: float,
    stays: Stays,
    on_step: Progress | None = None,
    seconds: float = 0.0,
) -> NearestPath | None:
    """From where the direct method stopped to the nearest stable shape under the full load, with a smallest eigenvalue
    of `margin` times the weight's rate g/L, or less where the way there ends; margin 0: the least, doubled or halved
    from that of the way, at which stays(rest shape, sag) says that simulations from the target end there. seconds: of
    the search (0: no limit), which then ends with the last stable shape. None where the full load is not reached before
    that, or nothing is free to move."""
    clock, stable = Clock(target.problem, seconds), list[tuple[Nearest, Place]]()
    turned_back = path.critical is None  # far from a loss of stability: less margin first
    for first in (LEAST_MARGIN, MARGIN) if turned_back and not margin else (margin or MARGIN,):
        search = Nearest(Direct(target), clock, on_step)
        if not search.beside.movable.sum():  # all of it touches
            return None
        place, reached = search.reach(path, first * search.beside.slow)
        if reached:
            wanted = margin * search.beside.slow
            place = search.advance(place, 1.0, wanted)[0] if margin else search.confirm(place, stays)
            return search.outcome(search.settled(place))
        if len(place.values):
            stable.append((search, place))
        if clock.over() and stable:
            search, place = max(stable, key=lambda each: each[1].fraction)
            return search.outcome(place)
    return None
