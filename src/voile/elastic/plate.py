"""How stiffly a model without director angles bends a mesh, beside the plate of its E, nu and h."""

from collections.abc import Mapping

import numpy as np
from scipy.sparse.linalg import splu

from voile.arrays import Flags, Ints, Reals
from voile.elastic.evaluate import evaluate

DIRECTIONS = 6  # of 180 degrees


def plate_stiffness(
    points: Reals,
    triangles: Ints,
    *,
    thickness: Reals,
    young: Reals,
    poisson: Reals,
    model: Mapping[str, str],
) -> tuple[float, float]:
    """Least and largest energy of a flat mesh (n, 3), z = 0, bent to cylinders along several directions, over that of
    a plate, E h^3 / (12 (1 - nu^2)) / 2 per curvature squared and area; small deflections.

    The deflection is a parabola at the border and next to it; inside it is the one of least energy, as in
    equilibrium. Per triangle thickness (m), young (Pa), poisson; model: what `evaluate` takes of it.
    """
    x = points - points.mean(axis=0)
    fabric = {"thickness": thickness, "young": young, "poisson": poisson}
    flat = evaluate(x, x, triangles, hessian=True, **fabric, **model)  # type: ignore[arg-type]  # text alone
    assert flat.hessian is not None
    upright = 3 * np.arange(len(x)) + 2
    bends = flat.hessian[upright][:, upright].tocsc()
    corner = x[triangles]
    area = 0.5 * np.linalg.norm(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]), axis=1)
    plate = float(area @ (young * thickness**3 / (12.0 * (1.0 - poisson**2))))
    inside = _inside(triangles, len(x))
    factor = splu(bends[inside][:, inside]) if inside.any() else None
    ratios = []
    for angle in np.pi / DIRECTIONS * np.arange(DIRECTIONS):
        deflection = 0.5 * (x[:, 0] * np.cos(angle) + x[:, 1] * np.sin(angle)) ** 2
        if factor:
            deflection[inside] -= factor.solve((bends @ deflection)[inside])
        ratios.append(deflection @ (bends @ deflection) / plate)
    return min(ratios), max(ratios)


def _inside(triangles: Ints, count: int) -> Flags:
    """(n,) marks the vertices that no edge joins to the border."""
    sides = np.sort(triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    edges, times = np.unique(sides, axis=0, return_counts=True)
    border = np.zeros(count, dtype=bool)
    border[edges[times == 1]] = True
    near = border.copy()
    near[edges[border[edges].any(axis=1)]] = True
    return ~near
