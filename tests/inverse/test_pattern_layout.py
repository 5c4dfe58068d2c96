"""Patterns on fabric and on paper: nothing overlaps, the grain stays, and rasters measure what the mesh says."""

import re
import shutil
import subprocess
import tempfile
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
import shapely
from browser import PROGRAMS
from PIL import Image
from scipy import ndimage
from test_pattern_wishes import garment

from voile.cli import main
from voile.inverse.flatten import flatten
from voile.inverse.panels import split
from voile.inverse.pattern import make_pattern
from voile.post import write_svg
from voile.post.nesting import efficiency, nested
from voile.post.pattern_pages import MARGIN, OVERLAP, PAPERS, sheets_of, write_pages
from voile.results import write_pattern

DPI = 96.0  # of a browser's page: 26.46 pixels in a centimetre


@pytest.fixture(scope="module")
def pattern():
    faces, points, groups = garment()
    return make_pattern(flatten(split(faces, points, groups=groups, cut_open=True)), allowance=0.01)


@pytest.fixture(scope="module")
def laid(pattern):
    pytest.importorskip("spyrrow")
    return nested(pattern, width=1.4, gap=0.006, turn=True, seconds=2)


def test_pieces_lie_on_the_fabric_with_their_grain_along_it(pattern, laid):
    """Apart, each congruent to its piece, its grain line along the selvage."""
    width, length = laid.fabric
    areas = [shapely.Polygon(piece.cut[0]) for piece in laid.pieces]
    for k, (piece, before) in enumerate(zip(laid.pieces, pattern.pieces, strict=True)):
        assert shapely.box(0, 0, width, length).contains(areas[k])
        assert all(areas[k].distance(other) > 0.004 for other in areas[:k])
        assert np.ptp(piece.grain[:, 0]) < 1e-12 and piece.grain[1, 1] > piece.grain[0, 1]
        sign = np.sign(np.vdot(piece.points[1] - piece.points[0], before.points[1] - before.points[0]))
        assert np.diff(piece.points, axis=0) == pytest.approx(
            sign * np.diff(before.points, axis=0), abs=1e-12
        )
        ring, notches = shapely.LinearRing(piece.cut[0]), piece.notches
        for point, way, reach in zip(notches.points, notches.inward, notches.allowance, strict=True):
            assert ring.distance(shapely.Point(point - reach * way)) < 1e-6
    assert efficiency(laid) == pytest.approx(sum(a.area for a in areas) / (width * length))
    assert efficiency(laid) > 0.5  # 0.78 in 5 s of a free processor


def test_sheets_cover_the_pattern_once_and_match_in_their_overlaps(pattern):
    """Cut lines of all sheets, put back where they are in the pattern, are the pattern's; crosses lie on crosses."""
    size = np.array(PAPERS["a4"])
    sheets = sheets_of(pattern, size)
    low = np.min([piece.cut[0].min(axis=0) for piece in pattern.pieces], axis=0)
    high = np.max([piece.cut[0].max(axis=0) for piece in pattern.pieces], axis=0)
    step = size - 2 * MARGIN - OVERLAP
    cut, crosses = [], []
    for sheet in sheets[1:]:
        corner = step * [int(sheet.name[1:]) - 1, ord(sheet.name[0]) - ord("A")]
        cut += [
            shapely.LineString(line.points - MARGIN + corner) for line in sheet.lines if line.layer == "cut"
        ]
        marks = [line.points for line in sheet.lines if line.layer == "mark"][1:]
        crosses.append({tuple(np.round(m.mean(axis=0) - MARGIN + corner, 6)) for m in marks})
    rings = [(1e3 * p.cut[0] - [1e3 * low[0], 1e3 * high[1]]) * [1, -1] for p in pattern.pieces]
    true = shapely.union_all([shapely.LinearRing(ring) for ring in rings])
    found = shapely.union_all(cut)
    assert shapely.hausdorff_distance(found, true) < 1e-6
    pieces = shapely.union_all([shapely.Polygon(ring) for ring in rings])
    frames = {f"{chr(65 + r)}{c + 1}": shapely.box(*(step * [c, r]), *(step * [c, r] + size - 2 * MARGIN))
              for r in range(9) for c in range(26)}  # fmt: skip
    assert {sheet.name for sheet in sheets[1:]} == {n for n, f in frames.items() if f.intersects(pieces)}
    assert all(len(line.points) > 1 for sheet in sheets for line in sheet.lines)
    every = [cross for names in crosses for cross in names]
    assert (
        min(every.count(cross) for cross in set(every)) >= 1
        and np.mean([every.count(c) for c in set(every)]) > 1.8
    )
    assert sheets[0].labels[0].text.startswith("10 cm x 10 cm")


def raster(drawings, sizes) -> list[np.ndarray]:
    """Pixels (h, w, 3) of SVG files, width and height in mm, as a browser shows them at DPI."""
    program = next(filter(None, map(shutil.which, PROGRAMS)), None)
    if program is None:
        pytest.skip("needs a browser: apt-get install chromium")
    pixels = np.ceil(np.array(sizes) / 25.4 * DPI).astype(int)
    texts = [re.sub(r"<\?xml.*?\?>", "", path.read_text()) for path in drawings]
    places = [
        f'<div style="height:{tall}px">{text}</div>' for text, tall in zip(texts, pixels[:, 1], strict=True)
    ]
    window = f"{pixels[:, 0].max()},{pixels[:, 1].sum()}"
    with tempfile.TemporaryDirectory() as folder:
        page = Path(folder) / "page.html"
        page.write_text('<!doctype html><meta charset="utf-8"><body style="margin:0">' + "".join(places))
        flags = [
            "--headless",
            "--no-sandbox",
            "--disable-gpu",
            "--hide-scrollbars",
            "--force-device-scale-factor=1",
        ]
        flags += [f"--user-data-dir={folder}", f"--screenshot={folder}/a.png", f"--window-size={window}"]
        subprocess.run([program, *flags, page.as_uri()], check=True, capture_output=True, timeout=120)
        image = np.asarray(Image.open(f"{folder}/a.png").convert("RGB")).astype(int)
    return np.split(image, np.cumsum(pixels[:, 1])[:-1])


def measured(line: np.ndarray) -> list[tuple[float, np.ndarray, np.ndarray]]:
    """Area (mm^2), width and height, and middle (mm), of the closed lines among pixels, amid their stroke."""
    pixel = 25.4 / DPI
    label, _ = ndimage.label(line, np.ones((3, 3)))
    found = []
    for k, place in enumerate(ndimage.find_objects(label), 1):
        outer = ndimage.binary_fill_holes(label[place] == k)
        inner = outer & ~line[place]
        if inner.sum() < 0.5 * outer.sum():
            continue
        spans = [
            [np.ptp(np.flatnonzero(mask.any(axis=axis))) + 1 for axis in (0, 1)] for mask in (outer, inner)
        ]
        middle = [0.5 * (place[axis].start + place[axis].stop) for axis in (1, 0)]
        area = 0.5 * (outer.sum() + inner.sum())
        found.append((area * pixel**2, np.mean(spans, axis=0) * pixel, np.array(middle) * pixel))
    return found


def test_rasters_measure_what_the_mesh_says(pattern, tmp_path):
    """Of pattern.svg in a browser, sew lines against the surface's triangles: 0.5 mm, 0.2 %. And the test square."""
    faces, points, (group, names) = garment()
    few = replace(pattern, pieces=pattern.pieces[:2], seams=())
    write_svg(tmp_path / "pattern.svg", few)
    root = ElementTree.parse(tmp_path / "pattern.svg").getroot()
    size = [float(value) for value in root.get("viewBox").split()[2:]]
    pages = write_pages(tmp_path, few, "a4")
    image, cover = raster((tmp_path / "pattern.svg", tmp_path / "page-cover.svg"), (size, PAPERS["a4"]))
    found = sorted(measured(image[:, :, 2] - image[:, :, 0] > 60), key=lambda shape: shape[2][0])
    assert len(found) == 2
    for piece, (area, extent, _) in zip(few.pieces, found, strict=True):
        a, b, c = np.moveaxis(points[faces[group == names.index(piece.name)]], 1, 0)
        surface = 0.5e6 * np.linalg.norm(np.cross(b - a, c - a), axis=1).sum()
        assert area == pytest.approx(surface, rel=2e-3)
        assert extent == pytest.approx(1e3 * np.ptp(piece.points, axis=0), abs=0.5)
    large = [shape for shape in measured(cover.max(axis=2) < 140) if shape[0] > 5e3]
    _, square, _ = min(large, key=lambda shape: shape[2][1])  # the map is below
    assert square == pytest.approx([100.0, 100.0], abs=0.3)
    text = pages[0].read_bytes()
    assert text.count(b"/Type /Page ") + text.count(b"/Type /Page\n") == len(pages) - 1
    box = re.search(rb"/MediaBox \[ ?0 0 ([\d.]+) ([\d.]+)", text)
    assert [float(v) / 72 * 25.4 for v in box.groups()] == pytest.approx(PAPERS["a4"], abs=0.01)


def test_the_command_lays_and_prints(pattern, tmp_path, capsys):
    pytest.importorskip("spyrrow")
    write_pattern(tmp_path, pattern)
    assert (
        main(
            [
                "pattern",
                str(tmp_path),
                "--width",
                "1.4",
                "--seconds",
                "1",
                "--pages",
                "a0",
                "-o",
                str(tmp_path / "o"),
            ]
        )
        == 0
    )
    said = capsys.readouterr().out
    assert "6 pieces on 1.400 x" in said and "% used" in said
    names = {path.name for path in (tmp_path / "o").rglob("*") if path.is_file()}
    assert {"layout.svg", "layout.dxf", "layout.png", "pages.pdf", "page-cover.svg", "page-A1.svg"} <= names


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ([], "nothing to do; allowed: --width, --pages or both"),
        (["--width", "0.2"], "m wide across its grain; allowed: at least that"),
        (["--width", "-1"], "--width -1; allowed: above 0"),
        (["--width", "2", "--gap", "3"], "--gap 3; allowed: 0 to the fabric's width"),
        (["--width", "2", "--seconds", "0"], "--seconds 0; allowed: above 0"),
        (["--pages", "b5"], "--pages b5; allowed: a4, a3, letter, a0"),
    ],
)
def test_bad_options_are_refused(pattern, tmp_path, capsys, options, message):
    write_pattern(tmp_path, pattern)
    assert main(["pattern", str(tmp_path), *options]) == 2
    assert message in capsys.readouterr().err
