"""Triangle meshes as smooth distance fields: exactness, smoothness, overlaps, holes and what is refused."""

import igl
import numpy as np
import pytest
from mesh_helpers import plate_mesh

from voile.contact.field import signed_distance
from voile.contact.obstacles import MeshBody
from voile.errors import InputError
from voile.mesh import read_mesh


def ball(
    level: int = 4, center: tuple[float, float, float] = (0.0, 0.0, 0.0)
) -> tuple[np.ndarray, np.ndarray]:
    """Triangulated unit sphere: an octahedron, its triangles split in four `level` times."""
    octahedron = np.concatenate([np.eye(3), -np.eye(3)])
    triangles = np.array(
        [[0, 1, 2], [1, 3, 2], [3, 4, 2], [4, 0, 2], [1, 0, 5], [3, 1, 5], [4, 3, 5], [0, 4, 5]]
    )
    for _ in range(level):
        octahedron, triangles = igl.upsample(octahedron, triangles, 1)
        octahedron = octahedron / np.linalg.norm(octahedron, axis=1, keepdims=True)
    return octahedron + center, triangles


def together(*pieces: tuple[np.ndarray, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    first = np.cumsum([0] + [len(points) for points, _ in pieces[:-1]])
    return (
        np.concatenate([points for points, _ in pieces]),
        np.concatenate([triangles + k for (_, triangles), k in zip(pieces, first, strict=True)]),
    )


def points_between(low: float, high: float, count: int = 2000) -> np.ndarray:
    """Random points at distances low to high from the origin."""
    rng = np.random.default_rng(5)
    d = rng.normal(size=(count, 3))
    return d / np.linalg.norm(d, axis=1)[:, None] * rng.uniform(low, high, (count, 1))


@pytest.fixture(scope="module")
def sphere() -> MeshBody:
    return MeshBody.around(*ball())


def test_error_falls_with_the_square_of_the_mesh_size():
    p = points_between(1.0, 1.1)
    errors = []
    for level in (3, 4, 5):
        body = MeshBody.around(*ball(level), resolution=0.6 * 0.5**level)
        errors.append(np.abs(body.gap(p, 0.0) - (np.linalg.norm(p, axis=1) - 1.0)).max())
        exact = signed_distance(body.points, body.triangles, body.triangles, p)
        assert np.abs(body.gap(p, 0.0) - exact).max() < 1.5 * body.error()
    assert errors[0] > 3.0 * errors[1] > 9.0 * errors[2]
    assert errors[2] < 2e-3


def test_gradient_has_about_length_one_near_the_surface(sphere):
    normal = sphere.derivatives(points_between(1.0, 1.1))[1]
    assert np.abs(np.linalg.norm(normal, axis=1) - 1.0).max() < 0.05


@pytest.mark.parametrize(("low", "high"), [(0.9, 1.2), (2.0, 4.0)], ids=["near", "beyond the grid"])
def test_taylor_series_of_the_gap(sphere, low, high):
    p = points_between(low, high)
    gap, normal, curvature = sphere.derivatives(p)
    np.testing.assert_allclose(gap, sphere.gap(p, 0.0), rtol=0, atol=1e-14)
    direction = np.random.default_rng(6).normal(size=p.shape)
    slope = np.einsum("ni,ni->n", normal, direction)
    bend = np.einsum("ni,nij,nj->n", direction, curvature, direction)

    def remainder(t: float) -> float:
        rest = sphere.gap(p + t * direction, 0.0) - gap - t * slope - 0.5 * t**2 * bend
        return float(np.median(np.abs(rest)))

    assert remainder(1e-3) > 7.0 * remainder(5e-4)  # third order


def test_second_derivatives_are_continuous_across_the_cells(sphere):
    node = sphere.origin + sphere.spacing * np.round(
        (points_between(1.0, 1.1) - sphere.origin) / sphere.spacing
    )
    step = 1e-7 * sphere.spacing * np.ones(3)
    for below, above, scale in zip(
        sphere.derivatives(node - step), sphere.derivatives(node + step), (1.0, 1.0, 1e3), strict=True
    ):
        assert np.abs(above - below).max() < 1e-6 * scale


def test_overlapping_pieces_are_their_union():
    left, right = np.array([-0.6, 0.0, 0.0]), np.array([0.6, 0.0, 0.0])
    body = MeshBody.around(*together(ball(4, tuple(left)), ball(4, tuple(right))))
    p = points_between(0.0, 2.0, 4000)
    exact = np.minimum(np.linalg.norm(p - left, axis=1), np.linalg.norm(p - right, axis=1)) - 1.0
    near = (exact > 0.0) & (exact < 0.2)
    away = near & (np.abs(p[:, 0]) > 0.2)  # from the crease, which a smooth field rounds
    error = np.abs(body.gap(p, 0.0) - exact)
    assert error[near].max() < 0.5 * body.spacing
    assert error[away].max() < 0.06 * body.spacing
    assert away.sum() > 200
    inside = body.gap(
        np.zeros((1, 3)), 0.0
    )  # in the lens: deep in the union, though both surfaces are 0.4 off
    assert inside[0] < -0.6


def test_a_small_hole_is_bridged():
    points, triangles = ball()
    hole = points[triangles].mean(axis=1)[:, 2] > 0.99
    assert hole.sum() > 4
    body = MeshBody.around(points, triangles[~hole])
    p = points_between(1.0, 1.2)
    error = np.abs(body.gap(p, 0.0) - (np.linalg.norm(p, axis=1) - 1.0))
    assert error[p[:, 2] < 0.9].max() < 0.01
    assert body.gap(np.zeros((1, 3)), 0.0)[0] < -0.5
    assert body.gap(np.array([[0.0, 0.0, 1.3]]), 0.0)[0] > 0.2


@pytest.mark.parametrize(
    ("mesh", "reason"),
    [
        ((ball()[0], ball()[1][:, ::-1]), "inside out"),
        (together(ball(), (ball(2, (3, 0, 0))[0], ball(2)[1][:, ::-1])), "1 of its 2 pieces"),
        ((np.eye(3), np.array([[0, 1, 2]])), "no volume"),
        (
            (ball()[0], np.concatenate([ball()[1][:9], ball()[1][9:10, ::-1], ball()[1][10:]])),
            "at 3 of its edges",
        ),
    ],
    ids=["inside out", "one piece inside out", "flat", "one triangle turned"],
)
def test_bodies_without_a_definite_inside_are_refused(mesh, reason):
    with pytest.raises(InputError, match=reason):
        MeshBody.around(*mesh, source="body.obj")


def test_a_resolution_too_fine_for_memory_is_refused():
    with pytest.raises(InputError, match="nodes"):
        MeshBody.around(*ball(2), resolution=1e-3)


@pytest.mark.slow
def test_the_mannequin_s_trunk_is_smooth_and_exact(shared):
    mannequin = read_mesh(shared / "meshes" / "mannequin.obj")
    body = MeshBody.around(mannequin.points, mannequin.triangles)
    assert body.error() < 0.6 * body.spacing
    corner = body.points[body.triangles]
    middle = corner.mean(axis=1)
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    length = np.linalg.norm(normal, axis=1)
    trunk = (np.abs(middle[:, 0]) < 0.25) & (middle[:, 1] > 0.85) & (middle[:, 1] < 1.2) & (length > 0.0)
    p = middle[trunk] + 1e-3 * normal[trunk] / length[trunk][:, None]
    outside = igl.fast_winding_number(body.points, body.triangles, p) < 0.5
    gap, gradient, _ = body.derivatives(p[outside])
    exact = signed_distance(body.points, body.triangles, body.triangles, p[outside])
    assert np.abs(gap - exact).max() < 4e-4
    steepness = np.linalg.norm(gradient, axis=1)
    assert steepness.min() > 0.8  # least in the hollow of the back
    assert (np.abs(np.quantile(steepness, [0.01, 0.99]) - 1.0) < 0.05).all()


def test_a_resolution_too_coarse_for_the_body():
    points = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
    triangles = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    with pytest.raises(InputError, match="blurs a body of 1.73 m; allowed: at most 0.17 m"):
        MeshBody.around(points, triangles, 0.5)


def test_a_thin_body_is_resolved_by_itself():
    body = MeshBody.around(*plate_mesh(0.1, 1e-3))
    assert 0.8e-3 < body.spacing <= 1e-3 and body.thinnest <= 1e-3 and not body.blurred
    across = np.column_stack([np.full(21, 0.013), np.linspace(-2e-3, 2e-3, 21), np.full(21, 0.011)])
    np.testing.assert_allclose(body.distance(across)[[0, -1]], 1.5e-3, atol=1.5e-4)
    assert body.distance(np.zeros((1, 3)))[0] < 0.0
    blunt = MeshBody.around(*plate_mesh(0.1, 1e-3), resolution=4e-3)
    assert "resolution of 0.00" in blunt.blurred and blunt.blurred in blunt.about()


def test_thin_parts_of_a_thick_body_are_told():
    """A ball with a small plate beside it keeps its resolution; the plate is a tenth of the surface."""
    points, triangles = plate_mesh(1.0, 0.01)
    body = MeshBody.around(*together(ball(), (points + np.array([2.0, 0.0, 0.0]), triangles)))
    assert body.spacing > 0.012 and body.thinnest < 0.0101 and body.blurred
    assert MeshBody.around(*ball()).thinnest == np.inf
