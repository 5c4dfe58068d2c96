"""Closest points of a vertex and a triangle, and of two edges: distance with gradient and Hessian over four vertices.

Both are the least length of r = sum_i w_i x_i over parameters a on which the weights depend linearly: a point of the
triangle, or one on each edge. With f = |r|^2 / 2 and E = dr/da, the envelope theorem gives the derivatives of its least
value: f_x = w r, and the second derivative is that at fixed a less f_xa (E^T E)^-1 f_ax.
"""

from dataclasses import dataclass

import numpy as np

from voile.arrays import Ints, Reals

PARALLEL = 1e-6  # sin^2 of the angle of edges under which they have no closest pair of points
CORNER, EDGES = 0, ((1, 2), (2, 3), (3, 1))  # places of a vertex and of a triangle's edges in a stencil


@dataclass
class Closest:
    """Of p stencils of four points: weights (p, 4) of r, their derivatives along (p, 4, 2) by the parameters (zero for
    those at their bounds), distance (p,) m, infinite where edges are not closest inside both."""

    weight: Reals
    along: Reals
    distance: Reals

    def __getitem__(self, rows: Ints) -> "Closest":
        return Closest(self.weight[rows], self.along[rows], self.distance[rows])


def closest_to_triangle(x: Reals) -> Closest:
    """x (p, 4, 3) m: a point, then a triangle's corners."""
    p = len(x)
    a, e1, e2 = x[:, 0] - x[:, 1], x[:, 2] - x[:, 1], x[:, 3] - x[:, 1]
    s, t = _solve(e1, e2, a)
    inside = (s >= 0.0) & (t >= 0.0) & (s + t <= 1.0)
    weight = np.where(inside[:, None], np.stack([np.ones(p), s + t - 1.0, -s, -t], axis=1), 0.0)
    along = np.zeros((p, 4, 2))
    along[inside] = [[0.0, 0.0], [1.0, 1.0], [-1.0, 0.0], [0.0, -1.0]]
    distance = np.where(inside, _length(weight, x), np.inf)
    for first, second in EDGES:
        u, length = _to_edge(x[:, 0], x[:, first], x[:, second])
        w = np.zeros((p, 4))
        w[:, 0], w[:, first], w[:, second] = 1.0, u - 1.0, -u
        nearer = ~inside & (length < distance)
        weight[nearer], distance[nearer] = w[nearer], length[nearer]
        along[nearer] = 0.0
        free = nearer & (u > 0.0) & (u < 1.0)
        along[free, first, 0], along[free, second, 0] = 1.0, -1.0
    return Closest(weight, along, distance)


def closest_of_edges(x: Reals) -> Closest:
    """x (p, 4, 3) m: the ends of an edge, then those of another."""
    p = len(x)
    e1, e2, a = x[:, 1] - x[:, 0], x[:, 3] - x[:, 2], x[:, 2] - x[:, 0]
    s, t = _solve(e1, -e2, a)
    crossed = np.cross(e1, e2)
    apart = _dot(crossed, crossed) > PARALLEL * _dot(e1, e1) * _dot(e2, e2)
    inside = apart & (s > 0.0) & (s < 1.0) & (t > 0.0) & (t < 1.0)
    weight = np.where(inside[:, None], np.stack([1.0 - s, s, t - 1.0, -t], axis=1), 0.0)
    along = np.zeros((p, 4, 2))
    along[inside] = [[-1.0, 0.0], [1.0, 0.0], [0.0, 1.0], [0.0, -1.0]]
    return Closest(weight, along, np.where(inside, _length(weight, x), np.inf))


def direction(c: Closest, x: Reals) -> Reals:
    """(p, 3) r / |r| of points x (p, 4, 3), whose products with the weights are the distances' gradient."""
    found: Reals = np.einsum("pi,pik->pk", c.weight, x) / c.distance[:, None]
    return found


def hessian(c: Closest, x: Reals) -> Reals:
    """(p, 12, 12) that of the distances of points x (p, 4, 3), 1/m."""
    p, normal = len(x), direction(c, x)
    r = normal * c.distance[:, None]
    tangent = np.einsum("pia,pik->pka", c.along, x)  # E
    one, two = tangent[:, :, 0], tangent[:, :, 1]
    still = ~c.along.any(axis=1)  # parameters at their bounds stay there
    g11, g12, g22 = _dot(one, one) + still[:, 0], _dot(one, two), _dot(two, two) + still[:, 1]
    inverse = np.stack([g22, -g12, -g12, g11], axis=1).reshape(p, 2, 2) / (g11 * g22 - g12**2)[:, None, None]
    mixed = c.weight[:, :, None, None] * tangent[:, None] + r[:, None, :, None] * c.along[:, :, None, :]
    mixed = mixed.reshape(p, 12, 2)
    fixed = np.einsum("pi,pj,kl->pikjl", c.weight, c.weight, np.eye(3)).reshape(p, 12, 12)
    gradient = (c.weight[:, :, None] * normal[:, None]).reshape(p, 12)
    found: Reals = fixed - mixed @ inverse @ mixed.transpose(0, 2, 1)
    found -= gradient[:, :, None] * gradient[:, None, :]
    return found / c.distance[:, None, None]


def _dot(a: Reals, b: Reals) -> Reals:
    found: Reals = np.einsum("pi,pi->p", a, b)
    return found


def _length(weight: Reals, x: Reals) -> Reals:
    found: Reals = np.linalg.norm(np.einsum("pi,pik->pk", weight, x), axis=1)
    return found


def _to_edge(point: Reals, first: Reals, second: Reals) -> tuple[Reals, Reals]:
    """Parameter (p,) of the point of an edge nearest to points (p, 3), and its distance (p,)."""
    edge = second - first
    u = np.clip(_dot(point - first, edge) / np.maximum(_dot(edge, edge), 1e-300), 0.0, 1.0)
    return u, np.linalg.norm(first + u[:, None] * edge - point, axis=1)


def _solve(e1: Reals, e2: Reals, a: Reals) -> tuple[Reals, Reals]:
    """Parameters (p,), (p,) of the point of the plane spanned by e1 and e2 (p, 3) that is nearest to a (p, 3)."""
    g11, g12, g22 = _dot(e1, e1), _dot(e1, e2), _dot(e2, e2)
    b1, b2 = _dot(e1, a), _dot(e2, a)
    determinant = np.maximum(g11 * g22 - g12 * g12, 1e-300)
    return (g22 * b1 - g12 * b2) / determinant, (g11 * b2 - g12 * b1) / determinant
