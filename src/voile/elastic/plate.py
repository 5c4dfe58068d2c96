"""How stiffly a model without director angles bends a mesh, beside the plate of its E, nu and h."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.linalg import eigvalsh
from scipy.sparse.linalg import splu

from voile.arrays import Flags, Ints, Reals, triangle_areas, triangle_sides
from voile.elastic.evaluate import evaluate

DIRECTIONS = 6  # of 180 degrees


@dataclass(frozen=True)
class Bending:
    """Quadratic forms (3, 3) of the curvatures xx, yy, xy of a flat mesh: twice the energy of the mesh bent so, and of
    the plate that it stands for."""

    mesh: Reals
    plate: Reals

    def of_cylinders(self) -> tuple[float, float]:
        """Least and largest ratio of both where the curvature is that of a cylinder, along several directions."""
        angle = np.pi / DIRECTIONS * np.arange(DIRECTIONS)
        bent = np.array([np.cos(angle) ** 2, np.sin(angle) ** 2, np.cos(angle) * np.sin(angle)])
        ratios = (bent * (self.mesh @ bent)).sum(axis=0) / (bent * (self.plate @ bent)).sum(axis=0)
        return float(ratios.min()), float(ratios.max())

    def of_all(self) -> tuple[float, float]:
        """The same over all curvatures: domes and saddles too."""
        ratios = eigvalsh(self.mesh, self.plate)
        return float(ratios[0]), float(ratios[-1])


def bending_of(
    points: Reals,
    triangles: Ints,
    *,
    thickness: Reals,
    young: Reals,
    poisson: Reals,
    model: Mapping[str, str],
) -> Bending:
    """How stiffly a flat mesh (n, 3), z = 0, bends; small deflections.

    The deflection is quadratic at the border and next to it; inside it is the one of least energy, as in equilibrium.
    Per triangle thickness (m), young (Pa), poisson; model: what `evaluate` takes of it.
    """
    x = points - points.mean(axis=0)
    fabric = {"thickness": thickness, "young": young, "poisson": poisson}
    flat = evaluate(x, x, triangles, hessian=True, **fabric, **model)  # type: ignore[arg-type]  # text alone
    assert flat.hessian is not None
    upright = 3 * np.arange(len(x)) + 2
    bends = flat.hessian[upright][:, upright].tocsc()
    area = triangle_areas(x, triangles)
    stiffness = area * (young * thickness**3 / (12.0 * (1.0 - poisson**2)))
    whole, side = stiffness.sum(), stiffness @ poisson
    plate = np.array([[whole, side, 0.0], [side, whole, 0.0], [0.0, 0.0, 2.0 * (whole - side)]])
    deflection = np.column_stack([0.5 * x[:, 0] ** 2, 0.5 * x[:, 1] ** 2, x[:, 0] * x[:, 1]])
    inside = _inside(triangles, len(x))
    if inside.any():
        deflection[inside] -= splu(bends[inside][:, inside]).solve((bends @ deflection)[inside])
    return Bending(deflection.T @ (bends @ deflection), plate)


def _inside(triangles: Ints, count: int) -> Flags:
    """(n,) marks the vertices that no edge joins to the border."""
    edges, times = np.unique(triangle_sides(triangles), axis=0, return_counts=True)
    border = np.zeros(count, dtype=bool)
    border[edges[times == 1]] = True
    near = border.copy()
    near[edges[border[edges].any(axis=1)]] = True
    return ~near
