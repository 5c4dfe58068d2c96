"""shell.refine: what midpoints keep of a mesh, and what a known case makes of it."""

import json

import numpy as np
import pytest
from command_line import refused, voile
from mesh_helpers import areas, generator, obj
from test_cli import SCENE, cells, two_panels

from voile import run as voile_run
from voile.errors import InputError
from voile.mesh import (
    build_topology,
    inner_lines,
    read_mesh,
    read_rest,
    refine,
    select,
    sewing_matrix,
    surface_loops,
    write_obj,
)
from voile.mesh.grids import grid, rings

GRID = 4  # cells a side of test_cli.cells: vertex 5 i + j is at (i, j)


def read(folder, text, times=1):
    return refine(read_mesh(obj(folder, text)), times, "shell.refine")


def loops(surface):
    return surface_loops(surface, build_topology(surface.triangles))


def chosen(surface, **selection):
    return select(surface, loops(surface), selection, "fix.0.select")


def places(surface, vertices):
    """Their x and y in cells of the coarse grid, in order."""
    return sorted(map(tuple, np.round(surface.points[vertices, :2] * GRID / 0.1, 9).tolist()))


@pytest.mark.parametrize("times", [0, 1, 3])
def test_areas_volumes_and_groups_stay(times, tmp_path):
    points, triangles = generator("dress_form").dress_form(size=0.2)
    half = np.arange(len(triangles)) % 3 == 0
    write_obj(tmp_path / "form.obj", points, triangles, groups=(half.astype(int), ("back", "front")))
    coarse = read_mesh(tmp_path / "form.obj")
    fine = refine(coarse, times, "shell.refine")

    def volume(surface):
        a, b, c = (surface.points[surface.triangles[:, k]] for k in range(3))
        return np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6

    assert len(fine.triangles) == 4**times * len(coarse.triangles)
    assert volume(fine) == pytest.approx(volume(coarse), rel=1e-12)
    assert np.array_equal(fine.points[: len(coarse.points)], coarse.points)
    for group in (0, 1):
        parts = [areas(s.points, s.triangles)[s.group == group].sum() for s in (coarse, fine)]
        assert parts[1] == pytest.approx(parts[0], rel=1e-12)
    assert fine.coarsest.points is coarse.points
    assert np.array_equal(np.diff(fine.input_vertex) > 0, np.ones(len(fine.points) - 1, dtype=bool))


def test_panels_are_refined_corner_by_corner(tmp_path):
    points, triangles = generator("strip").strip(length=0.2, width=0.1, size=0.1)
    write_obj(
        tmp_path / "bent.obj", points + points[:, [2, 2, 0]] ** 2, triangles, 2.0 * points[:, :2], triangles
    )
    surface = refine(read_mesh(tmp_path / "bent.obj"), 2, "shell.refine")
    rest = read_rest("flat", surface, tmp_path)
    assert rest.points[rest.triangles][:, :, :2] == pytest.approx(
        2.0 * surface.points[surface.triangles][:, :, :2]
    )
    assert areas(rest.points, rest.triangles).sum() == pytest.approx(4.0 * 0.02)


def test_rest_file_is_the_coarse_one(tmp_path):
    surface = read(tmp_path, cells(), 2)
    obj(tmp_path, cells(size=0.2), "rest.obj")
    rest = read_rest("rest.obj", surface, tmp_path)
    assert rest.points == pytest.approx(2.0 * surface.points, abs=1e-15)
    obj(tmp_path, cells(count=3), "other.obj")
    with pytest.raises(InputError, match="18 triangles, but .*mesh.obj has 32"):
        read_rest("other.obj", surface, tmp_path)


def test_boundary_loops_keep_their_order(tmp_path):
    """Both rims of a cylinder are equally long up to round-off."""
    points, triangles = generator("cylinder").cylinder(radius=0.3, length=1.0, size=0.17)
    write_obj(tmp_path / "tube.obj", points, triangles)
    coarse = read_mesh(tmp_path / "tube.obj")
    fine = refine(coarse, 2, "shell.refine")
    for index, loop in enumerate(loops(coarse)):
        rim = chosen(fine, boundary=index)
        assert len(rim) == 4 * len(loop) and np.isin(loop, rim).all()
        assert np.ptp(fine.points[rim], axis=0).min() == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("times", [1, 2])
def test_selected_nodes_take_along_what_lies_between(times, tmp_path):
    surface = read(tmp_path, cells(), times)
    n = GRID * 2**times
    steps = [k / 2**times for k in range(n + 1)]
    side = list(range(5))  # x = 0
    assert places(surface, chosen(surface, nodes=side)) == [(0.0, y) for y in steps]
    inside = [10 + k for k in range(5)]  # the line x = 2
    assert places(surface, chosen(surface, nodes=inside)) == [(2.0, y) for y in steps]
    area = [5 * i + j for i in range(3) for j in range(5)]  # 0 <= x <= 2
    assert places(surface, chosen(surface, nodes=area)) == [(x, y) for x in steps if x <= 2.0 for y in steps]
    assert places(surface, chosen(surface, nodes=[0, 12])) == [(0.0, 0.0), (2.0, 2.0)]


@pytest.mark.parametrize("times", [1, 2])
def test_nodes_around_the_border_leave_its_corners_free(times, tmp_path):
    """Edges of the grid cut two of its corners off; both their ends are selected."""
    surface = read(tmp_path, cells(), times)
    border = [5 * i + j for i in range(5) for j in range(5) if {i, j} & {0, 4}]
    assert np.array_equal(chosen(surface, nodes=border), chosen(surface, boundary=0))


def test_groups_and_boxes_select_on_the_refined_mesh(tmp_path):
    surface = read(tmp_path, "g left\n" + cells() + "g right\n" + cells(0.2, 25), 2)
    assert len(chosen(surface, group="right")) == 17**2
    assert len(chosen(surface, box=[[-1, -1, -1], [0.025, 1, 1]])) == 5 * 17


def test_cuts_stay_on_their_lines(tmp_path):
    surface = read(tmp_path, cells(), 2)
    cuts = inner_lines(surface, build_topology(surface.triangles), [[10, 14]], "inverse.seams")
    assert cuts.shape == (16, 2)
    assert surface.points[cuts][:, :, 0] == pytest.approx(0.05)


# --- seams


def seam_of(surface, x):
    """Vertices on the line x, by their piece."""
    matrix, _ = sewing_matrix(surface.stitches, len(surface.points))
    line = np.flatnonzero(np.abs(surface.points[:, 0] - x) < 1e-12)
    return line, matrix


@pytest.mark.parametrize("times", [1, 2])
@pytest.mark.parametrize("count", [4, 3, 7])
def test_seams_stay_closed_along_their_whole_length(count, times, tmp_path):
    """A panel of 4 cells and one of another number: vertices of the second hang on the first's edges, and its edges
    pass vertices of the first."""
    lines = []
    for j in range(count + 1):
        k = min(int(4 * j / count), 3)
        w = 4 * j / count - k
        lines.append(f"stitch {25 + j} {20 + k} {21 + k} {w:.17g}\n")
    surface = read(tmp_path, cells() + cells(0.1, 25, count=count) + "".join(lines), times)
    line, matrix = seam_of(surface, 0.1)
    s, x = surface.stitches, surface.points
    w = s.weight[:, None]
    assert np.abs(x[s.slave] - (1 - w) * x[s.first] - w * x[s.second]).max() < 1e-15
    assert len(line) == 2**times * (4 + count) + 2
    free = np.unique(matrix[line].indices)
    assert len(free) == 4 * 2**times + 1  # the first panel's side alone carries the seam
    assert np.ptp(matrix[line].sum(axis=1)) < 1e-12


def test_a_bent_seam_closes_at_second_order(tmp_path):
    """Both sides of a seam on one smooth curve: what separates their polylines falls by four."""
    lines = "".join(
        f"stitch {25 + j} {20 + (4 * j) // 7} {21 + (4 * j) // 7} {4 * j / 7 % 1:.17g}\n" for j in range(7)
    )
    text = cells() + cells(0.1, 25, count=7) + lines + "stitch 32 24 24 0\n"
    gaps = []
    for times in range(4):
        surface = refine(read_mesh(obj(tmp_path, text)), times, "shell.refine")
        s, y = surface.stitches, surface.points[:, 1]
        bent = np.column_stack([0 * y, np.sin(20 * y), np.cos(20 * y)])
        w = s.weight[:, None]
        gaps.append(
            np.linalg.norm(bent[s.slave] - (1 - w) * bent[s.first] - w * bent[s.second], axis=1).max()
        )
    rates = np.log2(np.array(gaps[:-1]) / gaps[1:])
    assert rates[1:].min() > 1.7 and gaps[-1] < 7e-4


def test_darts_and_corners_of_pillows(tmp_path):
    """A dart closes from its tip on; edges that only cut the same corner of two panels off are not sewn."""
    points = "v 0 0 0\nv 1 .1 0\nv 1 -.1 0\nv 0 1 0\nv -1 0 0\nv 0 -1 0\n"
    dart = points + "f 1 2 4\nf 1 4 5\nf 1 5 6\nf 1 6 3\nstitch 2 1 1 0\n"
    surface = read(tmp_path, dart)
    matrix, _ = sewing_matrix(surface.stitches, len(surface.points))
    upper, lower = (
        np.flatnonzero(np.abs(surface.points - [0.5, y, 0]).max(axis=1) < 1e-12)[0] for y in (0.05, -0.05)
    )
    assert (matrix[upper] != matrix[lower]).nnz == 0
    square = cells(count=2)
    both = "".join(f"stitch {9 + k} {k} {k} 0\n" for k in range(9) if k != 4)
    pillow = read(tmp_path, square + cells(count=2, first=9) + both)
    matrix, _ = sewing_matrix(pillow.stitches, len(pillow.points))
    x = pillow.points / 0.1
    inside = np.flatnonzero((x[:, :2] > 1e-9).all(axis=1) & (x[:, :2] < 1 - 1e-9).all(axis=1))
    assert len(inside) == 2 * 9
    assert len(np.unique(matrix[inside].indices)) == 2 * 9


def test_pleated_dress_panels(shared):
    """Each half of a seam's edges is sewn; on the draped dress they gape by no more than its edges are bent."""
    coarse = read_mesh(shared / "meshes" / "pleated-dress-panels.obj")
    surface = refine(coarse, 1, "shell.refine")
    draped = read_mesh(shared / "meshes" / "pleated-dress-draped-with-mannequin.obj").points[
        : len(coarse.points)
    ]
    s, x = surface.stitches, surface.carry(draped)
    w = s.weight[:, None]
    gap = np.linalg.norm(x[s.slave] - (1 - w) * x[s.first] - w * x[s.second], axis=1)
    assert gap.max() < 2e-3 and np.median(gap) < 1e-5

    def sewn(surface):
        topology = build_topology(surface.triangles)
        rim = np.unique(topology.edges[topology.boundary_edges])
        s = surface.stitches
        return np.isin(rim, np.concatenate([s.slave, s.first, s.second])).mean()

    assert sewn(surface) == pytest.approx(sewn(coarse), abs=0.005)


# --- scenes

TIP = -0.700199715514355  # of the elastica, gamma = 10 (runs/cantilever)


def strip_scene(folder, **more):
    points, triangles = generator("strip").strip(length=1.0, width=0.1, size=0.1)
    write_obj(folder / "strip.obj", points, triangles)
    text = """
shell = { mesh = "strip.obj", young = 1.0e6, poisson = 0.0, thickness = 1.0e-3, density = 1000.0 }
loads = { gravity = [0.0, 0.0, -8.333333333333333e-4] }
fix = [{ select = { nodes = [%s] }, clamp = true }]
statics = { load_steps = 1 }
"""
    held = ", ".join(map(str, np.flatnonzero(points[:, 0] < 1e-9)))
    (folder / "scene.toml").write_text(text % held)
    return folder / "scene.toml"


def drop(folder):
    from voile.results import read_result

    result = read_result(folder)
    tip = result.start[:, 0] > 1.0 - 1e-9
    return float((result.points(-1) - result.start)[tip, 2].mean())


def test_the_heavy_cantilever_converges_at_second_order(tmp_path):
    scene = strip_scene(tmp_path)
    errors = []
    for n in range(4):
        done = voile("run", scene, "-o", tmp_path / f"{n}", "--set", f"shell.refine={n}")
        assert done.returncode == 0, done.stderr
        errors.append(abs(drop(tmp_path / f"{n}") - TIP))
    rates = np.log2(np.array(errors[:-1]) / errors[1:])
    assert errors[-1] < 5e-5 and rates[-1] > 1.9


def test_sewn_panels_are_one_sheet_on_every_level(tmp_path):
    x, y = np.meshgrid(np.linspace(0.0, 0.2, 9), np.linspace(0.0, 0.1, 5), indexing="ij")
    a = (5 * np.arange(8)[:, None] + np.arange(4)).ravel()
    whole = np.concatenate([np.column_stack([a, a + 5, a + 6]), np.column_stack([a, a + 6, a + 1])])
    write_obj(tmp_path / "whole.obj", np.column_stack([x.ravel(), y.ravel(), 0 * x.ravel()]), whole)
    (tmp_path / "sewn.obj").write_text(two_panels())
    energies = []
    for mesh in ("whole.obj", "sewn.obj"):
        (tmp_path / "scene.toml").write_text(SCENE.replace("mesh.obj", mesh))
        keys = ("shell.seam_bending=true", "shell.refine=1", "shell.thickness=0.01")
        done = voile(
            "run", tmp_path / "scene.toml", "-o", tmp_path / "out", *(f"--set={key}" for key in keys)
        )
        assert done.returncode == 0, done.stderr
        energies.append(json.loads((tmp_path / "out" / "summary.json").read_text())["energy"])
    assert energies[1] == pytest.approx(energies[0], rel=1e-6)


@pytest.mark.parametrize("ranks", [2])
def test_ranks_agree(ranks, tmp_path, run_on):
    scene = strip_scene(tmp_path)
    scene.write_text(scene.read_text().replace("density = 1000.0", "density = 1000.0, refine = 2"))
    for n in (1, ranks):
        run_on(n, scene, tmp_path / f"on{n}")
    assert drop(tmp_path / f"on{ranks}") == pytest.approx(drop(tmp_path / "on1"), abs=1e-9)


def test_explain_tells_the_refined_counts(tmp_path):
    done = voile("explain", strip_scene(tmp_path), "--set", "shell.refine=2")
    assert "205 vertices, 320 triangles" in done.stdout
    assert "strip.obj, 22 vertices, 20 triangles, refined 2 times" in done.stdout


@pytest.mark.parametrize(
    ("value", "words"),
    [
        ("-1", ("shell.refine", "-1", "an integer >= 0")),
        ("1.5", ("shell.refine", "1.5 is a number", "an integer")),
        ("30", ("shell.refine = 30", "20 triangles", "at most 11")),
        ("1000000", ("shell.refine = 1000000", "at most 11")),
    ],
)
def test_bad_input(value, words, tmp_path):
    refused(voile("run", strip_scene(tmp_path), "--set", f"shell.refine={value}", cwd=tmp_path), *words)


def test_inverse_design_of_a_refined_target(tmp_path):
    """The rest shape found for a sheet that hangs flat has the refined triangles, and simulations from it stay."""
    (tmp_path / "mesh.obj").write_text(cells())
    text = SCENE.replace("[shell]", '[scene]\ntask = "inverse"\n[shell]\nrefine = 1')
    (tmp_path / "scene.toml").write_text(text)
    done = voile("run", tmp_path / "scene.toml", "-o", tmp_path / "out", "--set", "shell.thickness=0.01")
    assert done.returncode == 0, done.stderr
    rest = read_mesh(tmp_path / "out" / "rest.obj")
    assert len(rest.points) == 81 and len(rest.triangles) == 128
    report = json.loads((tmp_path / "out" / "summary.json").read_text())["inverse"]
    assert report["sag"] < 1e-6


def test_new_vertices_lie_on_a_smooth_surface_where_asked(tmp_path):
    """A half cylinder and its arcs, irregular inside: distances to it fall by 2^4 a level, those of facets by 2^2."""
    noise = np.random.default_rng(1).uniform(-0.15, 0.15, (2000, 2))
    off = []
    for n in (8, 16):
        uv, triangles = grid(2 * n, n, "crossed")
        inside = (np.abs(uv - 0.5) < 0.5 - 1e-9).all(axis=1)
        u, v = (uv + np.where(inside[:, None], noise[: len(uv)] / [2 * n, n], 0.0)).T
        write_obj(
            tmp_path / "half.obj", np.column_stack([np.cos(np.pi * u), np.sin(np.pi * u), v]), triangles
        )
        coarse = read_mesh(tmp_path / "half.obj")
        fine = refine(coarse, 2, "shell.refine", smooth=True)
        assert np.array_equal(fine.points[: len(coarse.points)], coarse.points)
        off.append(np.abs(np.hypot(fine.points[:, 0], fine.points[:, 1]) - 1.0).max())
        assert fine.points[:, 2].min() == 0.0 and fine.points[:, 2].max() == 1.0
    assert off[1] < 1e-5 and 14.0 < off[0] / off[1] < 18.0


def test_what_is_flat_straight_or_sharp_stays_so(tmp_path):
    """A sheet, and a box whose corners no smooth surface goes round."""
    write_obj(tmp_path / "flat.obj", np.pad(grid(5, 4)[0], ((0, 0), (0, 1))), grid(5, 4)[1])
    corners = np.array([[x, y, z] for x in (0.0, 1.0) for y in (0.0, 1.0) for z in (0.0, 1.0)])
    faces = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    write_obj(
        tmp_path / "box.obj",
        corners,
        np.array([(a, *two) for a, b, c, d in faces for two in ((b, c), (c, d))]),
    )
    for name in ("flat.obj", "box.obj"):
        sharp, smooth = (refine(read_mesh(tmp_path / name), 2, "shell.refine", s) for s in (False, True))
        np.testing.assert_allclose(smooth.points, sharp.points, atol=1e-15)


def test_a_smooth_sheet_that_is_refined_meets_the_exact_deflection(tmp_path):
    """A clamped disc from a polygon of 18 sides: w = q R^4 / (64 D), second order."""
    places, triangles = rings([1, 6, 12, 18])
    radius = np.repeat(np.arange(4) / 3.0, [1, 6, 12, 18])
    angle = 2.0 * np.pi * np.concatenate(places)
    flat = np.column_stack([radius * np.cos(angle), radius * np.sin(angle), 0.0 * angle])
    scene = {
        "shell": {
            "mesh": (flat, triangles),
            "young": 1e9,
            "poisson": 0.3,
            "thickness": 0.01,
            "density": 1e3,
        },
        "loads": {"gravity": [0.0, 0.0, -0.01]},
        "fix": [{"select": {"boundary": 0}, "clamp": True}],
        "statics": {"load_steps": 1},
    }
    exact = 0.1 / (64.0 * 1e9 * 1e-6 / (12.0 * (1.0 - 0.3**2)))
    off = [-_sag(scene, times) / exact - 1.0 for times in (2, 3)]
    assert 0.0 < off[1] < 0.006 and 3.5 < off[0] / off[1] < 4.5


def _sag(scene, times):
    shell = {**scene["shell"], "refine": times, "refine_smooth": True}
    return voile_run({**scene, "shell": shell}).positions[:, 2].min()
