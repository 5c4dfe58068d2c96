"""What is made of a mesh: rest shapes, seams, selections; and the real garments."""

import numpy as np
import pytest
from mesh_helpers import SQUARE, SQUARE_POINTS, areas, generator, loops_of, obj

from voile.errors import InputError
from voile.mesh import (
    Stitches,
    Surface,
    read_mesh,
    read_rest,
    select,
    sewing_matrix,
    write_obj,
)

# --- rest shapes


def test_rest_of_the_mesh_itself_and_of_a_file(tmp_path):
    surface = read_mesh(obj(tmp_path, "v 7 7 7\n" + SQUARE + "f 2 3 4\nf 2 5 4\n"))
    own = read_rest(None, surface, tmp_path)
    assert own.points is surface.points and own.triangles is surface.triangles and not own.flat
    # other positions, another start of a face, the same clash of orientations
    obj(tmp_path, "v 7 7 7\nv 0 0 0\nv 3 0 0\nv 3 3 0\nv 0 3 0\nf 3 4 2\nf 2 5 4\n", "rest.obj")
    rest = read_rest("rest.obj", surface, tmp_path, scale=2.0)
    np.testing.assert_array_equal(rest.points, 6 * SQUARE_POINTS)
    np.testing.assert_array_equal(rest.triangles, surface.triangles)


@pytest.mark.parametrize(
    ("rest", "message"),
    [
        (
            SQUARE + "f 1 2 3\nf 2 3 4\n",
            r"triangle 1 .*1, 2, 3\) in line 6 is not that of .*vertices 0, 2, 3",
        ),
        (SQUARE + "f 1 2 3\n", "1 triangles, but .* has 2; a rest shape needs the same triangles"),
        ("v 0 0 0\nv 1 0 0\nv 2 0 0\nv 0 1 0\nf 1 2 3 4\n", "triangle 0 has no area in the rest shape"),
        ("v 0 0 0\nv nan 0 0\nv 2 0 0\nv 0 1 0\nf 1 2 3 4\n", "vertex 1 in line 2 .*not finite"),
    ],
)
def test_refused_rest_files(tmp_path, rest, message):
    surface = read_mesh(obj(tmp_path, SQUARE + "f 1 2 3 4\n"))
    obj(tmp_path, rest, "rest.obj")
    with pytest.raises(InputError, match=message):
        read_rest("rest.obj", surface, tmp_path)
    with pytest.raises(InputError, match="no such mesh file"):
        read_rest("absent.obj", surface, tmp_path)


def test_flat_rest_has_its_own_numbering(tmp_path):
    texture = "vt 0 0\nvt 1 0\nvt 1 1\nvt 5 0\nvt 6 1\nvt 5 1\n"
    surface = read_mesh(obj(tmp_path, SQUARE + texture + "f 1/1 2/2 3/3\nf 1/4 3/5 4/6\n"))
    rest = read_rest("flat", surface, tmp_path)
    assert rest.flat and rest.points.shape == (6, 3) and (rest.points[:, 2] == 0).all()
    assert rest.triangles.tolist() == [[0, 1, 2], [3, 4, 5]]
    np.testing.assert_allclose(areas(rest.points, rest.triangles), 0.5)


def test_flat_rest_refusals(tmp_path):
    with pytest.raises(InputError, match="rest = 'flat' needs texture coordinates"):
        read_rest("flat", read_mesh(obj(tmp_path, SQUARE + "f 1 2 3 4\n")), tmp_path)
    surface = read_mesh(obj(tmp_path, SQUARE + "vt 0 0\nf 1/1 2/1 3/1 4/1\n"))
    with pytest.raises(InputError, match="texture coordinates: triangle 0 has no area in the rest shape"):
        read_rest("flat", surface, tmp_path)


# --- seams


def stitches(*records):
    slave, first, second, weight = zip(*records, strict=True)
    return Stitches(
        *(np.array(a, dtype=np.int32) for a in (slave, first, second)), np.array(weight, dtype=float)
    )


def test_sewing_satisfies_every_record():
    """Joins in a ring, an edge point recorded from both ends, and a chain of hanging vertices."""
    records = stitches(
        (2, 5, 9, 0.0), (5, 7, 9, 1.0), (9, 1, 2, 1.0),  # 2 = 5 = 9 = 2
        (3, 0, 2, 0.25), (3, 9, 0, 0.75),  # 3 on the edge 0-2, twice
        (4, 3, 6, 0.5), (8, 4, 0, 0.1), (7, 6, 6, 0.3),
    )  # fmt: skip
    matrix, free = sewing_matrix(records, 10)
    assert free.tolist() == [0, 1, 2, 6]
    np.testing.assert_allclose(matrix.sum(axis=1), 1.0)
    assert matrix.min() >= 0
    np.testing.assert_array_equal(matrix[free].toarray(), np.eye(4))
    x = matrix @ np.random.default_rng(0).random((4, 3))
    w = records.weight[:, None]
    residual = x[records.slave] - (1 - w) * x[records.first] - w * x[records.second]
    assert np.abs(residual).max() < 1e-15


@pytest.mark.parametrize(
    ("records", "message"),
    [
        ([(0, 1, 2, 0.5), (1, 0, 3, 0.5)], "stitches of vertices 0, 1 form a cycle"),
        ([(0, 0, 2, 0.5)], "stitch 0: the stitches of vertices 0 form a cycle"),
        (
            [(0, 1, 2, 0.5), (3, 0, 0, 0.0), (1, 3, 4, 0.2)],
            "stitches of vertices 0, 1 form a cycle",
        ),
        (
            [(0, 1, 2, 0.5), (0, 3, 4, 0.5)],
            "stitch 1: vertex 0 already hangs on .* by stitch 0",
        ),
        ([(0, 1, 2, 0.5), (0, 1, 2, 0.6)], "stitch 1: vertex 0 already hangs"),
    ],
)
def test_refused_stitches(records, message):
    with pytest.raises(InputError, match=message):
        sewing_matrix(stitches(*records), 5)


def test_cycle_in_a_file_names_its_line(tmp_path):
    text = SQUARE + "f 1 2 3 4\nstitch 0 1 2 0.5\nstitch 1 0 3 0.5\n"
    with pytest.raises(InputError, match=r"mesh\.obj: stitch 0 in line 6: .* vertices 0, 1 form a cycle"):
        read_mesh(obj(tmp_path, text))
    assert read_mesh(tmp_path / "mesh.obj", seams=False).stitches is None


def test_triangles_that_vanish_in_a_seam_are_dropped(tmp_path):
    """A strip whose middle edge closes: two triangles vanish, the rest file still counts them."""
    points, triangles = generator("patterns").grid(3, 2, "right")
    points = np.column_stack([points, np.zeros(len(points))])
    write_obj(tmp_path / "dart.obj", points, triangles, stitches=stitches((5, 6, 6, 0.0)))
    surface = read_mesh(tmp_path / "dart.obj")
    gone = np.flatnonzero([5 in t and 6 in t for t in triangles.tolist()])
    assert surface.input_triangle.tolist() == np.setdiff1d(np.arange(len(triangles)), gone).tolist()
    assert surface.input_triangles == 12 and len(surface.group) == 10 and len(surface.points) == 12
    assert surface.notes == (f"2 of 12 triangles dropped, their seams join them away: {gone[0]}, {gone[1]}",)
    rest = read_rest("dart.obj", surface, tmp_path)
    np.testing.assert_array_equal(rest.triangles, surface.triangles)
    assert len(read_mesh(tmp_path / "dart.obj", seams=False).triangles) == 12


# --- selections


@pytest.fixture
def annulus(tmp_path) -> Surface:
    """A ring in z = 0 with an unused vertex 0 in its file and two groups by the sign of x."""
    points, triangles = generator("cylinder").cylinder(radius=1.0, length=1.0, size=0.5)
    points = np.column_stack([points[:, :2] * (2 - points[:, 2:]), 0 * points[:, 2]])
    groups = ((points[triangles][:, :, 0].mean(axis=1) > 0).astype(int), ("left", "right"))
    write_obj(tmp_path / "ring.obj", np.concatenate([[[9, 9, 9]], points]), triangles + 1, groups=groups)
    return read_mesh(tmp_path / "ring.obj")


def test_select(annulus):
    loops = loops_of(annulus)
    radius = np.linalg.norm(annulus.points, axis=1)
    outer = select(annulus, loops, {"boundary": 0}, "fix[0].select")
    np.testing.assert_array_equal(outer, np.flatnonzero(radius > 1.99))
    assert outer.dtype == np.int32
    assert len(select(annulus, loops, {"boundary": [0, 1]}, "s")) == len(loops[0]) + len(loops[1])
    np.testing.assert_array_equal(select(annulus, loops, {"nodes": [3, 1]}, "s"), [0, 2])  # file numbering
    assert len(select(annulus, loops, {"all": True}, "s")) == len(annulus.points)
    right = select(annulus, loops, {"group": "right"}, "s")
    index = annulus.group_names.index("right")
    np.testing.assert_array_equal(right, np.unique(annulus.triangles[annulus.group == index]))
    both = select(annulus, loops, {"group": "right", "boundary": 0, "box": [[0, -3, 0], [3, 3, 0]]}, "s")
    expected = np.intersect1d(right, outer)
    np.testing.assert_array_equal(both, expected[annulus.points[expected, 0] >= 0])
    assert len(both) > 0


@pytest.mark.parametrize(
    ("selection", "message"),
    [
        ({}, "nothing selected, allowed keys: nodes, group, box, boundary, all"),
        ({"node": [1]}, "unknown key 'node', allowed: nodes, group"),
        ({"nodes": [0]}, r"nodes: vertex 0 of .* belongs to no triangle and was dropped"),
        ({"nodes": [999]}, r"nodes: vertex 999, allowed: 0 to \d+"),
        ({"nodes": [-1]}, r"nodes: vertex -1, allowed: 0 to"),
        ({"nodes": [1.5]}, "nodes: .*allowed: an integer or a list of integers"),
        ({"nodes": True}, "nodes: True, allowed: an integer"),
        ({"nodes": []}, "selects no vertex"),
        (
            {"group": "middle"},
            "group: no group 'middle' in .*ring.obj, allowed: (left, right|right, left)",
        ),
        ({"box": [[0, 0, 5], [1, 1, 6]]}, "selects no vertex of .*ring.obj, which spans"),
        ({"box": [[1, 1, 1], [0, 0, 0]]}, "box: .*min <= max"),
        ({"box": [0, 1]}, "box: .*allowed: .*xmin"),
        ({"box": "here"}, "box: 'here', allowed"),
        ({"boundary": 2}, r"boundary: loop 2, allowed: 0 to 1 .*2 boundary loops"),
        ({"boundary": "0"}, "boundary: .*allowed: an integer"),
        ({"all": False}, "all: False, allowed: true"),
    ],
)
def test_refused_selections(annulus, selection, message):
    with pytest.raises(InputError, match=message) as caught:
        select(annulus, loops_of(annulus), selection, "fix[0].select")
    assert str(caught.value).startswith("fix[0].select")


def test_select_on_a_closed_surface(tmp_path):
    points, triangles = generator("dress_form").dress_form(size=0.1)
    write_obj(tmp_path / "form.obj", points, triangles)
    with pytest.raises(InputError, match=r"form.obj is closed, it has no boundary loop"):
        select(read_mesh(tmp_path / "form.obj"), [], {"boundary": 0}, "fix[0].select")


# --- real garments


@pytest.mark.parametrize(
    ("name", "vertices", "triangles", "loops"),
    [
        ("skirt3448.obj", 1809, 3448, 2),
        ("skirt7271.obj", 3757, 7271, 2),
        ("dress-v5k-f10k-v3.obj", 4536, 8801, 6),
        ("dress-v17k-f34k.obj", 17562, 34099, 6),
        ("mannequin.obj", 12811, 25472, 3),
        ("pleated-dress-draped-with-mannequin.obj", 28467, 54928, 17),
    ],
)
def test_garments(shared, name, vertices, triangles, loops):
    surface = read_mesh(shared / "meshes" / name)
    assert surface.points.shape == (vertices, 3) and surface.triangles.shape == (triangles, 3)
    assert surface.notes == ()
    found = loops_of(surface)
    assert len(found) == loops
    touching = np.bincount(np.concatenate(found)).max() - 1
    assert touching == (1 if name.startswith("dress") else 0)


def test_one_texture_coordinate_for_all_is_no_pattern(shared):
    surface = read_mesh(shared / "meshes" / "skirt3448.obj")
    with pytest.raises(InputError, match="triangle 0 has no area in the rest shape"):
        read_rest("flat", surface, ".")


def test_pleated_dress_panels(shared):
    """The stitches count from 0: sewn, they hold on the draped dress of another simulator to 0.3 mm."""
    surface = read_mesh(shared / "meshes" / "pleated-dress-panels.obj")
    assert surface.points.shape == (15656, 3) and surface.input_triangles == 29456
    assert surface.group_names == tuple(f"panel{i}" for i in range(14))
    assert len(surface.stitches) == 851 and len(loops_of(surface)) == 14
    # two records tie three neighbours in one corner, and an edge of 7 mm closes with its two triangles
    assert surface.notes == (
        "6 stitches join vertices in a circle: some say what others say",
        "2 of 29456 triangles dropped, their seams join them away: 13771, 13774",
    )
    matrix, free = sewing_matrix(surface.stitches, len(surface.points))
    assert matrix.shape == (15656, 15656 - 799) and len(free) == 14857  # 799: rank of the 851 records
    x, s = matrix @ surface.points[free], surface.stitches
    w = s.weight[:, None]
    assert np.abs(x[s.slave] - (1 - w) * x[s.first] - w * x[s.second]).max() < 1e-15
    draped = read_mesh(shared / "meshes" / "pleated-dress-draped-with-mannequin.obj").points
    gap = draped[s.slave] - (1 - w) * draped[s.first] - w * draped[s.second]
    assert np.linalg.norm(gap, axis=1).max() < 3e-4
    rest = read_rest("flat", surface, ".")
    flat, placed = areas(rest.points, rest.triangles), areas(surface.points, surface.triangles)
    assert flat.sum() == pytest.approx(placed.sum(), rel=1e-3)


def test_garment_against_other_triangles(shared):
    surface = read_mesh(shared / "meshes" / "skirt3448.obj")
    with pytest.raises(InputError, match=r"7271 triangles, but .*skirt3448.obj has 3448"):
        read_rest("skirt7271.obj", surface, shared / "meshes")
