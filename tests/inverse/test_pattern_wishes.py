"""What a pattern maker asks for: symmetry, grain, ease and allowance of single panels and seams."""

import json
import tomllib
from pathlib import Path
from xml.etree import ElementTree

import ezdxf
import numpy as np
import pytest
import shapely
from mesh_helpers import areas, generator, loops_of
from pattern_shapes import gores, skirt
from scipy.spatial import cKDTree

import voile
from voile.cli import main
from voile.errors import InputError, NotConverged
from voile.inverse.flatten import flatten
from voile.inverse.panels import split
from voile.inverse.pattern import make_pattern, pattern_summary
from voile.inverse.rules import PanelRule, Rules, SeamRule
from voile.inverse.stitched import add_stitches
from voile.mesh import read_mesh, write_obj
from voile.post import write_dxf, write_svg
from voile.results import read_pattern, write_pattern

TILT = np.radians(80.0)


def garment(noise: float = 0.0):
    """A skirt of four gores and two sleeves, cones that hang 80 degrees off the vertical on either side."""
    points, triangles = skirt()
    group, names = gores(points, triangles)
    cos, sin = np.cos(TILT), np.sin(TILT)
    turn = np.array([[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]])
    left = 0.4 * points @ turn + [-0.5, 0.8, 0.0]
    right = left * [-1.0, 1.0, 1.0]
    n, m = len(points), len(triangles)
    everything = np.concatenate([points, left, right])
    faces = np.concatenate([triangles, triangles + n, triangles[:, ::-1] + 2 * n])
    group = np.concatenate([group, np.repeat([4, 5], m)])
    rough = noise * np.random.default_rng(0).standard_normal(everything.shape)
    return faces, everything + rough, (group, (*names, "sleeve left", "sleeve right"))


@pytest.fixture(scope="module")
def flat():
    faces, points, groups = garment()
    return flatten(split(faces, points, groups=groups, cut_open=True))


def run_length(points: np.ndarray) -> float:
    return float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())


def test_left_and_right_are_mirror_images():
    """Of a garment with an error of 0.3 mm in every vertex; without asking they differ by as much."""
    faces, points, groups = garment(noise=3e-4)
    rough = flatten(split(faces, points, groups=groups, cut_open=True))

    def apart(pattern) -> float:
        pieces = {piece.name: piece for piece in pattern.pieces}
        worst = 0.0
        for one, other in (
            ("left", "right"),
            ("sleeve left", "sleeve right"),
            ("front", "front"),
            ("back", "back"),
        ):
            a, b = (pieces[name].points[pieces[name].outline] for name in (one, other))
            a, b = a - a.mean(axis=0), (b - b.mean(axis=0)) * [-1.0, 1.0]
            near = np.linalg.norm(a[:, None] - b, axis=2).min(axis=1)
            worst = max(worst, near.max())
        return worst

    pattern = make_pattern(rough, rules=Rules(symmetric=0))
    assert apart(make_pattern(rough)) > 1e-4 and apart(pattern) < 1e-12
    told = pattern_summary(pattern)["symmetric"]
    assert ["left", "right"] in told["mirrored"] and ["front", "front"] in told["mirrored"]
    assert 1e-4 < told["moved"] < 3e-3


def test_what_has_no_mirror_image_is_named():
    faces, points, groups = garment()
    with pytest.raises(
        InputError, match=r"vertex \d+ at .* has no mirror image over y = .* allowed: a mesh whose"
    ):
        make_pattern(flatten(split(faces, points, groups=groups, cut_open=True)), rules=Rules(symmetric=1))
    group = groups[0].copy()
    group[np.flatnonzero(group == 1)[:3]] = 0
    panels = split(faces, points, groups=(group, groups[1]), cut_open=True)
    with pytest.raises(InputError, match="panel '.*' is cut otherwise than its mirror image across x"):
        make_pattern(flatten(panels), rules=Rules(symmetric=0))


def test_sleeves_have_their_grain_along_their_axis(flat):
    """The sector of a cone lies symmetric about its grain line, though the cone is nearly level."""

    def lopsided(pattern, name) -> float:
        piece = next(piece for piece in pattern.pieces if piece.name == name)
        x = piece.points[piece.outline, 0]
        return abs(x.max() + x.min() - 2 * piece.grain[0, 0]) / np.ptp(x)

    pattern = make_pattern(flat)
    asked = make_pattern(flat, rules=Rules((PanelRule("sleeve left", (0.0, 1.0, 0.0)),)))
    assert lopsided(pattern, "sleeve left") < 1e-9 and lopsided(pattern, "sleeve right") < 1e-9
    assert lopsided(asked, "sleeve left") > 0.02 and lopsided(asked, "sleeve right") < 1e-9
    with pytest.raises(InputError, match="grain = 'tube' of 'front', which is not sewn to itself"):
        make_pattern(flat, rules=Rules((PanelRule("front", "tube"),)))


def test_seams_have_their_own_allowance_and_hem(flat, tmp_path):
    """The cut line is as far outside as each seam asks; svg and dxf say so."""
    seams = (SeamRule(("front", "right"), 0.02), SeamRule(("back",), 0.04), SeamRule(("back", "left"), 0.0))
    pattern = make_pattern(flat, allowance=0.01, rules=Rules(seams=seams))
    wish = {frozenset({"front", "right"}): 0.02, frozenset({"back", "left"}): 0.0}
    for seam in pattern.seams:
        names = frozenset(pattern.pieces[k].name for k in seam.pieces)
        assert seam.allowance == wish.get(names, 0.01)
        for k, side in zip(seam.pieces, seam.sides, strict=True):
            piece = pattern.pieces[k]
            ring, run = shapely.LinearRing(piece.cut[0]), piece.points[side]
            distance = shapely.distance(ring, shapely.points(run[len(run) // 4 : -(len(run) // 4)]))
            assert distance == pytest.approx(seam.allowance, abs=1e-6)
    back = next(piece for piece in pattern.pieces if piece.name == "back")
    low = back.points[back.outline][:, 1].min()
    assert low - back.cut[0][:, 1].min() == pytest.approx(0.04, abs=1e-4)  # its hem, of short straight edges
    write_svg(tmp_path / "p.svg", pattern)
    write_dxf(tmp_path / "p.dxf", pattern)
    texts = [e.text for e in ElementTree.parse(tmp_path / "p.svg").iter() if e.text]
    label = next(s.label for s in pattern.seams if s.allowance == 0.02)
    assert texts.count(f"{label} | 20 mm") == 2
    drawn = [t.dxf.text for block in ezdxf.readfile(tmp_path / "p.dxf").blocks for t in block.query("TEXT")]
    assert drawn.count(f"Seam: {label} | 20 mm") == 2
    for piece in pattern.pieces:
        for point, way, width in zip(
            *(getattr(piece.notches, n) for n in ("points", "inward", "allowance")), strict=True
        ):
            assert shapely.LinearRing(piece.cut[0]).distance(shapely.Point(point - width * way)) < 1e-6


def test_ease_of_symmetric_panels_is_what_was_asked_for():
    """Panels become mirror images first; after it their ease is off, here by 3e-7 m, on a real skirt by 3e-6 m."""
    faces, points, groups = garment(noise=3e-4)
    wishes = tuple(SeamRule((side, "front"), ease=0.015) for side in ("left", "right"))
    pattern = make_pattern(
        flatten(split(faces, points, groups=groups, cut_open=True)), rules=Rules(seams=wishes, symmetric=0)
    )
    eased = [seam for seam in pattern.seams if seam.ease]
    assert len(eased) == 2 and max(seam.mismatch for seam in eased) < 2e-8 and pattern.symmetrised > 1e-4


def test_what_is_asked_of_one_half_holds_for_the_other(flat):
    """Ease on one side alone was halved by the mean of both; an allowance stayed on its side."""
    side = flat.panels.vertex[flat.panels.vertex_panel == flat.panels.names.index("right")]
    wishes = (
        SeamRule(("right", "front"), 0.02, ease=0.015),
        SeamRule(("right",), 0.03, vertices=side),
        SeamRule(("left", "back"), 0.004),
        SeamRule(("right", "back"), 0.006),
    )
    pattern = make_pattern(flat, rules=Rules(seams=wishes, symmetric=0))
    told = {frozenset(pattern.pieces[k].name for k in seam.pieces): seam for seam in pattern.seams}
    for name in ("left", "right"):
        seam = told[frozenset((name, "front"))]
        assert (seam.allowance, abs(seam.ease)) == (0.02, 0.015) and seam.mismatch < 2e-8
    assert [told[frozenset((n, "back"))].allowance for n in ("left", "right")] == [0.004, 0.006]
    for piece in (p for p in pattern.pieces if p.name in ("left", "right")):
        assert piece.points[:, 1].min() - piece.cut[0][:, 1].min() == pytest.approx(0.03, abs=2e-3)
    contrary = (wishes[0], SeamRule(("left", "front"), ease=0.01))
    with pytest.raises(InputError, match="allowed with pattern.symmetric: one value, and none where left"):
        make_pattern(flat, rules=Rules(seams=contrary, symmetric=0))


def test_ease_makes_one_side_longer(flat, tmp_path):
    """By what was asked for, the other panel and other seams of the same panel as good as unchanged."""
    pattern = make_pattern(flat, rules=Rules(seams=(SeamRule(("right", "front"), ease=0.015),)))
    plain = make_pattern(flat)
    for seam, before in zip(pattern.seams, plain.seams, strict=True):
        names = [pattern.pieces[k].name for k in seam.pieces]
        lengths = dict(zip(names, seam.lengths, strict=True)) if len(set(names)) == 2 else {}
        if set(names) == {"front", "right"}:
            assert lengths["right"] - lengths["front"] == pytest.approx(0.015, abs=2e-8)
            assert lengths["front"] == pytest.approx(0.55, abs=1e-9) and seam.mismatch < 2e-8
            eased = seam
        else:
            assert seam.lengths == pytest.approx(before.lengths, abs=1.5e-3)
    assert pattern_summary(pattern)["seams_beyond_tolerance"] == []
    write_pattern(tmp_path, pattern)
    back = read_pattern(tmp_path)
    assert [s.ease for s in back.seams] == [s.ease for s in pattern.seams] and back.mirrors == ()
    write_svg(tmp_path / "p.svg", pattern)
    texts = [e.text for e in ElementTree.parse(tmp_path / "p.svg").iter() if e.text]
    assert texts.count(f"{eased.label} | ease 15 mm") == 1 and texts.count(eased.label) == 1
    with pytest.raises(NotConverged, match="ease between .* ask for less|not flat"):
        make_pattern(flat, rules=Rules(seams=(SeamRule(("right", "front"), ease=-3.0),)))


@pytest.mark.parametrize(
    ("rules", "message"),
    [
        (
            Rules((PanelRule("hood", "long"),)),
            r"pattern.panel.0.panel: no panel 'hood'; allowed: front, left",
        ),
        (
            Rules(seams=(SeamRule(("front", "back"), 0.01),)),
            r"pattern.seam.0.between: no seam joins 'front' and 'back'",
        ),
    ],
)
def test_rules_for_nothing_are_refused(flat, rules, message):
    with pytest.raises(InputError, match=message):
        make_pattern(flat, rules=rules)


SCENE = """
[scene]
task = "inverse"
[shell]
mesh = "skirt.obj"
young = 1e8
thickness = 1e-3
density = 300.0
[loads]
gravity = [0.0, -9.81, 0.0]
[[fix]]
select = { box = [[-1, 0.999, -1], [1, 1.1, 1]] }
[inverse]
method = "direct"
seam_allowance = 0.01
"""
WISHES = """
[pattern]
symmetric = "x"
[[pattern.panel]]
panel = "back"
grain = "long"
[[pattern.seam]]
between = ["front", "left"]
ease = 0.01
[[pattern.seam]]
between = ["front", "right"]
ease = 0.01
[[pattern.seam]]
select = { box = [[-1, 0.0, -1], [1, 0.5, 1]] }
allowance = 0.03
"""


def scene(folder, wishes: str, size: float = 0.05) -> str:
    points, triangles = generator("skirt").skirt(size=size)[:2]
    points[:, 1] += 1.0 - points[:, 1].max()
    write_obj(folder / "skirt.obj", points, triangles, groups=gores(points, triangles))
    path = folder / "scene.toml"
    path.write_text(SCENE + wishes)
    return str(path)


def test_a_scene_asks_for_all_of_it(tmp_path, capsys):
    assert main(["run", scene(tmp_path, WISHES), "-o", str(tmp_path / "out")]) == 0, capsys.readouterr().err
    pattern = read_pattern(tmp_path / "out")
    told = json.loads((tmp_path / "out" / "summary.json").read_text())["inverse"]["pattern"]
    assert told["symmetric"]["moved"] < 1e-6 and ["right", "left"] in told["symmetric"]["mirrored"]
    pieces = {piece.name: piece for piece in pattern.pieces}
    left, right = (pieces[name].points for name in ("left", "right"))
    assert np.ptp(left, axis=0) == pytest.approx(np.ptp(right, axis=0), abs=1e-12)
    eased = [seam for seam in pattern.seams if seam.ease]
    assert len(eased) == 2 and max(seam.mismatch for seam in pattern.seams) < 2e-3
    for name in ("front", "left", "right"):  # the grain of the back is its long axis, either way up
        y, cut = pieces[name].points[:, 1], pieces[name].cut[0][:, 1]
        assert y.min() - cut.min() == pytest.approx(0.03, abs=1e-3)  # the hem
        assert cut.max() - y.max() == pytest.approx(0.01, abs=2e-3)  # the waist, whose corners point upwards


@pytest.mark.parametrize(
    ("wishes", "said"),
    [
        ('[[pattern.panel]]\npanel = "hood"\ngrain = "long"\n', "panel.0.panel = 'hood' is no panel; allowed: back"),
        ('[[pattern.panel]]\npanel = "back"\ngrain = "up"\n', 'is not allowed; allowed: "tube", "long"'),
        ('[[pattern.seam]]\nbetween = ["front", "back"]\nease = 0.01\n', "no seam joins 'front' and 'back'"),
        ('[[pattern.seam]]\nbetween = ["front"]\nease = 0.01\n', "of a free border; allowed: between two panels"),
        ('[[pattern.seam]]\nallowance = 0.01\n', "missing; allowed: between, select or both"),
        ('[[pattern.seam]]\nselect = { boundary = 7 }\nallowance = 0.01\n', "pattern.seam.0.select"),
        ('[[pattern.seam]]\nbetween = ["front"]\n', "says nothing of the seam; allowed: with allowance or ease"),
        ('[[pattern.seam]]\nbetween = ["front"]\nallowance = 9.0\n', "pattern.seam.0.allowance: 9 m; allowed: at most"),
        ('[pattern]\nsymmetric = "y"\n', "has no mirror image over y"),
        ('[pattern]\nsymmetric = "x"\n[scene]\n', "pattern: allowed with task = inverse"),
    ],
)  # fmt: skip
def test_wishes_that_cannot_be_are_refused_before_anything_is_solved(tmp_path, capsys, wishes, said):
    path = scene(tmp_path, wishes.removesuffix("[scene]\n"))
    options = ["--set", "scene.task=statics"] if wishes.endswith("[scene]\n") else []
    assert main(["run", path, "-o", str(tmp_path / "out"), *options]) == 2
    error = capsys.readouterr().err
    assert said in error and not (tmp_path / "out" / "rest.obj").exists(), error


def test_a_mesh_that_does_not_mirror_itself_is_made_to(tmp_path, capsys):
    """A skirt of four gores turned by 7 degrees on its axis: half of it and its image give a symmetric pattern."""
    points, triangles = skirt()
    turn = np.radians(7.0)
    points = points @ np.array([[np.cos(turn), 0, -np.sin(turn)], [0, 1, 0], [np.sin(turn), 0, np.cos(turn)]])
    write_obj(tmp_path / "skew.obj", points, triangles, groups=gores(points, triangles))
    out = tmp_path / "even.obj"
    assert main(["mesh", "mirror", str(tmp_path / "skew.obj"), "--across", "x", "-o", str(out)]) == 0
    even = read_mesh(out)
    assert set(even.group_names) == {"front", "left", "back", "right"} and even.notes == ()
    assert len(loops_of(even)) == 2
    assert areas(even.points, even.triangles).sum() == pytest.approx(areas(points, triangles).sum(), rel=5e-3)
    assert areas(even.points, even.triangles).min() > 1e-2 * np.median(areas(points, triangles))
    panels = split(even.triangles, even.points, groups=(even.group, even.group_names), cut_open=True)
    pattern = make_pattern(flatten(panels), rules=Rules(symmetric=0))
    wishes = tuple(SeamRule((side, "front"), ease=0.015) for side in ("left", "right"))
    eased = make_pattern(flatten(panels), rules=Rules(seams=wishes, symmetric=0)).seams
    assert (
        max(seam.mismatch for seam in eased if seam.ease) < 2e-8
    )  # 8e-6 by one edge alone at a seam's corners
    left, right = (next(p for p in pattern.pieces if p.name == name) for name in ("left", "right"))
    assert np.sort(left.points[:, 0]) - left.points[:, 0].min() == pytest.approx(
        right.points[:, 0].max() - np.sort(right.points[:, 0])[::-1], abs=1e-12
    )
    figures = json.loads((tmp_path / "even.json").read_text())
    assert abs(figures["plane"]["x"]) < 1e-3 and 0 < figures["other_half"]["apart"] < 0.02
    for options, message in (
        ([], "mesh mirror without --across"),
        (["--across", "x", "--at", "9"], "nothing lies on that side of x = 9"),
        (["--across", "x", "--unit", "cm"], "--unit is no option of mesh mirror"),
    ):
        assert main(["mesh", "mirror", str(tmp_path / "skew.obj"), *options]) == 2
        assert message in capsys.readouterr().err


def test_symmetric_panels_are_those_that_are_proved(tmp_path, run_on):
    """On one rank and on two: the panels of rest.obj are the pattern, which symmetry no longer moves."""
    wishes = '[pattern]\nsymmetric = "x"\n'
    path = scene(tmp_path, wishes, size=0.1)
    text = (
        (tmp_path / "scene.toml")
        .read_text()
        .replace('method = "direct"', 'developable = "panels"\niterations = 1')
    )
    (tmp_path / "scene.toml").write_text(text.replace("[shell]", "[shell]\nseam_bending = true"))
    sags = []
    for ranks in (1, 2):
        out = tmp_path / f"out{ranks}"
        run_on(ranks, Path(path), out)
        told = json.loads((out / "summary.json").read_text())["inverse"]
        assert told["pattern"]["symmetric"]["moved"] < 1e-12 and len(told["pattern"]["panels"]) == 4
        sags.append(told["sag"])
    assert sags[0] == pytest.approx(sags[1], rel=1e-5) and sags[0] < 0.05


def test_eased_panels_are_those_that_are_proved(tmp_path):
    """The sag is that of the panels as they are written: it was that of panels without the ease."""
    path = scene(
        tmp_path,
        '[[pattern.seam]]\nbetween = ["front", "left"]\nease = 0.01\n[pattern]\nsymmetric = "x"\n',
        0.1,
    )
    text = Path(path).read_text().replace('method = "direct"', 'developable = "panels"\niterations = 1')
    Path(path).write_text(text.replace("[shell]", "[shell]\nseam_bending = true"))
    assert main(["run", path, "-o", str(tmp_path / "out")]) == 0
    told = json.loads((tmp_path / "out" / "summary.json").read_text())["inverse"]
    target = read_mesh(tmp_path / "skirt.obj").points
    table = tomllib.loads(text) | {"scene": {}, "statics": {"nested": False}}
    del table["inverse"], table["pattern"]
    table["shell"] |= {"mesh": str(tmp_path / "out" / "rest.obj"), "rest": "flat", "seam_bending": True}
    away = cKDTree(target).query(voile.run(table).positions)[0].max()
    assert told["sag"] == pytest.approx(away / np.linalg.norm(np.ptp(target, axis=0)), rel=0.01)
    assert told["sag"] > 1e-3 and sum(seam["ease"] != 0 for seam in told["pattern"]["seams"].values()) == 2


def test_a_real_dress_of_fourteen_panels_becomes_seven_pairs(shared, tmp_path):
    """Cut panels around a body, no two alike in their triangles, 851 stitches; left and right stay sewn."""
    out = tmp_path / "dress.obj"
    dress = shared / "meshes" / "pleated-dress-panels.obj"
    assert main(["mesh", "mirror", str(dress), "--across", "x", "-o", str(out)]) == 0
    even = read_mesh(out)
    panels = split(even.triangles, even.points, groups=(even.group, even.group_names))
    panels = add_stitches(panels, even.stitches)
    pattern = make_pattern(flatten(panels), grain=(0, 0, 1), rules=Rules(symmetric=0))
    pairs = pattern_summary(pattern)["symmetric"]["mirrored"]
    assert sorted(map(sorted, pairs)) == sorted(sorted((f"panel{k}", f"panel{k + 7}")) for k in range(7))
    assert pattern.symmetrised < 1e-9
    sewn = even.stitches
    across = np.isclose(
        even.points[sewn.slave, 0], 2 * figures_of(out) - even.points[sewn.first, 0], atol=1e-9
    )
    assert across.sum() > 50 and len(sewn) > 700


def figures_of(path) -> float:
    return json.loads(path.with_suffix(".json").read_text())["plane"]["x"]
