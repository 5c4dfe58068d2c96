"""How stiffly a model without director angles bends and stretches a mesh, beside the plate of its E, nu and h."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.linalg import eigvalsh
from scipy.sparse.linalg import splu

from voile.arrays import Flags, Ints, Reals, border_sides, triangle_areas, triangle_sides
from voile.elastic.evaluate import evaluate

DIRECTIONS = 6  # of 180 degrees


@dataclass(frozen=True)
class Stiffness:
    """Quadratic forms (3, 3) of the curvatures xx, yy, xy of a flat mesh, or of its strains: twice the energy of the
    mesh bent or stretched so, and of the plate that it stands for."""

    mesh: Reals
    plate: Reals

    def of_cylinders(self) -> tuple[float, float]:
        """Least and largest ratio of both where the curvature is that of a cylinder, along several directions."""
        angle = np.pi / DIRECTIONS * np.arange(DIRECTIONS)
        bent = np.array([np.cos(angle) ** 2, np.sin(angle) ** 2, np.cos(angle) * np.sin(angle)])
        ratios = (bent * (self.mesh @ bent)).sum(axis=0) / (bent * (self.plate @ bent)).sum(axis=0)
        return float(ratios.min()), float(ratios.max())

    def of_all(self) -> tuple[float, float]:
        """The same over all curvatures or strains: domes and saddles too."""
        ratios = eigvalsh(self.mesh, self.plate)
        return float(ratios[0]), float(ratios[-1])


class FlatMesh:
    """A mesh (n, 3), z = 0, of triangles (m, 3) with thickness (m), young (Pa), poisson each; model: what `evaluate`
    takes of it."""

    def __init__(
        self,
        points: Reals,
        triangles: Ints,
        *,
        thickness: Reals,
        young: Reals,
        poisson: Reals,
        model: Mapping[str, str],
    ):
        self.points, self.triangles = points - points.mean(axis=0), triangles
        self.thickness, self.young, self.poisson = thickness, young, poisson
        fabric = {"thickness": thickness, "young": young, "poisson": poisson}
        x = self.points
        found = evaluate(x, x, triangles, hessian=True, **fabric, **model)  # type: ignore[arg-type]  # text alone
        self.hessian: Any = found.hessian
        self.inside = _inside(triangles, len(points))

    def bending(self) -> Stiffness:
        """How stiffly it bends; small deflections.

        The deflection is quadratic at the border and next to it; inside it is the one of least energy, as in
        equilibrium."""
        x, upright = self.points, 3 * np.arange(len(self.points)) + 2
        deflection = np.column_stack([0.5 * x[:, 0] ** 2, 0.5 * x[:, 1] ** 2, x[:, 0] * x[:, 1]])
        return Stiffness(
            self._form(upright, deflection, self.inside), self._plate(self.thickness**3 / 12.0, 2.0)
        )

    def stretching(self) -> Stiffness:
        """As `bending`, of strains xx, yy and the shear angle xy in the plane, beside plane stress."""
        x = self.points
        level = np.flatnonzero(np.arange(3 * len(x)) % 3 < 2)
        moved = np.zeros((len(x), 2, 3))
        moved[:, 0, 0], moved[:, 1, 1], moved[:, 0, 2] = x[:, 0], x[:, 1], x[:, 1]
        form = self._form(level, moved.reshape(-1, 3), np.repeat(self.inside, 2))
        return Stiffness(form, self._plate(self.thickness, 0.5))

    def _form(self, unknowns: Ints, fields: Reals, inside: Flags) -> Reals:
        """(3, 3) twice the energy of three fields (k, 3) of the unknowns (k,), which give way inside."""
        hessian = self.hessian[unknowns][:, unknowns].tocsc()
        if inside.any():
            fields[inside] -= splu(hessian[inside][:, inside]).solve((hessian @ fields)[inside])
        form: Reals = fields.T @ (hessian @ fields)
        return form

    def _plate(self, section: Reals, twist: float) -> Reals:
        """The plate's form; section (m,): of the thickness; twist: its last entry over the stiffness less Poisson's
        share."""
        area = triangle_areas(self.points, self.triangles)
        stiffness = area * (self.young * section / (1.0 - self.poisson**2))
        whole, side = stiffness.sum(), stiffness @ self.poisson
        return np.array([[whole, side, 0.0], [side, whole, 0.0], [0.0, 0.0, twist * (whole - side)]])


def _inside(triangles: Ints, count: int) -> Flags:
    """(n,) marks the vertices that no edge joins to the border."""
    border, sides = np.zeros(count, dtype=bool), triangle_sides(triangles)
    border[border_sides(triangles)] = True
    near = border.copy()
    near[sides[border[sides].any(axis=1)]] = True
    return ~near
