"""Exact distances of the obstacles: against their equations, with derivatives, moved and at their singular points."""

import numpy as np
import pytest

from voile.contact.obstacles import (
    Box,
    Capsule,
    Cone,
    Cylinder,
    Ellipsoid,
    Motion,
    Plane,
    Sphere,
    Torus,
    _ellipsoid_foot,
    normalised,
)

AXIS = normalised(np.array([1.0, 2.0, -0.5]))
CENTRE = np.array([0.1, -0.2, 0.3])
END = CENTRE + 0.6 * normalised(np.array([0.3, -1.0, 2.0]))
RADII = np.array([0.3, 0.2, 0.5])
SIZES = np.array([0.1, 0.2, 0.3])
MOTION = Motion(
    displacement=np.array([0.3, -0.1, 0.2]),
    rotation=np.array([0.5, 1.0, -0.7]),
    center=np.array([0.2, 0.0, -0.4]),
)
FACTOR = 0.7


def norm(d: np.ndarray) -> np.ndarray:
    return np.linalg.norm(d, axis=-1)


def capsule(d):
    """Of d from its first end: the union of two balls and the cylinder between them."""
    axis, length = normalised(END - CENTRE), norm(END - CENTRE)
    tube = np.where(np.abs(d @ axis - length / 2) < length / 2, norm(np.cross(d, axis)), np.inf)
    return np.minimum(np.minimum(norm(d), norm(d - (END - CENTRE))), tube) - 0.15


# name: (class and keys, equation of the surface in d = p - CENTRE: negative inside)
SHAPES = {
    "plane": ((Plane, {"point": CENTRE, "normal": AXIS}), lambda d: d @ AXIS),
    "sphere": ((Sphere, {"center": CENTRE, "radius": 0.4}), lambda d: norm(d) - 0.4),
    "cylinder": (
        (Cylinder, {"center": CENTRE, "axis": AXIS, "radius": 0.3}),
        lambda d: norm(np.cross(d, AXIS)) - 0.3,
    ),
    "capsule": ((Capsule, {"a": CENTRE, "b": END, "radius": 0.15}), capsule),
    "cone": (
        (Cone, {"apex": CENTRE, "axis": AXIS, "half_angle": 0.4}),
        lambda d: norm(np.cross(d, AXIS)) * np.cos(0.4) - d @ AXIS * np.sin(0.4),
    ),
    "torus": (
        (Torus, {"center": CENTRE, "axis": AXIS, "radius": 0.5, "tube": 0.15}),
        lambda d: (norm(np.cross(d, AXIS)) - 0.5) ** 2 + (d @ AXIS) ** 2 - 0.15**2,
    ),
    "ellipsoid": (
        (Ellipsoid, {"center": CENTRE, "radii": RADII}),
        lambda d: ((d / RADII) ** 2).sum(axis=-1) - 1.0,
    ),
    "box": ((Box, {"center": CENTRE, "sizes": SIZES}), lambda d: (np.abs(d) - SIZES).max(axis=-1)),
}
EVERY = pytest.mark.parametrize("name", SHAPES)


def shape(name: str, motion: Motion | None = None):
    kind, keys = SHAPES[name][0]
    return kind(**keys, motion=motion or Motion())


def around(count: int = 400) -> np.ndarray:
    """Points about the shapes, inside and outside."""
    return CENTRE + np.random.default_rng(3).uniform(-1.0, 1.0, (count, 3))


@EVERY
def test_the_distance_reaches_the_surface_and_no_point_of_it_is_nearer(name):
    body, equation, p = shape(name), SHAPES[name][1], around()
    gap, normal, _ = body.derivatives(p)
    assert np.abs(equation(p - gap[:, None] * normal - CENTRE)).max() < 1e-11
    assert ((gap > 0) == (equation(p - CENTRE) > 0)).all()
    samples = body.surface(np.array([CENTRE - 2.0, CENTRE + 2.0]))[0]
    assert np.abs(equation(samples - CENTRE)).max() < 1e-11
    nearest = np.array([norm(q - samples).min() for q in p])
    assert (nearest > np.abs(gap) - 1e-11).all()


@EVERY
def test_gradients_have_length_one_and_are_straight(name):
    _, normal, curvature = shape(name).derivatives(around())
    np.testing.assert_allclose(norm(normal), 1.0, atol=1e-12)
    scale = 1.0 + np.abs(curvature).max(axis=(1, 2))
    assert (norm(np.einsum("nij,nj->ni", curvature, normal)) < 1e-11 * scale).all()
    assert (np.abs(curvature - curvature.transpose(0, 2, 1)).max(axis=(1, 2)) < 1e-11 * scale).all()


@EVERY
@pytest.mark.parametrize("motion", [None, MOTION], ids=["still", "moved"])
def test_taylor_series_of_the_gap(name, motion):
    body, p = shape(name, motion), around()
    gap, normal, curvature = body.gap_derivatives(p, FACTOR)
    some = gap > 0.05
    p, gap, normal, curvature = p[some], gap[some], normal[some], curvature[some]
    direction = np.random.default_rng(4).normal(size=p.shape)
    slope = np.einsum("ni,ni->n", normal, direction)
    bend = np.einsum("ni,nij,nj->n", direction, curvature, direction)

    def remainder(t: float) -> tuple[float, float]:
        rest = body.gap(p + t * direction, FACTOR) - gap - t * slope - 0.5 * t**2 * bend
        return float(np.median(np.abs(rest))), float(np.abs(rest).max() / t**2)

    steps = [remainder(t) for t in (2e-4, 1e-4)]
    if steps[0][0] < 1e-15:  # flat almost everywhere
        assert np.abs(curvature).max(axis=(1, 2)).min() == 0.0
    else:
        assert steps[0][0] > 7.0 * steps[1][0]  # third order
    assert steps[1][1] < 0.05


@EVERY
def test_gap_and_its_derivatives_agree(name):
    body, p = shape(name, MOTION), around()
    np.testing.assert_allclose(body.gap(p, FACTOR), body.gap_derivatives(p, FACTOR)[0], rtol=0, atol=1e-14)


@EVERY
def test_points_carried_along_keep_their_gap(name):
    body, p = shape(name, MOTION), around()
    carried = body.carry(p, 0.2, FACTOR)
    np.testing.assert_allclose(body.gap(carried, FACTOR), body.gap(p, 0.2), atol=1e-12)
    np.testing.assert_allclose(body.carry(carried, FACTOR, 0.2), p, atol=1e-12)
    np.testing.assert_allclose(carried, MOTION.place(MOTION.unplace(p, 0.2), FACTOR), atol=1e-14)
    homogeneous = np.column_stack([p, np.ones(len(p))])
    np.testing.assert_allclose(
        (homogeneous @ MOTION.matrix(FACTOR).T)[:, :3], MOTION.place(p, FACTOR), atol=1e-14
    )


@pytest.mark.parametrize("offset", [1e-3, 0.05, 0.3])
def test_offset_surfaces_of_a_box_are_smooth_across_its_edges(offset):
    body = shape("box")
    angle = np.array([-1e-7, 1e-7])  # either side of where the face ends and the round begins
    foot = CENTRE + np.array([SIZES[0], SIZES[1], 0.05])
    p = foot + offset * np.column_stack([np.cos(angle), np.sin(angle), 0 * angle])
    gap, normal, _ = body.derivatives(p)
    assert abs(gap[0] - gap[1]) < 1e-7 * offset
    assert norm(normal[0] - normal[1]) < 3e-7


ALONG = np.array([0.0, 0.123, -0.37, 0.61, 1e5, -1e-9])  # heights on the axis, most of them with round-off
MORE = CENTRE + ALONG[:, None] * AXIS


@pytest.mark.parametrize("motion", [None, MOTION], ids=["still", "moved"])
@pytest.mark.parametrize(
    ("name", "exact"),
    [
        ("cylinder", np.full(6, -0.3)),
        ("torus", np.hypot(ALONG, 0.5) - 0.15),
        ("cone", np.where(ALONG < 0, -ALONG, -ALONG * np.sin(0.4))),
    ],
)
def test_points_on_the_axis_have_their_exact_gap_and_a_normal_that_points_to_it(name, exact, motion):
    body, equation = shape(name, motion), SHAPES[name][1]
    p = body.carry(MORE, 0.0, FACTOR)
    gap, normal, curvature = body.gap_derivatives(p, FACTOR)
    scale = np.maximum(1.0, np.abs(ALONG))
    assert (np.abs(gap - exact) < 1e-14 * scale).all()
    np.testing.assert_allclose(norm(normal), 1.0, atol=1e-12)
    foot = body.carry(p - gap[:, None] * normal, FACTOR, 0.0) - CENTRE
    assert (np.abs(equation(foot)) < 1e-12 * scale**2).all()
    assert np.isfinite(curvature).all()


def test_normals_next_to_an_axis_stay_square_to_it():
    for distance in 10.0 ** np.arange(-18.0, -3.0):
        p = MORE + distance * normalised(np.cross(AXIS, [0.0, 0.0, 1.0]))
        _, normal, curvature = shape("cylinder").derivatives(p)
        assert np.abs(normal @ AXIS).max() < 1e-14
        assert np.abs(curvature @ AXIS).max() < 1e-13 * max(1.0, np.abs(curvature).max())


@pytest.mark.parametrize("motion", [None, MOTION], ids=["still", "moved"])
@pytest.mark.parametrize(
    ("name", "point", "exact"),
    [
        ("sphere", CENTRE, -0.4),
        ("capsule", CENTRE, -0.15),
        ("capsule", END, -0.15),
        ("capsule", (CENTRE + END) / 2, -0.15),
        ("torus", CENTRE + 0.5 * normalised(np.cross(AXIS, [0.0, 0.0, 1.0])), -0.15),
        ("cone", CENTRE, 0.0),
        ("ellipsoid", CENTRE, -0.2),
        ("box", CENTRE, -0.1),
        ("box", CENTRE + SIZES, 0.0),
        ("box", CENTRE + SIZES * [1.0, 1.0, 0.2], 0.0),
    ],
)
def test_singular_points_have_their_gap_a_unit_normal_and_a_finite_hessian(name, point, exact, motion):
    body = shape(name, motion)
    gap, normal, curvature = body.gap_derivatives(body.carry(point[None], 0.0, FACTOR), FACTOR)
    assert abs(gap[0] - exact) < 2e-12
    assert abs(norm(normal[0]) - 1.0) < 1e-12
    assert np.isfinite(curvature).all()


def test_hessians_turn_with_the_body_at_singular_points_too():
    body, p = shape("cylinder", MOTION), MORE[:1]
    still, turn = shape("cylinder"), MOTION.turn(FACTOR)
    moved = body.gap_derivatives(MOTION.place(p + 0.01, FACTOR), FACTOR)[2][0]
    expected = turn @ still.derivatives(p + 0.01)[2][0] @ turn.T
    np.testing.assert_allclose(moved, expected, atol=1e-9)
    flat = body.gap_derivatives(MOTION.place(p, FACTOR), FACTOR)[2][0]
    assert np.abs(flat @ turn @ AXIS).max() < 1e-12 * np.abs(flat).max()


class Swing(Motion):
    """Another law of motion: to and fro, turning ever further."""

    moves = True

    def shift(self, t):
        return np.sin(3.0 * t) * self.displacement

    def turn(self, t):
        return super().turn(t**2)


@EVERY
def test_a_law_of_motion_is_its_shift_and_turn(name):
    swing = Swing(displacement=MOTION.displacement, rotation=MOTION.rotation, center=MOTION.center)
    body, still, p = shape(name, swing), shape(name), around()
    for t in (0.0, 0.4, 1.3):
        angle, axis = t**2 * norm(MOTION.rotation), normalised(MOTION.rotation)
        d = p - MOTION.center
        turned = np.cos(angle) * d + np.sin(angle) * np.cross(axis, d)
        turned += (1.0 - np.cos(angle)) * np.outer(d @ axis, axis)  # Rodrigues
        there = turned + MOTION.center + np.sin(3.0 * t) * MOTION.displacement
        np.testing.assert_allclose(body.carry(p, 0.0, t), there, atol=1e-12)
        np.testing.assert_allclose(body.gap(there, t), still.gap(p, 0.0), atol=1e-12)
        matrix = swing.matrix(t)
        np.testing.assert_allclose(p @ matrix[:3, :3].T + matrix[:3, 3], there, atol=1e-12)


@pytest.mark.parametrize("radii", [[0.1, 0.16, 0.23], [1.0, 1.0, 2.0], [1e-3, 1.0, 1e3], [1.0, 1e6, 1e6]])
def test_closest_points_of_ellipsoids_take_few_iterations(radii, monkeypatch):
    """On spheres, needles and discs, on either side and on the planes of symmetry; bisection took 55, which was half
    of the time of a sheet on an ellipsoid."""
    roots: list[int] = []
    monkeypatch.setattr(np, "sqrt", lambda x, sqrt=np.sqrt: roots.append(1) or sqrt(x))
    radii = np.array(radii)
    rng = np.random.default_rng(5)
    way = np.abs(rng.normal(size=(400, 3)))
    way *= radii / norm(way)[:, None]
    for share in (1e-9, 0.5, 1.0 - 1e-6, 1.0 + 1e-6, 2.0, 100.0):
        for p in (share * way, share * way * rng.integers(0, 2, way.shape)):
            roots.clear()
            foot = _ellipsoid_foot(p, radii)
            assert np.abs(((foot / radii) ** 2).sum(axis=1) - 1.0).max() < 4e-15
            off = np.cross(np.maximum(p, 1e-12 * radii.min()) - foot, foot / radii**2)
            assert (norm(off) < 1e-14 * norm(foot / radii**2) * (norm(p) + radii.max())).all()
            assert 0 < len(roots) <= 25
