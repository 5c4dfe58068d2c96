"""Quantities computed from the shapes in a result: strain per triangle, curvature per vertex; stresses at vertices."""

from dataclasses import dataclass

import numpy as np

from voile.arrays import Array, Ints, Reals, area_vectors, row_sums, triangle_areas
from voile.post.edges import boundary_edges, hinges
from voile.post.recovery import TENSORS, described, recovered
from voile.results import Result


@dataclass(frozen=True)
class Quantity:
    """Values at the vertices (location "point") or triangles ("cell") of a shape, with title and SI unit."""

    name: str
    location: str
    values: Array
    unit: str
    title: str


DERIVED = {
    "displacement": ("m", "displacement"),
    "strain": ("", "largest principal Green strain"),
    "curvature": ("1/m", "principal curvature of largest magnitude"),
    "mean_curvature": ("1/m", "mean curvature"),
}

ROUND_OFF = 1e-13  # of a strain: some hundred times that of 1


def quantity(result: Result, name: str, step: int = -1) -> Quantity:
    """A field of the result or a derived one (DERIVED) of a step; what is stored comes first.

    Raises KeyError naming what there is for a name that is neither.
    """
    for location, fields in (
        ("point", result.point_fields),
        ("cell", result.cell_fields + result.computed_fields),
    ):
        if name in fields:
            field = result.describe(name)
            return Quantity(name, location, result.field(name, step), field.unit, field.meaning)
    if name in TENSORS and name in known(result):
        return Quantity(name, "point", recovered(result, name, step), *described(name))
    if name not in DERIVED:
        raise KeyError(f"no field {name!r}; there are {', '.join(known(result))}")
    points = result.points(step)
    if name == "displacement":
        values = points - result.start
    elif name == "strain":
        values = largest_strain(points, result.triangles, result.rest, result.rest_triangles)
    else:
        mean, extreme = vertex_curvature(points, result.triangles)
        values = mean if name == "mean_curvature" else extreme
    return Quantity(name, "cell" if name == "strain" else "point", values, *DERIVED[name])


def unit(name: str) -> str:
    """SI unit of a derived field; "" of others."""
    return described(name)[0] if name in TENSORS else DERIVED.get(name, ("", ""))[0]


def known(result: Result) -> list[str]:
    """Names `quantity` takes for this result."""
    on_triangles = {*result.cell_fields, *result.computed_fields}
    return sorted(
        {*available(result), *on_triangles, *(n for n, of in TENSORS.items() if on_triangles.issuperset(of))}
    )


def available(result: Result) -> list[str]:
    """Those of `known` that the result's file alone tells."""
    return sorted({*DERIVED, *result.point_fields, *result.cell_fields})


def largest_strain(points: Reals, triangles: Ints, rest: Reals, rest_triangles: Ints) -> Reals:
    """(m,) larger principal Green strain (F^T F - I)/2, F from the flat rest triangle to the one in space.

    points (n, 3), triangles (m, 3), rest (nr, 3), rest_triangles (m, 3). A rest triangle without area has
    none: NaN. What round-off leaves, under 1e-13, is 0: pictures of a start would show nothing but that.
    """
    corners, home = points[triangles], rest[rest_triangles]
    d1, d2 = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    e1, e2 = home[:, 1] - home[:, 0], home[:, 2] - home[:, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        width = np.linalg.norm(
            e1, axis=1
        )  # the rest triangle in its own frame: (0, 0), (width, 0), (shear, height)
        shear = (e1 * e2).sum(1) / width
        height = np.linalg.norm(np.cross(e1, e2), axis=1) / width
        f1 = d1 / width[:, None]
        f2 = (d2 - shear[:, None] * f1) / height[:, None]
    c11, c12, c22 = (f1 * f1).sum(1), (f1 * f2).sum(1), (f2 * f2).sum(1)
    found: Reals = ((c11 + c22) / 2 + np.hypot((c11 - c22) / 2, c12) - 1) / 2
    return np.where(np.abs(found) < ROUND_OFF, 0.0, found)


def hinge_angles(points: Reals, triangles: Ints, hinge: Ints) -> Reals:
    """(k,) signed angle between the normals of each hinge, rad; positive where the surface bulges out."""
    normal = area_vectors(points, triangles)
    left, right = normal[hinge[:, 2]], normal[hinge[:, 3]]
    axis = points[hinge[:, 1]] - points[hinge[:, 0]]
    length = np.linalg.norm(axis, axis=1)
    turn = np.cross(left, right)
    found: Reals = np.arctan2((turn * axis).sum(1) / np.where(length > 0, length, 1), (left * right).sum(1))
    return found


def vertex_curvature(points: Reals, triangles: Ints) -> tuple[Reals, Reals]:
    """(n,) mean curvature and (n,) principal curvature of largest magnitude, 1/m, positive for a sphere.

    The curvature tensor of Cohen-Steiner & Morvan (2003): the sum of angle * length * t t^T over a vertex'
    edges (t the edge's direction; a hinge curves across its edge), halved, over a third of its triangles'
    area; then averaged over the vertex and its neighbours. Boundary edges have no angle, so boundary vertices
    take their inner neighbours' average; a shape without inner vertices shows none.
    """
    n = len(points)
    hinge = hinges(triangles)
    angle = hinge_angles(points, triangles, hinge)
    edge = points[hinge[:, 1]] - points[hinge[:, 0]]
    length = np.linalg.norm(edge, axis=1)
    rows, columns = np.triu_indices(3)
    tensor = (angle / np.where(length > 0, length, 1))[:, None] * edge[:, rows] * edge[:, columns]
    area = triangle_areas(points, triangles)
    own = row_sums(hinge[:, :2].ravel(), np.repeat(tensor / 2, 2, axis=0), n)
    own_area = row_sums(triangles.ravel(), np.repeat(area / 3, 3)[:, None], n)
    weight = np.ones((n, 1))
    weight[boundary_edges(triangles)] = 0
    inner = np.hstack([own, own_area]) * weight
    across, back = hinge[:, 0], hinge[:, 1]
    ring = inner + row_sums(across, inner[back], n) + row_sums(back, inner[across], n)
    alone = ring[:, 6] <= 0  # corners, whose neighbours all lie on the boundary
    around = np.repeat(ring[triangles].sum(axis=1), 3, axis=0)
    ring[alone] = row_sums(triangles.ravel(), around, n)[alone]
    total = np.zeros((n, 3, 3))
    total[:, rows, columns] = total[:, columns, rows] = ring[:, :6] / np.where(
        ring[:, 6:] > 0, ring[:, 6:], 1
    )
    eigenvalues = np.linalg.eigvalsh(total)
    extreme = np.where(-eigenvalues[:, 0] > eigenvalues[:, 2], eigenvalues[:, 0], eigenvalues[:, 2])
    return eigenvalues.sum(axis=1) / 2, extreme
