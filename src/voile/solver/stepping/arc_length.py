"""Statics along the arc of a path: load factors rise and fall, limit points and bifurcations are found on the way.

A limit point is where the load factor's slope changes its sign; a bifurcation where the tangent's inertia changes
otherwise. Either lies between two points of the path, and is closed in by equilibria between them.
"""

from dataclasses import dataclass, replace

import numpy as np

from voile.errors import NotConverged
from voile.problem.contact import contact_report
from voile.problem.imperfection import imperfection
from voile.problem.problem import Problem
from voile.solver.methods.method import Workspace
from voile.solver.path import (
    BIFURCATION,
    LIMIT_POINT,
    STEPS,
    Arrays,
    LoadStep,
    Path,
    Pause,
    Progress,
    StaticsOptions,
)
from voile.solver.stepping.arc import Arc, PathPoint
from voile.solver.stepping.restart import packed_path, packed_state, unpacked_path, unpacked_state

ALMOST = 1e-6  # relative: a step that ends so near to the end of the path ends there


@dataclass
class Options:
    """wanted: iterations of a step that keeps its length; turn: least cosine between the directions at a step's ends;
    bend: departure of its load factor from a straight line, over the longest change of one; sharp: over the first, a
    step so short that neither counts; longest: step (sizes); shortest: over the first, where none is shorter. flat:
    relative error of a limit point's load factor; halvings: of a step around a bifurcation."""

    wanted: int = 6
    turn: float = 0.95
    bend: float = 0.25
    sharp: float = 1e-3
    longest: float = 0.05
    shortest: float = 1e-6
    flat: float = 1e-9
    searches: int = 12
    halvings: int = 8


def solve_arc(
    problem: Problem,
    options: StaticsOptions,
    most: float,
    branch: int,
    on_step: Progress | None = None,
    on_pause: Pause | None = None,
    found: Arrays | None = None,
    path: Path | None = None,
) -> Path:
    """Follows the path of a problem on which nothing moves or rubs from the unloaded shell until the load factor is
    `most`, or minus that. branch: leaves it at that bifurcation, counted from 1; 0: at none. on_step, on_pause and
    found as of `solve_statics`; path: without steps, filled with them. Does not raise for lack of convergence; see
    Path."""
    run = ArcPath(problem, options, most, branch, path or Path(state=problem.create_vector()))
    run.follow(on_step, on_pause, found)
    return run.path


class ArcPath:
    """The path."""

    def __init__(self, problem: Problem, options: StaticsOptions, most: float, branch: int, path: Path):
        self.problem, self.asked, self.most, self.branch, self.path = problem, options, most, branch, path
        self.options, work = Options(), Workspace(problem)
        self.arc = Arc(problem, work, options.tolerance * problem.load_norm(path.state))
        path.counts = work.counts
        self.cap = most / (options.load_steps or STEPS)  # change of the load factor in a step
        self.on_step: Progress | None = None
        self.on_pause: Pause | None = None
        self.first = self.length = 0.0  # of the first step and the next (sizes)

    def follow(
        self, on_step: Progress | None, on_pause: Pause | None = None, found: Arrays | None = None
    ) -> None:
        """Calls on_step after each equilibrium, then on_pause; found: what that was given, to go on from."""
        self.on_step, self.on_pause = on_step, on_pause
        here = self._found(found) if found else self._begin()
        if here is None:
            self.path.reason = (
                "next to its start shape the unloaded shell has no equilibrium that a path leaves"
            )
            return
        self.last = here
        self._go(here)
        self.arc.back(self.last).copy(self.path.state)

    def _begin(self) -> PathPoint | None:
        """Where the path begins."""
        here = self.arc.start()
        if here:
            self.first = self.length = min(self.cap / here.slope, self.options.longest)
        return here

    def _pause(self, here: PathPoint, length: float) -> None:
        """The path may go on from a point with a step of some length (sizes)."""
        self.length = length
        if self.on_pause:
            self.on_pause(lambda: self._packed(here))

    def _packed(self, here: PathPoint) -> Arrays:
        point = {"factor": here.factor, "iterations": here.iterations, "residual": here.residual}
        said = packed_path(
            self.path,
            place=point | {"reason": here.reason, "slope": here.slope, "negative": here.negative},
            lengths=[self.first, self.length, self.arc.psi],
        )
        return said | packed_state(self.problem, here.state) | {"direction": here.direction.array_r.copy()}

    def _found(self, found: Arrays) -> PathPoint | None:
        """Where `_pause` was called."""
        problem = self.problem
        said, direction = unpacked_path(found, self.path), problem.create_vector()
        direction.array[:] = found["direction"]
        self.first, self.length, self.arc.psi = said["lengths"]
        state = unpacked_state(problem, found, said["place"]["factor"])
        here = PathPoint(state, direction=direction, **said["place"])
        return here if self.arc.aim(here, direction, here.slope) else None

    def _ended(self, there: PathPoint) -> bool:
        """Whether a point is the path's end."""
        if abs(there.factor) < self.most:
            return False
        self.path.converged, self.path.reason = True, there.reason
        self.path.stable = None if there.negative is None else there.negative == 0
        return True

    def _closed(self, origin: PathPoint, here: PathPoint, there: PathPoint) -> bool:
        """Whether a step passes where the path, or its branch, began: from there on it would repeat itself."""
        arc = self.arc
        passed = arc.along(origin, here) < 0.0 <= arc.along(origin, there)
        if not passed or arc.norm(arc.between(origin, there)) > 2.0 * arc.norm(arc.between(here, there)):
            return False
        self.path.converged, self.path.reason = True, "the path is closed: it is back where it began"
        self.path.stable = None if there.negative is None else there.negative == 0
        return True

    def _go(self, here: PathPoint) -> None:
        """From point to point until the end."""
        path, options, first, length, origin = self.path, self.options, self.first, self.length, here
        before: PathPoint | None = None
        if self._ended(here):
            return
        while path.attempts < self.asked.max_steps:
            path.attempts += 1
            there = self._next(here, length, length < options.sharp * first)
            if there is None:
                length *= 0.25
                if length >= options.shortest * first:
                    continue
                length = options.sharp * first
                there = self.arc.rebound(before, here, length) if self.problem.contact else None
                if there is None:
                    path.reason = f"no equilibrium next to that at load factor {here.factor:g}"
                    return
                here = replace(here, negative=None)  # a touch turns the load factor at the same inertia
            left = self._pass(here, there)
            if left:
                here, length = left
                origin, before = here, None
                self._keep(here, "branch")
                self._pause(here, length)
                continue
            self._keep(there, "arc-length")
            if self._ended(there) or self._closed(origin, here, there):
                self._pause(there, length)
                return
            easier = min(options.wanted / there.iterations, (0.5 / max(self._bend(here, there), 1e-3)) ** 0.5)
            length *= min(max(easier, 0.25), 2.0)
            length = min(length, options.longest, self.cap / max(abs(there.slope), 1e-300))
            before, here = here, there
            self._pause(here, length)
        path.reason = f"max_steps = {self.asked.max_steps} steps ended at load factor {here.factor:g}"

    def _next(self, here: PathPoint, length: float, sharp: bool) -> PathPoint | None:
        """The end of a step; None where it has to be shorter."""
        arc = self.arc
        there = arc.follow(here, length)
        if there is None:
            return None
        turned = arc.cosine(here, there) < self.options.turn
        if not sharp and (turned or self._bend(here, there) > 1.0):
            return None
        if abs(there.factor) > (1.0 - ALMOST) * self.most:
            end = arc.reach(here, there, float(np.copysign(self.most, there.factor)))
            return end if end and arc.aim(end, here.direction, here.slope) else None
        return there

    def _bend(self, here: PathPoint, there: PathPoint) -> float:
        """How far the load factor is from a straight line, over what is allowed."""
        straight = self.arc.along(here, there) * here.slope
        return abs(there.factor - here.factor - straight) / (self.options.bend * self.cap)

    def _keep(self, point: PathPoint, method: str) -> None:
        """A point becomes a step of the path."""
        self.last, y = point, self.arc.back(point)
        done = LoadStep(
            point.factor,
            point.iterations,
            point.residual,
            self.arc.tolerance,
            self.problem.at(point.factor).energies(y),
            point.negative,
            contact_report(self.problem.at(point.factor), y) if self.problem.contact else None,
            method,
            point.reason,
            self.arc.along_load(point),
        )
        self.path.steps.append(done)
        self.path.seconds |= {"linear_solve": self.path.counts.seconds}
        if self.on_step:
            self.on_step(done, y)

    # ---- critical points ----

    def _pass(self, a: PathPoint, b: PathPoint) -> tuple[PathPoint, float] | None:
        """Finds what is critical between two points; if a branch begins there that is asked for, its first point and
        the length of its first step."""
        events = []
        turns = a.slope * b.slope < 0.0
        if turns:
            events.append((LIMIT_POINT, self._limit(a, b)))
        if self._changed(a, b):
            events.append((BIFURCATION, self._bifurcation(a, b)))
        events.sort(key=lambda event: self.arc.along(a, event[1]))
        for kind, point in events:
            self._keep(point, kind)
            if kind == BIFURCATION and self.branch == len(self.path.found_by(kind)):
                return self._leave(point)
        return None

    def _limit(self, a: PathPoint, b: PathPoint) -> PathPoint:
        """Where the load factor is greatest or least between two points: regula falsi (Illinois) on its slope."""
        arc, best = self.arc, b if abs(b.slope) < abs(a.slope) else a
        low, high = 0.0, arc.along(a, b)
        at_low, at_high, curvature = a.slope, b.slope, abs(b.slope - a.slope) / high
        for _ in range(self.options.searches):
            length = (low * at_high - high * at_low) / (at_high - at_low)
            point = arc.follow(a, length)
            if point is None:
                break
            best = point
            if point.slope**2 < 2.0 * curvature * self.options.flat * max(
                abs(point.factor), 1e-3 * self.most
            ):
                break
            if point.slope * at_low > 0.0:
                low, at_low, at_high = length, point.slope, 0.5 * at_high
            else:
                high, at_high, at_low = length, point.slope, 0.5 * at_low
        return best

    def _bifurcation(self, a: PathPoint, b: PathPoint) -> PathPoint:
        """Where the inertia changes between two points: halving, then its eigenvalue is linear."""
        arc, left, right = self.arc, a, b
        length = arc.along(a, b)
        for _ in range(self.options.halvings):
            middle = arc.follow(left, 0.5 * length)
            if middle is None:
                break
            length *= 0.5
            left, right = (left, middle) if self._changed(left, middle) else (middle, right)
        field = imperfection(self.problem)
        values = [arc.softest(point, field)[0] for point in (left, right)]
        share = values[0] / (values[0] - values[1]) if values[0] * values[1] < 0.0 else 0.5
        arc.aim(left, left.direction, left.slope)
        point = arc.advance(left, share * length, left.direction, left.slope) or left
        point.direction, point.slope, point.negative = left.direction, left.slope, left.negative
        return point

    def _leave(self, point: PathPoint) -> tuple[PathPoint, float]:
        """The first point of the branch that meets the path at a bifurcation, a perturbation along its vector, and how
        far that is."""
        arc = self.arc
        _, way = arc.softest(point, imperfection(self.problem))
        off = self.asked.perturbation * self.problem.thickness() / self.problem.size()
        length = off / self.problem.largest_motion(way)
        for further in (1.0, 4.0, 0.25, 16.0):
            there = arc.advance(point, further * length, way, 0.0)
            if there and arc.aim(there, way, 0.0):
                return there, further * length
        raise NotConverged(
            f"statics.branch = {self.branch}: no equilibrium is found beside the bifurcation at load factor "
            f"{point.factor:g}"
        )

    def _changed(self, a: PathPoint, b: PathPoint) -> bool:
        """Whether the inertia changes otherwise than by a limit point, or by contacts that open or close."""
        if a.negative is None or b.negative is None or not self.problem.everywhere(a.touching == b.touching):
            return False
        return abs(b.negative - a.negative) != (a.slope * b.slope < 0.0)
