"""Contact as users see it: bodies, arrows and states in pictures, bodies in exports, totals as text."""

import json
import struct

import numpy as np
import pytest
import pyvista
from mpi4py import MPI
from PIL import Image, ImageColor

from voile.post import export, info, render
from voile.post.contact import LARGE, STATES, framed, surfaces, vertex_cells
from voile.results import Body, ResultWriter, StaticMesh, read_result, write_summary

X, Y = (a.ravel() for a in np.meshgrid(np.linspace(-1, 1, 9), np.linspace(-1, 1, 9)))
FIRST = (np.arange(8)[:, None] * 9 + np.arange(8)).ravel()
TRIANGLES = np.concatenate(
    [np.column_stack([FIRST, FIRST + 1, FIRST + 10]), np.column_stack([FIRST, FIRST + 10, FIRST + 9])]
)
FLAT = np.column_stack([X, Y, 0 * X])
STATE = np.where(X < -0.3, 0, np.where(X < 0.3, 1, 2)).astype(np.uint8)
GROUND = np.array([[-1.5, -1.5, -1], [1.5, -1.5, -1], [1.5, 1.5, -1], [-1.5, 1.5, -1]], dtype=float)
PLACE = np.array(
    [[0.0, -1, 0, 0], [1, 0, 0, 0], [0, 0, 1, 0.5], [0, 0, 0, 1]]
)  # a quarter turn about z, then up


@pytest.fixture(scope="module")
def result(tmp_path_factory):
    """A square, a third each free, sticking and slipping, over a larger square that turns and rises."""
    path = tmp_path_factory.mktemp("touch") / "result.vtkhdf"
    body = Body("ground", 0.3, GROUND, np.array([[0, 1, 2], [0, 2, 3]]))
    scene = '[scene]\nname = "square"\n[loads]\ngravity = [0, 0, -9.81]\n'
    mesh = StaticMesh(FLAT, TRIANGLES, bodies=(body,))
    with ResultWriter(path, MPI.COMM_SELF, mesh=mesh, scene_text=scene) as writer:
        for value, place in ((0.5, np.eye(4)), (1.0, PLACE)):
            writer.write_step(
                value,
                FLAT,
                np.arange(len(FLAT)),
                point_data={
                    "reaction": np.outer(STATE, [0.0, 0.0, 2.0]),
                    "gap": np.where(STATE == 0, 0.1, 0.0),
                    "contact": STATE,
                },
                placements=place[None],
            )
    return path


def picture(result, out, field, **options):
    render(result, out, field=field, view="top", size=(600, 450), outline=False, **options)
    return np.asarray(Image.open(out).convert("RGB"), dtype=int)


def hue(rgb):
    """Colour without brightness: shading changes that only."""
    rgb = np.asarray(rgb, dtype=float)
    return rgb / np.maximum(np.linalg.norm(rgb, axis=-1, keepdims=True), 1e-9)


def test_bodies_are_where_the_step_has_them(result):
    with read_result(result) as r:
        assert np.array_equal(surfaces(r, 0)[0][0], GROUND)
        there = surfaces(r, 1)[0][0]
    assert np.allclose(there, np.column_stack([-GROUND[:, 1], GROUND[:, 0], GROUND[:, 2] + 0.5]), atol=1e-15)


def test_bodies_much_larger_than_the_shape_run_out_of_the_picture():
    small, large = 0.9 * LARGE * GROUND / 1.5, 1.1 * LARGE * GROUND / 1.5
    assert len(framed(FLAT, [(small, TRIANGLES), (large, TRIANGLES)])) == len(FLAT) + len(GROUND)


def test_cells_of_vertices_share_out_the_triangles():
    normals = np.tile([0.0, 0.0, 1.0], (len(FLAT), 1))
    places, directions, quads, vertex = vertex_cells(FLAT, TRIANGLES, normals)
    corner = places[quads]
    area = np.cross(corner[:, 2] - corner[:, 0], corner[:, 3] - corner[:, 1])[:, 2] / 2
    assert np.allclose(area, 0.25**2 / 6, rtol=1e-12)  # a third of each triangle, all turning its way
    assert np.allclose(np.bincount(vertex, area).sum(), 4.0, rtol=1e-12)
    assert np.array_equal(places[quads[:, 0]], FLAT[vertex]) and np.allclose(directions, [0, 0, 1])


def test_states_are_drawn_in_their_colours_without_blends(result, tmp_path):
    shown = picture(result, tmp_path / "contact.png", "contact")
    square = hue(shown[100:400, 60:380].reshape(-1, 3))
    colours = hue([ImageColor.getrgb(c) for c in STATES.values()])
    distance = np.linalg.norm(square[:, None] - colours, axis=2)
    share = np.bincount(distance.argmin(axis=1)[distance.min(axis=1) < 0.05], minlength=3) / len(square)
    assert (share > 0.1).all(), share


@pytest.mark.parametrize("field", ["contact", "gap", "reaction", "strain"])
def test_reactions_are_arrows_in_pictures_of_contact_only(field, result, tmp_path):
    shown = picture(result, tmp_path / f"{field}.png", field)
    red = (shown[..., 0] > 1.8 * shown[..., 1]) & (shown[..., 0] > 1.5 * shown[..., 2])
    assert (red.sum() > 100) == (field != "strain")


def test_the_body_is_grey_behind_the_shape(result, tmp_path):
    shown = picture(result, tmp_path / "strain.png", "strain")
    bar = shown[:, :450]  # left of the colour bar
    grey = (np.ptp(bar, axis=2) < 12) & (bar.mean(axis=2) > 90) & (bar.mean(axis=2) < 235)
    assert grey.sum() > 0.15 * grey.size


def test_glb_holds_the_bodies_where_the_step_has_them(result, tmp_path):
    data = export(result, tmp_path / "x.glb").read_bytes()
    length = struct.unpack("<I", data[12:16])[0]
    document, body = json.loads(data[20 : 20 + length]), data[20 + length + 8 :]
    assert [node["name"] for node in document["nodes"]] == ["result", "ground"]
    primitive = document["meshes"][1]["primitives"][0]
    view = document["bufferViews"][document["accessors"][primitive["attributes"]["POSITION"]]["bufferView"]]
    read = np.frombuffer(body[view["byteOffset"] :][: view["byteLength"]], "<f4").reshape(-1, 3)
    assert np.allclose(read[:, 2], -0.5) and np.allclose(read[0], [1.5, -1.5, -0.5])
    view = document["bufferViews"][document["accessors"][primitive["indices"]]["bufferView"]]
    corners = np.frombuffer(body[view["byteOffset"] :][: view["byteLength"]], "<u4")
    assert corners.tolist() == [0, 1, 2, 0, 2, 3]


def test_vtu_has_the_bodies_beside(result, tmp_path):
    assert export(result, tmp_path / "x.vtu") == tmp_path / "x.vtu"
    read = pyvista.read(tmp_path / "x-obstacles.vtu")
    assert np.allclose(read.points[0], [1.5, -1.5, -0.5]) and read.n_cells == 2
    assert read.cell_data["obstacle"].tolist() == [0, 0]


def test_info_counts_ways_and_lists_what_each_obstacle_carries(result):
    totals = {
        "name": "ground",
        "vertices": 54,
        "force": [1e-13, 0.25, 162.0],
        "moment": [1.0, 2.0, -3.5],
        "area": 2.5,
    }
    write_summary(
        result.parent / "summary.json",
        {"contact": {"active": 54, "obstacles": [totals]}, "ways": ["semismooth"] * 9 + ["pseudo-time"]},
    )
    lines = [" ".join(line.split()) for line in info(result).splitlines()]
    assert "ways semismooth 9, pseudo-time 1" in lines
    assert "ground 54 vertices, 2.5 m^2, force (0, 0.25, 162) N, moment (1, 2, -3.5) N m" in lines
