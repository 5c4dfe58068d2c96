"""Linear Kirchhoff-Love shells of one patch in B-splines: an independent limit for triangle meshes.

The mid-surface is x(u, v) on the unit square; unknown are the spline coefficients of the Cartesian displacement w. With
the tangents a_i = x_,i, the normal n and the Christoffel symbols G^k_ij,
    membrane strain (a_i.w_,j + a_j.w_,i)/2,   change of curvature -(w_,ij - G^k_ij w_,k).n
and energy t/2 C e e + t^3/24 C k k, C the plane-stress tensor (Kiendl et al. 2009, Comput. Methods Appl. Mech. Eng.
198, 3902-3914, linearised).
"""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import scipy.sparse
import scipy.sparse.linalg
from scipy.interpolate import BSpline
from scipy.sparse.csgraph import connected_components

DEGREE = 4
ROTATION = (
    1e5  # penalty of a clamped edge's rotation in flexural stiffness over length: the shells are 12 long
)

Mapping = Callable[[np.ndarray, np.ndarray], list[np.ndarray]]
"""x_u, x_v, x_uu, x_vv, x_uv (points, 3) at u, v (points,)"""

EDGES = {"u0": (0, slice(None)), "u1": (-1, slice(None)), "v0": (slice(None), 0), "v1": (slice(None), -1)}
NEXT = {"u0": (1, slice(None)), "u1": (-2, slice(None)), "v0": (slice(None), 1), "v1": (slice(None), -2)}


@dataclass
class Patch:
    """A shell of spans[0] x spans[1] polynomials. held: edge -> axes; planes: edge -> the axis normal to its plane of
    symmetry; clamped: whether the edge u0 keeps its tangent plane; pinned: axes held at the corner u = v = 0. Forces:
    density per area, tip spread evenly over v at u = 1, points (u, v) -> force."""

    mapping: Mapping
    spans: tuple[int, int]
    fabric: tuple[float, float, float]  # thickness, Young's modulus, Poisson's ratio
    held: dict[str, tuple[int, ...]] = field(default_factory=dict)
    planes: dict[str, int] = field(default_factory=dict)
    clamped: bool = False
    pinned: tuple[int, ...] = ()
    density: np.ndarray | None = None
    tip: np.ndarray | None = None
    points: dict[tuple[float, float], np.ndarray] = field(default_factory=dict)


class Line:
    """Splines on n equal spans of [0, 1], with Gauss points of each span."""

    def __init__(self, n: int):
        t = np.concatenate([np.zeros(DEGREE), np.linspace(0.0, 1.0, n + 1), np.ones(DEGREE)])
        self.count = n + DEGREE
        self.spline = BSpline(t, np.eye(self.count), DEGREE)
        place, weight = np.polynomial.legendre.leggauss(DEGREE + 1)
        self.places = (np.arange(n)[:, None] + 0.5 * (place + 1.0)) / n  # (spans, points)
        self.weights = 0.5 * weight / n

    def on_span(self, span: int) -> list[np.ndarray]:
        """Values, first and second derivatives (points, DEGREE + 1) of the splines that live on a span."""
        live = slice(span, span + DEGREE + 1)
        return [self.spline.derivative(k)(self.places[span])[:, live] for k in range(3)]


def solve(patch: Patch) -> Callable[[float, float], np.ndarray]:
    """Equilibrium: the displacement (3,) as a function of u, v."""
    lines = Line(patch.spans[0]), Line(patch.spans[1])
    shape = lines[0].count, lines[1].count, 3
    number = np.arange(np.prod(shape)).reshape(shape)
    force, entries = np.zeros(number.size), []
    values = [[line.on_span(k) for k in range(n)] for line, n in zip(lines, patch.spans, strict=True)]
    for i in range(patch.spans[0]):
        for j in range(patch.spans[1]):
            at = number[i : i + DEGREE + 1, j : j + DEGREE + 1].ravel()
            matrix, load = _element(patch, lines, (i, j), values[0][i], values[1][j])
            if patch.clamped and i == 0:
                matrix = matrix + _rotation(patch, lines, j, values[1][j])
            force[at] += load
            entries.append((matrix.ravel(), np.repeat(at, len(at)), np.tile(at, len(at))))
    for (u, v), f in patch.points.items():
        force += np.einsum("a,b,k->abk", lines[0].spline(u), lines[1].spline(v), f).ravel()
    if patch.tip is not None:
        share = np.einsum("p,spb->b", lines[1].weights, lines[1].spline(lines[1].places))
        force += np.einsum("a,b,k->abk", lines[0].spline(1.0), share, patch.tip).ravel()
    matrix, row, column = (np.concatenate(part) for part in zip(*entries, strict=True))
    stiffness = scipy.sparse.csr_matrix((matrix, (row, column)), shape=(force.size, force.size))
    free = _constraints(patch, number)
    found = scipy.sparse.linalg.spsolve((free.T @ stiffness @ free).tocsc(), free.T @ force)
    w = (free @ found).reshape(shape)
    return lambda u, v: np.einsum("a,b,abk->k", lines[0].spline(u), lines[1].spline(v), w)


def _element(patch, lines, span, along_u, along_v) -> tuple[np.ndarray, np.ndarray]:
    """Stiffness and load of one pair of spans."""
    thickness, young, poisson = patch.fabric
    u, v = (g.ravel() for g in np.meshgrid(lines[0].places[span[0]], lines[1].places[span[1]], indexing="ij"))
    x_u, x_v, *second = patch.mapping(u, v)
    a = np.stack([x_u, x_v], axis=1)
    normal = np.cross(x_u, x_v)
    area = np.linalg.norm(normal, axis=1)
    normal /= area[:, None]
    inverse = np.linalg.inv(a @ a.transpose(0, 2, 1))
    dual = inverse @ a

    def product(k: int, m: int) -> np.ndarray:
        return np.einsum("pa,qb->pqab", along_u[k], along_v[m]).reshape(len(u), -1)

    def rows(values: np.ndarray, direction: np.ndarray) -> np.ndarray:
        return np.einsum("pa,pk->pak", values, direction).reshape(len(u), -1)

    d_u, d_v = product(1, 0), product(0, 1)
    membrane = np.stack([rows(d_u, x_u), rows(d_v, x_v), rows(d_u, x_v) + rows(d_v, x_u)], axis=1)
    bending = []
    for twice, values, x_ij in zip(
        (1, 1, 2), (product(2, 0), product(0, 2), product(1, 1)), second, strict=True
    ):
        symbol = np.einsum("pik,pk->pi", dual, x_ij)
        bending.append(twice * rows(values - symbol[:, :1] * d_u - symbol[:, 1:] * d_v, normal))
    pairs = ((0, 0), (1, 1), (0, 1))
    stress = (
        young
        / (1.0 + poisson)
        * 0.5
        * np.array(
            [[[m[i, k] * m[j, n] + m[i, n] * m[j, k] for k, n in pairs] for i, j in pairs] for m in inverse]
        )
    )
    spread = np.stack([inverse[:, i, j] for i, j in pairs], axis=1)
    stress += young * poisson / (1.0 - poisson**2) * spread[:, :, None] * spread[:, None, :]
    weight = np.outer(lines[0].weights, lines[1].weights).ravel() * area
    matrix = sum(
        scale * np.einsum("p,pra,prc,pcb->ab", weight, b, stress, b, optimize=True)
        for scale, b in ((thickness, membrane), (thickness**3 / 12.0, np.stack(bending, axis=1)))
    )
    density = np.zeros(3) if patch.density is None else patch.density
    return matrix, np.outer(weight @ product(0, 0), density).ravel()


def _rotation(patch, lines, span, along_v) -> np.ndarray:
    """Stiffness against rotation of the edge u0 on one span of v."""
    thickness, young, _ = patch.fabric
    v = lines[1].places[span]
    x_u, x_v, *_ = patch.mapping(np.zeros(len(v)), v)
    normal = np.cross(x_u, x_v)
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    slope = lines[0].spline.derivative(1)(0.0)[: DEGREE + 1] / np.linalg.norm(x_u, axis=1)[:, None]
    turn = np.einsum("pa,pb,pk->pabk", slope, along_v[0], normal).reshape(len(v), -1)
    weight = ROTATION * young * thickness**3 / 12.0 * lines[1].weights * np.linalg.norm(x_v, axis=1)
    return np.einsum("p,pa,pb->ab", weight, turn, turn)


def _constraints(patch, number) -> scipy.sparse.csr_matrix:
    """Coefficients of free unknowns: held ones are zero, on planes of symmetry the first two rows are one."""
    held, ties = np.zeros(number.shape, dtype=bool), []
    for edge, axes in patch.held.items():
        held[EDGES[edge]][:, list(axes)] = True
    held[0, 0, list(patch.pinned)] = True
    for edge, axis in patch.planes.items():
        held[EDGES[edge]][:, axis] = True
        even = [k for k in range(3) if k != axis]
        ties.append(np.stack([number[place[edge]][:, even].ravel() for place in (EDGES, NEXT)]))
    one, other = np.concatenate(ties, axis=1) if ties else np.zeros((2, 0), dtype=int)
    graph = scipy.sparse.coo_matrix((np.ones(len(one)), (one, other)), shape=(number.size,) * 2)
    count, group = connected_components(graph, directed=False)
    free = np.setdiff1d(np.arange(count), group[held.ravel()])
    place = np.full(count, -1)
    place[free] = np.arange(len(free))
    row = np.flatnonzero(place[group] >= 0)
    column = place[group[row]]
    return scipy.sparse.csr_matrix((np.ones(len(row)), (row, column)), shape=(number.size, len(free)))
