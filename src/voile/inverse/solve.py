"""Inverse design from start to end: rest shape, certificate of stability, and proof by simulation."""

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from voile.contact.obstacles import Obstacle
from voile.contact.self_contact import Layers
from voile.errors import NotConverged
from voile.inverse.adjoint import NEAR, REASON, AdjointPath, keep_what_is_reached, minimise
from voile.inverse.adjoint import Progress as AdjointProgress
from voile.inverse.bounds import area_range
from voile.inverse.developable import DevelopableRest, start_of_panels
from voile.inverse.direct import SMALLEST, Direct, DirectPath, DirectStep
from voile.inverse.flatten import FlatPanels
from voile.inverse.nearest import NearestPath, approach
from voile.inverse.nearest import Progress as NearestProgress
from voile.inverse.target import HOLDS, Target
from voile.inverse.verify import Simulation, simulate
from voile.problem.discrete import Problem
from voile.problem.rest import PanelRest
from voile.problem.shell import Shell

Progress = Callable[[DirectStep], None]
FAR = 0.1  # sizes: a simulation that ends further from the target has nothing to do with it
STILL = 1e-6  # sizes, that a simulation from the nearest answer may move
COARSE = 0.25  # of the load, steps in which each hold on contacts is tried first
TRADE = (0.0, 0.5, 0.8, 0.9, 0.95, 1.0)  # shares of the way to the developable rest shape


@dataclass
class InverseOptions:
    """friction: reactions in Coulomb's cones, else along the normal; contact_tolerance (m): target vertices nearer
    than this to an obstacle may carry a reaction; tolerance: residual of simulations over the loads' norm; method:
    "direct", or "adjoint" to go on where the target itself is not stable: to the nearest stable shape with `margin`
    (smallest eigenvalue over g/L; 0: the least at which simulations from the target end), or, where there is no way to
    it and with "tao", by TAO with the weight `regularisation` of the rest shape's change, for `iterations` at most;
    developable: the rest shape has no angle defect inside."""

    friction: bool = True
    contact_tolerance: float = 1e-3
    tolerance: float = 1e-8
    method: str = "adjoint"
    margin: float = 0.0
    regularisation: float = 1e-3
    iterations: int = 20
    developable: bool = False


@dataclass
class InverseResult:
    """A rest shape (`rest`: rest displacements and director angles on the problem's unknowns) and what it is worth.

    residual (N): of the balance at the target; nearest, adjoint: where the target itself is not stable, the search for
    the nearest stable answer; eigenvalue: smallest omega^2 (1/s^2), at the target or at that answer, with its `mode`;
    simulation and disturbed: statics from the target and from beside it, `held` from the nearest answer, all to
    `tolerance` of the loads' norm; seconds: of
    the search (`inverse`) and of certificate and simulations (`proof`).
    """

    target: Target
    rest: PETSc.Vec
    direct: DirectPath
    adjoint: AdjointPath | None
    residual: float
    eigenvalue: float
    mode: PETSc.Vec
    simulation: Simulation
    disturbed: Simulation
    seconds: dict[str, float]
    panels: PanelRest | None = None
    trade: list[dict[str, float | None]] | None = None
    nearest: NearestPath | None = None
    held: Simulation | None = None
    guess: np.ndarray | None = None
    tolerance: float = 0.0

    @property
    def stable(self) -> bool:
        return self.eigenvalue > 0.0

    @property
    def converged(self) -> bool:
        """Whether the rest shape's simulation ends stable: in the target, or as near to it as was found."""
        found = self.direct.converged or self.nearest is not None or self.adjoint is not None
        return found and self.stable and self.simulation.stable and not (self._drifts or self._far)

    @property
    def _far(self) -> bool:
        return (self.nearest or self.simulation).sag > FAR

    @property
    def _drifts(self) -> bool:
        """Whether the nearest answer is none to the simulation, friction and contact included."""
        return self.held is not None and not (self.held.stable and self.held.sag <= STILL)

    @property
    def reason(self) -> str:
        far = f"; it ends {self.simulation.sag:.2g} sizes from the target" if self._far else ""
        settled, beside = self.simulation.path.converged, self.disturbed.path.converged
        settles = "; the simulation from beside it did not settle" if settled and not beside else ""
        said, bounds = self._finding() + far + settles, self.target.bounds
        exact = self.direct.converged and not (self.panels or self.trade)
        return said if exact or bounds.last in said else said + bounds.told()

    def _finding(self) -> str:
        if not self.simulation.path.converged:
            without = "" if self.direct.converged else f"{self.direct.reason}; {self._kept()}; simulated, "
            return without + self.simulation.path.reason
        leaves = "" if self._stays() else "; a simulation from the target leaves it"
        if self.panels or self.trade:
            what = "flat panels" if self.panels else "developable rest shape"
            kind = "a stable" if self.stable else "an unstable"
            where = f"{self.simulation.sag:.2g} sizes from the target{leaves}"
            return f"{what} with {kind} equilibrium {where}{self._more()}"
        if self.direct.converged:
            unstable = f"the target is unstable: {self._unstable()}"
            return "target in stable equilibrium" if self.stable else unstable
        if self.nearest:
            found = f"nearest stable answer found, with sag {self.nearest.sag:.2e}, margin {self.nearest.margin:g} g/L"
            where = "; a simulation from it leaves it" if self._drifts else leaves
            return f"{found}{where}; exactly, {self.direct.reason}"
        if self.adjoint is None:
            return f"{self.direct.reason}; {self._kept()}"
        if not self.stable:
            return f"{self.direct.reason}; the nearest equilibrium found is unstable: {self._unstable()}"
        sag = f"with sag {self.simulation.sag:.2e}"
        return f"nearest stable answer found, {sag}{leaves}; exactly, {self.direct.reason}"

    def _kept(self) -> str:
        if self.nearest or self.adjoint:
            return "kept is the nearest found"
        return f"kept is the rest shape at {self.direct.fraction:.4g} of the load"

    def _more(self) -> str:
        cut_short = self.adjoint and self.adjoint.reason == REASON.DIVERGED_MAXITS
        return "; more inverse.iterations may come nearer" if cut_short else ""

    def _stays(self) -> bool:
        """Whether a simulation from the target ends in the answer that a search found beside it."""
        sag = self.nearest.sag if self.nearest else self.adjoint.trail[-1].sag if self.adjoint else np.inf
        return self.simulation.sag <= NEAR * sag

    def _unstable(self) -> str:
        return f"smallest eigenvalue {self.eigenvalue:.3g} 1/s^2"


def solve_inverse(
    problem: Problem,
    shell: Shell | None,
    obstacles: list[Obstacle],
    offset: float,
    options: InverseOptions | None = None,
    on_step: Progress | None = None,
    on_iteration: AdjointProgress | None = None,
    exempt: np.ndarray | None = None,
    guess: np.ndarray | None = None,
    on_nearest: NearestProgress | None = None,
    layers: Layers | None = None,
    on_found: Callable[[PETSc.Vec], None] | None = None,
) -> InverseResult:
    """The rest shape that makes the problem's start shape (shell: rank 0's) a stable equilibrium on the obstacles,
    `offset` (m) from the mid-surface, and on its own `layers` where they are in each other's way. exempt: vertices of
    the shell that may have an angle defect in a developable rest shape, beside boundaries and seams; guess (n, 3) m:
    rest positions to start from. exempt and guess on rank 0. on_found takes the rest shape before its proof. Raises
    NotConverged where no reactions can hold the target."""
    options = options or InverseOptions()
    target = Target(problem, shell, obstacles, offset, options.contact_tolerance, options.friction, layers)
    began = time.perf_counter()
    guess = problem.comm.bcast(guess)
    away = None if guess is None else guess[problem.part.vertex] - target.x
    path = _direct(target, on_step, None if away is None else target.field_vector(away))
    adjoint = nearest = None

    def stays(rest: PETSc.Vec, sag: float) -> bool:
        runs = (simulate(target, rest, options.tolerance, disturbed=d) for d in (False, True))
        return all(run.stable and run.sag <= NEAR * sag for run in runs)

    if on_found and not path.converged and options.method != "direct":
        on_found(path.rest)  # the search that follows may be long
    if not path.converged and options.method == "direct":
        path.reason += '; inverse.method = "adjoint" goes on to the nearest stable shape'
    if not path.converged and options.method == "adjoint":
        nearest = approach(target, path, options.margin, stays, on_nearest)
    if not (path.converged or nearest) and options.method != "direct":
        target.load(1.0)
        try:
            adjoint = minimise(
                target, path.rest, options.regularisation, options.iterations, options.tolerance, on_iteration
            )
        except NotConverged as reason:  # the last stable rest shape stays
            path.reason += f"; {reason}"
    beside = nearest or adjoint
    exact = Direct(target).home(beside.state, beside.rest, on_step) if beside else None
    if exact:  # past where the direct branch turned back
        exact.iterations += path.iterations
        path, nearest, adjoint = exact, None, None
    found = nearest or adjoint or path
    if not adjoint:
        target.hold(found.rest)  # the search for the least margin ends at another one
    z, trade = found.rest, None
    if options.developable:
        if on_found:
            on_found(z)  # there may be none
        target.load(1.0)
        z, adjoint, trade = _make_developable(target, shell, exempt, z, options, on_iteration)
        nearest = None
    searched = time.perf_counter()
    if on_found:
        on_found(z)
    proving = time.perf_counter()
    tolerance = _resolved(target, path, options.tolerance) if found is path else options.tolerance
    simulation = simulate(target, z, tolerance, eigenvalue=adjoint is not None)
    disturbed = simulate(target, z, tolerance, disturbed=True)
    held = simulate(target, z, tolerance, start=nearest.state) if nearest else None
    if nearest:
        eigenvalue, mode = nearest.eigenvalue, nearest.mode
    elif adjoint:
        eigenvalue, mode = simulation.eigenvalue, path.mode or problem.create_vector()
    else:
        target.load(path.fraction)
        eigenvalue, mode = target.smallest(z)
        mode = path.mode or mode
    seconds = {"inverse": searched - began, "proof": time.perf_counter() - proving}
    return InverseResult(
        target, z, path, adjoint, path.residual, eigenvalue, mode, simulation, disturbed, seconds, trade=trade,
        nearest=nearest, held=held, guess=away, tolerance=tolerance,
    )  # fmt: skip


def _resolved(target: Target, path: DirectPath, tolerance: float) -> float:
    """A residual over the loads' norm that simulations can reach: where contacts bear, round-off may have ended the
    direct method before; without them displacements from the target keep the digits that the target itself lacks."""
    if not (path.converged and target.touches):
        return tolerance
    return max(tolerance, path.residual / target.load_norm(target.rest.state(path.rest)))


def _direct(target: Target, on_step: Progress | None, guess: PETSc.Vec | None = None) -> DirectPath:
    """The direct method. At contacts that slide its outcome depends on how firmly they hold, and Newton's method may
    alternate between two states at any load: all of HOLDS are tried in coarse steps, then the longest path is taken.
    Raises NotConverged where round-off hides the loads."""
    solver, paths = Direct(target), dict[float, DirectPath]()
    holds = HOLDS if target.touches else HOLDS[:1]
    for smallest in (COARSE, SMALLEST):
        for hold in holds:
            target.firmness = hold * target.membrane
            if hold not in paths:
                solver.check_round_off()
            path = paths[hold] = solver.follow(on_step, guess, smallest, paths.get(hold))
            if path.converged or path.critical is not None:
                break
        if path.converged:
            break
    best = max(paths, key=lambda hold: paths[hold].fraction)
    path, target.firmness = paths[best], best * target.membrane
    path.iterations = sum(each.iterations for each in paths.values())
    target.load(path.fraction)
    target.rest.set(path.rest)
    target.hold(path.rest)
    return path


def _make_developable(
    target: Target,
    shell: Shell | None,
    exempt: np.ndarray | None,
    z: PETSc.Vec,
    options: InverseOptions,
    on_iteration: AdjointProgress | None,
) -> tuple[PETSc.Vec, AdjointPath, list[dict[str, float | None]]]:
    """From a rest shape z to a developable one whose simulation is nearest to the target, and the trade between them:
    largest angle defect (rad) and sag, None where no simulation settles, on the straight way from one to the other."""
    design = DevelopableRest(target, shell, exempt)
    design.set(z)
    adjoint = minimise(
        target,
        design.projected,
        options.regularisation,
        options.iterations,
        options.tolerance,
        on_iteration,
        design,
    )
    design.set(adjoint.rest)
    found, trade = design.projected.copy(), []
    found.array[design.idle()] = adjoint.state.array_r[design.idle()]
    for share in TRADE:
        between = z.copy()
        between.axpby(share, 1.0 - share, found)
        reached = simulate(target, between, options.tolerance).settled_sag
        target.rest.set(between)
        trade.append({"share": share, "defect": design.largest_defect(), "sag": reached})
    return found, adjoint, trade


def solve_panels(
    problem: Problem,
    shell: Shell | None,
    flat: FlatPanels | None,
    obstacles: list[Obstacle],
    offset: float,
    options: InverseOptions | None = None,
    on_step: Progress | None = None,
    on_iteration: AdjointProgress | None = None,
    layers: Layers | None = None,
    on_found: Callable[[np.ndarray], None] | None = None,
) -> tuple[InverseResult, np.ndarray]:
    """As `solve_inverse` with flat panels (rank 0), the problem's rest shape, whose 2D coordinates are the design
    variables: the panels that drape nearest to the target, and their coordinates (p, 2) m, which on_found takes."""
    options = options or InverseOptions()
    target = Target(problem, shell, obstacles, offset, options.contact_tolerance, options.friction, layers)
    began = time.perf_counter()
    path = _direct(target, on_step)  # for the reactions at the target
    target.load(1.0)
    panels = PanelRest(problem, problem.comm.bcast(start_of_panels(target, shell, path.rest, flat)))
    adjoint = minimise(
        target,
        panels.create(),
        options.regularisation,
        options.iterations,
        options.tolerance,
        on_iteration,
        panels,
    )
    simulation = keep_what_is_reached(target, adjoint, options.tolerance, panels)
    z, searched = adjoint.rest, time.perf_counter()
    if on_found:
        on_found(panels.coordinates(z))
    proving = time.perf_counter()
    disturbed = simulate(target, z, options.tolerance, panels=panels, disturbed=True)
    seconds = {"inverse": searched - began, "proof": time.perf_counter() - proving}
    still = problem.create_vector()
    result = InverseResult(
        target, still, path, adjoint, path.residual, simulation.eigenvalue, still, simulation, disturbed, seconds,
        panels, tolerance=options.tolerance,
    )  # fmt: skip
    return result, panels.coordinates(z)


def inverse_report(result: InverseResult) -> dict:
    """Figures for the summary: see the keys."""
    target, direct, adjoint = result.target, result.direct, result.adjoint
    problem = target.problem
    rest = problem.motion(result.rest)
    moved = np.linalg.norm(rest, axis=1)
    off = np.zeros(0) if result.guess is None else np.linalg.norm(rest - result.guess, axis=1)
    return {
        "load_fraction": direct.fraction,
        "critical_fraction": direct.critical,
        "residual_at_target": result.residual if direct.steps else None,
        "sag": result.simulation.settled_sag,
        "sag_disturbed": result.disturbed.settled_sag,
        "stable": result.stable,
        "smallest_eigenvalue": result.eigenvalue,
        "direct_iterations": direct.iterations,
        "nearest": _nearest(result),
        "adjoint_iterations": len(adjoint.steps) - 1 if adjoint else 0,
        "forward_solves": (adjoint.forward_solves if adjoint else 0) + 2,
        "adjoint_solves": adjoint.adjoint_solves if adjoint else 0,
        "rest_displacement": problem.comm.allreduce(float(moved.max(initial=0.0)), op=MPI.MAX),
        "rest_distance_to_guess": problem.comm.allreduce(float(off.max(initial=0.0)), op=MPI.MAX),
        "rest_area_ratio": area_range(result.panels or target.rest),
        "bounds": {"turned_away": target.bounds.breaches, "last": target.bounds.last or None},
        "reactions": _reactions(target),
        **(
            {"developability": result.trade, "largest_defect": result.trade[-1]["defect"]}
            if result.trade
            else {}
        ),
    }


def _nearest(result: InverseResult) -> dict | None:
    nearest, held = result.nearest, result.held
    if not (nearest and held):
        return None
    return {"sag": nearest.sag, "margin": nearest.margin, "steps": len(nearest.steps), "moved": held.sag}


def _reactions(target: Target) -> dict:
    """What holds the target, over all ranks: contacts, those that bear, the least margin to slip (share of friction's
    bound that is left) and the least friction that would do."""
    comm = target.problem.comm
    own, body = target.own, target.on_obstacles()
    normal, margin = target.margins()
    bears = own & (normal > 0.0)
    return {
        "contacts": comm.allreduce(int(own.sum())),
        "bearing": comm.allreduce(int(bears.sum())),
        "force": comm.allreduce(target.reactions[own & body].sum(axis=0)),
        "least_margin": comm.allreduce(float(margin[bears].min(initial=1.0)), op=MPI.MIN),
        "least_friction": target.least_friction,
    }
