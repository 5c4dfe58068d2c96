"""Panels laid flat: exactly where they are developable, with the least symmetric Dirichlet energy elsewhere.

E = sum over triangles of area (s1^2 + s2^2 + 1/s1^2 + 1/s2^2 - 4), s1 >= s2 > 0 the stretches from the surface to
the plane (Smith & Schaefer, ACM TOG 34(4), 2015): zero for an isometry only, infinite before a triangle flips. Newton's
method with the eigenvalues of the energy's Hessian in closed form (Smith, de Goes & Kim, ACM TOG 38(1), 2019).
"""

from dataclasses import dataclass

import numpy as np
import shapely
from scipy import sparse
from scipy.sparse.linalg import splu

from voile.arrays import Ints, Reals, sums
from voile.errors import NotConverged
from voile.inverse.panels import Panels
from voile.mesh import boundary_loops, build_topology

ITERATIONS = 500
ROUND_OFF = 1e-13  # a Newton step of this share of the size changes nothing any more
CURVED, SHORT = 1e-8, 1e-7  # energy per area of what is no isometry: such a last step is short enough
NEAR = 1e-6  # decrement over energy scale below which the Hessian is taken as it is: quadratic convergence
SHIFT = 1e-10  # relative to the Hessian's diagonal: makes it regular in rigid motions, which carry no force


@dataclass(frozen=True)
class FlatPanels:
    """Panels with plane coordinates (p, 2) in metres, true scale, right side up, and the stretches s1 >= s2 (m, 2)
    of each triangle from the surface to the plane."""

    panels: Panels
    coordinates: Reals
    stretches: Reals


def flatten(panels: Panels) -> FlatPanels:
    """Lay each panel flat, each in its own place. Raises NotConverged, naming the panel."""
    flat = np.zeros((len(panels.vertex), 2))
    for k, name in enumerate(panels.names):
        triangles, vertices = panels.corners[panels.panel == k], np.flatnonzero(panels.vertex_panel == k)
        local = triangles - vertices[0]  # panel vertices are ordered by panel
        flat[vertices] = flatten_disc(panels.points[panels.vertex[vertices]], local, name)
    return FlatPanels(panels, flat, distortion(panels.points[panels.vertex], panels.corners, flat))


def distortion(points: Reals, triangles: Ints, flat: Reals) -> Reals:
    """Stretches s1 >= s2 (m, 2), 1 for an isometry, of the map from points (n, 3) to flat (n, 2), both in metres.

    s2 is negative where a triangle is flipped.
    """
    gradient, _ = _gradients(points, triangles)
    _, s, _ = _signed_svd(np.einsum("tij,tjk->tik", flat[triangles].transpose(0, 2, 1), gradient))
    return s


def overlaps(outline: Reals) -> bool:
    """Whether a panel of this outline (b, 2), counter-clockwise, lies on itself; sides that just touch do not."""
    one, two = outline, np.roll(outline, -1, axis=0)
    area = 0.5 * np.sum(one[:, 0] * two[:, 1] - one[:, 1] * two[:, 0])
    return bool(abs(shapely.make_valid(shapely.Polygon(outline)).area - area) > 1e-6 * area)


def flatten_disc(points: Reals, triangles: Ints, name: str = "panel") -> Reals:
    """Plane coordinates (n, 2) of a disc of triangles (m, 3), points (n, 3) in metres; raises NotConverged."""
    gradient, _ = _gradients(points, triangles)
    return relax(_start(points, triangles, gradient), triangles, points[triangles], name)


def relax(x: Reals, triangles: Ints, shapes: Reals, name: str) -> Reals:
    """Plane coordinates (n, 2) of least distortion of triangles (m, 3) from shapes of their own, corners (m, 3, 3) in
    metres, from coordinates x without flips; raises NotConverged."""
    gradient, area = _gradients(shapes.reshape(-1, 3), np.arange(3 * len(shapes)).reshape(-1, 3))
    energy = _Energy(triangles, gradient, area, len(x))
    size = float(np.ptp(shapes, axis=(0, 1)).max())
    value, slope, before = energy.value(x), np.inf, np.inf
    for _ in range(ITERATIONS):
        direction, force = energy.step(x, exact=slope < NEAR * area.sum())
        if np.vdot(direction, force) <= 0:  # near a saddle: the safe Hessian
            direction, force = energy.step(x, exact=False)
        slope = float(np.vdot(direction, force))
        length = float(abs(direction).max())
        # where the energy's round-off hides the decrease, full steps, as long as they get shorter
        if slope < 1e-12 * area.sum():
            if value > CURVED * area.sum() and length < SHORT * size:
                return x + direction
            if length <= ROUND_OFF * size or length > 0.5 * before:
                return x + direction if length < before else x
            x, before, value = x + direction, length, energy.value(x + direction)
            continue
        step = min(1.0, 0.9 * energy.longest(x, direction))
        while (trial := energy.value(x + step * direction)) > value - 1e-4 * step * slope:
            step *= 0.5
        x, value = x + step * direction, trial
    raise NotConverged(
        f"{name}: not flat after {ITERATIONS} Newton steps, the last one still {length / size:.1e} of its size"
    )


def _gradients(points: Reals, triangles: Ints) -> tuple[Reals, Reals]:
    """Gradients (m, 3, 2) of the corners' shape functions in an orthonormal frame of each triangle, and areas (m,):
    the map's Jacobian is the sum over corners of position times gradient."""
    a, b, c = (points[triangles[:, i]] for i in range(3))
    base = np.linalg.norm(b - a, axis=1)
    along = np.einsum("ti,ti->t", c - a, b - a) / base
    height = np.linalg.norm(np.cross(b - a, c - a), axis=1) / base
    second = np.column_stack([-1 / base, -(base - along) / (base * height)])
    third = np.column_stack([1 / base, -along / (base * height)])
    fourth = np.column_stack([np.zeros(len(base)), 1 / height])
    return np.stack([second, third, fourth], axis=1), 0.5 * base * height


def _start(points: Reals, triangles: Ints, gradient: Reals) -> Reals:
    """The least-squares conformal map at true mean scale; where it flips a triangle, Tutte's, which never does."""
    import igl

    loop = boundary_loops(triangles, build_topology(triangles), points)[0]
    ends = np.array([loop[0], loop[np.linalg.norm(points[loop] - points[loop[0]], axis=1).argmax()]])
    places = np.array([[0.0, 0.0], [np.linalg.norm(points[ends[1]] - points[ends[0]]), 0.0]])
    x, _ = igl.lscm(points, triangles.astype(np.int64), ends.astype(np.int64), places)
    jacobian = np.einsum("tij,tjk->tik", x[triangles].transpose(0, 2, 1), gradient)
    if not np.isfinite(x).all() or (np.linalg.det(jacobian) <= 0).any():
        x = _tutte(points, triangles, loop)
        jacobian = np.einsum("tij,tjk->tik", x[triangles].transpose(0, 2, 1), gradient)
    found: Reals = x / np.sqrt(np.mean(np.linalg.det(jacobian)))
    return found


def _tutte(points: Reals, triangles: Ints, loop: Ints) -> Reals:
    """Tutte's embedding (Proc. London Math. Soc. 1963): the border on a circle, the others amid their neighbours."""
    edges = build_topology(triangles).edges
    n = len(points)
    ones = np.ones(len(edges))
    graph = sparse.csr_matrix((ones, (edges[:, 0], edges[:, 1])), shape=(n, n))
    graph = graph + graph.T
    length = np.linalg.norm(points[loop] - points[np.roll(loop, 1)], axis=1)
    angle = 2 * np.pi * np.cumsum(length) / length.sum()
    x = np.zeros((n, 2))
    x[loop] = np.column_stack([np.cos(angle), np.sin(angle)])
    inner = np.setdiff1d(np.arange(n), loop)
    laplacian = sparse.diags(np.asarray(graph.sum(axis=1)).ravel()) - graph
    if len(inner):
        rows = sparse.csr_matrix(laplacian)[inner]
        x[inner] = splu(rows[:, inner].tocsc()).solve(-(rows[:, loop] @ x[loop]))
    return x


def _signed_svd(jacobian: Reals) -> tuple[Reals, Reals, Reals]:
    """U, s, V of (m, 2, 2) = U diag(s) V^T with rotations U and V; s1 >= |s2|, s2 negative where flipped.

    In closed form: a matrix is a turned scaling plus a turned reflection (Blinn, IEEE CG&A 16(2), 1996).
    """
    (a, b), (c, d) = jacobian.transpose(1, 2, 0)
    scaled, mirrored = 0.5 * np.hypot(a + d, c - b), 0.5 * np.hypot(a - d, c + b)
    of_scaled, of_mirrored = np.arctan2(c - b, a + d), np.arctan2(c + b, a - d)
    s = np.stack([scaled + mirrored, scaled - mirrored], axis=1)
    return _turn(0.5 * (of_mirrored + of_scaled)), s, _turn(0.5 * (of_mirrored - of_scaled))


def _turn(angle: Reals) -> Reals:
    """(m, 2, 2) rotations by angles (m,) in radians."""
    cos, sin = np.cos(angle), np.sin(angle)
    return np.stack([np.stack([cos, -sin], axis=1), np.stack([sin, cos], axis=1)], axis=1)


class _Energy:
    """The symmetric Dirichlet energy of a disc's plane coordinates x (n, 2), in m^2."""

    def __init__(self, triangles: Ints, gradient: Reals, area: Reals, count: int):
        self.triangles, self.gradient, self.area = triangles, gradient, area
        rows = 2 * triangles[:, :, None] + np.arange(2)
        self.unknown = rows.reshape(-1, 6)  # of corner and axis
        size = 2 * count
        entries = size * np.tile(self.unknown, (1, 6)) + np.repeat(self.unknown, 6, axis=1)
        places, self.entry = np.unique(entries, return_inverse=True)  # by column
        ends = np.searchsorted(places, size * np.arange(size + 1))
        self.pattern = (places % size, ends)
        self.diagonal = np.searchsorted(places, (size + 1) * np.arange(size))

    def jacobian(self, x: Reals) -> Reals:
        found: Reals = np.einsum("tij,tik->tjk", x[self.triangles], self.gradient)
        return found

    def value(self, x: Reals) -> float:
        """Infinite where a triangle is flipped."""
        j = self.jacobian(x)
        det = np.linalg.det(j)
        if (det <= 0).any():
            return np.inf
        square = np.einsum("tij,tij->t", j, j)
        return float(self.area @ (square + square / det**2 - 4))

    def step(self, x: Reals, exact: bool) -> tuple[Reals, Reals]:
        """Newton direction and negative gradient (n, 2), with all eigenvalues of triangles at least 0 unless exact."""
        u, s, v = _signed_svd(self.jacobian(x))
        one, two = s.T
        slopes = 2 * (s - s**-3)
        stress = np.einsum("tik,tk,tjk->tij", u, slopes, v)
        product, square = one * two, one**2 + two**2
        eigenvalues = np.stack(
            [2 + 6 * one**-4, 2 + 6 * two**-4, 2 - 2 * (square - product) / product**3,
             2 + 2 * (square + product) / product**3], axis=1,
        )  # fmt: skip
        if not exact:
            eigenvalues = np.maximum(eigenvalues, 0.0)
        root = np.sqrt(0.5)
        modes = np.array(
            [[[1, 0], [0, 0]], [[0, 0], [0, 1]], [[0, -root], [root, 0]], [[0, root], [root, 0]]]
        )  # stretch twice, twist, flip
        within = np.einsum("tjb,tcj->tcb", v, self.gradient)
        along = np.einsum("tia,kab,tcb->tkci", u, modes, within, optimize=True).reshape(-1, 4, 6)
        local = along.transpose(0, 2, 1) @ ((eigenvalues * self.area[:, None])[:, :, None] * along)
        values = sums(self.entry.ravel(), local.ravel())
        values[self.diagonal] += SHIFT * values[self.diagonal].mean()
        matrix = sparse.csc_matrix((values, *self.pattern))
        force = -np.einsum("tij,tcj,t->tci", stress, self.gradient, self.area).reshape(-1)
        total = sums(self.unknown.ravel(), force)
        options = {"SymmetricMode": True}
        solved = splu(matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=options).solve(total)
        return solved.reshape(-1, 2), total.reshape(-1, 2)

    def longest(self, x: Reals, direction: Reals) -> float:
        """The step at which the first triangle would lose its area: smallest positive root of det(J + t dJ)."""
        j, d = self.jacobian(x), self.jacobian(direction)
        a, c = np.linalg.det(d), np.linalg.det(j)
        b = (
            j[:, 0, 0] * d[:, 1, 1]
            + j[:, 1, 1] * d[:, 0, 0]
            - j[:, 0, 1] * d[:, 1, 0]
            - j[:, 1, 0] * d[:, 0, 1]
        )
        # with c > 0 the first positive root is 2c / (-b + sqrt(b^2 - 4ac)) where that is real and positive
        inner = b * b - 4 * a * c
        below = -b + np.sqrt(np.maximum(inner, 0.0))
        first = (inner >= 0) & (below > 0)
        return float((2 * c[first] / below[first]).min(initial=np.inf))
