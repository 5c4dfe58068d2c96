"""The pattern: seams, notches, grain, cut lines, layout; files read back by ezdxf, XML and Voile itself."""

import json
from xml.etree import ElementTree

import ezdxf
import numpy as np
import pytest
import shapely
from mesh_helpers import areas
from pattern_shapes import gores, hat, ramp, skirt

import voile
from voile.cli import main
from voile.elastic import evaluate
from voile.errors import InputError
from voile.inverse.flatten import FlatPanels, flatten
from voile.inverse.panels import split
from voile.inverse.pattern import make_pattern, pattern_summary, write_rest_obj
from voile.mesh import Pattern, read_mesh, read_rest, sewing_matrix
from voile.post import write_dxf, write_svg
from voile.results import read_pattern, read_result, write_pattern

ALLOWANCE = 0.012
SVG = "{http://www.w3.org/2000/svg}"


@pytest.fixture(scope="module")
def flat():
    points, triangles = skirt()
    return flatten(split(triangles, points, groups=gores(points, triangles)))


@pytest.fixture(scope="module")
def pattern(flat) -> Pattern:
    return make_pattern(flat, allowance=ALLOWANCE)


def perimeter(line: np.ndarray) -> float:
    return float(np.linalg.norm(line - np.roll(line, 1, axis=0), axis=1).sum())


# ---- the pattern itself ----


def test_seams_match_and_are_notched_alike(flat, pattern):
    assert [seam.label for seam in pattern.seams] == ["A", "B", "C", "D"]
    for seam, cut in zip(pattern.seams, flat.panels.seams, strict=True):
        assert seam.mismatch < 1e-12 and seam.lengths[0] == pytest.approx(0.55, rel=1e-12)
        length = [pattern.pieces[k].points[side] for k, side in zip(seam.pieces, seam.sides, strict=True)]
        assert np.array_equal(flat.panels.vertex[cut.sides[0]], flat.panels.vertex[cut.sides[1]])
        for piece, run in zip((pattern.pieces[k] for k in seam.pieces), length, strict=True):
            of_seam = [k for k, name in enumerate(piece.notches.labels) if name.startswith(seam.label)]
            assert [piece.notches.labels[k] for k in of_seam] == [seam.label + "1", seam.label + "2"]
            third = run[0] + np.outer([1 / 3, 2 / 3], run[-1] - run[0])  # the seams of a cone are straight
            assert piece.notches.points[of_seam] == pytest.approx(third, abs=1e-12)
            inside = shapely.Polygon(piece.points[piece.outline])
            for k in of_seam:
                tip = piece.notches.points[k] + 1e-3 * piece.notches.inward[k]
                assert inside.contains(shapely.Point(tip))
                assert inside.exterior.distance(shapely.Point(tip)) == pytest.approx(1e-3, rel=1e-6)


def test_gores_stand_upright_with_four_turn_points(pattern):
    for piece in pattern.pieces:
        corners = piece.points[piece.turns]
        assert len(corners) == 4
        low, high = corners[np.argsort(corners[:, 1])].reshape(2, 2, 2)
        assert np.ptp(low[:, 0]) > 2 * np.ptp(high[:, 0])  # the hem is below
        assert low[:, 0].mean() == pytest.approx(high[:, 0].mean(), abs=1e-9)
        assert piece.grain[:, 0] == pytest.approx(low[:, 0].mean(), abs=1e-9)
        assert piece.grain[1, 1] - piece.grain[0, 1] == pytest.approx(
            0.6 * np.ptp(piece.points[:, 1]), rel=0.05
        )


def test_grain_follows_another_direction_or_the_long_axis(flat):
    front = flat.panels.names.index("front")
    across = make_pattern(flat, grain=(1.0, 0.0, 0.0)).pieces[front]
    assert np.ptp(across.points[:, 0]) == pytest.approx(0.55, rel=0.1)  # its length lies along the weft
    long = make_pattern(flat, grain=None).pieces[front]
    assert np.ptp(long.points[:, 1]) == pytest.approx(0.55, rel=0.1)


def test_cut_line_runs_an_allowance_outside(pattern):
    for piece in pattern.pieces:
        sew, cut = shapely.Polygon(piece.points[piece.outline]), shapely.Polygon(piece.cut[0])
        assert len(piece.cut) == 1 and cut.contains(sew)
        middles = 0.5 * (piece.cut[0] + np.roll(piece.cut[0], 1, axis=0))
        distance = shapely.distance(sew.exterior, shapely.points(middles))
        assert distance == pytest.approx(ALLOWANCE, rel=1e-5)
        strip = ALLOWANCE * perimeter(piece.points[piece.outline])
        assert cut.area - sew.area == pytest.approx(strip, rel=0.05) and cut.area - sew.area > strip


def test_pieces_lie_apart_in_their_order(pattern):
    boxes = [shapely.box(*shapely.Polygon(piece.cut[0]).bounds) for piece in pattern.pieces]
    assert all(not a.intersects(b) for k, a in enumerate(boxes) for b in boxes[:k])
    places = [(-round(box.bounds[1], 6), box.bounds[0]) for box in boxes]
    assert places == sorted(places)


def test_a_hat_names_the_seam_that_does_not_match():
    points, triangles, groups = hat()
    panels = split(triangles, points, groups=groups, cut_open=True)
    pattern = make_pattern(flatten(panels), allowance=0.01, grain=(0.0, 0.0, 1.0))
    crown, brim = pattern.pieces
    assert brim.stretches == pytest.approx(1.0, abs=1e-12) and len(brim.cut) == 2
    summary = pattern_summary(pattern)
    around = next(
        label for label, seam in summary["seams"].items() if set(seam["panels"]) == {"crown", "brim"}
    )
    lengths = sorted(summary["seams"][around]["lengths"])
    assert summary["seams_beyond_tolerance"] == [around]
    assert lengths == pytest.approx(
        sorted([2 * np.pi * 0.1, perimeter(crown.points[crown.outline])]), rel=0.01
    )
    assert summary["seam_mismatch"] == pytest.approx(lengths[1] - lengths[0])
    assert (
        0.1 < summary["panels"]["crown"]["mean_distortion"] < summary["panels"]["crown"]["distortion"] < 0.5
    )
    assert around + "0" in crown.notches.labels  # its rim has no corner where the brim's own seam meets it
    marks = [[n for n in piece.notches.labels if n.startswith(around)] for piece in pattern.pieces]
    assert sorted(marks[0]) == sorted(marks[1])  # whichever side has a corner there


def test_summary_gives_areas_and_lengths(flat, pattern):
    summary = pattern_summary(pattern)
    area = areas(flat.panels.points, flat.panels.triangles).sum()
    assert sum(panel["area"] for panel in summary["panels"].values()) == pytest.approx(area, rel=1e-12)
    assert summary["distortion"] < 1e-12 and summary["seam_mismatch"] < 1e-12
    front = summary["panels"]["front"]
    assert front["perimeter"] == pytest.approx(2 * 0.55 + (0.7 + 1.6) / 4, rel=0.01)
    assert len(front["seams"]) == 2 and front["area_ratio"] == pytest.approx(1, abs=1e-12)
    json.dumps(summary, allow_nan=False)


# ---- files ----


def test_pattern_file_keeps_every_number(pattern, tmp_path):
    write_pattern(tmp_path, pattern)
    back = read_pattern(tmp_path)
    assert (back.allowance, back.tolerance) == (pattern.allowance, pattern.tolerance)
    for one, two in zip(pattern.pieces, back.pieces, strict=True):
        for name in ("points", "triangles", "stretches", "outline", "turns", "grain"):
            assert np.array_equal(getattr(one, name), getattr(two, name)), name
        assert all(np.array_equal(a, b) for a, b in zip(one.cut, two.cut, strict=True))
        assert np.array_equal(one.notches.points, two.notches.points)
        assert one.notches.labels == two.notches.labels and one.name == two.name
    for one, two in zip(pattern.seams, back.seams, strict=True):
        assert (one.label, one.pieces, one.lengths) == (two.label, two.pieces, two.lengths)
        assert all(np.array_equal(a, b) for a, b in zip(one.sides, two.sides, strict=True))


def test_svg_is_true_to_scale(pattern, tmp_path):
    write_pattern(tmp_path, pattern)
    assert main(["export", str(tmp_path), "--to", "svg"]) == 0
    root = ElementTree.parse(tmp_path / "pattern.svg").getroot()
    size = [float(v) for v in root.get("viewBox").split()]
    assert root.get("width") == f"{size[2]:.3f}mm" and root.get("height") == f"{size[3]:.3f}mm"
    layers = {g.get("id"): g for g in root.findall(f"{SVG}g")}
    assert list(layers) == ["cut", "notch", "grain", "internal", "sew", "text"]
    for piece in pattern.pieces:
        for layer, line in (("cut", piece.cut[0]), ("sew", piece.points[piece.outline])):
            path = next(p for p in layers[layer] if p.get("id") == f"{layer}-{piece.name}")
            words = path.get("d").replace("M ", "").replace(" Z", "").split(" L ")
            drawn = np.array([[float(v) for v in word.split(",")] for word in words])
            assert np.ptp(drawn, axis=0) == pytest.approx(1e3 * np.ptp(line, axis=0), abs=1e-3)
            assert perimeter(drawn) == pytest.approx(1e3 * perimeter(line), rel=1e-6)
            assert (drawn >= 0).all() and (drawn <= size[2:]).all()
    texts = [text.text for text in layers["text"].iter(f"{SVG}text")]
    assert {piece.name for piece in pattern.pieces} <= set(texts)
    assert sorted(t for t in texts if len(t) == 1) == sorted("AABBCCDD")


def test_dxf_has_a_block_for_each_piece_on_the_layers_of_the_standard(pattern, tmp_path):
    write_dxf(tmp_path / "pattern.dxf", pattern)
    document = ezdxf.readfile(tmp_path / "pattern.dxf")
    assert document.dxfversion == "AC1009" and not document.audit().errors
    inserted = [insert.dxf.name for insert in document.modelspace().query("INSERT")]
    assert inserted == [piece.name.upper() for piece in pattern.pieces]
    for name, piece in zip(inserted, pattern.pieces, strict=True):
        block = document.blocks.get(name)
        for layer, line in (("1", piece.cut[0]), ("14", piece.points[piece.outline])):
            (polyline,) = block.query(f'POLYLINE[layer=="{layer}"]')
            assert polyline.is_closed
            drawn = np.array([v.dxf.location.vec2 for v in polyline.vertices])
            assert drawn == pytest.approx(1e3 * line, abs=1e-6)
        found = {layer: len(block.query(f'*[layer=="{layer}"]')) for layer in ("2", "4", "7")}
        assert found == {"2": 4, "4": 4, "7": 1}
        texts = [text.dxf.text for text in block.query('TEXT[layer=="15"]')]
        assert f"Piece Name: {piece.name}" in texts and sum(t.startswith("Seam: ") for t in texts) == 2


def test_awkward_names_become_valid_and_distinct(flat, tmp_path):
    names = (
        "Vorderteil links, größte Länge des Musters",
        "Vorderteil links, größte Länge des Musters 2",
        "a",
        "A",
    )
    panels = flat.panels.__class__(**{**flat.panels.__dict__, "names": names})
    pattern = make_pattern(FlatPanels(panels, flat.coordinates, flat.stretches))
    write_dxf(tmp_path / "p.dxf", pattern)
    document = ezdxf.readfile(tmp_path / "p.dxf")
    inserted = [insert.dxf.name for insert in document.modelspace().query("INSERT")]
    assert len(set(inserted)) == 4 and max(map(len, inserted)) <= 31
    write_svg(tmp_path / "p.svg", pattern)
    ids = [e.get("id") for e in ElementTree.parse(tmp_path / "p.svg").iter() if e.get("id")]
    assert len(ids) == len(set(ids)) and not any(" " in name for name in ids)


def test_picture_shows_the_panels(pattern, tmp_path):
    from PIL import Image

    write_pattern(tmp_path, pattern)
    assert main(["export", str(tmp_path), "--to", "png"]) == 0
    image = np.asarray(Image.open(tmp_path / "pattern.png").convert("RGB"))
    assert image.shape[1] > 1500 and np.mean((image != 255).any(axis=2)) > 0.2


# ---- sewing it again ----


def test_rest_obj_is_sewn_and_laid_out_as_the_pattern(flat, pattern, tmp_path):
    panels = flat.panels
    write_rest_obj(tmp_path / "rest.obj", panels, pattern, panels.points, "four gores")
    surface = read_mesh(tmp_path / "rest.obj")
    assert [surface.group_names[k] for k in surface.group] == [panels.names[k] for k in panels.panel]
    assert len(surface.points) == len(panels.vertex) and surface.notes == ()
    matrix, free = sewing_matrix(surface.stitches, len(surface.points))
    assert len(free) == len(panels.points)
    assert np.array_equal(matrix @ surface.points[free], panels.points[panels.vertex])
    rest = read_rest("flat", surface, tmp_path)
    assert rest.flat
    energy = evaluate(rest.points, surface.points, surface.triangles, thickness=1e-3, young=1e6, poisson=0.3)
    assert energy.stretching_energy < 1e-20 < energy.bending_energy


def test_the_sewn_pattern_drapes_where_the_cone_was(flat, pattern, tmp_path):
    """A cloth stiff against stretch and gravity, light against bending, stays within 1 % of the cone's height."""
    panels = flat.panels
    write_rest_obj(tmp_path / "rest.obj", panels, pattern, panels.points, "four gores")
    (tmp_path / "scene.toml").write_text(
        '[shell]\nmesh = "rest.obj"\nrest = "flat"\nyoung = 1e7\nthickness = 1e-3\ndensity = 1.0\n'
        "[[fix]]\nselect = { box = [[-1, 0.999, -1], [1, 1.001, 1]] }\n"
        "[[fix]]\nselect = { box = [[-1, 0.0, -1], [1, 0.47, 1]] }\n"
    )
    assert main(["run", str(tmp_path / "scene.toml"), "-o", str(tmp_path / "out")]) == 0
    with read_result(tmp_path / "out") as result:
        moved = np.linalg.norm(result.points(-1) - result.start, axis=1).max()
    assert moved < 0.01 * np.ptp(panels.points[:, 1])


# ---- bad input ----


def test_a_panel_that_overlaps_itself_is_refused():
    points, triangles = ramp()
    flat = flatten(split(triangles, points))
    assert abs(flat.stretches - 1).max() < 1e-3
    with pytest.raises(InputError, match="panel 'panel-1' overlaps itself when laid flat"):
        make_pattern(flat)


@pytest.mark.parametrize(
    ("allowance", "message"), [(-0.01, "seam allowance = -0.01"), (np.nan, "seam allowance = nan")]
)
def test_bad_allowance_is_refused(flat, allowance, message):
    with pytest.raises(InputError, match=message):
        make_pattern(flat, allowance=allowance)


@pytest.mark.parametrize("grain", [(0, 0, 0), (0, 1), (0, np.nan, 1)])
def test_bad_grain_is_refused(flat, grain):
    with pytest.raises(InputError, match="pattern: grain = .* allowed: a direction"):
        make_pattern(flat, grain=grain)


def test_missing_and_damaged_patterns_are_refused(pattern, tmp_path, capsys):
    assert main(["export", str(tmp_path), "--to", "svg"]) == 2
    assert "no pattern.json" in capsys.readouterr().err
    write_pattern(tmp_path, pattern)
    text = (tmp_path / "pattern.json").read_text()
    (tmp_path / "pattern.json").write_text(text[: len(text) // 2])
    with pytest.raises(InputError, match="damaged pattern file"):
        read_pattern(tmp_path)
    (tmp_path / "pattern.json").write_text('{"version": 1}')
    with pytest.raises(InputError, match="damaged pattern file"):
        read_pattern(tmp_path)


@pytest.mark.parametrize(("waves", "said"), [(0, "strains it by up to "), (9, "no sewing pattern: panel")])
def test_a_run_tells_where_cloth_cut_so_is_not_the_rest_shape(waves, said, capfd):
    """A bowl, which strains when laid flat, and a ruffle, which overlaps itself. Their sag alone promised too much."""
    angle, out = np.meshgrid(2 * np.pi * np.arange(72) / 72, np.linspace(0.0, 1.0, 5), indexing="ij")
    radius = 0.1 + 0.1 * out
    height = (0.03 if waves else 0.15) * out**2 * np.cos(waves * angle)
    points = np.stack([radius * np.cos(angle), height, radius * np.sin(angle)], axis=-1).reshape(-1, 3)
    k = (np.arange(72)[:, None] * 5 + np.arange(4)).ravel()
    on = (k + 5) % len(points)
    triangles = np.concatenate([np.column_stack([k, k + 1, on]), np.column_stack([on, k + 1, on + 1])])
    table = {
        "scene": {"task": "inverse"},
        "shell": {"mesh": (points, triangles), "young": 1e9, "thickness": 1e-3, "density": 300.0},
        "loads": {"gravity": [0.0, -9.81, 0.0]},
        "fix": [{"select": {"boundary": 1}}],
    }
    notes = voile.run(table, progress=True).summary["notes"]
    assert sum(said in note for note in notes) == 1 and f"note: {notes[0]}" in capfd.readouterr().out
