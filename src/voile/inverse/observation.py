"""An experiment that ended in an observed equilibrium, and its simulation with other parameters."""

from collections.abc import Collection
from dataclasses import replace

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from voile.arrays import Reals
from voile.contact.obstacles import Obstacle
from voile.elastic.weave import STIFFNESSES, restiffened, stiffnesses
from voile.errors import InputError
from voile.inverse.direct import Direct
from voile.inverse.target import Target
from voile.problem.contact import with_obstacles
from voile.problem.problem import Problem
from voile.problem.rest import RestShape, field_vector
from voile.problem.shell import Shell
from voile.solver.linear import Counts, symmetric
from voile.solver.path import StaticsOptions
from voile.solver.statics import solve_statics

FABRIC = ("thickness", "young", "poisson", "density")  # as in Part.fabric
FRICTION = "friction"
ROUND_OFF = 1e-12  # relative: values that are one
STEP = 1e-4  # of the logarithm of a woven fabric's parameter in differences of forces, nearly linear in it
TOP = {"poisson": 0.5}  # what a parameter must stay below


class Observation:
    """A shell let go at the problem's start shape, which comes to rest in the observed one.

    Without obstacles its end does not depend on the way, and simulations start from the last end. With obstacles it
    does: each follows the `steps` load steps from the start shape, where slip is measured from. A shell observed at
    rest, of which no earlier shape is known, starts there: it stays if friction can hold it.
    """

    def __init__(
        self,
        problem: Problem,
        observed: Reals | None = None,
        obstacles: tuple[Obstacle, ...] = (),
        offset: float = 0.0,
        steps: int = 1,
        ruled: Collection[str] = (),
        counts: Counts | None = None,
    ):
        """observed (local vertices, 3) m: the start shape where None; offset (m) from the mid-surface to the surface
        that touches; ruled: stiffnesses of a woven fabric that follow the others by a rule; counts: of the run."""
        self.ruled, self.counts = ruled, counts or Counts()
        self.problem, self.obstacles, self.offset = problem, obstacles, offset
        self.flat, self.woven = problem.flat, bool(problem.part.weave.size)
        self.stiffnesses = stiffnesses(problem.part.weave, *problem.part.fabric[1:3]) if self.woven else {}
        self.rest = RestShape(problem, target=False)
        self.seen = self.rest.is_vertex
        self.count: int = problem.comm.allreduce(int(self.seen.sum()))
        self.steps = steps
        away = 0.0 if observed is None else observed - problem.positions(problem.create_vector())
        self.target = field_vector(problem, away + np.zeros((len(problem.own), 3)))
        self.state: PETSc.Vec | None = None
        self.simulations = 0
        self.stable, self.reason = False, ""  # of the last one's end; why it has none
        self._solver = symmetric(problem.comm, PETSc.KSP.Type.PREONLY, 0.0, self.counts)
        self._tangent = problem.create_matrix()

    # ---- parameters ----

    def value(self, name: str) -> float:
        """A parameter of all of the shell, or of all obstacles. Raises InputError where it has several values or none
        that a search can start from."""
        if name == FRICTION:
            own = np.array([o.friction for o in self.obstacles])
            if not len(own):
                raise InputError("inverse.estimate: friction: the shell touches nothing without [[obstacle]]")
        elif name in STIFFNESSES:
            if name not in self.stiffnesses:
                raise InputError(
                    f"inverse.estimate: {name}: bending follows the thickness; allowed: a fabric with bending "
                    "stiffnesses of its own"
                )
            own = self.stiffnesses[name]
        else:
            own = self.problem.part.fabric[FABRIC.index(name)]
        comm = self.problem.comm
        low = comm.allreduce(float(own.min(initial=np.inf)), op=MPI.MIN)
        high = comm.allreduce(float(own.max(initial=-np.inf)), op=MPI.MAX)
        if high - low > ROUND_OFF * abs(high):
            raise InputError(
                f"inverse.estimate: {name} differs from part to part ({low:g} to {high:g}); allowed: one value"
            )
        if low <= 0.0:
            raise InputError(f"inverse.estimate: the first guess of {name} is {low:g}; allowed: above 0")
        return float(low)

    def set(self, values: dict[str, float]) -> bool:
        """Gives the problem these parameters, with the masses and contacts that they make; False if they are none."""
        if any(values.get(name, 0.0) >= top for name, top in TOP.items()):
            return False
        problem, fabric = self.problem, self.problem.part.fabric
        for name in values.keys() & set(FABRIC):
            fabric[FABRIC.index(name)] = values[name]
        if self.woven:
            names = values.keys() & set(STIFFNESSES)
            given = self.stiffnesses | {name: values[name] for name in names} if names else {}
            if (fabric[2] ** 2 * given.get("young_weft", 0.0) >= fabric[1]).any():
                return False
            ruled = set(self.ruled) - values.keys()
            problem.part.weave = restiffened(
                problem.part.weave, fabric[1], fabric[2], given, fabric[0], ruled
            )
            problem.kernel.set_weave(np.ascontiguousarray(problem.part.weave))
        problem.kernel.set_fabric(*(np.ascontiguousarray(row) for row in fabric[:3]))
        problem.set_rest(problem.part.rest_points, self.flat)
        if FRICTION in values:
            self.obstacles = tuple(replace(o, friction=values[FRICTION]) for o in self.obstacles)
        return True

    def set_rest(self, points: Reals) -> None:
        """Another rest shape: positions (n, 3) m of all vertices of the mesh."""
        self.problem.set_rest(points[self.problem.part.rest_vertex])

    # ---- what they lead to ----

    def simulate(self, accuracy: float) -> PETSc.Vec | None:
        """The equilibrium with the present parameters, residual under `accuracy` of the loads; None where there is
        none."""
        problem = self.problem = with_obstacles(self.problem, list(self.obstacles), self.offset)
        start = None if self.obstacles else self.state
        steps = self.steps if start is None else 1
        self.simulations += 1
        options = StaticsOptions(load_steps=steps, tolerance=accuracy)
        path = solve_statics(problem, options, start=start, counts=self.counts)
        problem.reset_origin(path.state)
        self.stable, self.reason = bool(path.stable), "" if path.converged else path.reason
        if not path.converged:
            return None
        self.state = path.state.copy()
        return self.state

    def missed(self, y: PETSc.Vec) -> Reals:
        """(own unknowns,) of a state y less the observed displacements (m); zero for director angles."""
        return np.where(self.seen, y.array_r - self.target.array_r, 0.0)

    def slopes(self, y: PETSc.Vec, values: dict[str, float]) -> Reals:
        """(own unknowns, k) change of an equilibrium without contact by the logarithms of parameters, -K^-1 dR/dp."""
        self.problem.tangent(y, self._tangent)
        self._solver.factor(self._tangent)
        columns = []
        for name, value in values.items():
            if self.woven:
                slope = self._change(y, values, name)
            else:
                slope = self.rest.fabric_derivative(y, name)
                slope.scale(value)
            moved = slope.duplicate()
            self._solver.solve(slope, moved)
            columns.append(np.where(self.seen, -moved.array_r, 0.0))
        return np.stack(columns, axis=1)

    def _change(self, y: PETSc.Vec, values: dict[str, float], name: str) -> PETSc.Vec:
        """Change of the residual (N) at a state by the logarithm of a parameter, by central differences of forces."""
        total = self.problem.create_vector()
        for step in (STEP, -STEP):
            self.set(values | {name: values[name] * np.exp(step)})
            residual = self.problem.create_vector()
            self.problem.residual(y, residual)
            total.axpy(0.5 / step, residual)
        self.set(values)
        return total


class UnknownRest:
    """The rest shape for which an observed equilibrium without contact, taken as exact, stands: a function of the
    parameters, by the direct method."""

    def __init__(self, problem: Problem, shell: Shell | None, counts: Counts | None = None):
        """The problem's start shape (shell: rank 0's) is the observed one; counts: of the run. Raises NotConverged
        where nothing holds it or round-off hides the loads."""
        self.observation = Observation(problem, counts=counts)
        self._direct = Direct(Target(problem, shell, [], 0.0, problem.size(), counts=counts))
        self._direct.check_round_off()
        self._last: PETSc.Vec | None = None

    def find(self, values: dict[str, float]) -> Reals | None:
        """(n, 3) m on every rank, of all vertices of the mesh; None where there is no stable answer."""
        problem, target = self.observation.problem, self._direct.target
        if not self.observation.set(values):
            return None
        path = self._direct.follow(guess=self._last)
        if not path.converged:
            return None
        self._last = path.rest
        own, rest = problem.part.owned_vertices, target.x + problem.motion(path.rest)
        pieces = problem.comm.allgather((problem.part.vertex[own], rest[own]))
        index, points = (np.concatenate(part) for part in zip(*pieces, strict=True))
        found: Reals | None = points[np.argsort(index)]
        return found
