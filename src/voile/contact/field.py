"""Triangle meshes as obstacles: a smooth signed distance field, precomputed on a grid around the surface.

The distance to a mesh has kinks wherever its closest triangle changes, on which Newton's method would stall. The body
is therefore the zero level of a tricubic spline (twice continuously differentiable) through exact signed distances at
the nodes of a grid. Bodies need not be watertight and their pieces may overlap: inside is where the generalised winding
number (Jacobson et al. 2013) exceeds one half, and triangles inside the union carry no surface.
"""

from dataclasses import dataclass, replace

import numpy as np
import scipy  # its parts load when they are asked for

from voile.arrays import Flags, Ints, Reals, area_vectors, diagonal, units
from voile.contact.directions import TINY, unit
from voile.contact.pairs import outer
from voile.errors import InputError

BAND = 6  # grid spacings on either side of the surface with exact distances
COARSE = 4  # grid spacings per spacing of the grid that finds the band
FINEST, COARSEST = 1 / 400, 1 / 60  # default spacing, of the body's diagonal
BLUNT = 0.1  # coarsest spacing allowed, of the diagonal
LARGEST = 3e7  # nodes of a grid
AFFORDABLE = 1e7  # nodes of a grid that nobody asked for: about 15 s
RESOLVED = 1.25  # thinnesses: coarsest spacing at which a spline through a plate has an inside wherever its nodes are
SAMPLES = 4000  # places at which thinness is measured
PART, MOST = (
    0.05,
    0.5,
)  # shares of the surface that make a thin part, and a body that is thin and refined by itself


@dataclass(frozen=True, kw_only=True)
class DistanceField:
    """The signed distance to a body bounded by triangles, points and triangles as given.

    coefficients (nx, ny, nz) of the spline (m) on a grid of `spacing` (m) from `origin` (3,), continued beyond the grid
    by the distance to it; measured: largest error (m); thinnest: part of the body (m), inf where it is thick enough.
    """

    points: Reals
    triangles: Ints
    origin: Reals
    spacing: float
    coefficients: Reals
    measured: float
    thinnest: float = np.inf

    @property
    def blurred(self) -> str:
        """What the field does not see of the body; empty where it sees it."""
        if self.spacing <= RESOLVED * self.thinnest:
            return ""
        return (
            f"parts of it are {self.thinnest:.2g} m thin, below the spacing of its distance field, "
            f"{self.spacing:.2g} m, and may let things through: give it a resolution of {self.thinnest:.2g} m"
        )

    def distance(self, p: Reals) -> Reals:
        """(n,) m at points (n, 3)."""
        place, beyond = self._clamp(p)
        spline = scipy.ndimage.map_coordinates(
            self.coefficients, place.T, order=3, mode="mirror", prefilter=False
        )
        found: Reals = spline + np.linalg.norm(beyond, axis=1)
        return found

    def derivatives(self, p: Reals) -> tuple[Reals, Reals, Reals]:
        """Distance (n,), its gradient (n, 3) and Hessian (n, 3, 3)."""
        place, beyond = self._clamp(p)
        gap, gradient, hessian = self._spline(place)
        far, out = unit(beyond, np.zeros(3))
        away = np.where(beyond != 0.0, 1.0, 0.0)
        kept = 1.0 - away  # the spline varies only along the axes on which the place is not clamped
        across = (away[:, :, None] * np.eye(3) - outer(out, out)) / np.maximum(far, TINY)[:, None, None]
        return gap + far, kept * gradient + out, outer(kept, kept) * hessian + across

    def _clamp(self, p: Reals) -> tuple[Reals, Reals]:
        """The nearest places (n, 3) in spacings at which the spline is defined, and p (n, 3) from there (m)."""
        place = (p - self.origin) / self.spacing
        inner = np.clip(place, 1.0, np.array(self.coefficients.shape) - 2.0)
        return inner, (place - inner) * self.spacing

    def _spline(self, place: Reals) -> tuple[Reals, Reals, Reals]:
        """Value, gradient and Hessian of the spline at places (n, 3) in spacings."""
        last = np.array(self.coefficients.shape) - 3
        cell = np.clip(np.floor(place).astype(int), 1, last)
        t = place - cell
        nodes = np.arange(-1, 3)
        index = [cell[:, k, None] + nodes for k in range(3)]
        c = self.coefficients[
            index[0][:, :, None, None], index[1][:, None, :, None], index[2][:, None, None, :]
        ]
        w, d, dd = _weights(t)
        planes = np.einsum("nabc,nc->nab", c, w[:, 2])
        value = np.einsum("nab,na,nb->n", planes, w[:, 0], w[:, 1])
        slopes, bends = np.einsum("nabc,nc->nab", c, d[:, 2]), np.einsum("nabc,nc->nab", c, dd[:, 2])

        def along(grid: Reals, first: Reals, second: Reals) -> Reals:
            found: Reals = np.einsum("nab,na,nb->n", grid, first[:, 0], second[:, 1])
            return found

        gradient = np.stack([along(planes, d, w), along(planes, w, d), along(slopes, w, w)], axis=1)
        xx, yy, zz = along(planes, dd, w), along(planes, w, dd), along(bends, w, w)
        xy, xz, yz = along(planes, d, d), along(slopes, d, w), along(slopes, w, d)
        hessian = np.stack([xx, xy, xz, xy, yy, yz, xz, yz, zz], axis=1).reshape(-1, 3, 3)
        return value, gradient / self.spacing, hessian / self.spacing**2

    def error(self) -> float:
        """Largest known error of the gap near the surface (m)."""
        return self.measured


def _weights(t: Reals) -> tuple[Reals, Reals, Reals]:
    """(n, 3, 4) uniform cubic B-spline weights of four nodes at t in [0, 1], their first and second derivatives."""
    s = 1.0 - t
    value = [s**3 / 6, (3 * t**3 - 6 * t**2 + 4) / 6, (3 * s**3 - 6 * s**2 + 4) / 6, t**3 / 6]
    slope = [-(s**2) / 2, (3 * t**2 - 4 * t) / 2, (4 * s - 3 * s**2) / 2, t**2 / 2]
    return tuple(np.stack(rows, axis=2) for rows in (value, slope, [s, 3 * t - 2, 3 * s - 2, t]))


def distance_field(
    points: Reals, triangles: Ints, resolution: float | None = None, source: str = "mesh"
) -> DistanceField:
    """That of points (n, 3) m and triangles (m, 3); resolution (m): the grid's spacing, by default half the mean edge
    within bounds of the body's size.

    Raises InputError for a mesh without inside, one turned inside out, or a resolution too fine for memory.
    """
    triangles = np.ascontiguousarray(triangles, dtype=np.int64)
    points = np.ascontiguousarray(points, dtype=float)
    size = diagonal(points)
    edges = np.linalg.norm(points[triangles] - points[np.roll(triangles, 1, axis=1)], axis=2)
    if resolution and resolution > BLUNT * size:
        raise InputError(
            f"{source}: a resolution of {resolution:.3g} m blurs a body of {size:.3g} m; "
            f"allowed: at most {BLUNT * size:.2g} m"
        )
    spacing = resolution or float(np.clip(0.5 * edges.mean(), FINEST * size, COARSEST * size))
    _check_orientation(points, triangles, source)
    skin = _outer(points, triangles)
    thinnest, thickness = _thin(points, triangles, skin, spacing)
    if not resolution and spacing > RESOLVED * thickness:
        space = np.prod(np.ptp(points, axis=0) + 2 * (BAND + COARSE) * thickness)
        spacing = max(thickness, float(np.cbrt(space / AFFORDABLE)))
    body = _sampled(points, triangles, skin, spacing, source)
    return replace(body, thinnest=thinnest, measured=_measure(body, skin))


def another_shape(body: DistanceField, points: Reals, source: str) -> DistanceField:
    """That of the same mesh with its points (n, 3) m elsewhere, as finely. Its error is taken for the first one's."""
    triangles, points = np.ascontiguousarray(body.triangles), np.ascontiguousarray(points, dtype=float)
    skin = _outer(points, triangles)
    found = _sampled(points, triangles, skin, body.spacing, source)
    return replace(found, thinnest=body.thinnest, measured=body.measured)


def _sampled(points: Reals, triangles: Ints, skin: Ints, spacing: float, source: str) -> DistanceField:
    margin = (BAND + COARSE) * spacing
    origin = points.min(axis=0) - margin
    shape = np.ceil((np.ptp(points, axis=0) + 2 * margin) / spacing / COARSE).astype(int) * COARSE + 1
    if np.prod(shape.astype(float)) > LARGEST:
        raise InputError(
            f"{source}: a resolution of {spacing:.3g} m needs {np.prod(shape.astype(float)):.1e} nodes; "
            f"allowed: {LARGEST:.0e}, that is a resolution of about {diagonal(points) * FINEST:.2g} m"
        )
    samples = _samples(points, triangles, skin, origin, spacing, shape)
    coefficients = scipy.ndimage.spline_filter(samples, order=3, mode="mirror")
    return DistanceField(
        points=points,
        triangles=triangles,
        origin=origin,
        spacing=spacing,
        coefficients=coefficients,
        measured=0.0,
    )


def signed_distance(points: Reals, triangles: Ints, skin: Ints, p: Reals) -> Reals:
    """(k,) exact distance of p (k, 3) to the triangles `skin`, negative inside the whole mesh."""
    return _sides(points, triangles, p) * _distances(points, skin, p)


def _distances(points: Reals, skin: Ints, p: Reals) -> Reals:
    import igl

    found: Reals = np.sqrt(igl.point_mesh_squared_distance(np.ascontiguousarray(p), points, skin)[0])
    return found


def _sides(points: Reals, triangles: Ints, p: Reals) -> Reals:
    """(k,) -1 inside, 1 outside."""
    import igl

    inside = igl.fast_winding_number(points, triangles, np.ascontiguousarray(p)) > 0.5
    return np.where(inside, -1.0, 1.0)


def _check_orientation(points: Reals, triangles: Ints, source: str) -> None:
    """Refuses triangles turned against their neighbours, and what `check_inside` does."""
    sides = np.sort(np.stack([triangles, np.roll(triangles, -1, axis=1)], axis=2).reshape(-1, 2), axis=1)
    forth = (triangles < np.roll(triangles, -1, axis=1)).ravel()
    _, first, edge, count = np.unique(
        sides, axis=0, return_index=True, return_inverse=True, return_counts=True
    )
    against = np.flatnonzero((count == 2) & (np.bincount(edge.ravel(), forth) != 1.0))
    if len(against):
        a, b = sides[first[against[0]]]
        raise InputError(
            f"{source}: at {len(against)} of its edges, first that of vertices {a} and {b}, the two triangles face "
            "opposite sides; orient all normals outwards"
        )
    check_inside(points, triangles, source)


def check_inside(points: Reals, triangles: Ints, source: str) -> None:
    """Refuses meshes without inside, and closed pieces turned inside out even where the whole is not."""
    import igl

    pieces, piece = igl.facet_components(triangles)
    corner = points[triangles]
    normal = area_vectors(points, triangles)
    height = corner.mean(axis=1) - corner.mean(axis=(0, 1))
    volume = np.bincount(piece, np.einsum("ti,ti->t", height, normal) / 6.0)
    area = np.linalg.norm(normal, axis=1).sum() / 2.0
    if abs(volume.sum()) < 1e-6 * area**1.5:
        raise InputError(f"{source}: the mesh encloses no volume; an obstacle needs an inside")
    closed = np.bincount(piece[igl.boundary_facets(triangles)[1]], minlength=pieces) == 0
    inverted = closed & (volume < 0.0)
    if volume.sum() < 0.0 or inverted.any():
        which = f"{inverted.sum()} of its {pieces} pieces are" if volume.sum() > 0.0 else "the mesh is"
        raise InputError(f"{source}: {which} inside out (normals point inwards); reverse the triangles")


def _outer(points: Reals, triangles: Ints) -> Ints:
    """The triangles with outside on their outer side, at their middle or a corner: those of the union's surface."""
    import igl

    corner = points[triangles]
    lifted = corner + 1e-4 * diagonal(points) * units(area_vectors(points, triangles))[:, None]
    middle = lifted.mean(axis=1, keepdims=True)
    probes = np.concatenate([middle, 0.9 * lifted + 0.1 * middle], axis=1)
    outside = igl.fast_winding_number(points, triangles, probes.reshape(-1, 3)) <= 0.5
    found: Ints = triangles[outside.reshape(-1, 4).any(axis=1)]
    return found


def _thin(points: Reals, triangles: Ints, skin: Ints, most: float) -> tuple[float, float]:
    """How thin (m) the body is behind a small part of its skin and behind half of it, inf where that is more than
    `most` (m): how far inwards from places on it outside is, to a tenth."""
    import igl

    corner = points[skin]
    normal = area_vectors(points, skin)
    twice = np.linalg.norm(normal, axis=1)
    rng = np.random.default_rng(0)
    row = rng.choice(len(skin), SAMPLES, p=twice / twice.sum())
    share = rng.dirichlet(np.ones(3), SAMPLES)
    place = np.einsum("pk,pki->pi", share, corner[row])
    inwards = -normal[row] / twice[row, None]

    def outside(depth: Reals) -> Flags:
        there = np.ascontiguousarray(place + depth[:, None] * inwards)
        found: Flags = igl.fast_winding_number(points, triangles, there) <= 0.5
        return found

    deep = np.full(SAMPLES, most)
    thin = outside(deep)
    if thin.mean() < PART:
        return np.inf, np.inf
    shallow = deep / 256.0
    for _ in range(6):  # to the 64th root of 256
        middle = np.sqrt(shallow * deep)
        beyond = outside(middle)
        deep, shallow = np.where(beyond, middle, deep), np.where(beyond, shallow, middle)
    found = np.sort(np.where(thin, shallow, np.inf))
    return float(found[int(PART * SAMPLES)]), float(found[int(MOST * SAMPLES)])


def _samples(points: Reals, triangles: Ints, skin: Ints, origin: Reals, spacing: float, shape: Ints) -> Reals:
    """Signed distances at the grid's nodes: exact in the band around the surface, interpolated beyond.

    A function of slope 1 is interpolated between the corners of a coarse cell to `off` (Jensen's inequality for the
    mean distance to them). So most nodes have the side of the corners around.
    """
    few = [np.arange(0, n, COARSE) for n in shape]
    coarse = np.stack(np.meshgrid(*few, indexing="ij"), axis=-1).reshape(-1, 3)
    far = signed_distance(points, triangles, skin, origin + spacing * coarse).reshape([len(n) for n in few])
    axes = [np.arange(n) / COARSE for n in shape]
    samples: Reals = scipy.ndimage.map_coordinates(far, np.meshgrid(*axes, indexing="ij"), order=1)
    off = np.sqrt(3.0) / 2.0 * COARSE * spacing
    band = np.abs(samples) < BAND * spacing + off
    nodes = np.argwhere(band)
    side = scipy.ndimage.map_coordinates(np.sign(far), nodes.T / COARSE, order=1)
    open_to = (np.abs(samples[band]) <= off) | (np.abs(side) < 1.0 - 1e-9)
    there = origin + spacing * nodes
    side[open_to] = _sides(points, triangles, there[open_to])
    samples[band] = np.sign(side) * _distances(points, skin, there)
    return samples


def _measure(body: DistanceField, skin: Ints) -> float:
    """Largest error of the gap outside (m): at the middles of the surface's triangles and edges and its vertices, on
    the surface and one and two spacings off."""
    corner = body.points[skin]
    normal = units(area_vectors(body.points, skin))
    middle = corner.mean(axis=1, keepdims=True)
    sites = np.concatenate([middle, 0.5 * (corner + np.roll(corner, 1, axis=1))], axis=1)
    raised = [sites + k * body.spacing * normal[:, None] for k in range(3)]
    probes = np.concatenate([np.concatenate(raised).reshape(-1, 3), body.points[np.unique(skin)]])
    exact = signed_distance(body.points, body.triangles, skin, probes)
    outside = exact > -1e-9 * diagonal(body.points)
    return float(np.abs(body.distance(probes[outside]) - exact[outside]).max())
