"""The rest shape nearest to holding the target where the target itself is not stable: the adjoint method in TAO.

    min_z  |x(z) - x_t|^2_M / (2 M L^2)  +  regularisation |z - z_0|^2_M / (2 M L^2),

x(z) the statics of the program itself, M the lumped mass, L the size, z_0 where the search starts. These two terms, or
others behind the same interface, are in objective.py; their derivatives by z in reduced.py. Any of TAO's types for
unconstrained problems can be chosen by -inverse_tao_type; trust regions (ntr) are the default, for equilibria are lost
where a step goes too far.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field

import numpy as np
from petsc4py import PETSc

from voile.errors import NotConverged
from voile.inverse.journal import Journal, Keep, columns, heard, said
from voile.inverse.kept import vector
from voile.inverse.objective import Design, Objective, nearness
from voile.inverse.reduced import Iterate, Reduced
from voile.inverse.target import Target
from voile.inverse.verify import TIMED_OUT, Simulation, simulate
from voile.problem.lifetime import TimeIsOver, until
from voile.problem.rest import PanelRest
from voile.solver.path import Arrays
from voile.solver.stepping.restart import packed_history

FIRST_RADIUS = 2e-3  # of the trust region: root mean square of the rest shape's change over the size
FIRST_STRAIN = 1e-2  # the same for flat panels: root mean square of their strain
LAST_RADIUS = 1e-4  # of the first one: no step improves
SLOW, LOOK_BACK = 0.05, 4  # settled when so many iterations decreased the objective by less than this share
PRODUCTS, ACCURACY = 40, 1e-2  # of conjugate gradients in one iteration
REASON = getattr(PETSc.TAO, "ConvergedReason", None) or PETSc.TAO.Reason  # newer and older petsc4py
TIME = REASON.DIVERGED_USER  # its time was over
NEAR = 2.0  # sags of an answer beside the target: a simulation that stays there
TRIED = 6  # iterates that a simulation from the target does not end in


@dataclass
class AdjointStep:
    """An iteration of TAO: objective, norm of its gradient, sag over the size."""

    iteration: int
    objective: float
    gradient: float
    sag: float


@dataclass
class AdjointPath:
    """The best iterate: rest displacements with the director angles of their equilibrium `state`, the last of the
    `trail` of ever better ones; reason: TAO's; reached: the simulation of it from the target, where it was chosen by
    that."""

    rest: PETSc.Vec
    state: PETSc.Vec
    steps: list[AdjointStep] = field(default_factory=list)
    forward_solves: int = 0
    adjoint_solves: int = 0
    reason: int = 0
    trail: list[Iterate] = field(default_factory=list)
    reached: Simulation | None = None


Progress = Callable[[AdjointStep], None]


def minimise(
    target: Target,
    start: PETSc.Vec,
    regularisation: float,
    iterations: int,
    accuracy: float = 1e-8,
    on_step: Progress | None = None,
    design: Design | None = None,
    objectives: Sequence[Objective] | None = None,
    journal: Journal | None = None,
) -> AdjointPath:
    """The rest shape that minimises the sum of the objectives, from `start` on: design variables, by default rest
    displacements with director angles; by default that whose simulation is nearest to the target, `regularisation` the
    weight of its change. Ends when it settles, after so many iterations of TAO, or when the target's clock is over.
    journal: of the search. Raises NotConverged where the first simulation has no end."""

    def work(kept: Arrays, keep: Keep) -> Arrays:
        terms = objectives or nearness(target, design or target.rest, start, regularisation)
        search = Minimisation(target, start, design or target.rest, terms, accuracy, on_step)
        if kept:
            search.go_on(kept)
        path = search.run(iterations, keep)
        return _packed(target, path) | {"rest": path.rest.array_r.copy()}

    found = (journal or Journal()).call(work)
    path = _unpacked(target, design or target.rest, found)
    path.rest, path.state = vector(path.trail[-1].rest, found["rest"]), path.trail[-1].state
    (design or target.rest).set(path.trail[-1].rest)
    return path


class Minimisation:
    """TAO's iterations for a sum of objectives from `start` on; `path` is told of everything. `before`: iterations of
    the search that it goes on from, with their simulations and adjoint solves."""

    def __init__(
        self,
        target: Target,
        start: PETSc.Vec,
        design: Design,
        terms: Sequence[Objective],
        accuracy: float,
        on_step: Progress | None,
    ):
        self.target, self.design, self.on_step = target, design, on_step
        problem, panels = target.problem, isinstance(design, PanelRest)
        state = problem.create_vector() if panels else target.rest.state(start)
        self.objective = Reduced(target, design, terms, state, accuracy)
        self.z, self.path = start.copy(), AdjointPath(start, start)
        self.metric = design.metric() if isinstance(design, PanelRest) else None
        rough = FIRST_RADIUS * problem.size() * math.sqrt(start.getSize())
        self.first = self.radius = FIRST_STRAIN if self.metric else rough
        self.before, self.solves = 0, (0, 0)

    def go_on(self, kept: Arrays) -> None:
        """From what an interrupted search kept."""
        path = self.path = _unpacked(self.target, self.design, kept)
        self.radius, self.z = float(kept["radius"]), path.trail[-1].rest.copy()
        self.objective.go_on(path.trail, kept)
        self.before, self.solves = path.steps[-1].iteration, (path.forward_solves, path.adjoint_solves)

    def run(self, iterations: int, keep: Keep) -> AdjointPath:
        """Until it settles, after so many iterations in all, or when the target's clock is over; keep: what an
        interrupted search goes on from."""
        path = self.path
        tao = _optimiser(self.objective, self.z, self.radius, self.metric)
        tao.setMaximumIterations(max(iterations - self.before, 0))
        tao.setMonitor(lambda tao: self._note(tao, keep))
        tao.setConvergenceTest(
            lambda tao: _settled(tao, path, self.first, self.before, self.target.clock.over)
        )
        try:
            with until(self.target.clock):
                tao.solve()
            path.reason = tao.getConvergedReason()
        except PETSc.Error as error:  # newer petsc4py wraps what an evaluation raises
            raise error.__cause__ or error from None
        except TimeIsOver:
            if not self.objective.trail:
                raise NotConverged(f"adjoint method: {TIMED_OUT} that it starts from") from None
            path.reason = TIME
            self.target.problem.reset_origin(self.target.problem.create_vector())
        finally:
            tao.destroy()  # calls back to what holds it
        self._count()
        path.rest, path.state = path.trail[-1].rest.copy(), path.trail[-1].state
        self.design.set(path.rest)
        if self.metric is None:
            path.rest = _surface(self.target, path.trail[-1])
        return path

    def _note(self, tao: PETSc.TAO, keep: Keep) -> None:
        """An iteration, counted from the first start."""
        path = self.path
        iteration, value, gradient, _, reach, _ = tao.getSolutionStatus()
        if path.steps and path.steps[-1].objective == value:
            return  # a trial was rejected, or a search goes on from here: nothing is new
        self._count()
        path.steps.append(AdjointStep(self.before + iteration, value, gradient, path.trail[-1].sag))
        if self.on_step:
            self.on_step(path.steps[-1])
        history, radius = (
            self.objective.carried,
            reach if iteration else self.radius,
        )  # at its start TAO tells none
        keep(
            lambda: (
                _packed(self.target, path)
                | {"radius": np.array(radius)}
                | (packed_history(history) if history else {})
            )
        )

    def _count(self) -> None:
        """The path has the iterates and solves so far."""
        path, (forward, adjoint) = self.path, self.solves
        path.trail = self.objective.trail
        path.forward_solves = forward + self.objective.forward.solves
        path.adjoint_solves = adjoint + self.objective.adjoint_solves


def _surface(target: Target, iterate: Iterate) -> PETSc.Vec:
    """The rest shape of an iterate, with the director angles of its state."""
    rest, directors = iterate.rest.copy(), ~target.rest.is_vertex
    rest.array[directors] = iterate.state.array_r[directors]
    return rest


def _kept(path: AdjointPath) -> list[Iterate]:
    """The first and the last few iterates."""
    return path.trail[:1] + path.trail[1:][-TRIED:]


def _packed(target: Target, path: AdjointPath) -> Arrays:
    """A path with the first and the last of its trail."""
    trail = _kept(path)
    return {
        **said(
            steps=[asdict(step) for step in path.steps],
            solves=[path.forward_solves, path.adjoint_solves],
            reason=int(path.reason),
            bounds=[target.bounds.breaches, target.bounds.last],
            sags=[iterate.sag for iterate in trail],
        ),
        "rests": columns([iterate.rest for iterate in trail]),
        "states": columns([iterate.state for iterate in trail]),
    }


def _unpacked(target: Target, design: Design, found: Arrays) -> AdjointPath:
    """That of `_packed`."""
    figures, rest, state = heard(found), design.create(), target.problem.create_vector()
    target.bounds.breaches, target.bounds.last = figures["bounds"]
    trail = [
        Iterate(vector(rest, z), vector(state, y), sag)
        for z, y, sag in zip(found["rests"], found["states"], figures["sags"], strict=True)
    ]
    steps, (forward, adjoint) = [AdjointStep(**step) for step in figures["steps"]], figures["solves"]
    return AdjointPath(trail[-1].rest, trail[-1].state, steps, forward, adjoint, figures["reason"], trail)


def keep_what_is_reached(
    target: Target,
    path: AdjointPath,
    accuracy: float,
    panels: PanelRest | None = None,
) -> Simulation | None:
    """Leaves in the path the last iterate in whose equilibrium a simulation from the target ends, no farther off than
    the first, or of the first and the last few the one that ends nearest: the search's short simulations may end
    elsewhere than statics do, and what it minimises is no largest displacement. When
    the target's clock is over, the first that ends stable will do. That simulation, None where time ended all."""
    runs: list[tuple[Iterate, Simulation]] = []
    for iterate in reversed(_kept(path)):
        rest = iterate.rest if panels else _surface(target, iterate)
        run = simulate(target, rest, accuracy, panels=panels, eigenvalue=True)
        if run.timed_out:
            break
        runs.append((iterate, run))
        if run.stable and (target.clock.over() or run.sag <= min(NEAR * iterate.sag, path.trail[0].sag)):
            break
    if not runs:
        return None
    kept, run = min(runs, key=lambda pair: (not pair[1].stable, pair[1].sag))
    path.trail = path.trail[: path.trail.index(kept) + 1]
    path.rest, path.state = kept.rest if panels else _surface(target, kept), kept.state
    path.reached = run
    return run


def _optimiser(objective: Reduced, z: PETSc.Vec, radius: float, metric: PETSc.Mat | None) -> PETSc.TAO:
    """TAO for the objective, from z on, which it moves; radius: of the first trust region, in the metric, which
    preconditions the products, or the plain norm."""
    tao = PETSc.TAO().create(comm=objective.problem.comm)
    tao.setOptionsPrefix("inverse_")
    tao.setType(PETSc.TAO.Type.NTR)
    tao.setObjectiveGradient(lambda _tao, z, g: objective.evaluate(z, g), z.duplicate())
    hessian = PETSc.Mat().createPython((z.getSizes(), z.getSizes()), objective, comm=objective.problem.comm)
    hessian.setUp()

    def accepted(_tao: PETSc.TAO, z: PETSc.Vec, _hessian: PETSc.Mat, _preconditioner: PETSc.Mat) -> None:
        objective.simulate(z)
        objective.accept()
        objective.shifted = 0.0

    tao.setHessian(accepted, hessian, metric or hessian)
    tao.setInitialTrustRegionRadius(radius)
    tao.setTolerances(gatol=0.0, grtol=0.0, gttol=1e-6)
    _defaults(tao, PETSc.PC.Type.CHOLESKY if metric else PETSc.PC.Type.NONE)
    tao.setSolution(z)
    return tao


def _defaults(tao: PETSc.TAO, preconditioner: str) -> None:
    """What the options do not say: the trust region's first radius as set; no reduction too small to be judged (TAO
    takes all under 1e-6, and so small are sags of 1e-3); few products."""
    options = PETSc.Options("inverse_")
    for name, value in {"tao_ntr_init_type": "constant", "tao_ntr_epsilon": "1e-30"}.items():
        if not options.hasName(name):
            options.setValue(name, value)
    tao.setFromOptions()
    ksp = tao.getKSP()
    if ksp:
        ksp.setTolerances(rtol=ACCURACY, max_it=PRODUCTS)
        ksp.pc.setType(preconditioner)
        if preconditioner != PETSc.PC.Type.NONE:
            ksp.pc.setFactorSolverType("mumps")
        ksp.setFromOptions()


def _settled(tao: PETSc.TAO, path: AdjointPath, radius: float, before: int, over: Callable[[], bool]) -> None:
    """Converged by default's tests, where the trust region has shrunk, or where it has become slow; else ended where
    time is `over`. before: iterations of the search that it goes on from."""
    iteration, value, gradient, _, reach, _ = tao.getSolutionStatus()
    reason = REASON.CONTINUE_ITERATING
    first = path.steps[0] if path.steps else None
    if not np.isfinite(value) or (first and gradient <= 1e-6 * first.gradient) or value == 0.0:
        reason = REASON.CONVERGED_GTTOL
    elif before + iteration and tao.getType() == PETSc.TAO.Type.NTR and reach < LAST_RADIUS * radius:
        reason = REASON.CONVERGED_STEPTOL
    elif iteration >= tao.getMaximumIterations():
        reason = REASON.DIVERGED_MAXITS
    elif len(path.steps) > LOOK_BACK and value > (1.0 - SLOW) * path.steps[-1 - LOOK_BACK].objective:
        reason = REASON.CONVERGED_STEPTOL
    elif over():
        reason = TIME
    tao.setConvergedReason(reason)
