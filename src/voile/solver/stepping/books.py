"""Where energy goes in time: what a step's forces work over h (v_n + v_n+1) / 2.

Over that way the inertia works exactly the change of the kinetic energy in implicit Euler's steps, impacts included.
What the other parts differ from the change of their energies is the scheme's own dissipation. The books close but for
the work of the residual.
"""

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from petsc4py import PETSc

from voile.arrays import Reals
from voile.contact.pairs import Pairs
from voile.problem.contact import contact_work, measured_pairs
from voile.problem.mean import between
from voile.problem.problem import Problem
from voile.problem.rest import field_vector
from voile.problem.support_forces import Supporting
from voile.problem.terms import Point
from voile.solver.stepping.forces import StepForces
from voile.solver.stepping.schemes import Kinematics, Prediction

TOTALS = (
    "friction_dissipated",
    "impact_dissipated",
    "damping_dissipated",
    "scheme_dissipated",
    "wind_work",
    "supports_work",
    "obstacles_work",
    "loads_work",
)


LOST = ("friction_dissipated", "damping_dissipated")  # beside scheme and impacts, see created


def created(entries: dict[str, float]) -> float:
    """What a step with these entries takes from nowhere (J). Impacts count with the scheme: what lands stops within the
    step, and both are booked along its mean velocity."""
    return entries["error"] - entries["scheme_dissipated"] - entries["impact_dissipated"]


@dataclass
class Ended:
    """A step that ended at the unknowns y with the kinematics `after`, solved to a tolerance (N); lost (J): elastic
    energy at its start."""

    forces: StepForces
    y: PETSc.Vec
    after: Kinematics
    prediction: Prediction
    tolerance: float
    lost: float = 0.0

    @cached_property
    def at(self) -> Point:
        return self.forces.problem.point(self.y)

    @cached_property
    def pairs(self) -> list[Pairs]:
        """Its contacts, as its residual has them: reactions that follow gaps more stiffly have their round-off."""
        return measured_pairs(self.forces.problem, self.after.positions, self.tolerance)

    @cached_property
    def inertia(self) -> Reals:
        """(local vertices, 3) N that move the shell."""
        mass = self.forces.problem.vertex_mass()
        return mass[:, None] * self.prediction.acceleration(self.after.positions)

    @cached_property
    def acting(self) -> dict[str, Reals]:
        """(dofs,) N each."""
        forces, at = self.forces, self.at
        return {
            "elastic": forces.elastic.forces(at)
            + sum((term.forces(at) for term in forces.springs), forces.began),
            "loads": forces.loads(at),
            "damping": forces.resistance(at, self.prediction),
        }

    @cached_property
    def lacking(self) -> Reals:
        """(dofs,) N that move the shell beside all that acts on it: on what is held the supports', else the
        residual."""
        problem, moving = self.forces.problem, self.inertia
        if problem.contact:
            moving = moving - problem.contact.projected(self.pairs)
        dofs = np.concatenate([moving.ravel(), np.zeros(len(problem.part.edge))])
        return sum((-force for force in self.acting.values()), dofs)

    def supporting(self) -> Supporting:
        """What supports and clamps exert on the shell in the step."""
        problem = self.forces.problem
        lacking = self.lacking[: problem.layout.vertices].reshape(-1, 3)
        forces: Reals = np.einsum("nij,nj->ni", problem.kept, lacking)
        return Supporting(forces, *self.forces.clamp_moments(self.at))


@dataclass
class Books:
    """Energies now and what has been dissipated and worked so far (J), by name: those of TOTALS add up. `error`: by how
    much the books do not close; most: that loads and motions, from the start on, have ever let the shell have."""

    problem: Problem
    totals: dict[str, float] = field(default_factory=lambda: dict.fromkeys(TOTALS, 0.0))
    error: float = 0.0
    most: float = 0.0

    @property
    def created(self) -> float:
        """What came from nowhere, see `created` of a step (J)."""
        return created({"error": self.error, **self.totals})

    def kinetic(self, k: Kinematics) -> float:
        """J."""
        square = (k.velocity**2).sum(axis=1)
        return 0.5 * self._sum(self.problem.vertex_mass() * square)

    def momenta(self, k: Kinematics) -> tuple[Reals, Reals]:
        """Momentum (3,) kg m/s and angular momentum about the origin (3,) kg m^2/s."""
        own = self.problem.own
        p = self.problem.vertex_mass()[own, None] * k.velocity[own]
        both = np.concatenate([p.sum(axis=0), np.cross(k.positions[own], p).sum(axis=0)])
        both = self.problem.comm.allreduce(both)
        return both[:3], both[3:]

    def entries(self, step: Ended) -> dict[str, float]:
        """What a step adds to the totals, and to the error (J)."""
        forces, before = step.forces, step.forces.before
        problem, at = forces.problem, step.at
        start = between(forces.start, at, 0.0)
        way = 0.5 * forces.h * (before.velocity + step.after.velocity)
        turned = (at.phi - forces.start.phi) / (1.0 - forces.first)  # directors follow at every instant
        wind = float(problem.comm.allreduce(forces.wind_work(at, step.prediction)))
        clamps, damped = map(float, problem.comm.allreduce(np.array(forces.clamp_work(at))))
        work = {name: self._work(force, way, turned) for name, force in step.acting.items()}
        moved = self._sum((step.inertia * way).sum(axis=1))
        gained = self.kinetic(step.after) - self.kinetic(before)
        stored = self._elastic(at) - self._elastic(start)
        given, potential = work["loads"], -work["loads"]
        if problem.conservative:
            late = replace(start, time=at.time)
            given = self._loads(late) - self._loads(start)
            potential = self._loads(at) - self._loads(late)
        contact = dict.fromkeys(("friction", "impact", "obstacles", "total"), 0.0)
        if problem.contact:
            contact = contact_work(problem, step.pairs, way, before.positions)
        missed = self._residual_work(step, way)
        lost = sum(self.totals[name] for name in LOST)
        return {
            "error": missed,
            "present": self.kinetic(step.after) + self._elastic(at) + lost,
            "friction_dissipated": contact["friction"],
            "impact_dissipated": contact["impact"],
            "damping_dissipated": wind + damped - work["damping"],
            "wind_work": wind,
            "scheme_dissipated": (moved - gained)
            + step.lost
            - (work["elastic"] + stored - clamps)
            - (work["loads"] + potential if problem.conservative else 0.0),
            "supports_work": moved - sum(work.values()) + clamps + damped - contact["total"] - missed,
            "obstacles_work": contact["obstacles"],
            "loads_work": given,
        }

    def enter(self, entries: dict[str, float]) -> None:
        """Books a step's."""
        for name in self.totals:
            self.totals[name] += entries[name]
        self.error += entries["error"]
        self.most = self.let(entries)

    def let(self, entries: dict[str, float]) -> float:
        """`most` after a step with these entries (J)."""
        lost = sum(entries[name] for name in LOST)
        return max(self.most, entries["present"] + lost - self.created - created(entries))

    def _residual_work(self, step: Ended, way: Reals) -> float:
        """Of the residual over the way of what is free (J)."""
        problem = step.forces.problem
        residual, free = problem.create_vector(), field_vector(problem, way)
        residual.array[:] = problem.layout.collect(step.lacking)
        return float(residual.dot(free))

    def _work(self, force: Reals, way: Reals, turned: Reals) -> float:
        """Of a force (dofs,) N over the vertices' way (n, 3) m, and what directors have turned (edges,) rad."""
        moment, edges = force[way.size :], self.problem.part.owned_edges
        by_moments = float(self.problem.comm.allreduce(float(moment[edges] @ turned[edges])))
        return self._sum((force[: way.size].reshape(-1, 3) * way).sum(axis=1)) + by_moments

    def _sum(self, values: Reals) -> float:
        """Over all vertices."""
        return float(self.problem.comm.allreduce(float(values[self.problem.own].sum())))

    def _elastic(self, at: Point) -> float:
        """Energy of the shell and its springs (J)."""
        terms = (self.problem.elastic, *self.problem.springs)
        return float(self.problem.comm.allreduce(sum(sum(term.energies(at).values()) for term in terms)))

    def _loads(self, at: Point) -> float:
        return float(self.problem.comm.allreduce(sum(self.problem.loads.energies(at).values())))
