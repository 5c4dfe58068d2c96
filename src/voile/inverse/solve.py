"""Inverse design from start to end: rest shape, certificate of stability, and proof by simulation."""

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial

from petsc4py import PETSc

from voile.arrays import Ints, Reals
from voile.contact.candidates import Layers
from voile.contact.obstacles import Obstacle
from voile.errors import NotConverged
from voile.inverse.adjoint import NEAR, AdjointPath, keep_what_is_reached, minimise
from voile.inverse.adjoint import Progress as AdjointProgress
from voile.inverse.developable import DevelopableRest, start_of_panels
from voile.inverse.direct import SMALLEST, Direct, DirectPath, DirectStep
from voile.inverse.flatten import FlatPanels
from voile.inverse.journal import Journal, Keep
from voile.inverse.kept import packed_direct, unpacked_direct
from voile.inverse.nearest import Progress as NearestProgress
from voile.inverse.nearest import approach
from voile.inverse.nearest_path import NearestPath
from voile.inverse.objective import Design
from voile.inverse.result import InverseResult
from voile.inverse.target import HOLDS, Target
from voile.inverse.verify import Proofs, Simulation, as_scene, settles_within, simulate
from voile.problem.lifetime import Clock
from voile.problem.problem import Problem
from voile.problem.rest import PanelRest
from voile.problem.shell import Shell
from voile.solver.path import Arrays, StaticsOptions

Progress = Callable[[DirectStep], None]
Proof = tuple[Simulation, Simulation, Simulation | None, float, PETSc.Vec]
COARSE = 0.25  # of the load, steps in which each hold on contacts is tried first
TRADE = (0.0, 0.5, 0.8, 0.9, 0.95, 1.0)  # shares of the way to the developable rest shape


@dataclass
class InverseOptions:
    """friction: reactions in Coulomb's cones, else along the normal; contact_tolerance (m): target vertices nearer
    than this to an obstacle may carry a reaction; tolerance: residual of simulations over the loads' norm; method:
    "direct", or "adjoint" to go on where the target itself is not stable: to the nearest stable shape with `margin`
    (smallest eigenvalue over g/L; 0: the least at which simulations from the target end), or, where there is no way to
    it and with "tao", by TAO with the weight `regularisation` of the rest shape's change, for `iterations` at most;
    developable: the rest shape has no angle defect inside; max_seconds: of the search, and again of the proof of its
    answer; 0: no limit; statics: of the scene that a user makes of the answer."""

    friction: bool = True
    contact_tolerance: float = 1e-3
    tolerance: float = 1e-8
    method: str = "adjoint"
    margin: float = 0.0
    regularisation: float = 1e-3
    iterations: int = 20
    developable: bool = False
    max_seconds: float = 0.0
    statics: StaticsOptions = field(default_factory=lambda: StaticsOptions(nested=True))


@dataclass(frozen=True)
class Told:
    """Who is told of a search: of each step of the direct method and to the nearest stable shape, of each iteration of
    the adjoint method; found: of the rest shape, or of panels' coordinates, before the proof, and before a search that
    may be long."""

    step: Progress | None = None
    nearest: NearestProgress | None = None
    iteration: AdjointProgress | None = None
    found: Callable[..., None] = lambda _: None


def solve_inverse(
    problem: Problem,
    shell: Shell | None,
    obstacles: list[Obstacle],
    offset: float,
    options: InverseOptions | None = None,
    *,
    layers: Layers | None = None,
    exempt: Ints | None = None,
    guess: Reals | None = None,
    told: Told | None = None,
    journal: Journal | None = None,
) -> InverseResult:
    """The rest shape that makes the problem's start shape (shell: rank 0's) a stable equilibrium on the obstacles,
    `offset` (m) from the mid-surface, and on its own `layers` where they are in each other's way. exempt: vertices of
    the shell that may have an angle defect in a developable rest shape, beside boundaries and seams; guess (n, 3) m:
    rest positions to start from. exempt and guess on rank 0. journal: what an interrupted search goes on from. Raises
    NotConverged where no reactions can hold the target."""
    options, told, began = options or InverseOptions(), told or Told(), time.perf_counter()
    target = Target(problem, shell, obstacles, offset, options.contact_tolerance, options.friction, layers)
    search = Search(target, options, told, journal or Journal())
    guess = problem.comm.bcast(guess)
    away = None if guess is None else guess[problem.part.vertex] - target.x
    path = search.direct(None if away is None else target.field_vector(away))
    nearest = search.nearest(path)
    adjoint = None if nearest else search.adjoint(path)
    exact = search.home(nearest, adjoint)
    if exact:  # past where the direct branch turned back
        exact.iterations += path.iterations
        path, nearest, adjoint = exact, None, None
    found = nearest or adjoint or path
    if not adjoint:
        target.hold(found.rest)  # the search for the least margin ends at another one
    z, trade = found.rest, None
    if options.developable:
        told.found(z)  # there may be none
        z, adjoint, trade = search.developable(shell, exempt, z)
        nearest = None
    if adjoint:
        target.release()
    searched = time.perf_counter()
    told.found(z)
    proving = search.start_clock()
    tolerance = _resolved(target, path, options.tolerance) if found is path else options.tolerance
    simulation, disturbed, held, eigenvalue, mode = search.proof(z, path, nearest, adjoint, tolerance)
    closed, hovers = None, target.hovering()
    if hovers or adjoint or (nearest and nearest.fraction == 1.0):  # else it finds the target, too
        closed = as_scene(
            target, z, replace(options.statics, tolerance=max(options.statics.tolerance, tolerance))
        )
    seconds = {"inverse": searched - began, "proof": time.perf_counter() - proving}
    return InverseResult(
        target, z, path, adjoint, path.residual, eigenvalue, mode, simulation, disturbed, seconds, trade=trade,
        nearest=nearest, held=held, closed=closed, hovers=hovers, guess=away, tolerance=tolerance,
    )  # fmt: skip


class Search:
    """The stages of a search and its proof."""

    def __init__(self, target: Target, options: InverseOptions, told: Told, journal: Journal):
        self.target, self.options, self.told, self.journal = target, options, told, journal
        self.proofs = Proofs(target, options.tolerance)
        self.start_clock()

    def start_clock(self) -> float:
        """Search and proof each have their time (inverse.max_seconds); the present one."""
        self.target.clock = Clock(self.target.problem.comm, self.options.max_seconds)
        return time.perf_counter()

    def direct(self, guess: PETSc.Vec | None = None) -> DirectPath:
        """The direct method. At contacts that slide its outcome depends on how firmly they hold, and Newton's method
        may alternate between two states at any load: all of HOLDS are tried in coarse steps, then the longest path is
        taken. Raises NotConverged where round-off hides the loads, or they are no numbers."""
        target, paths = self.target, dict[float, DirectPath]()
        if not math.isfinite(target.load_norm(target.problem.create_vector())):
            raise NotConverged("the loads are not finite")
        solver = Direct(target, over=self.target.clock.over)
        holds = HOLDS if target.contacts else HOLDS[:1]
        for smallest in (COARSE, SMALLEST):
            for hold in holds:
                target.penalty = hold * target.membrane
                if hold not in paths:
                    solver.check_round_off()
                before = paths.get(hold)

                def work(
                    kept: Arrays, keep: Keep, so_far: DirectPath | None = before, least: float = smallest
                ) -> Arrays:
                    path = unpacked_direct(target.problem, kept) if kept else so_far
                    return packed_direct(
                        solver.follow(
                            self.told.step,
                            guess,
                            least,
                            path,
                            lambda path: keep(partial(packed_direct, path)),
                        )
                    )

                path = paths[hold] = unpacked_direct(target.problem, self.journal.call(work))
                if path.converged or path.critical is not None or self.target.clock.over():
                    break
            if path.converged or self.target.clock.over():
                break
        best = max(paths, key=lambda hold: paths[hold].fraction)
        path, target.penalty = paths[best], best * target.membrane
        path.iterations = sum(each.iterations for each in paths.values())
        target.load(path.fraction)
        target.rest.set(path.rest)
        target.hold(path.rest)
        return path

    def nearest(self, path: DirectPath) -> NearestPath | None:
        """The nearest stable shape where the direct method has none, if it is asked for and nearer than nothing."""
        target, options = self.target, self.options
        if path.converged:
            return None
        if options.method == "direct":
            path.reason += '; inverse.method = "adjoint" goes on to the nearest stable shape'
            return None
        self.told.found(path.rest)  # the search that follows may be long
        if options.method != "adjoint":
            return None
        found = approach(target, path, options.margin, self._stays, self.told.nearest, self.journal)
        if not found:
            return None
        target.hold(found.rest)
        nearer = target.clock.over() or _nearer(target, found, self.proofs(found.rest), options.tolerance)
        return found if nearer else None

    def _stays(self, rest: PETSc.Vec, sag: float) -> bool:
        """Whether simulations of a rest shape end about so far from the target as its equilibrium lies."""
        runs = (self.proofs(rest, disturbed) for disturbed in (False, True))
        return all(run.stable and run.sag <= NEAR * sag for run in runs)

    def adjoint(self, path: DirectPath) -> AdjointPath | None:
        """The simulation nearest to the target where the direct method has no stable shape."""
        if path.converged or self.options.method == "direct" or self.target.clock.over():
            return None
        self.target.load(1.0)
        try:
            found = self.minimise(self._start(path))
        except NotConverged as reason:  # the last stable rest shape stays
            path.reason += f"; {reason}"
            return None
        self.target.release()
        keep_what_is_reached(self.target, found, self.options.tolerance)
        self.target.rest.set(found.rest)
        return found

    def _start(self, path: DirectPath) -> PETSc.Vec:
        """Of the direct method's last rest shape and the target's own the one whose simulation ends nearer."""
        target, plain = self.target, self.target.problem.create_vector()
        target.hold(path.rest)
        if not path.fraction:  # the same
            return path.rest
        last = simulate(target, path.rest, self.options.tolerance)
        target.release()
        own = simulate(target, plain, self.options.tolerance)
        if own.stable and not (last.stable and last.sag <= own.sag):
            return plain
        target.hold(path.rest)
        return path.rest

    def minimise(self, start: PETSc.Vec, design: Design | None = None) -> AdjointPath:
        """The adjoint method from a start on."""
        options, told = self.options, self.told
        return minimise(
            self.target,
            start,
            options.regularisation,
            options.iterations,
            options.tolerance,
            told.iteration,
            design,
            journal=self.journal,
        )

    def home(self, nearest: NearestPath | None, adjoint: AdjointPath | None) -> DirectPath | None:
        """The exact rest shape by the straight way from an equilibrium under the full load to the target."""
        beside = nearest or adjoint
        if beside is None or (nearest and nearest.fraction != 1.0):
            return None
        return Direct(self.target, over=self.target.clock.over).home(
            beside.state, beside.rest, self.told.step
        )

    def developable(
        self, shell: Shell | None, exempt: Ints | None, z: PETSc.Vec
    ) -> tuple[PETSc.Vec, AdjointPath, list[dict[str, float | None]]]:
        """From a rest shape z to a developable one whose simulation is nearest to the target, and the trade between
        them: largest angle defect (rad) and sag, None where no simulation settles, on the straight way from one to the
        other."""
        target = self.target
        target.load(1.0)
        design = DevelopableRest(target, shell, exempt)
        design.set(z, target.clock.over)
        adjoint = self.minimise(design.projected, design)
        design.set(adjoint.rest)
        found, trade = design.projected.copy(), []
        found.array[design.idle()] = adjoint.state.array_r[design.idle()]
        for share in TRADE[-1:] if self.target.clock.over() else TRADE:
            between = z.copy()
            between.axpby(share, 1.0 - share, found)
            reached = simulate(target, between, self.options.tolerance).settled_sag
            target.rest.set(between)
            trade.append({"share": share, "defect": design.largest_defect(), "sag": reached})
        return found, adjoint, trade

    def proof(
        self,
        z: PETSc.Vec,
        path: DirectPath,
        nearest: NearestPath | None,
        adjoint: AdjointPath | None,
        tolerance: float,
    ) -> Proof:
        """Simulations of the rest shape z from the target, from beside it, and where it is that of a nearest stable
        shape from there; the smallest eigenvalue (1/s^2) of the answer and its mode. What says most comes first, for
        time may end the others."""
        target = self.target
        if nearest:
            simulation, whole = self.proofs(z), nearest.fraction == 1.0
            # else it is no answer, and has nothing to prove
            held = simulate(target, z, tolerance, start=nearest.state) if whole else None
            return simulation, self.proofs(z, True), held, nearest.eigenvalue, nearest.mode
        reached = adjoint.reached if adjoint else None
        simulation = reached or simulate(target, z, tolerance, eigenvalue=adjoint is not None)
        disturbed = simulate(target, z, tolerance, disturbed=True)
        if adjoint:
            mode = path.mode or target.problem.create_vector()
            return simulation, disturbed, None, simulation.eigenvalue, mode
        target.load(path.fraction)
        eigenvalue, mode = target.smallest(z)
        return simulation, disturbed, None, eigenvalue, path.mode or mode


def _nearer(target: Target, nearest: NearestPath, run: Simulation, tolerance: float) -> bool:
    """Whether a nearest stable shape is nearer to the target than what the target's own shape as rest shape gives; so
    is its simulation from the target, where that ends at all."""
    target.release()
    plain = target.problem.create_vector()
    return not settles_within(target, plain, tolerance, run.sag if run.stable else nearest.sag)


def _resolved(target: Target, path: DirectPath, tolerance: float) -> float:
    """A residual over the loads' norm that simulations can reach: where contacts bear, round-off may have ended the
    direct method before; without them displacements from the target keep the digits that the target itself lacks."""
    if not (path.converged and target.contacts):
        return tolerance
    return max(tolerance, path.residual / target.load_norm(target.rest.state(path.rest)))


def solve_panels(
    problem: Problem,
    shell: Shell | None,
    flat: FlatPanels | None,
    obstacles: list[Obstacle],
    offset: float,
    options: InverseOptions | None = None,
    *,
    layers: Layers | None = None,
    even: Callable[[Reals], Reals] | None = None,
    ease: Callable[[Reals], Reals] | None = None,
    told: Told | None = None,
    journal: Journal | None = None,
) -> tuple[InverseResult, Reals]:
    """As `solve_inverse` with flat panels (rank 0), the problem's rest shape, whose 2D coordinates are the design
    variables: the panels that drape nearest to the target, and their coordinates (p, 2) m; told.found takes these
    and those that the search starts from. even: makes coordinates symmetric, on all ranks; the search starts from such
    panels, and such are proved. ease: gives those that were found the ease of their seams, before they are proved."""
    options, told, began = options or InverseOptions(), told or Told(), time.perf_counter()
    target = Target(problem, shell, obstacles, offset, options.contact_tolerance, options.friction, layers)
    search = Search(target, options, told, journal or Journal())
    path = search.direct()  # for the reactions at the target
    target.load(1.0)
    base = problem.comm.bcast(start_of_panels(target, shell, path.rest, flat))
    panels = PanelRest(problem, even(base) if even else base)
    told.found(panels.base)  # the search may be long, or find nothing
    adjoint = search.minimise(panels.create(), panels)
    target.release()
    simulation = keep_what_is_reached(target, adjoint, options.tolerance, panels)
    z = adjoint.rest
    for change in (even, ease):
        if change:
            panels.take(z, change(panels.coordinates(z)))
    searched = time.perf_counter()
    told.found(panels.coordinates(z))
    proving = search.start_clock()
    if even or ease or simulation is None:
        simulation = simulate(target, z, options.tolerance, panels=panels, eigenvalue=True)
    disturbed = simulate(target, z, options.tolerance, panels=panels, disturbed=True)
    seconds = {"inverse": searched - began, "proof": time.perf_counter() - proving}
    still = problem.create_vector()
    result = InverseResult(
        target, still, path, adjoint, path.residual, simulation.eigenvalue, still, simulation, disturbed, seconds,
        panels, tolerance=options.tolerance,
    )  # fmt: skip
    return result, panels.coordinates(z)
