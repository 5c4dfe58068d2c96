"""The generators of meshes/: oriented manifolds of the right area, size and shape."""

import subprocess
import sys

import igl
import numpy as np
import pytest
from mesh_helpers import GENERATORS, areas, generator, loops_of, normals

from voile.contact.obstacles import MeshBody
from voile.mesh import (
    build_topology,
    read_mesh,
    read_rest,
    write_obj,
)

SPHERE_ZONE = 2 * np.pi * 100 * np.cos(np.radians(18))
CAP = 2 * np.pi * (1 - np.cos(np.radians(30)))
SHAPES = [  # name, parameters, exact area, its relative error at that size, loops, Euler characteristic
    ("plate", {"length": 2.0, "width": 1.0, "size": 0.1}, 2.0, 1e-12, 1, 1),
    ("strip", {"size": 0.02}, 0.1, 1e-12, 1, 1),
    ("slit_annulus", {"size": 0.4}, 64 * np.pi, 1e-3, 1, 1),
    ("cylinder", {"size": 0.5}, 2 * np.pi * 4.953 * 10.35, 1e-3, 2, 0),
    ("cylinder", {"size": 0.5, "sector": 90.0}, np.pi / 2 * 4.953 * 10.35, 1e-3, 1, 1),
    ("hemisphere", {"size": 0.8}, SPHERE_ZONE, 5e-3, 2, 0),
    ("hemisphere", {"size": 0.8, "sector": 90.0}, SPHERE_ZONE / 4, 5e-3, 1, 1),
    ("spherical_cap", {"size": 0.04}, CAP, 2e-3, 1, 1),
    ("skirt", {"size": 0.03}, 0.55 * (0.70 + 1.60) / 2, 2e-3, 2, 0),
]


@pytest.mark.parametrize("irregular", [False, True], ids=["structured", "irregular"])
@pytest.mark.parametrize(("name", "options", "area", "error", "loops", "euler"), SHAPES)
def test_generated_shapes(tmp_path, name, options, area, error, loops, euler, irregular):
    if irregular:
        pytest.importorskip("gmsh", reason="irregular meshes need gmsh (pip install gmsh)")
    mesh = getattr(generator(name), name)(**options, irregular=irregular)
    write_obj(tmp_path / "out.obj", *mesh)
    surface = read_mesh(tmp_path / "out.obj")
    assert surface.notes == ()  # consistently oriented, no unused vertex
    assert areas(surface.points, surface.triangles).sum() == pytest.approx(area, rel=error)
    topology = build_topology(surface.triangles)
    assert len(loops_of(surface)) == loops
    assert len(surface.points) - len(topology.edges) + len(surface.triangles) == euler
    corners = surface.points[surface.triangles]
    normal = normals(surface.points, surface.triangles)
    outward = {
        "cylinder": corners.mean(axis=1) * [1, 1, 0],
        "skirt": corners.mean(axis=1) * [1, 0, 1],
        "hemisphere": corners.mean(axis=1),
    }.get(name, np.broadcast_to([0.0, 0.0, 1.0], normal.shape))
    assert ((normal * outward).sum(axis=1) > 0).all()
    edges = np.linalg.norm(
        surface.points[topology.edges[:, 0]] - surface.points[topology.edges[:, 1]], axis=1
    )
    assert 0.5 * options["size"] < np.median(edges) < 1.5 * options["size"]


@pytest.mark.parametrize("irregular", [False, True], ids=["structured", "irregular"])
def test_slit_is_open_and_straight(irregular):
    if irregular:
        pytest.importorskip("gmsh", reason="irregular meshes need gmsh (pip install gmsh)")
    points, _ = generator("slit_annulus").slit_annulus(size=0.5, irregular=irregular)
    on_cut = points[(np.abs(points[:, 1]) < 1e-9) & (points[:, 0] > 0)]
    assert len(on_cut) == 2 * len(np.unique(on_cut[:, 0].round(9)))  # every place twice
    assert (
        len(on_cut) == 2 * 9
        and on_cut[:, 0].min() == pytest.approx(6)
        and on_cut[:, 0].max() == pytest.approx(10)
    )


@pytest.mark.parametrize("irregular", [False, True], ids=["structured", "irregular"])
def test_skirt_pattern_is_developable(tmp_path, irregular):
    """Edges of skirt and pattern agree but for the chords of the round; the waist is on top."""
    if irregular:
        pytest.importorskip("gmsh", reason="irregular meshes need gmsh (pip install gmsh)")
    size = 0.02
    mesh = generator("skirt").skirt(size=size, irregular=irregular)
    write_obj(tmp_path / "skirt.obj", *mesh)
    surface = read_mesh(tmp_path / "skirt.obj")
    rest = read_rest("flat", surface, tmp_path)

    def lengths(points, triangles):
        corners = points[triangles]
        return np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)

    strain = lengths(surface.points, surface.triangles) / lengths(rest.points, rest.triangles) - 1
    assert np.abs(strain).max() < 0.1 * (2 * np.pi * size / 0.70) ** 2
    assert len(rest.points) > len(surface.points)  # the cut
    assert (normals(rest.points, rest.triangles)[:, 2] > 0).all()
    hem, waist = loops_of(surface)
    np.testing.assert_allclose(surface.points[waist, 1], 1.0, atol=1e-12)
    assert np.linalg.norm(surface.points[hem][:, [0, 2]], axis=1) == pytest.approx(1.6 / (2 * np.pi))


def test_dress_form_has_its_girths():
    """A closed outward body, symmetric in x, whose horizontal sections measure waist, hip and bust."""
    sizes = {"bust": 0.90, "waist": 0.70, "hip": 1.00}
    form = generator("dress_form")
    points, triangles = form.dress_form(height=0.8, size=0.01, **sizes)
    topology = build_topology(triangles)
    assert (topology.across >= 0).all()
    assert len(points) - len(topology.edges) + len(triangles) == 2
    a, b, c = (points[triangles[:, i]] for i in range(3))
    volume = (a * np.cross(b, c)).sum() / 6
    assert 0.02 < volume < 0.06  # positive: outward
    assert points[:, 1].min() == pytest.approx(0, abs=1e-12) and points[:, 1].max() == pytest.approx(0.8)
    assert points[:, 0].max() == pytest.approx(-points[:, 0].min(), rel=0.01)
    for share, name, *_ in (s for s in form.SECTIONS if s[2] == 1.0):
        level = form.BOTTOM + share * (0.8 - form.TOP - form.BOTTOM)
        assert girth(points, triangles, level) == pytest.approx(sizes[name], rel=0.005)


def girth(points, triangles, level):
    """Length of the horizontal section of a surface at y = level."""
    total = 0.0
    for corners in points[triangles]:
        above = corners[:, 1] > level
        if 0 < above.sum() < 3:
            ends = [
                corners[i]
                + (level - corners[i, 1]) / (corners[j, 1] - corners[i, 1]) * (corners[j] - corners[i])
                for i, j in ((0, 1), (1, 2), (2, 0))
                if above[i] != above[j]
            ]
            total += float(np.linalg.norm(ends[1] - ends[0]))
    return total


def test_diagonals():
    patterns = generator("patterns")
    for diagonals, triangles in (("alternating", 24), ("right", 24), ("crossed", 48)):
        points, corners = patterns.grid(4, 3, diagonals)
        plane = np.column_stack([points, np.zeros(len(points))])
        assert len(corners) == triangles
        assert areas(plane, corners).sum() == pytest.approx(1.0)
        edges = build_topology(corners).edges
        slope = points[edges[:, 1]] - points[edges[:, 0]]
        turns = np.sign(slope[:, 0] * slope[:, 1]).astype(int)
        rising, falling = (turns > 0).sum(), (turns < 0).sum()
        assert (rising, falling) == {"alternating": (6, 6), "right": (12, 0), "crossed": (24, 24)}[diagonals]
    with pytest.raises(ValueError, match="allowed: alternating, crossed, right"):
        patterns.grid(1, 1, "left")


def test_generator_command(tmp_path):
    program = [sys.executable, GENERATORS / "plate.py"]
    out = tmp_path / "plate.obj"
    done = subprocess.run(
        [*program, "--size", "0.5", "--diagonals", "crossed", out], capture_output=True, text=True
    )
    assert done.returncode == 0 and "13 vertices, 16 triangles" in done.stdout, done.stderr
    assert len(read_mesh(out).triangles) == 16
    done = subprocess.run([*program, "--size", "0", out], capture_output=True, text=True)
    assert done.returncode == 2 and "size = 0.0, allowed: a positive number" in done.stderr


def test_a_fitted_skirt_keeps_its_clearance_from_the_form(tmp_path):
    points, triangles = generator("fitted_skirt").fitted_skirt(clearance=0.004, size=0.02)
    write_obj(tmp_path / "out.obj", points, triangles)
    surface = read_mesh(tmp_path / "out.obj")
    assert surface.notes == () and len(loops_of(surface)) == 2
    # girth of the form 0.26 m up; offset curves grow by 2 pi
    area = 0.40 * (0.8758 + 2 * np.pi * 0.004 + np.pi * 0.25 * 0.40)
    assert areas(points, triangles).sum() == pytest.approx(area, rel=5e-3)
    assert ((normals(points, triangles) * points[triangles].mean(axis=1) * [1, 0, 1]).sum(axis=1) > 0).all()
    form, faces = generator("dress_form").dress_form(size=0.005)
    gap = np.sqrt(igl.point_mesh_squared_distance(points, form, faces)[0])
    assert (igl.winding_number(form, faces, points) < 0.5).all()
    assert 0.86 * 0.004 < gap.min() < 1.02 * 0.004  # the form slopes by up to 30 degrees against its section


@pytest.mark.parametrize("garment", ["fitted_skirt", "bell_skirt"])
def test_a_fitted_body_keeps_its_clearance_from_the_garment(tmp_path, garment):
    """Closed, near the cloth where it is worn tight, away from it below, and smooth enough for its distance field."""
    module = generator(garment)
    write_obj(tmp_path / "cloth.obj", *getattr(module, garment)(size=0.04)[:2])
    cloth = read_mesh(tmp_path / "cloth.obj")
    clearance, radius, below, slope, size = 0.002, 0.04, 0.08, 0.3, 0.015
    write_obj(
        tmp_path / "body.obj",
        *generator("fitted_body").fitted_body(
            str(tmp_path / "cloth.obj"), 1.0, clearance, radius, below, slope, size
        ),
    )
    body = read_mesh(tmp_path / "body.obj")
    topology = build_topology(body.triangles)
    assert body.notes == () and (topology.across >= 0).all()
    assert len(body.points) - len(topology.edges) + len(body.triangles) == 2
    gap = np.sqrt(igl.point_mesh_squared_distance(cloth.points, body.points, body.triangles)[0])
    assert (igl.winding_number(body.points, body.triangles, cloth.points) < 0.5).all()  # outward, too
    chord = size**2 / (
        4 * radius
    )  # of the two surfaces found on the grid, a ball's curvature in two directions
    depth = cloth.points[:, 1].max() - cloth.points[:, 1]
    tight = depth < below / 2
    assert clearance - chord < gap.min() and gap[tight].max() < clearance + 2 * chord
    assert (gap > clearance + slope * np.maximum(depth - below - radius, 0) - chord).all()
    field = MeshBody.around(body.points, body.triangles, resolution=0.012)
    assert field.gap(cloth.points, 0.0).min() > 0 and field.error() < clearance


def test_a_fitted_body_needs_room(tmp_path):
    write_obj(tmp_path / "cloth.obj", *generator("fitted_skirt").fitted_skirt(size=0.05))
    with pytest.raises(
        ValueError, match="no ball fits inside the garment, allowed: less radius or clearance"
    ):
        generator("fitted_body").fitted_body(str(tmp_path / "cloth.obj"), radius=0.3, size=0.03)
