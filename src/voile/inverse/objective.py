"""What the adjoint method minimises: a sum of objectives, each one class behind one interface.

An objective is a function J(y, z) of the equilibrium y (displacements from the target, director angles) and of the
design z, on the unknowns of either. It gives its value, its two gradients, and products with the two diagonal parts of
a positive semidefinite Hessian, that of Gauss and Newton. How y depends on z is none of its business: see reduced.py.
"""

from petsc4py import PETSc

from voile.inverse.developable import DevelopableRest
from voile.inverse.target import Target
from voile.problem.rest import PanelRest, RestShape

Design = RestShape | PanelRest | DevelopableRest


class Objective:
    """The interface. One that does not depend on y, or on z, leaves the methods `by_` and `along_` it as they are."""

    def value(self, y: PETSc.Vec, z: PETSc.Vec) -> float:
        """J(y, z)."""
        raise NotImplementedError

    def by_state(self, y: PETSc.Vec, z: PETSc.Vec) -> PETSc.Vec:
        """dJ/dy."""
        return _zero(y)

    def by_design(self, y: PETSc.Vec, z: PETSc.Vec) -> PETSc.Vec:
        """dJ/dz at fixed y."""
        return _zero(z)

    def along_state(self, dy: PETSc.Vec) -> PETSc.Vec:
        """(d2J/dy2) dy, where the objective was evaluated last."""
        return _zero(dy)

    def along_design(self, dz: PETSc.Vec) -> PETSc.Vec:
        """(d2J/dz2) dz, where the objective was evaluated last."""
        return _zero(dz)


class Distance(Objective):
    """|y|^2_M / (2 M L^2): the mean square distance from the target over its size L, M the lumped mass."""

    def __init__(self, target: Target):
        self.weight = target.rest.weight()
        self.weight.scale(1.0 / target.problem.size() ** 2)

    def value(self, y: PETSc.Vec, z: PETSc.Vec) -> float:
        return float(0.5 * y.dot(scaled(self.weight, y)))

    def by_state(self, y: PETSc.Vec, z: PETSc.Vec) -> PETSc.Vec:
        return scaled(self.weight, y)

    def along_state(self, dy: PETSc.Vec) -> PETSc.Vec:
        return scaled(self.weight, dy)


class Change(Objective):
    """factor |z - home|^2_M / (2 M L^2): the mean square change of the rest shape, in the design's metric."""

    def __init__(self, target: Target, design: Design, home: PETSc.Vec, factor: float):
        self.home, self.factor = home.copy(), factor
        self.metric = design.weight()
        self.metric.scale(1.0 / target.problem.size() ** 2)

    def value(self, y: PETSc.Vec, z: PETSc.Vec) -> float:
        change = z - self.home
        return float(0.5 * self.factor * change.dot(scaled(self.metric, change)))

    def by_design(self, y: PETSc.Vec, z: PETSc.Vec) -> PETSc.Vec:
        return self.along_design(z - self.home)

    def along_design(self, dz: PETSc.Vec) -> PETSc.Vec:
        slope = scaled(self.metric, dz)
        slope.scale(self.factor)
        return slope


def nearness(target: Target, design: Design, home: PETSc.Vec, regularisation: float) -> list[Objective]:
    """Near the target, with a rest shape near `home`: the objectives of inverse design."""
    return [Distance(target), Change(target, design, home, regularisation)]


def scaled(weight: PETSc.Vec, v: PETSc.Vec) -> PETSc.Vec:
    """The entries of v times those of the weight."""
    out = v.duplicate()
    out.pointwiseMult(weight, v)
    return out


def _zero(v: PETSc.Vec) -> PETSc.Vec:
    out = v.duplicate()
    out.set(0.0)
    return out
