"""The forces of a step in time, and its problem: what balances inertia."""

from dataclasses import dataclass

import numpy as np

from voile.arrays import Flags, Ints, Reals
from voile.problem.damping import Air, Damping, Viscous, Wind
from voile.problem.elastic import Elastic
from voile.problem.inertia import Dead, Inertia
from voile.problem.mean import END, MeanElastic, MeanTerm, Nodes
from voile.problem.problem import Problem
from voile.problem.terms import Point, Term
from voile.solver.stepping.schemes import Kinematics, Prediction, Scheme


@dataclass
class StepForces:
    """Of a step of `scheme` over h (s) from the point `start`, with the kinematics before; problem: at the step's end.

    The elastic force and springs' at the start count by `first`: `began` (dofs,) N. Stiffness damping acts on the
    elastic force's mean rate over the step: share (F(x) - F_n), share = b / h.
    """

    problem: Problem
    scheme: Scheme
    h: float
    start: Point
    before: Kinematics
    damping: Damping
    air: Air | None

    def __post_init__(self) -> None:
        problem, early = self.problem, self.scheme.early
        nodes = tuple((s, weight) for s, weight in self.scheme.nodes if s)
        self.first = sum(weight for s, weight in self.scheme.nodes if not s)
        self.elastic = self._mean(nodes)
        self.springs = problem.springs
        if nodes != END:
            self.springs = tuple(MeanTerm(term, self.start, nodes) for term in problem.springs)
        self.share, self.lag = self.damping.stiffness / self.h, np.zeros(problem.part.matrix.shape[0])
        self.lag_work = 0.0
        self.late, dead = problem.loads, self.lag
        self.early = early * problem.loads.forces(self.start) if early else dead
        self.began = np.zeros_like(self.lag)
        if self.first:  # directors follow at every instant
            count = problem.layout.vertices
            self.early[count:] = 0.0
            terms = (problem.elastic, *problem.springs)
            self.began[:count] = self.first * sum(term.forces(self.start)[:count] for term in terms)
            dead = dead + self.began
        if early:
            self.late, dead = problem.loads.scaled(1.0 - early), dead + self.early
        damped = self.elastic
        if self.share:
            self.lag = self.share * problem.elastic.forces(self.start)
            turned = problem.elastic.clamp_work(self.start, self.start.time, problem.time)
            self.lag_work = self.share * turned
            damped, dead = self._mean(_with_end(nodes, self.share)), dead - self.lag
        if early and problem.loads.moments:  # whose Hessian comes with that of the kernel at the end
            damped = self._mean(_with_end(nodes, self.share))
        constant = [Dead(dead, self._own())] if early or self.share else []
        self.given = problem.with_means(damped, self.late, self.springs, *constant)

    def balance(self, prediction: Prediction) -> Problem:
        """The step's problem."""
        problem = self.problem
        inertia = Inertia(problem.vertex_mass(), problem.own, prediction.coefficient, prediction.predicted)
        return self.given.with_terms(inertia, *self.resisting(prediction))

    def resisting(self, prediction: Prediction) -> list[Term]:
        """What depends on velocities: the air and mass damping."""
        problem, k, terms = self.problem, self.before, list[Term]()
        rate, still = prediction.flow(k.velocity)
        if self.air:
            terms.append(Wind.at(problem.part, self.air, k.positions, rate, still))
        if self.damping.mass:
            terms.append(Viscous(problem.vertex_mass(), problem.own, self.damping.mass * rate, still))
        return terms

    def loads(self, at: Point) -> Reals:
        """(dofs,) N, where the step ends at a point."""
        return self.late.forces(at) + self.early

    def resistance(self, at: Point, prediction: Prediction) -> Reals:
        """(dofs,) N of the air and of all damping."""
        total = sum((term.forces(at) for term in self.resisting(prediction)), np.zeros_like(self.lag))
        if self.share:
            total += self.share * self.problem.elastic.forces(at) - self.lag
        return total

    def clamp_work(self, at: Point) -> tuple[float, float]:
        """What the clamps that rotate work on this rank against the elastic force, and against its damping (J)."""
        since, until = self.start.time, at.time
        damping = 0.0
        if self.share:
            damping = self.share * self.problem.elastic.clamp_work(at, since, until) - self.lag_work
        at_start = (
            self.first * self.problem.elastic.clamp_work(self.start, since, until) if self.first else 0.0
        )
        return at_start + self.elastic.clamp_work(at, since, until), damping

    def clamp_moments(self, at: Point) -> tuple[Ints, Reals]:
        """Elastic.clamp_moments of the step's elastic force and its damping, where the step ends at a point."""
        row, moments = self.elastic.clamp_moments(at)
        if self.share:
            moments = moments + self.share * self.problem.elastic.clamp_moments(at)[1]
        if self.first or self.share:
            moments = moments + (self.first - self.share) * self.problem.elastic.clamp_moments(self.start)[1]
        return row, moments

    def wind_work(self, at: Point, prediction: Prediction) -> float:
        """What the moving air works on this rank (J)."""
        wind = [term for term in self.resisting(prediction) if isinstance(term, Wind)]
        return sum(term.given(at, self.h) for term in wind)

    def _mean(self, nodes: Nodes) -> Elastic | MeanElastic:
        elastic = self.problem.elastic
        return elastic if nodes == END else MeanElastic(elastic, self.start, nodes)

    def _own(self) -> Flags:
        """(dofs,) marks what is counted on this rank."""
        part, own = self.problem.part, np.zeros(len(self.lag), dtype=bool)
        count = len(own) - len(part.edge)
        own[:count] = self.problem.own_dofs()
        own[count + part.owned_edges] = True
        return own


def _with_end(nodes: Nodes, weight: float) -> Nodes:
    """Nodes with another one at the end."""
    if nodes == END:
        return ((1.0, 1.0 + weight),)
    return (*nodes, (1.0, weight))
