"""What users see of a result: quantities against exact values, exports and pictures read back by others."""

import subprocess
import sys

import numpy as np
import pytest
from mpi4py import MPI

from voile.errors import InputError
from voile.post import export, info, quantity, render
from voile.post.camera import MARGINS, look, parse_scene, upright
from voile.post.edges import boundary_edges, hinges
from voile.post.quantities import hinge_angles, largest_strain, vertex_curvature
from voile.post.trade import draw_trade
from voile.results import ResultWriter, StaticMesh, read_result, write_summary

SCENE = '[scene]\nname = "test strip"\n[loads]\ngravity = [0.0, -9.81, 0.0]\n'


def strip(nx=33, ny=9, wide=1.0, high=0.25, seed=None):
    """Flat rectangle in the x-z plane, normals up; vertices moved at random within the plane for `seed`."""
    x, z = np.meshgrid(np.linspace(0, wide, nx), np.linspace(0, high, ny))
    points = np.column_stack([x.ravel(), 0 * x.ravel(), z.ravel()])
    first = (np.arange(ny - 1)[:, None] * nx + np.arange(nx - 1)).ravel()
    upper = np.column_stack([first, first + nx, first + nx + 1])
    lower = np.column_stack([first, first + nx + 1, first + 1])
    if seed is not None:
        inside = (x.ravel() > 0) & (x.ravel() < wide) & (z.ravel() > 0) & (z.ravel() < high)
        shift = np.random.default_rng(seed).uniform(-0.2, 0.2, (inside.sum(), 2))
        points[np.ix_(inside, [0, 2])] += shift * [wide / (nx - 1), high / (ny - 1)]
    return points, np.concatenate([upper, lower])


def rolled(flat, radius):
    """The strip rolled downwards about z on a cylinder of that radius: an isometry."""
    angle = flat[:, 0] / radius
    return np.column_stack([radius * np.sin(angle), radius * (np.cos(angle) - 1), flat[:, 2]])


@pytest.fixture(scope="module")
def result(tmp_path_factory):
    """A strip that rolls up in three steps, in two groups, with gap and energy density."""
    path = tmp_path_factory.mktemp("strip") / "result.vtkhdf"
    flat, triangles = strip()
    group = (np.arange(len(triangles)) % 2).astype(np.int32)
    mesh = StaticMesh(flat, triangles, group=group, group_names=("front", "back"))
    with ResultWriter(path, MPI.COMM_SELF, mesh=mesh, scene_text=SCENE, versions={"voile": "0.1"}) as writer:
        for step, radius in enumerate((5.0, 1.0, 0.5)):
            writer.write_step(
                (step + 1) / 3,
                rolled(flat, radius),
                np.arange(len(flat)),
                point_data={"gap": flat[:, 0] - 0.25},
                cell_data={"energy_density": np.full(len(triangles), 2.0 * step)},
                cell_index=np.arange(len(triangles)),
                scalars={"newton_iterations": 4 + step},
            )
    return path


def test_strain_of_a_homogeneous_deformation():
    flat, triangles = strip(seed=3)
    gradient = np.array([[1.2, 0.3, 0.1], [0.0, 1.0, 0.0], [0.05, 0.0, 0.7]])
    plane = gradient[:, [0, 2]]
    green = (plane.T @ plane - np.eye(2)) / 2
    strain = largest_strain(flat @ gradient.T, triangles, flat, triangles)
    assert np.allclose(strain, np.linalg.eigvalsh(green)[-1], rtol=0, atol=1e-13)
    turn = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]
    assert np.abs(largest_strain(flat @ turn.T + 1, triangles, flat, triangles)).max() < 1e-13


def test_a_shape_moved_as_it_is_has_no_strain_at_all():
    """Its picture had the colours of round-off, on a bar up to 3e-16."""
    flat, triangles = strip(seed=3)
    turn = np.array([[0.6, -0.8, 0.0], [0.8, 0.6, 0.0], [0.0, 0.0, 1.0]])
    assert not largest_strain(flat @ turn.T + 0.3, triangles, flat, triangles).any()


def test_strain_against_a_rest_shape_with_its_own_vertices():
    flat, triangles = strip()
    corners = np.arange(3 * len(triangles)).reshape(-1, 3)
    rest = flat[triangles].reshape(-1, 3) / 1.5
    assert np.allclose(largest_strain(flat, triangles, rest, corners), (1.5**2 - 1) / 2, rtol=0, atol=1e-12)


@pytest.mark.parametrize("seed", [None, 7])
def test_curvature_of_a_cylinder(seed):
    errors = []
    for n in (33, 65):
        flat, triangles = strip(n, n // 4 + 1, seed=seed)
        mean, extreme = vertex_curvature(rolled(flat, 0.5), triangles)
        errors.append(np.sqrt(np.mean((extreme - 2.0) ** 2)))
        assert abs(mean.mean() - 1.0) < 0.02
        inwards, _ = vertex_curvature(rolled(flat, 0.5), triangles[:, ::-1])
        assert np.allclose(inwards, -mean, rtol=0, atol=1e-12)
    assert errors[-1] < (0.005 if seed is None else 0.3), errors


def test_curvature_of_a_sphere():
    pyvista = pytest.importorskip("pyvista")
    ball = pyvista.Icosphere(radius=0.25, nsub=4)
    mean, extreme = vertex_curvature(np.asarray(ball.points, float), ball.regular_faces)
    assert np.abs(mean - 4.0).max() < 0.1 and np.abs(extreme - 4.0).max() < 0.6


def test_hinges_and_boundary():
    flat, triangles = strip(4, 3)
    hinge = hinges(triangles)
    assert len(boundary_edges(triangles)) == 2 * (3 + 2)
    assert 3 * len(triangles) == 2 * len(hinge) + 10
    assert np.abs(hinge_angles(flat, triangles, hinge)).max() == 0
    folded = np.array([[0, 0, 0], [0, 1, 0], [-1, 0, 0], [0, 0, -1.0]])
    pair = np.array([[0, 1, 2], [1, 0, 3]])
    assert hinge_angles(folded, pair, hinges(pair)) == pytest.approx([np.pi / 2])


def test_quantity(result):
    with read_result(result) as r:
        moved = quantity(r, "displacement", 1)
        assert moved.unit == "m" and np.array_equal(moved.values, r.points(1) - r.start)
        assert quantity(r, "energy_density", 2).location == "cell" and quantity(r, "gap").unit == "m"
        assert np.abs(quantity(r, "strain").values).max() < 2e-3  # chords of the isometry
        assert np.median(quantity(r, "curvature", 1).values) == pytest.approx(1.0, rel=1e-3)
        with pytest.raises(KeyError, match="displacement.*gap"):
            quantity(r, "pressure")


def test_info(result):
    text = info(result.parent)
    for line in (
        "297 vertices, 512 triangles, groups front, back",
        "3, value 0.333333 to 1",
        "newton_iterations",
    ):
        assert line in text
    row = next(line for line in text.splitlines() if line.split()[0] == "gap")
    assert row.split()[1:4] == ["-0.25", "0.75", "m"] and "summary" not in text
    write_summary(result.parent / "summary.json", {"converged": True, "energy": {"bending": 0.125}})
    text = info(result)
    (result.parent / "summary.json").unlink()
    assert [line.split() for line in text.splitlines()[-3:]] == [
        ["converged", "True"],
        ["energy"],
        ["bending", "0.125"],
    ]


@pytest.mark.parametrize("kind", ["obj", "ply", "vtu", "glb"])
def test_export_reads_back(result, tmp_path, kind):
    out = export(result, tmp_path / f"shape.{kind}", step=1)
    with read_result(result) as r:
        points, triangles = r.points(1), r.triangles
        curvature = quantity(r, "curvature", 1).values
    if kind == "glb":
        pyvista = pytest.importorskip("pyvista")
        read = pyvista.read(out).combine(merge_points=False).extract_surface(algorithm=None)
        assert np.allclose(read.points, points, rtol=0, atol=1e-6)
        assert np.array_equal(read.regular_faces, triangles)
        normals = read.point_data["NORMAL"]
        assert np.allclose(normals[:, :2], points[:, :2] + [0, 1], rtol=0, atol=0.05)  # radial on radius 1
        return
    meshio = pytest.importorskip("meshio")
    read = meshio.read(out)
    found = np.concatenate([block.data for block in read.cells if block.type == "triangle"])
    assert np.array_equal(read.points, points)
    if kind == "obj":
        order = np.lexsort(triangles.T)
        assert np.array_equal(found[np.lexsort(found.T)], triangles[order])
        groups = [line.split()[1] for line in out.read_text().splitlines() if line.startswith("g ")]
        assert set(groups) == {"front", "back"}
    else:
        assert np.array_equal(found, triangles)
    if kind == "vtu":
        assert np.array_equal(read.point_data["curvature"], curvature)
        assert np.array_equal(read.cell_data["energy_density"][0], np.full(512, 2.0))
        assert {"displacement", "rest", "gap"} <= set(read.point_data) and "strain" in read.cell_data


def test_export_refuses(result, tmp_path):
    for name, message in (
        ("x.svg", "no pattern.json with a sewing pattern"),
        ("x.png", "no pattern.json with a sewing pattern"),
        ("x.stl", "unknown format '.stl'"),
        ("none/x.ply", "cannot be written: No such file"),
        ("none/x.vtu", "cannot be written"),
        ("none/x.obj", "none/x.obj"),
    ):
        with pytest.raises(InputError, match=message):
            export(result, tmp_path / name)
    with pytest.raises(InputError, match="no step 3; allowed: 0 to 2"):
        export(result, tmp_path / "x.ply", step=3)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("size", [(800, 600), (500, 700)])
@pytest.mark.parametrize("view", [None, "front", "top", (70.0, -40.0)])
def test_camera_frames_every_point(view, size):
    rng = np.random.default_rng(2)
    points = rng.normal(size=(200, 3)) * [1.0, 2.0, 0.4] + 10
    camera = look(points, np.array([0.0, 1.0, 0.0]), view, size)
    forward = camera.focus - camera.position
    forward /= np.linalg.norm(forward)
    away = points - camera.position
    depth = away @ forward
    slope = np.tan(np.radians(camera.angle) / 2)
    right = np.cross(forward, camera.up)
    x = away @ right / depth / (slope * size[0] / size[1])
    y = away @ camera.up / depth / slope
    left, on_right, low, top = MARGINS
    room = [x.min() + 1 - left, 1 - on_right - x.max(), y.min() + 1 - low, 1 - top - y.max()]
    assert depth.min() > 0 and min(room) > -1e-9
    assert min(room[0], room[1]) < 1e-9 or min(room[2], room[3]) < 1e-9  # as large as it fits
    assert abs(room[0] - room[1]) < 0.35 and abs(room[2] - room[3]) < 0.35


def test_upright_follows_gravity():
    assert np.array_equal(upright({}), [0, 1, 0])
    assert np.array_equal(upright(parse_scene("[loads]\ngravity = [0.0, 0.0, -9.81]")), [0, 0, 1])
    assert np.array_equal(upright({"loads": {"gravity": [0, 0, 0]}}), [0, 1, 0])
    told = (
        "[loads]\ngravity = [0.0, 0.0, 0.0]\n# --set loads.gravity=[9.81, 0, 0]\n# --set scene.task=modes\n"
    )
    assert np.array_equal(upright(parse_scene(told)), [-1, 0, 0])
    assert parse_scene(told)["scene"]["task"] == "modes"
    for damaged in (
        "loads = 3",
        "[loads]\ngravity = 'up'",
        "[loads]\n# --set loads.gravity.x=1",
        "# --set =",
        "=",
    ):
        assert np.array_equal(upright(parse_scene(damaged)), [0, 1, 0])


def test_render(result, tmp_path):
    """The asked size, a white border, ink where the shape is, the field's colours, an outline."""
    pytest.importorskip("pyvista")
    from PIL import Image

    pictures = {}
    for field, outline in (("displacement", True), ("displacement", False), ("strain", True), ("gap", True)):
        out = render(result, tmp_path / "x.png", field=field, size=(480, 360), outline=outline)
        pictures[field, outline] = np.asarray(Image.open(out).convert("RGB")).astype(int)
    for picture in pictures.values():
        assert picture.shape == (360, 480, 3)
        for border in (picture[:3], picture[-3:], picture[:, :3], picture[:, -3:]):
            assert border.min() > 250
        shape = picture[60:, :370]
        assert 0.02 < np.mean(shape.min(axis=2) < 200) < 0.9
    colourful = np.ptp(pictures["displacement", True][60:, :370], axis=2).max()
    assert colourful > 90
    assert np.mean(pictures["displacement", True] != pictures["displacement", False]) > 0.01
    assert np.mean(pictures["displacement", True] != pictures["gap", True]) > 0.01


def test_render_refuses(result, tmp_path):
    out = tmp_path / "x.png"
    with pytest.raises(InputError, match="no field 'pressure'; allowed: .*curvature.*gap"):
        render(result, out, field="pressure")
    with pytest.raises(InputError, match="no step 9"):
        render(result, out, step=9)
    with pytest.raises(InputError, match="view 'below' is unknown; allowed: front"):
        render(result, out, view="below")
    with pytest.raises(InputError, match="written as .png"):
        render(result, tmp_path / "x.jpg")
    with pytest.raises(InputError, match="cannot be written"):
        render(result, tmp_path / "none" / "x.png", size=(100, 100))


def test_pictures_load_nothing_before_they_are_asked_for():
    code = "import sys, voile.post, voile.results; print({'pyvista', 'vtk', 'matplotlib'} & set(sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "set()"


def test_the_rest_shape_is_drawn_in_place_of_the_step(result, tmp_path):
    """Its picture differs from the step's, and panels with vertices of their own are refused elsewhere."""
    drawn = render(result, tmp_path / "step.png", field="strain")
    rest = render(result, tmp_path / "rest.png", field="strain", shape="rest")
    assert rest.stat().st_size > 5000 and rest.read_bytes() != drawn.read_bytes()


def test_a_reader_that_has_read_enough_is_no_error():
    command = [sys.executable, "-m", "voile.cli", "schema"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        process.stdout.close()
        assert (process.stderr.read(), process.wait()) == ("", 0)


def test_trade_is_drawn_with_a_gap_where_no_simulation_settled(tmp_path):
    from PIL import Image

    steps = [
        {"share": s, "defect": 0.1 * (1 - s), "sag": sag}
        for s, sag in ((0.0, 1e-4), (0.5, None), (1.0, 2e-3))
    ]
    draw_trade(tmp_path / "trade.png", steps)
    picture = np.asarray(Image.open(tmp_path / "trade.png").convert("RGB"))
    assert 0.005 < (picture < 250).any(axis=2).mean() < 0.5
