"""Triangulated surfaces of obstacles: on the zero level of the gap, facing outwards, around what they must show."""

import igl
import numpy as np
import pytest

from voile.contact.obstacles import Box, Capsule, Cone, Cylinder, Ellipsoid, MeshBody, Plane, Sphere, Torus

AXIS = np.array([1.0, 2.0, -0.5])
CENTRE = np.array([0.1, -0.2, 0.3])
BOUNDS = np.array([[-0.4, -0.3, 0.1], [0.5, 0.6, 0.9]])

# shape, area (m^2) or None where the patch depends on the bounds
SHAPES = {
    "plane": (Plane(point=CENTRE, normal=AXIS), None),
    "sphere": (Sphere(center=CENTRE, radius=0.7), 4 * np.pi * 0.49),
    "cylinder": (Cylinder(center=CENTRE, axis=AXIS, radius=0.2), None),
    "capsule": (
        Capsule(a=CENTRE, b=CENTRE + np.array([0.0, 3.0, 4.0]), radius=0.5),
        4 * np.pi * 0.25 + 2 * np.pi * 0.5 * 5,
    ),
    "cone": (Cone(apex=CENTRE, axis=AXIS, half_angle=0.4), None),
    "torus": (Torus(center=CENTRE, axis=AXIS, radius=0.6, tube=0.2), 4 * np.pi**2 * 0.6 * 0.2),
    # prolate: 2 pi b^2 (1 + a / (b e) asin e) with e^2 = 1 - b^2 / a^2
    "ellipsoid": (
        Ellipsoid(center=CENTRE, radii=np.array([0.3, 0.3, 0.5])),
        2 * np.pi * 0.09 * (1 + 0.5 / (0.3 * 0.8) * np.arcsin(0.8)),
    ),
    "box": (Box(center=CENTRE, sizes=np.array([0.1, 0.2, 0.3])), 8 * (0.02 + 0.03 + 0.06)),
}


@pytest.mark.parametrize("name", SHAPES)
def test_surfaces_lie_on_the_obstacle_and_face_outwards(name):
    shape, exact = SHAPES[name]
    points, triangles = shape.surface(BOUNDS)
    assert np.abs(shape.gap(points, 0.0)).max() < 1e-12
    assert set(triangles.ravel()) <= set(range(len(points)))
    corner = points[triangles]
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    area = np.linalg.norm(normal, axis=1) / 2
    assert area.min() > 0.0
    outwards = shape.gap_derivatives(corner.mean(axis=1), 0.0)[1]
    assert (normal * outwards).sum(axis=1).min() > 0.0
    if exact is not None:
        assert area.sum() == pytest.approx(exact, rel=4e-3)


@pytest.mark.parametrize("name", ["plane", "cylinder", "cone"])
def test_patches_of_unbounded_shapes_reach_past_the_bounds(name):
    shape, _ = SHAPES[name]
    inside = np.random.default_rng(1).uniform(*BOUNDS, (200, 3))
    gap, normal, _ = shape.gap_derivatives(inside, 0.0)
    feet = inside - gap[:, None] * normal
    points, triangles = shape.surface(BOUNDS)
    squares = igl.point_mesh_squared_distance(feet, points, triangles)[0]
    assert np.sqrt(squares.max()) < 1e-3  # a chord of 96 sides stays within 5.4e-4 radii of its arc


def test_a_mesh_shows_its_own_triangles():
    points, triangles = SHAPES["box"][0].surface(BOUNDS)
    body = MeshBody.around(points, triangles, 0.02)
    shown = body.surface(BOUNDS)
    assert np.array_equal(shown[0], points) and np.array_equal(shown[1], triangles)
