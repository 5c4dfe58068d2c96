"""A kernel with all its degrees of freedom, and the models and meshes that its tests run over."""

import numpy as np
import pytest
import scipy.sparse
from scipy.spatial import Delaunay

from voile import _kernels
from voile.elastic import BENDING, MATERIALS, model_name
from voile.elastic.weave import Woven, weave_rows
from voile.mesh.topology import build_topology

KOITER = [("koiter", bending, material) for bending in BENDING for material in MATERIALS]
ALL_MODELS = [
    *KOITER,
    *[("membrane", "tan", material) for material in MATERIALS],
    ("discrete-shells", "tan", "stvk"),
    ("projective", "tan", "stvk"),
]
each_model = pytest.mark.parametrize("model", ALL_MODELS, ids="-".join)


def weave_of(rest, triangles, thickness, young):
    """A fabric with weaker weft and shear and a warp that turns from triangle to triangle; every other triangle bends
    by its own stiffness, not by its thickness."""
    m = len(triangles)
    ones, every = np.ones(m), np.where(np.arange(m) % 2, np.nan, 1.0)
    cube = young * thickness**3 / 12.0
    woven = Woven(
        0.3 * young * ones, 0.2 * young * ones, 0.9 * cube * every, 0.5 * cube * every, 0.3 * cube * every
    )
    warp = np.column_stack([np.cos(np.arange(m)), np.sin(np.arange(m)), 0.3 * ones])
    fabric = {"thickness": thickness * ones, "young": young * ones, "poisson": 0.3 * ones}
    rows = weave_rows(rest, triangles, warp, **fabric, woven=woven)
    rows[:, :2] = warp[
        :, :2
    ]  # components along the edges: the warp goes with the triangle to another rest shape
    return rows


class Shell:
    """A kernel with full degrees of freedom z: 3n coordinates of the current shape, then director angles."""

    def __init__(self, model, rest, triangles, thickness=0.1, young=1.0, poisson=0.3, flat=False, clamps=()):
        self.rest, self.triangles = rest, triangles
        self.topology = build_topology(triangles)
        top = self.topology
        self.kernel = _kernels.Elastic(
            model_name(*model), triangles, top.triangle_edges, top.signs, top.across, len(top.edges), rest
        )
        if clamps:
            half_edges, conormal, vectors = zip(*clamps, strict=True)
            never = np.zeros(len(clamps), dtype=np.int32)
            self.kernel.set_clamps(
                np.int32(half_edges),
                np.int32(conormal),
                never,
                np.array(vectors, dtype=float),
                np.zeros(len(clamps)),
            )
        self.kernel.set_rest(rest, triangles, flat)
        ones = np.ones(len(triangles))
        self.kernel.set_fabric(thickness * ones, young * ones, poisson * ones)
        if model[2] == "orthotropic":
            self.kernel.set_weave(weave_of(rest, triangles, thickness, young))
        self.size = rest.size + (len(top.edges) if self.kernel.directors else 0)
        identity = np.minimum(np.arange(rest.size + len(top.edges) + 1), self.size).astype(np.int32)
        self.scatter = _kernels.Scatter(
            self.kernel,
            self.kernel.directors,
            self.size,
            identity,
            np.arange(self.size, dtype=np.int32),
            np.ones(self.size),
        )
        start, self.column = self.scatter.pattern(np.arange(self.size))
        none = np.zeros(0, dtype=np.int32)
        self.start, self.values = start.astype(np.int32), np.zeros(len(self.column))
        self.scatter.bind(self.start, self.column, self.values, none, none, np.zeros(0), none)

    def state(self, z):
        phi = np.zeros(len(self.topology.edges))
        phi[: self.size - self.rest.size] = z[self.rest.size :]
        return z[: self.rest.size].reshape(-1, 3) - self.rest, phi

    def energy(self, z):
        return sum(self.kernel.energy(*self.state(z)))

    def gradient(self, z):
        g, edge = np.zeros_like(self.rest), np.zeros(len(self.topology.edges))
        self.kernel.gradient(*self.state(z), g, edge)
        return np.concatenate([g.ravel(), edge])[: self.size]

    def hessian(self, z, kind="exact"):
        self.kernel.hessian(*self.state(z), kind, self.scatter)
        return scipy.sparse.csr_matrix(
            (self.values.copy(), self.column, self.start), shape=(self.size, self.size)
        )


def irregular_mesh(seed=0, count=24):
    """A curved patch of random triangles: points (n, 3) on and inside a boundary, triangles (m, 3)."""
    rng = np.random.default_rng(seed)
    flat = rng.random((count, 2))
    triangles = Delaunay(flat).simplices.astype(np.int32)
    area = np.linalg.det(flat[triangles[:, 1:]] - flat[triangles[:, :1]])
    triangles = triangles[abs(area) > 0.01]
    area = area[abs(area) > 0.01]
    triangles[area < 0] = triangles[area < 0][:, [0, 2, 1]]
    used, triangles = np.unique(triangles, return_inverse=True)
    flat, triangles = flat[used], triangles.reshape(-1, 3).astype(np.int32)
    return np.column_stack([flat, 0.3 * flat[:, 0] ** 2 - 0.2 * flat[:, 0] * flat[:, 1]]), triangles


def rates(remainder, h):
    """Observed orders of a remainder function between h, h/2 and h/4."""
    r = [np.linalg.norm(remainder(h / 2**k)) for k in range(3)]
    return np.log2(r[0] / r[1]), np.log2(r[1] / r[2])
