"""`voile mesh repair`: damaged meshes come back whole, and what was changed is told."""

import json

import meshio
import numpy as np
import pytest
from mesh_helpers import areas, generator, loops_of, obj

from voile.cli import main
from voile.errors import InputError
from voile.mesh import build_topology, read_mesh, write_obj


def mended(path, *options: str):
    """The repaired surface and its report."""
    out = path.with_name("mended.obj")
    assert main(["mesh", "repair", str(path), "-o", str(out), *options]) == 0
    return read_mesh(out), json.loads(out.with_suffix(".json").read_text())


def sheet():
    """A unit square of 200 triangles in two groups, its texture coordinates, on a cylinder."""
    uv, triangles = generator("patterns").grid(10, 10)
    points = np.column_stack([np.sin(uv[:, 0]), uv[:, 1], np.cos(uv[:, 0])])
    return points, triangles, uv, (uv[triangles].mean(axis=1)[:, 0] > 0.5).astype(int)


def test_a_damaged_scan_comes_back_whole(tmp_path):
    """Soup, flips, doubles, isolated vertices, a cap, a needle, a fin and another unit, all at once."""
    points, triangles, uv, group = sheet()
    area = areas(points, triangles).sum()
    soup, texture = points[triangles.ravel()], uv[triangles.ravel()]  # no triangle shares a vertex
    faces = np.arange(len(soup)).reshape(-1, 3)
    faces[::7] = faces[::7, ::-1]
    one = len(soup)
    low, high = soup[0], soup[1]  # of the first triangle's first edge
    extra = np.array([0.5 * (low + high), [9.0, 9.0, 9.0], soup[31] + [0, 0, 0.02], soup[0] + 1e-12])
    cap, fin, needle = [0, one, 1], [31, 32, one + 2], [0, one + 3, 2]
    faces = np.concatenate([faces, faces[[5]][:, ::-1], [cap, fin, needle]])
    path = tmp_path / "scan.obj"
    write_obj(
        path, 100 * np.concatenate([soup, extra]), faces,
        np.concatenate([texture, np.zeros((4, 2))]), groups=(np.append(group, [0] * 4), ("left", "right")),
    )  # fmt: skip
    with pytest.raises(InputError, match=f"'voile mesh repair {path}' mends it"):
        read_mesh(path)
    surface, report = mended(path, "--unit", "cm")
    assert len(surface.points) == 121 + 1 and surface.notes == ()  # the cap's corner stays on the border
    assert areas(surface.points, surface.triangles).sum() == pytest.approx(area, rel=1e-4)
    assert len(loops_of(surface)) == 1 and surface.group_names == ("left", "right")
    assert np.bincount(surface.group).tolist() == [101, 100]
    assert surface.texture is not None and surface.texture_triangles is not None
    told = report["changed"]
    assert told["vertices turned from cm into metres"] == len(soup) + 4
    assert told["flaps dropped"] == 1 and told["triangles given twice dropped"] == 1
    assert report["written"]["vertices"] == len(surface.points)
    assert main(["mesh", "repair", str(tmp_path / "mended.obj"), "-o", str(tmp_path / "again.obj")]) == 0
    assert json.loads((tmp_path / "again.json").read_text())["changed"] == {}


def test_a_loose_triangle_is_no_hole_to_fill(tmp_path):
    """Nothing closes its border but itself; no larger N is advised then."""
    path = tmp_path / "two.obj"
    path.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 3 0 0\nv 4 0 0\nv 3 1 0\nf 1 2 3\nf 4 5 6\n")
    left = mended(path, "--fill-holes", "3")[1]["left"][-1]
    assert "2 border loops are open: 2 of 3 edges (up to 3 edges: each filling has" in left


def test_holes_are_filled_only_when_asked(tmp_path):
    """A sphere without two patches, its holes as large as the cap that was there."""
    sphere = meshio.read(_stl(tmp_path))
    surface, report = mended(tmp_path / "ball.stl")
    assert len(sphere.points) >= len(surface.points) and len(loops_of(surface)) == 2
    assert "2 border loops are open" in report["left"][0]
    surface, report = mended(tmp_path / "ball.stl", "--fill-holes", "20")
    assert (
        not len(build_topology(surface.triangles).boundary_edges) and report["changed"]["holes filled"] == 2
    )
    corners = surface.points[surface.triangles]
    volume = np.linalg.det(corners).sum() / 6
    assert abs(volume) == pytest.approx(4 / 3 * np.pi, rel=0.06)


def test_triangles_that_hang_on_no_other_are_told(tmp_path):
    """A soup whose corners differ by 1e-4 of its size: more is to be welded, and the report says how much."""
    uv, triangles = generator("patterns").grid(4, 4)
    corners = np.column_stack([uv, np.zeros(len(uv))])[triangles].reshape(-1, 3)
    corners += 1e-4 * np.random.default_rng(0).uniform(size=corners.shape)
    write_obj(tmp_path / "soup.obj", corners, np.arange(len(corners)).reshape(-1, 3))
    surface, report = mended(tmp_path / "soup.obj", "--fill-holes", "4")
    assert report["left"][0].startswith("32 triangles hang on no other") and "(--weld)" in report["left"][0]
    within = float(report["left"][0].split("within ")[1].split()[0])
    surface, report = mended(tmp_path / "soup.obj", "--weld", str(3.0 * within))
    assert len(surface.points) == len(uv) and not any("hang" in left for left in report["left"])


def _stl(folder):
    pyvista = pytest.importorskip("pyvista")
    ball = pyvista.Sphere(radius=1.0, theta_resolution=24, phi_resolution=24)
    triangles = ball.faces.reshape(-1, 4)[:, 1:]
    middle = np.asarray(ball.points)[triangles].mean(axis=1)
    kept = np.linalg.norm(middle[:, None] - [[1, 0, 0], [0, 0.8, 0.6]], axis=2).min(axis=1) > 0.25
    path = folder / "ball.stl"
    meshio.write(path, meshio.Mesh(np.asarray(ball.points, float), [("triangle", triangles[kept])]))
    return path


def test_sheets_along_one_edge_stay_sewn(tmp_path):
    """A pocket's wall on the middle line of a plate: three triangles to an edge, then stitches."""
    uv, plate = generator("patterns").grid(4, 4)
    points = np.column_stack([uv, np.zeros(len(uv))])
    line = np.flatnonzero(uv[:, 0] == 0.5)
    line = line[np.argsort(uv[line, 1])]
    upper = len(points) + np.arange(len(line))
    wall = [[a, b, c] for a, b, c in zip(line[:-1], line[1:], upper[1:], strict=True)]
    wall += [[a, c, d] for a, c, d in zip(line[:-1], upper[1:], upper[:-1], strict=True)]
    points = np.concatenate([points, points[line] + [0, 0, 0.25]])
    path = tmp_path / "pocket.obj"
    write_obj(path, points, np.concatenate([plate, wall]))
    surface, report = mended(path)
    assert len(surface.triangles) == len(plate) + len(wall)
    assert report["changed"]["edges of three and more triangles come apart"] == 4
    sewn = surface.stitches
    assert len(sewn) == 5 and np.array_equal(surface.points[sewn.slave], surface.points[sewn.first])


def test_a_moebius_band_is_cut_and_sewn(tmp_path):
    turn = np.linspace(0, 2 * np.pi, 24, endpoint=False)
    rim = np.column_stack([np.cos(turn), np.sin(turn), 0 * turn])
    up = np.cos(turn / 2)[:, None] * [[0, 0, 1]] + np.sin(turn / 2)[:, None] * rim
    points = np.concatenate([rim - 0.2 * up, rim + 0.2 * up])
    n, faces = 24, []
    for k in range(n):
        a, b, c, d = k, k + n, (k + 1) % n, (k + 1) % n + n
        c, d = (d, c) if k == n - 1 else (c, d)
        faces += [[a, c, b], [b, c, d]]
    path = tmp_path / "band.obj"
    write_obj(path, points, np.array(faces))
    surface, report = mended(path)
    assert len(surface.points) == 2 * n + 2 and len(surface.stitches) == 2
    assert report["changed"]["stitches added where surfaces came apart"] == 2


def test_quads_are_told_and_bad_options_refused(tmp_path, capsys):
    path = obj(tmp_path, "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nv 9 9 9\nf 1 2 3 4\n")
    surface, report = mended(path)
    assert len(surface.triangles) == 2 and report["changed"]["vertices without a triangle dropped"] == 1
    assert report["changed"]["faces of more than three corners split into triangles"] == 1
    for options, message in (
        (["-o", "x.ply"], "allowed: a file named .obj"),
        (["--weld", "2"], "--weld 2; allowed: 0 to 0.1"),
        (["--fill-holes", "-1"], "--fill-holes -1; allowed: 0 or more"),
        (["-o", str(path)], "is the file it is made from"),
        (["--drop-pieces", "9"], "no triangle is left to repair (triangles of pieces of fewer than 9"),
    ):
        assert main(["mesh", "repair", str(path), *options]) == 2
        assert message in capsys.readouterr().err
    empty = obj(tmp_path, "v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n", "line.obj")
    assert main(["mesh", "repair", str(empty)]) == 2
    assert "no triangle is left" in capsys.readouterr().err


def test_legs_that_touch_the_plane_of_symmetry_stay_apart(tmp_path):
    """Two tubes 0.1 mm from it under a sheet that lies across it: four triangles met in an edge
    of what `mesh mirror` wrote."""
    angle, level = np.meshgrid(2 * np.pi * np.arange(24) / 24, np.linspace(0.0, 0.5, 13), indexing="ij")
    tube = np.column_stack([0.1 * np.cos(angle).ravel() + 0.1001, 0.1 * np.sin(angle).ravel(), level.ravel()])
    k = (np.arange(24)[:, None] * 13 + np.arange(12)).ravel()
    on = (k + 13) % len(tube)
    sides = np.concatenate([np.column_stack([k, on, k + 1]), np.column_stack([on, on + 1, k + 1])])
    sheet = np.array([[-0.2, -0.2, 0.7], [0.2, -0.2, 0.7], [0.21, 0.2, 0.7], [-0.2, 0.2, 0.7]])
    points = np.concatenate([tube, tube * [-1.0, 1.0, 1.0], sheet])
    n = len(tube)
    triangles = np.concatenate([sides, sides[:, ::-1] + n, 2 * n + np.array([[0, 1, 2], [0, 2, 3]])])
    write_obj(tmp_path / "legs.obj", points, triangles)
    out = str(tmp_path / "even.obj")
    assert main(["mesh", "mirror", str(tmp_path / "legs.obj"), "--across", "x", "--at", "0", "-o", out]) == 0
    even = read_mesh(tmp_path / "even.obj")
    assert len(loops_of(even)) == 5
    legs = even.points[even.points[:, 2] < 0.6]
    assert np.abs(np.sort(legs[:, 0]) - np.sort(np.concatenate([tube[:, 0], -tube[:, 0]]))).max() < 1e-15
