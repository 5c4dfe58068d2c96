"""Panels: where a surface is cut, and how it is laid flat."""

import json

import numpy as np
import pytest
from mesh_helpers import generator
from pattern_shapes import cylinder, gores, octahedron, ramp, skirt, t_shirt, torus

from voile.cli import main
from voile.errors import InputError
from voile.inverse.flatten import distortion, flatten, flatten_disc, overlaps
from voile.inverse.overlaps import split_overlaps
from voile.inverse.panels import Panels, split
from voile.inverse.pattern import sewing
from voile.inverse.stitched import add_stitches
from voile.inverse.symmetric import mirror_map
from voile.mesh import Stitches, build_topology, read_body, read_mesh, write_obj

patterns = generator("patterns")


def edge_errors(panels: Panels, flat: np.ndarray) -> np.ndarray:
    """Relative errors of all edges' lengths in the plane."""
    edges = build_topology(panels.corners).edges
    lengths = [
        np.linalg.norm(np.diff(x[edges], axis=1)[:, 0], axis=1) for x in (flat, panels.points[panels.vertex])
    ]
    return lengths[0] / lengths[1] - 1


# ---- cutting ----


def test_skirt_is_cut_open_down_the_middle_of_its_back():
    points, triangles = skirt()
    panels = split(triangles, points)
    assert panels.names == ("panel-1",) and len(panels.seams) == 1
    seam = panels.seams[0]
    at = points[panels.vertex[seam.sides[0]]]
    assert seam.panels == (0, 0)
    assert abs(at[:, 0]).max() < 1e-12 and at[:, 2].max() < 0
    assert np.ptp(at[:, 1]) == pytest.approx(np.ptp(points[:, 1]), rel=1e-12)
    assert np.array_equal(panels.vertex[seam.sides[0]], panels.vertex[seam.sides[1]])
    assert not np.intersect1d(*seam.sides).size
    assert len(panels.vertex) == len(points) + len(at)


SCENE = """
[scene]
task = "inverse"
[shell]
mesh = "even.obj"
young = 1e9
thickness = 1e-3
density = 30.0
[[fix]]
select = { boundary = 1 }
[pattern]
symmetric = "x"
"""


def test_a_rough_skirt_is_cut_in_the_plane_of_its_symmetry(tmp_path):
    """Half of a skirt whose vertices lie anywhere by 5 mm, and its image: the shortest cut is beside the plane, and
    leaves a panel that does not mirror itself."""
    points, triangles = skirt()
    points = points + np.random.default_rng(0).uniform(-5e-3, 5e-3, points.shape)
    write_obj(tmp_path / "rough.obj", points, triangles)
    even = str(tmp_path / "even.obj")
    assert main(["mesh", "mirror", str(tmp_path / "rough.obj"), "--across", "x", "-o", even]) == 0
    surface = read_mesh(even)
    with pytest.raises(InputError, match="cut otherwise than its mirror image"):
        mirror_map(split(surface.triangles, surface.points), 0)
    (tmp_path / "scene.toml").write_text(SCENE)
    assert main(["run", str(tmp_path / "scene.toml"), "-o", str(tmp_path / "out")]) == 0
    pattern = json.loads((tmp_path / "out" / "pattern.json").read_text())
    assert pattern["mirrors"] == [0]
    x = np.array(pattern["pieces"][0]["points"])
    image = x * [-1.0, 1.0] + [x[:, 0].min() + x[:, 0].max(), 0.0]
    assert np.linalg.norm(x[:, None] - image, axis=2).min(axis=1).max() < 1e-12


def test_gores_are_sewn_along_their_four_seams():
    points, triangles = skirt()
    panels = split(triangles, points, groups=gores(points, triangles))
    assert panels.names == ("front", "left", "back", "right")  # in the order of the groups
    joined = sorted(sorted(panels.names[k] for k in seam.panels) for seam in panels.seams)
    assert joined == [["back", "left"], ["back", "right"], ["front", "left"], ["front", "right"]]
    for seam in panels.seams:
        assert [np.unique(panels.vertex_panel[side]).tolist() for side in seam.sides] == [
            [k] for k in seam.panels
        ]
        assert seam.at[0][0] == 0 and seam.at[0][-1] == pytest.approx(1) and (np.diff(seam.at[0]) > 0).all()


def test_given_seams_cut_the_same_gores():
    points, triangles = skirt()
    index, names = gores(points, triangles)
    grouped = split(triangles, points, groups=(index, names))
    pairs = np.concatenate(
        [np.column_stack([s[:-1], s[1:]]) for s in (grouped.vertex[q.sides[0]] for q in grouped.seams)]
    )
    seamed = split(triangles, points, seams=pairs)
    first = [grouped.panel[seamed.panel == k] for k in range(4)]  # the same pieces, numbered as they appear
    assert sorted(p[0] for p in first) == [0, 1, 2, 3] and all(np.ptp(p) == 0 for p in first)
    assert seamed.names == ("panel-1", "panel-2", "panel-3", "panel-4")


@pytest.mark.parametrize(("shape", "seams"), [(torus, 2), (octahedron, 1)])
def test_closed_surfaces_are_cut_to_one_disc(shape, seams):
    points, triangles = shape()
    panels = split(triangles, points)
    edges = build_topology(panels.corners).edges
    assert len(panels.outlines) == 1 and len(panels.vertex) - len(edges) + len(triangles) == 1
    assert len(panels.seams) == seams
    assert sum(len(seam.sides[0]) - 1 for seam in panels.seams) * 2 == len(panels.outlines[0])


def test_a_t_shirt_is_sewn_at_its_shoulders_and_sides():
    points, triangles, groups = t_shirt()
    panels = split(triangles, points, groups=groups)
    assert panels.names == ("front", "back") and [seam.panels for seam in panels.seams] == [(0, 1)] * 4
    lengths = [
        np.linalg.norm(np.diff(points[panels.vertex[s.sides[0]]], axis=0), axis=1).sum() for s in panels.seams
    ]
    assert sorted(lengths) == pytest.approx([0.5, 0.5, 0.7, 0.7])
    flat = flatten(panels)
    assert abs(edge_errors(panels, flat.coordinates)).max() < 1e-12
    one = split(triangles, points)  # without groups: neck, hem and sleeves joined by three cuts
    edges = build_topology(one.corners).edges
    assert len(one.outlines) == 1 and len(one.vertex) - len(edges) + len(triangles) == 1


def test_a_group_in_two_pieces_gives_two_numbered_panels():
    points, triangles = skirt()
    index = gores(points, triangles)[0]
    panels = split(triangles, points, groups=(index % 2, ("front and back", "sides")))
    assert panels.names == ("front and back-1", "front and back-2", "sides-1", "sides-2")


# ---- flattening ----


@pytest.mark.parametrize("shape", [skirt, cylinder])
def test_developable_panels_keep_every_edge(shape):
    points, triangles = shape()
    flat = flatten(split(triangles, points))
    assert abs(edge_errors(flat.panels, flat.coordinates)).max() < 1e-12
    assert abs(flat.stretches - 1).max() < 1e-12


def test_gores_keep_every_edge():
    points, triangles = skirt()
    flat = flatten(split(triangles, points, groups=gores(points, triangles)))
    assert abs(edge_errors(flat.panels, flat.coordinates)).max() < 1e-12


def test_a_hemisphere_is_laid_flat_with_least_energy():
    """Against disturbed shapes: no other one near has less; and rings are too long as they must be."""
    points, triangles = generator("hemisphere").hemisphere(radius=0.1, hole=0.0, size=0.02)
    flat = flatten_disc(points, triangles)
    area = np.linalg.norm(
        np.cross(*(points[triangles[:, k]] - points[triangles[:, 0]] for k in (1, 2))), axis=1
    )

    def energy(x):
        s = distortion(points, triangles, x)
        return area @ (s**2 + s**-2).sum(axis=1)

    random = np.random.default_rng(1)
    for _ in range(5):
        change = 1e-5 * random.standard_normal(flat.shape)
        assert energy(flat + change) > energy(flat)
        slope = (energy(flat + 1e-3 * change) - energy(flat - 1e-3 * change)) / 2e-3
        assert abs(slope) < 1e-7 * (energy(flat + change) - energy(flat)) / 1e-3
    assert distortion(points, triangles, flat).min() > 0.5
    rim = abs(points[:, 2]) < 1e-12
    assert np.linalg.norm(flat[rim] - flat.mean(axis=0), axis=1).mean() > 0.11


@pytest.mark.parametrize(("shape", "pieces"), [(ramp, 2), (lambda: t_shirt()[:2], 3)])
def test_what_overlaps_itself_is_cut_in_two(shape, pieces):
    points, triangles = shape()
    whole = flatten(split(triangles, points))
    assert overlaps(whole.coordinates[whole.panels.outlines[0]])
    flat = split_overlaps(triangles, points)
    assert len(flat.panels.names) == pieces
    assert not any(overlaps(flat.coordinates[outline]) for outline in flat.panels.outlines)
    assert len(flat.panels.seams) >= len(whole.panels.seams) + pieces - 1
    sizes = np.bincount(flat.panels.panel) / len(triangles)
    assert sizes.min() > 0.1  # no scraps


def test_distortion_is_that_of_a_known_map():
    points = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0.0]])
    s = distortion(points, np.array([[0, 1, 2]]), np.array([[0, 0], [0, 1.25], [-0.8, 0]]))
    assert s == pytest.approx(np.array([[1.25, 0.8]]))


# ---- bad input ----


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"groups": (np.zeros(10000, dtype=int), ("all",))}, "panel 'all' is no disc, it has 2 borders"),
        ({"seams": np.array([[0, 1]])}, "vertices 0 and 1 are an edge of its border"),
        ({"seams": np.array([[0, 200]])}, "vertices 0 and 200 are no edge of the surface"),
        ({"seams": np.array([[24, 48], [48, 72]])}, "seams end at the vertices 24, 72"),
    ],
)
def test_bad_panels_are_refused(options, message):
    points, triangles = skirt()
    if "groups" in options:
        options = {"groups": (options["groups"][0][: len(triangles)], options["groups"][1])}
    with pytest.raises(InputError, match=message):
        split(triangles, points, **options)


def test_more_than_two_triangles_at_an_edge_are_refused():
    with pytest.raises(InputError, match="at most two triangles to an edge"):
        split(np.array([[0, 1, 2], [1, 0, 3], [0, 1, 4]]), np.random.default_rng(0).random((5, 3)))


# ---- panels that come apart already ----


def test_stitches_between_unlike_borders_make_a_seam():
    """Two squares, 4 and 6 cells wide, the first hung on the second's edge, also between vertices."""
    one, few = patterns.grid(4, 2)
    two, many = patterns.grid(6, 2)
    points = np.concatenate(
        [
            np.column_stack([one, np.zeros(len(one))]),
            np.column_stack([two[:, 0], two[:, 1] + 1.1, np.zeros(len(two))]),
        ]
    )
    upper = np.flatnonzero(one[:, 1] == 1)
    lower = len(one) + np.flatnonzero(two[:, 1] == 0)
    along = 6 * one[upper, 0]
    left = np.minimum(along.astype(int), 5)
    stitches = Stitches(upper, lower[left], lower[left + 1], along - left)
    bare = split(np.concatenate([few, many + len(one)]), points)
    panels = add_stitches(bare, stitches)
    assert bare.seams == () and len(panels.seams) == 1
    seam = panels.seams[0]
    assert seam.panels == (0, 1)
    assert panels.vertex[seam.sides[0]].tolist() == upper[::-1].tolist()  # counter-clockwise
    assert panels.vertex[seam.sides[1]].tolist() == lower[::-1].tolist()
    assert seam.at[0] == pytest.approx(np.linspace(0, 1, 5)) and seam.at[1] == pytest.approx(
        np.linspace(0, 1, 7)
    )
    assert np.array_equal(sewing(panels).weight, stitches.weight)


def test_pleated_dress_is_estimated_from_its_drape(shared):
    """Against its true pattern: the flat panels are as far from it as the draped cloth is stretched, no more."""
    cut = read_mesh(shared / "meshes" / "pleated-dress-panels.obj", seams=False)
    drape, _ = read_body(shared / "meshes" / "pleated-dress-draped-with-mannequin.obj")
    few = np.isin(cut.group, [1, 2, 3, 5])  # bodice, waistband, skirt
    panels = split(cut.triangles[few], drape[cut.input_vertex], groups=(cut.group[few], cut.group_names))
    true = np.zeros((len(panels.vertex), 2))
    true[panels.corners] = cut.texture[cut.texture_triangles[few]]
    flat = flatten(panels)
    edges = build_topology(panels.corners).edges
    shapes = (true, flat.coordinates, panels.points[panels.vertex])
    length = [np.linalg.norm(np.diff(x[edges], axis=1)[:, 0], axis=1) for x in shapes]
    corners = [x[panels.corners] for x in shapes[:2]]
    area = [np.linalg.det(c[:, 1:] - c[:, :1]) for c in corners]
    for k, (name, most) in enumerate(
        {"panel1": 0.02, "panel2": 0.08, "panel3": 0.03, "panel5": 0.01}.items()
    ):
        assert panels.names[k] == name
        here = panels.vertex_panel[edges[:, 0]] == k
        flat_error, drape_error = (np.sqrt(np.mean((x / length[0] - 1)[here] ** 2)) for x in length[1:])
        assert flat_error < 1.01 * drape_error
        true_area, flat_area = (a[panels.panel == k].sum() for a in area)
        assert flat_area == pytest.approx(true_area, rel=most)


def test_pleated_dress_is_sewn_as_its_stitches_say(shared):
    surface = read_mesh(shared / "meshes" / "pleated-dress-panels.obj")
    groups = (surface.group, surface.group_names)
    panels = add_stitches(split(surface.triangles, surface.points, groups=groups), surface.stitches)
    pairs = {frozenset(panels.names[k] for k in seam.panels) for seam in panels.seams}
    for one, two in ((4, 5), (5, 12), (11, 12), (4, 11), (0, 1), (7, 8), (2, 3), (9, 10), (1, 13), (6, 8)):
        assert {f"panel{one}", f"panel{two}"} in pairs
    sewn = np.concatenate([np.concatenate(seam.sides) for seam in panels.seams])
    ends = np.unique(panels.stitches.slave)
    assert np.isin(ends, sewn).mean() > 0.95  # all but the tips of its pleats
    assert len(sewing(panels)) == len(surface.stitches)
