"""Elastic energies at states with a known answer: flat, wrinkled, of constant curvature; and extreme ones."""

import numpy as np
import pytest
import scipy.sparse.linalg
from kernel_shell import Shell, each_model, irregular_mesh, rates

from voile.elastic import BENDING, MATERIALS
from voile.mesh.topology import build_topology


@pytest.mark.parametrize("material", MATERIALS)
def test_bending_variants_agree_on_a_flat_state(material):
    """f(0) = 0, f'(0) = 1, f''(0) = 0 for each: equal Hessians; `average` is `sin` with directors held."""
    rest, triangles = irregular_mesh(6)
    rest[:, 2] = 0.0
    current = rest * [1.2, 1.1, 1.0]
    hessians = {}
    for bending in BENDING:
        shell = Shell(("koiter", bending, material), rest, triangles)
        z = np.concatenate([current.ravel(), np.zeros(shell.size - rest.size)])
        hessians[bending] = shell.hessian(z)
    scale = abs(hessians["sin"]).max()
    for bending in ("tan", "theta"):
        assert abs(hessians[bending] - hessians["sin"]).max() < 1e-12 * scale
    assert abs(hessians["average"] - hessians["sin"][: rest.size, : rest.size]).max() < 1e-12 * scale
    normal = np.arange(2, rest.size, 3)
    assert abs(hessians["sin"][normal][:, rest.size :]).max() > 1e-5 * scale  # bending does enter


@pytest.mark.parametrize("bending", BENDING)
def test_tension_field_taut_is_stvk(bending):
    """Also compares the hand-written derivatives of the quadratic energy with the automatic ones."""
    rest, triangles = irregular_mesh(7)
    rng = np.random.default_rng(8)
    current = rest * [1.4, 1.5, 1.3] + 0.005 * rng.normal(size=rest.shape)
    for kind in ("exact", "safe"):
        by_material = []
        for material in ("stvk", "tension-field"):
            shell = Shell(("koiter", bending, material), rest, triangles)
            angles = 0.3 * np.random.default_rng(9).normal(size=shell.size - rest.size)
            z = np.concatenate([current.ravel(), angles])
            by_material.append((shell.energy(z), shell.gradient(z), shell.hessian(z, kind).toarray()))
        for by_hand, automatic in zip(*by_material, strict=True):
            assert np.abs(by_hand - automatic).max() < 1e-12 * np.abs(automatic).max()


def test_tension_field_slack_and_wrinkled():
    rest, triangles = irregular_mesh(7)
    rest[:, 2] = 0.0
    area = (
        np.linalg.norm(
            np.cross(
                rest[triangles[:, 1]] - rest[triangles[:, 0]], rest[triangles[:, 2]] - rest[triangles[:, 0]]
            ),
            axis=1,
        ).sum()
        / 2
    )
    h, young = 2e-3, 3e4
    shell = Shell(("membrane", "tan", "tension-field"), rest, triangles, h, young, 0.3)
    assert shell.energy((0.8 * rest).ravel()) == 0.0
    assert np.all(shell.gradient((0.8 * rest).ravel()) == 0.0)
    strain = (1.2**2 - 1) / 2
    wrinkled = (rest * [1.2, 0.7, 1.0]).ravel()
    assert shell.energy(wrinkled) == pytest.approx(area * h * young * strain**2 / 2, rel=1e-12)
    width = rest * [0.0, 1.0, 0.0]
    assert abs(shell.gradient(wrinkled) @ width.ravel()) < 1e-13 * young * h  # no stress across the wrinkles


@pytest.mark.parametrize("model", ["membrane", "koiter"])
def test_a_slack_triangle_does_not_vanish(model):
    """Energy, without bound as the area goes to zero, and Taylor rates at a shape of a hundredth of it."""
    rest, triangles = irregular_mesh(7)
    rest[:, 2] = 0.0
    shell = Shell((model, "tan", "tension-field"), rest, triangles, 1e-3, 1.0, 0.3)
    flat = np.zeros(shell.size - rest.size)
    energies = [shell.energy(np.concatenate([(s * rest).ravel(), flat])) for s in (0.33, 0.3, 1e-1, 3e-2)]
    area = np.linalg.det((rest[triangles[:, 1:]] - rest[triangles[:, :1]])[:, :, :2]).sum() / 2
    missing = np.log(np.array([0.09, 1e-2, 9e-4]) / 0.1)
    assert energies[0] == 0.0
    assert energies[1:] == pytest.approx(1e-5 * 1e-3 * area * missing**2, rel=1e-9, abs=0.0)
    z = np.concatenate([(0.1 * rest).ravel(), flat])
    d = 0.01 * np.random.default_rng(1).normal(size=shell.size)
    energy, slope, change = shell.energy(z), shell.gradient(z) @ d, shell.hessian(z) @ d
    assert min(rates(lambda s: shell.energy(z + s * d) - energy - s * slope, 1e-2)) > 1.9
    assert min(rates(lambda s: shell.gradient(z + s * d) - shell.gradient(z) - s * change, 1e-2)) > 1.9


def saddle_curvature(s, t):
    """Mean curvature of z = (s^2 - t^2)/2, positive where convex seen from above."""
    return (s * s - t * t) / (2 * (1 + s * s + t * t) ** 1.5)


SURFACES = {  # point, normal (any length), mean curvature at the parameters s, t
    "sphere": (
        lambda s, t: _unit(s, t, 1 + 0 * s),
        lambda s, t: _unit(s, t, 1 + 0 * s),
        lambda s, t: 1.0 + 0 * s,
    ),
    "cylinder": (
        lambda s, t: np.column_stack([np.sin(s), t, np.cos(s)]),
        lambda s, t: np.column_stack([np.sin(s), 0 * t, np.cos(s)]),
        lambda s, t: 0.5 + 0 * s,
    ),
    "saddle": (
        lambda s, t: np.column_stack([s, t, (s * s - t * t) / 2]),
        lambda s, t: _unit(-s, t, 1 + 0 * s),
        saddle_curvature,
    ),
}


def _unit(x, y, z):
    v = np.column_stack([x, y, z])
    return v / np.linalg.norm(v, axis=1, keepdims=True)


def irregular_grid(n, seed=10):
    """Parameters (2, vertices) in [-1/2, 1/2]^2, moved by up to a quarter cell; triangles"""
    rng = np.random.default_rng(seed)
    parameters = np.array(np.meshgrid(*[np.linspace(-0.5, 0.5, n + 1)] * 2, indexing="ij"))
    parameters[:, 1:-1, 1:-1] += rng.uniform(-0.25 / n, 0.25 / n, (2, n - 1, n - 1))
    corner = (np.arange(n)[:, None] * (n + 1) + np.arange(n)).ravel()
    quads = corner[:, None] + [0, n + 1, n + 2, 1]
    turned = rng.random(n * n) < 0.5
    quads[turned] = np.roll(quads[turned], 1, axis=1)
    return parameters.reshape(2, -1), np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]]).astype(
        np.int32
    )


def curvature_error(surface, n, bending):
    """Root-mean-square error of the triangles' mean curvature, directors at the least bending energy.

    The rest shape has the surface's metric and no curvature; boundary directors are held at exact normals.
    """
    point, normal, mean_curvature = SURFACES[surface]
    (s, t), triangles = irregular_grid(n)
    topology = build_topology(triangles)
    half = np.flatnonzero(topology.across.ravel() < 0)
    ends = topology.edges[topology.triangle_edges.ravel()[half]]
    held = normal(s[ends].mean(axis=1), t[ends].mean(axis=1))
    points = point(s, t)
    shell = Shell(
        ("koiter", bending, "stvk"),
        points,
        triangles,
        1.0,
        flat=True,
        clamps=[(h, 0, v) for h, v in zip(half, held, strict=True)],
    )
    z = np.concatenate([points.ravel(), np.zeros(shell.size - points.size)])
    free = points.size + np.setdiff1d(np.arange(len(topology.edges)), topology.boundary_edges)
    for _ in range(20):
        force = shell.gradient(z)[free]
        if np.abs(force).max() < 1e-12:
            break
        z[free] -= scipy.sparse.linalg.spsolve(shell.hessian(z)[free][:, free].tocsc(), force)
    else:
        raise AssertionError("the directors do not converge")
    length, alpha = shell.kernel.invariants(*shell.state(z))
    second = {"sin": np.sin, "tan": np.tan, "theta": np.asarray}[bending](alpha)
    a, b, c = length[:, 2], (length[:, 1] + length[:, 2] - length[:, 0]) / 2, length[:, 1]
    double_area = np.sqrt(a * c - b * b)
    ii = 2 * double_area[:, None] / np.sqrt(length) * second
    trace = (c * (ii[:, 0] + ii[:, 1]) - 2 * b * ii[:, 0] + a * (ii[:, 0] + ii[:, 2])) / double_area**2
    exact = mean_curvature(s[triangles].mean(axis=1), t[triangles].mean(axis=1))
    return np.sqrt(np.average((trace / 2 - exact) ** 2, weights=double_area))


@pytest.mark.parametrize("bending", ["sin", "tan", "theta"])
@pytest.mark.parametrize("surface", SURFACES)
def test_discrete_curvature_converges(surface, bending):
    """Second order where the curvature is constant, first order (sampled at centroids) on the saddle."""
    errors = np.array([curvature_error(surface, n, bending) for n in (8, 16, 32)])
    bound, rate = (3e-3, 1.0) if surface == "saddle" else (3e-4, 1.6)
    assert errors[-1] < bound
    assert np.log2(errors[0] / errors[2]) / 2 > rate


def equilateral_cylinder(around, along, radius=1.0):
    """A closed cylinder about z of nearly equilateral triangles in `along` rows: points, triangles, side"""
    edge = 2 * radius * np.sin(np.pi / around)
    row, k = np.divmod(np.arange((along + 1) * around), around)
    angle = 2 * np.pi * (k + 0.5 * (row % 2)) / around
    points = np.column_stack([radius * np.cos(angle), radius * np.sin(angle), row * edge * np.sqrt(3) / 2])
    row, k = np.divmod(np.arange(along * around), around)
    next_k, odd = (k + 1) % around, row % 2 == 1
    low, low_next, high, high_next = (r * around + c for r in (row, row + 1) for c in (k, next_k))
    first = np.column_stack([low, low_next, np.where(odd, high_next, high)])
    second = np.column_stack([np.where(odd, low, low_next), high_next, high])
    return points, np.concatenate([first, second]).astype(np.int32), edge


@pytest.mark.parametrize("poisson", [0.0, 0.3])
def test_discrete_shells_bends_like_the_plate(poisson):
    """D kappa^2/2 per area; two lengths of the cylinder, subtracted, leave the free ends out."""
    young, thickness, energies = 3.0, 0.05, []
    for along in (8, 16):
        points, triangles, edge = equilateral_cylinder(60, along)
        shell = Shell(
            ("discrete-shells", "tan", "stvk"), points, triangles, thickness, young, poisson, flat=True
        )
        energies.append(shell.energy(points.ravel()))
    area = 2 * np.pi * 8 * edge * np.sqrt(3) / 2
    flexural = young * thickness**3 / (12 * (1 - poisson**2))
    assert (energies[1] - energies[0]) / area == pytest.approx(flexural / 2, rel=0.005)


def check_finite_and_consistent(shell, z, step):
    """Central differences of the energy and of the gradient, along a random direction scaled to the shape."""
    rng = np.random.default_rng(11)
    d = rng.normal(size=shell.size)
    d[: shell.rest.size] *= step
    d[shell.rest.size :] *= step / np.ptp(shell.rest)
    g, h = shell.gradient(z), shell.hessian(z)
    assert np.isfinite(shell.energy(z)) and np.isfinite(g).all() and np.isfinite(h.data).all()
    assert np.isfinite(shell.hessian(z, "safe").data).all()
    slope = (shell.energy(z + d) - shell.energy(z - d)) / 2
    assert slope == pytest.approx(g @ d, rel=1e-4)
    change = (shell.gradient(z + d) - shell.gradient(z - d)) / 2
    assert np.abs(change - h @ d).max() < 1e-4 * np.abs(change).max()


@each_model
@pytest.mark.parametrize("size", [1e-6, 1e3])
def test_size(model, size):
    rest, triangles = irregular_mesh(12)
    rng = np.random.default_rng(13)
    shell = Shell(model, size * rest, triangles, 0.01 * size)
    current = size * (rest * [1.1, 0.95, 1.0] + 0.02 * rng.normal(size=rest.shape))
    z = np.concatenate([current.ravel(), 0.1 * rng.normal(size=shell.size - rest.size)])
    unit = Shell(model, rest, triangles, 0.01)
    assert shell.energy(z) == pytest.approx(
        size**3 * unit.energy(np.append(z[: rest.size] / size, z[rest.size :])), rel=1e-12
    )
    check_finite_and_consistent(shell, z, 1e-6 * size)


@each_model
@pytest.mark.parametrize("held", [False, True], ids=["free", "held"])
def test_forces_of_small_displacements_keep_their_digits(model, held):
    """Half the displacement, half the force: to 1e-9 at displacements of 1e-11, where a difference of angles would
    leave five digits. The shell is curved; held: boundary directors along the normal or the edge's conormal."""
    rest, triangles = irregular_mesh(14)
    topology, clamps = build_topology(triangles), []
    for k, half in enumerate(np.flatnonzero(topology.across.ravel() < 0) if held else ()):
        x = rest[np.roll(triangles[half // 3], -(half % 3))]
        normal = np.cross(x[2] - x[1], x[0] - x[1])
        clamps.append((half, k % 2, normal if k % 2 == 0 else np.cross(x[2] - x[1], normal)))
    clamps = [(half, kind, vector / np.linalg.norm(vector)) for half, kind, vector in clamps]
    shell = Shell(model, rest, triangles, clamps=clamps)
    rng = np.random.default_rng(15)
    u = 1e-11 * rng.normal(size=rest.shape)
    phi = 1e-11 * rng.normal(size=len(topology.edges)) * shell.kernel.directors

    def force(share):
        g, edge = np.zeros_like(rest), np.zeros(len(phi))
        shell.kernel.gradient(share * u, share * phi, g, edge)
        return np.concatenate([g.ravel(), edge])

    at_rest = force(0.0)
    whole, half = force(1.0) - at_rest, force(0.5) - at_rest
    assert np.abs(at_rest).max() < (1e-16 if held else 1e-30)
    assert np.abs(2.0 * half - whole).max() < 1e-9 * np.abs(whole).max()


@each_model
def test_folded_hinge(model):
    fold = np.radians(179.9)
    rest = np.array([[0, 0, 0], [1, 0, 0], [0.4, 0.9, 0], [0.6, -0.8, 0]], dtype=float)
    current = 1.05 * rest
    current[3, 1:] = 0.84 * np.array([-np.cos(fold), -np.sin(fold)])
    shell = Shell(model, rest, np.array([[0, 1, 2], [1, 0, 3]], dtype=np.int32), 0.01)
    z = np.concatenate([current.ravel(), np.zeros(shell.size - rest.size)])
    check_finite_and_consistent(shell, z, 1e-6)


@each_model
def test_sliver(model):
    rest = np.array([[0, 0, 0], [1, 0, 0], [0.5, 1e-3, 0], [0.45, -1e-3, 2e-4]], dtype=float)
    shell = Shell(model, rest, np.array([[0, 1, 2], [1, 0, 3]], dtype=np.int32), 1e-4)
    current = rest * [1.01, 1.02, 1.3]
    z = np.concatenate([current.ravel(), np.full(shell.size - rest.size, 0.05)])
    check_finite_and_consistent(shell, z, 1e-8)
