"""The rest shape nearest to holding the target where the target itself is not stable: the adjoint method in TAO.

    min_z  |x(z) - x_t|^2_M / (2 M L^2)  +  regularisation |z - z_0|^2_M / (2 M L^2),

x(z) the statics of the program itself, M the lumped mass, L the size, z_0 where the search starts. The gradient takes
one transposed solve with the tangent K at the equilibrium and the mixed derivative D = dR/dX; the Hessian is that of
Gauss and Newton, D^T K^-T M K^-1 D, each product a tangent and an adjoint solve with the same factor. Any of TAO's
types for unconstrained problems can be chosen by -inverse_tao_type; trust regions (ntr) are the default, for equilibria
are lost where a step goes too far.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from petsc4py import PETSc

from voile.errors import NotConverged
from voile.inverse.developable import DevelopableRest
from voile.inverse.target import Target
from voile.inverse.verify import Simulation, sag, simulate
from voile.problem.discrete import Problem
from voile.problem.rest import PanelRest, RestShape
from voile.solver.equilibrium import Solver
from voile.solver.linear import negative_pivots
from voile.solver.path import StaticsOptions, tolerance
from voile.solver.statics import solve_statics

PATIENCE = 200  # Newton iterations of one equilibrium
FIRST_RADIUS = 2e-3  # of the trust region: root mean square of the rest shape's change over the size
FIRST_STRAIN = 1e-2  # the same for flat panels: root mean square of their strain
LAST_RADIUS = 1e-4  # of the first one: no step improves
SLOW, LOOK_BACK = 0.05, 4  # settled when so many iterations decreased the objective by less than this share
PRODUCTS, ACCURACY = 40, 1e-2  # of conjugate gradients in one iteration
REASON = getattr(PETSc.TAO, "ConvergedReason", None) or PETSc.TAO.Reason  # newer and older petsc4py
NEAR = 2.0  # sags of an answer beside the target: a simulation that stays there
TRIED = 6  # iterates of panels that a simulation from the target does not end in
UNREACHABLE = 1e10  # the objective where no equilibrium is found


@dataclass
class AdjointStep:
    """An iteration of TAO: objective, norm of its gradient, sag over the size."""

    iteration: int
    objective: float
    gradient: float
    sag: float


@dataclass(eq=False)
class Iterate:
    """Design variables, the equilibrium that the search found for them, and its sag over the size."""

    rest: PETSc.Vec
    state: PETSc.Vec
    sag: float


@dataclass
class AdjointPath:
    """The best iterate: rest displacements with the director angles of their equilibrium `state`, the last of the
    `trail` of ever better ones; reason: TAO's."""

    rest: PETSc.Vec
    state: PETSc.Vec
    steps: list[AdjointStep] = field(default_factory=list)
    forward_solves: int = 0
    adjoint_solves: int = 0
    reason: int = 0
    trail: list[Iterate] = field(default_factory=list)


Progress = Callable[[AdjointStep], None]
Design = RestShape | PanelRest | DevelopableRest


class Forward:
    """Equilibria under the full load from nearby ones, with one solver for all."""

    def __init__(self, problem: Problem, accuracy: float):
        """accuracy: residual over the loads' norm."""
        self.problem, self.options = problem, StaticsOptions(tolerance=accuracy)
        self.solver, self.solves = Solver(problem, self.options), 0

    def solve(self, y: PETSc.Vec) -> bool:
        """y moves to an equilibrium that descent reaches from it; False where it does not."""
        problem = self.problem
        self.solves += 1
        problem.load_factor = 1.0
        wanted = tolerance(problem, y, self.options)
        if problem.contact:
            found = self.solver.solve(y, wanted, last_resort=False).converged
            problem.unbase(y)
            return found
        return self.solver.descent.run(problem, y, wanted, PATIENCE)

    def search(self, y: PETSc.Vec) -> bool:
        """y moves to the equilibrium that statics find from it by all means; False where they do not."""
        path = solve_statics(self.problem, replace(self.options, load_steps=1), start=y)
        self.problem.unbase(path.state)
        path.state.copy(y)
        return path.converged


class Objective:
    """Distance of the simulation from the target as a function of the rest shape, with derivatives, and the Python
    context of its Hessian. The target must be `obstructed`."""

    def __init__(
        self,
        target: Target,
        design: Design,
        home: PETSc.Vec,
        start: PETSc.Vec,
        regularisation: float = 0.0,
        accuracy: float = 1e-8,
    ):
        """home: z_0; start: state that the first simulation starts from; regularisation: weight of the rest shape's
        change; accuracy of statics: residual over the loads' norm."""
        self.target, self.problem, self.design = target, target.problem, design
        self.home, self.regularisation = home.copy(), regularisation
        problem = self.problem
        self.weight, self.metric = target.rest.weight(), design.weight()
        for weight in (self.weight, self.metric):
            weight.scale(1.0 / problem.size() ** 2)
        self.tangent = problem.create_matrix()
        self.factors = {symmetric: _factor(problem.comm, symmetric) for symmetric in (True, False)}
        self.factor = self.factors[True]
        self.forward, self.adjoint_solves = Forward(problem, accuracy), 0
        self.start = start.copy()  # of every simulation: see `accept`
        self.began = problem.contact.state.copy() if problem.contact else None
        self.state = self.start.copy()
        self.at: PETSc.Vec | None = None
        self.best = math.inf  # objective of the last of the trail
        self.trail: list[Iterate] = []  # the best so far, one after the other
        self.shifted = 0.0  # multiple of the identity in the Hessian

    # ---- the map from rest shape to equilibrium ----

    def simulate(self, z: PETSc.Vec) -> bool:
        """The equilibrium of rest shape z from `start`; `state` stays where there is none. Raises NotConverged where
        the first one is not found."""
        if self.at is not None and self.at.equal(z):
            return True
        first = self.at is None
        try:
            self.design.set(z)
        except NotConverged:  # no developable shape is near
            if first:
                raise
            return False
        broken = self.target.bounds.broken(self.design)
        if broken:
            if first:
                raise NotConverged(f"adjoint method: where it starts, {broken}")
            return False
        y, contact = self.start.copy(), self.problem.contact
        if contact and self.began:
            contact.state = self.began.copy()
        found = self.forward.solve(y) or (first and self.forward.search(self.start.copy(y)))
        if not (found and self._linearise(y)):
            if first:
                raise NotConverged("adjoint method: the first simulation, from the target, did not converge")
            self._linearise(self.state)
            return False
        self.state, self.at = y, z.copy()
        return True

    def accept(self) -> None:
        """Simulations start from the present equilibrium from now on; slip is still measured from the target. Those of
        panels start from the target, as a drape does: of two equilibria they show the one that it finds."""
        if isinstance(self.design, PanelRest):
            return
        self.start = self.state.copy()
        if self.problem.contact:
            self.began = self.problem.contact.state.copy()

    def _linearise(self, y: PETSc.Vec) -> bool:
        """Factors the tangent at the equilibrium y, which leaves a saddle first; False where there is none beside."""
        problem = self.problem
        if problem.contact:  # whose solver has left saddles
            linear = problem.contact.linearise(problem.positions(y), problem.load_factor)
            problem.tangent(y, self.tangent, "exact", linear.blocks())
            symmetric = problem.everywhere(linear.symmetric)
        else:
            problem.tangent(y, self.tangent)
            symmetric = True
        self.factor = self.factors[symmetric]
        self.factor.setOperators(self.tangent)
        self.factor.setUp()
        if not problem.contact and negative_pivots(self.factor):
            if not self.forward.search(y):
                return False
            problem.tangent(y, self.tangent)
            self.factor.setUp()
            if negative_pivots(self.factor):
                return False
        self.design.linearise(y)
        return True

    # ---- what TAO asks ----

    def evaluate(self, z: PETSc.Vec, gradient: PETSc.Vec) -> float:
        """The objective and its gradient; UNREACHABLE, with the last equilibrium's gradient, where z has none."""
        found = self.simulate(z)
        missed, change = _scaled(self.weight, self.state), z - self.home
        changed = _scaled(self.metric, change)
        value = 0.5 * self.state.dot(missed) + 0.5 * self.regularisation * change.dot(changed)
        self._pull(missed).copy(gradient)
        gradient.axpy(self.regularisation, changed)
        if found and value < self.best:
            self.best = value
            self.trail.append(Iterate(z.copy(), self.state.copy(), sag(self.target, self.state)))
        return value if found else UNREACHABLE

    def mult(self, _matrix: PETSc.Mat, v: PETSc.Vec, out: PETSc.Vec) -> None:
        """The Gauss-Newton Hessian times v; the identity on entries that are no design variables."""
        image = self.design.push(v)
        moved = image.duplicate()
        self.factor.apply(image, moved)  # K^-1 D v: the equilibrium moves by its opposite
        self.adjoint_solves += 1
        self._pull(_scaled(self.weight, moved)).copy(out)
        out.scale(-1.0)
        out.axpy(self.regularisation, _scaled(self.metric, v))
        idle = self.design.idle()
        out.array[idle] = v.array_r[idle]
        out.axpy(self.shifted, v)

    def shift(self, _matrix: PETSc.Mat, by: float) -> None:
        """Adds a multiple of the identity to the Hessian, until the next one."""
        self.shifted += by

    def _pull(self, v: PETSc.Vec) -> PETSc.Vec:
        """-D^T K^-T v."""
        adjoint = v.duplicate()
        self.factor.applyTranspose(v, adjoint)
        self.adjoint_solves += 1
        out = self.design.pull(adjoint)
        out.scale(-1.0)
        return out


def _scaled(weight: PETSc.Vec, v: PETSc.Vec) -> PETSc.Vec:
    out = v.duplicate()
    out.pointwiseMult(weight, v)
    return out


def _factor(comm, symmetric: bool) -> PETSc.PC:
    """LDL^T (its inertia tells a saddle) or, where something slips, LU."""
    pc = PETSc.PC().create(comm=comm)
    pc.setOptionsPrefix("adjoint_")
    pc.setType(PETSc.PC.Type.CHOLESKY if symmetric else PETSc.PC.Type.LU)
    pc.setFactorSolverType("mumps")
    pc.setFromOptions()
    return pc


def minimise(
    target: Target,
    start: PETSc.Vec,
    regularisation: float,
    iterations: int,
    accuracy: float = 1e-8,
    on_step: Progress | None = None,
    design: Design | None = None,
) -> AdjointPath:
    """The rest shape whose simulation is nearest to the target, from `start` on: design variables, by default rest
    displacements with director angles. Ends when it settles, or after so many iterations of TAO."""
    problem = target.problem
    design = design or target.rest
    surface = not isinstance(design, PanelRest)
    with target.obstructed():
        state = target.rest.state(start) if surface else problem.create_vector()
        objective = Objective(target, design, start, state, regularisation, accuracy)
        z, path = start.copy(), AdjointPath(start, start)
        metric = design.metric() if isinstance(design, PanelRest) else None
        radius = FIRST_STRAIN if metric else FIRST_RADIUS * problem.size() * math.sqrt(z.getSize())
        tao = _optimiser(objective, z, radius, metric)
        tao.setMaximumIterations(iterations)
        tao.setMonitor(lambda tao: _note(tao, objective, path, on_step))
        tao.setConvergenceTest(lambda tao: _settled(tao, path, radius))
        try:
            tao.solve()
            path.reason = tao.getConvergedReason()
        finally:
            tao.destroy()  # calls back to what holds it
    path.trail = objective.trail
    path.rest, path.state = path.trail[-1].rest.copy(), path.trail[-1].state
    design.set(path.rest)
    if surface:
        path.rest.array[~target.rest.is_vertex] = path.state.array_r[~target.rest.is_vertex]
    path.forward_solves, path.adjoint_solves = objective.forward.solves, objective.adjoint_solves
    return path


def keep_what_is_reached(target: Target, path: AdjointPath, accuracy: float, panels: PanelRest) -> Simulation:
    """Leaves in the path the last iterate in whose equilibrium a simulation from the target ends, or of the last few
    the one that ends nearest: the search's short simulations may end elsewhere than statics do. That simulation."""
    runs: list[tuple[Iterate, Simulation]] = []
    for iterate in path.trail[: -1 - TRIED : -1]:
        run = simulate(target, iterate.rest, accuracy, panels=panels, eigenvalue=True)
        runs.append((iterate, run))
        if run.stable and run.sag <= NEAR * iterate.sag:
            break
    kept, run = min(runs, key=lambda pair: (not pair[1].stable, pair[1].sag))
    path.trail = path.trail[: path.trail.index(kept) + 1]
    path.rest, path.state = kept.rest, kept.state
    return run


def _optimiser(objective: Objective, z: PETSc.Vec, radius: float, metric: PETSc.Mat | None) -> PETSc.TAO:
    """TAO for the objective, from z on, which it moves; radius: of the first trust region, in the metric, which
    preconditions the products, or the plain norm."""
    tao = PETSc.TAO().create(comm=objective.problem.comm)
    tao.setOptionsPrefix("inverse_")
    tao.setType(PETSc.TAO.Type.NTR)
    tao.setObjectiveGradient(lambda _tao, z, g: objective.evaluate(z, g), z.duplicate())
    hessian = PETSc.Mat().createPython((z.getSizes(), z.getSizes()), objective, comm=objective.problem.comm)
    hessian.setUp()

    def accepted(_tao, z, _hessian, _preconditioner) -> None:
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


def _note(tao: PETSc.TAO, objective: Objective, path: AdjointPath, on_step: Progress | None) -> None:
    iteration, value, gradient = tao.getSolutionStatus()[:3]
    if path.steps and path.steps[-1].iteration == iteration:
        return  # a trial that was rejected
    path.steps.append(AdjointStep(iteration, value, gradient, objective.trail[-1].sag))
    if on_step:
        on_step(path.steps[-1])


def _settled(tao: PETSc.TAO, path: AdjointPath, radius: float) -> None:
    """Converged by default's tests, where the trust region has shrunk, or where it has become slow."""
    iteration, value, gradient, _, reach, _ = tao.getSolutionStatus()
    reason = REASON.CONTINUE_ITERATING
    first = path.steps[0] if path.steps else None
    if not np.isfinite(value) or (first and gradient <= 1e-6 * first.gradient) or value == 0.0:
        reason = REASON.CONVERGED_GTTOL
    elif iteration and tao.getType() == PETSc.TAO.Type.NTR and reach < LAST_RADIUS * radius:
        reason = REASON.CONVERGED_STEPTOL
    elif iteration >= tao.getMaximumIterations():
        reason = REASON.DIVERGED_MAXITS
    elif len(path.steps) > LOOK_BACK and value > (1.0 - SLOW) * path.steps[-1 - LOOK_BACK].objective:
        reason = REASON.CONVERGED_STEPTOL
    tao.setConvergedReason(reason)
