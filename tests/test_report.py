"""Pages of runs: what a browser shows of them, what is left out for their size, and that no text of a result runs."""

import json
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
import pyvista
from browser import Browser, change, coloured, meta_of
from mpi4py import MPI
from PIL import Image
from test_film import FLAT, TRIANGLES, write

import voile
from voile.cli import main
from voile.errors import InputError
from voile.post.render import render
from voile.post.report import report
from voile.post.report_arrays import GRID, LEVELS, NO_VALUE, levels
from voile.results import Body, ResultWriter, StaticMesh, read_result, write_summary

ROOT = Path(__file__).parents[1]
STEPS = np.linspace(0, 0.5, 6)
# nowhere in a page may this become anything but text
HOSTILE = (
    "</script></title></textarea></pre><script>window.hacked=1</script><img src=x onerror=window.hacked=2>"
    "{{viewer}}&amp;\"'$x^{"
)


@pytest.fixture(scope="module")
def browser():
    browser = Browser()
    yield browser
    browser.close()


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A square that falls beside a ball that turns, and its page."""
    folder = tmp_path_factory.mktemp("run")
    write(folder, STEPS)
    write_summary(
        folder / "summary.json",
        {"converged": True, "dofs": 75, "energy": {"kinetic": 2.0}, "notes": ["mind"]},
    )
    assert main(["report", str(folder), "--field", "gap"]) == 0
    return folder


@pytest.fixture
def page(browser, run):
    browser.open(run / "report.html")
    yield browser
    assert browser.problems == []


def test_a_page_opens_by_itself(page, run, capsys):
    """It asks for nothing but itself, tells the run's name, outcome, figures and notes, and draws."""
    assert page.requests == [(run / "report.html").as_uri()]
    text = page.value("document.body.innerText")
    for words in (
        "square",
        "converged",
        "kinetic",
        "75",
        "mind",
        "places are rounded to",
        "[scene]",
        "time 0.5 s",
    ):
        assert words in text or words in page.value("document.body.textContent"), words
    assert page.value("document.title") == "square"
    stage = page.picture("#stage")
    assert 0.03 < coloured(stage) < 0.5 and (stage.min(axis=2) > 250).mean() > 0.3
    assert (run / "report.html").stat().st_size < 1e6
    assert page.value("document.querySelectorAll('#plots svg').length") == 1
    assert page.value("document.getElementById('plots').textContent").count("gravity") > 0


def test_it_shows_what_a_picture_shows(browser, tmp_path):
    """The shape stands where `voile render` draws it, in its colours."""
    run = wavy(tmp_path / "run", 20, 1)
    size = (1200, 900)
    picture = render(run, tmp_path / "a.png", field="curvature", outline=False, size=size)
    browser.open(report(run, tmp_path / "a.html", field="curvature").path)
    stage = browser.picture("#canvas")
    rows, columns = stage.shape[:2]
    other = Image.open(picture).convert("RGB").resize((columns, rows), Image.Resampling.BOX)
    inside = np.s_[int(0.1 * rows) :, : int(0.78 * columns)]  # without title and colour bar
    seen, expected = stage[inside], np.asarray(other).astype(int)[inside]
    shape, there = seen.min(axis=2) < 235, expected.min(axis=2) < 235
    assert 0.1 < there.mean() < 0.9 and (shape & there).sum() > 0.97 * (shape | there).sum()
    both = shape & there
    red, reddish = (
        x[both][:, 0] - x[both][:, 2] for x in (seen, expected)
    )  # against blue, whatever the light
    assert np.corrcoef(red, reddish)[0, 1] > 0.95


def test_bodies_stay_under_what_lies_on_them(browser, tmp_path):
    """Coarse cloth whose vertices lie on a ball hides it, though the middles of its triangles are inside."""
    ball = pyvista.Icosphere(nsub=4)
    points = np.column_stack([0.5 * FLAT[:, 0], 0.5 * FLAT[:, 1], np.ones(len(FLAT))])
    points /= np.linalg.norm(points, axis=1)[:, None]
    bodies = (Body("ball", 0.3, np.asarray(ball.points, float), ball.regular_faces),)
    mesh = StaticMesh(points, TRIANGLES, bodies=bodies)
    with ResultWriter(tmp_path / "result.vtkhdf", MPI.COMM_SELF, mesh=mesh, scene_text="[scene]") as writer:
        writer.write_step(
            1.0, points, np.arange(25), point_data={"gap": np.ones(25)}, placements=np.eye(4)[None]
        )
    browser.open(report(tmp_path, tmp_path / "a.html", field="gap").path)
    front = "[...document.querySelectorAll('#views button')].find(b => b.textContent === 'front')"
    browser.value(f"{front}.click()")
    browser.drawn()
    covered = coloured(browser.picture("#canvas"))
    browser.value(
        "[...document.querySelectorAll('#toggles label')].find(l => /obstacles/.test(l.textContent)).click()"
    )
    browser.drawn()
    alone = coloured(browser.picture("#canvas"))
    assert alone > 0.05 and covered > 0.999 * alone


def test_a_body_deforms_with_the_steps(browser, tmp_path):
    ball = pyvista.Icosphere(nsub=1)
    frames = np.array([ball.points, 2.0 * ball.points, 2.0 * ball.points + 1.0], dtype=float)
    body = Body("", 0.3, frames[0], ball.regular_faces, frames, 0.25)
    mesh = StaticMesh(FLAT, TRIANGLES, bodies=(body,))
    with ResultWriter(tmp_path / "result.vtkhdf", MPI.COMM_SELF, mesh=mesh, scene_text="[scene]") as writer:
        for at in STEPS:
            writer.write_step(at, FLAT, np.arange(25), placements=np.eye(4)[None])
    browser.open(report(tmp_path, tmp_path / "a.html", field="displacement").path)
    found = browser.value(
        "readArrays().then(read => { const v = new Viewer(JSON.parse(element('page-data').textContent), read);"
        "const shape = (step) => { v.show({step, field: 'displacement'}); return v.bodies[0].made.geometry; };"
        "return v.meta.steps.map((_, k) => Array.from(shape(k).attributes.position.array)); })"
    )
    np.testing.assert_allclose(found, [body.shape(at)[body.triangles].ravel() for at in STEPS], atol=1e-4)


def test_places_are_the_results(page, run):
    """What the page unpacks is what the file holds, to half a step of the grid, at every step."""
    found = page.value(
        "readArrays().then(read => { const meta = JSON.parse(element('page-data').textContent);"
        "const values = read(meta.points.data);"
        "return meta.steps.map((_, k) => Array.from(unpackPoints({values, ...meta.points}, k, meta.vertices))); })"
    )
    with read_result(run) as result:
        expected = np.array([result.points(k).ravel() for k in range(result.n_steps)])
    assert np.abs(np.array(found) - expected).max() < 0.51 * 3.0 / GRID  # m of height that it falls through


def test_it_turns(page):
    before = page.picture("#stage")
    x, y, width, height = page.box("#canvas")
    page.drag((x + width / 2, y + height / 2), (x + width / 2 + 150, y + height / 2 + 60))
    turned = page.picture("#stage")
    assert change(before, turned) > 2
    page.value("document.querySelector('#views button').click()")
    page.drawn()
    assert change(before, page.picture("#stage")) < 0.1


def test_it_draws_again_where_graphics_start_anew(page):
    """A lost WebGL context left the view blank for good."""
    before = page.picture("#stage")
    lost = "new Promise(done => { const canvas = document.getElementById('canvas'); %s; })"
    events = "canvas.addEventListener('webglcontext%s', () => done(1), { once: true })"
    extension = "window.lost = canvas.getContext('webgl2').getExtension('WEBGL_lose_context')"
    page.value(lost % f"{extension}; {events % 'lost'}; window.lost.loseContext()")
    page.drawn()
    assert change(before, page.picture("#stage")) > 2
    page.value(lost % f"{events % 'restored'}; window.lost.restoreContext()")
    page.drawn()
    assert change(before, page.picture("#stage")) < 0.1
    assert all("THREE.WebGLRenderer: Context" in told for told in page.problems)
    page.problems.clear()


def test_it_slides(page):
    """The slider moves shape, obstacle, label and the plots' cursor, by the keyboard too."""
    last, at = page.picture("#stage"), page.value("document.getElementById('cursor').offsetLeft")
    page.value("document.getElementById('step').focus()")
    for _ in STEPS[1:]:
        page.press("ArrowLeft", 37)
    assert page.value("document.getElementById('at').textContent") == "time 0 s"
    assert page.value("document.getElementById('cursor').offsetLeft") < at - 200
    assert change(last, page.picture("#stage")) > 2
    page.value("document.getElementById('play').click()")
    end = "new Promise(done => setInterval(() => viewed() && done(1), 20))"
    page.value(f"viewed = () => document.getElementById('at').textContent === 'time 0.5 s'; {end}")
    page.drawn()
    assert change(last, page.picture("#stage")) < 0.1


def test_it_switches_fields_and_shapes(page):
    gap = page.picture("#stage")
    names = page.value("[...document.querySelectorAll('#field option')].map(o => o.value)")
    assert {"gap", "displacement", "strain", "curvature", "reaction"} <= set(names) and "start" not in names
    seen = []
    for name in names:
        page.choose("#field", name)
        seen.append(page.picture("#stage"))
        assert coloured(seen[-1]) > 0.02, name
    assert change(gap, seen[names.index("strain")]) > 2
    assert page.value("document.getElementById('bar-title').textContent") != ""
    page.choose("#shape", "start")
    assert change(seen[-1], page.picture("#stage")) > 2


def test_a_click_tells_a_vertex(page):
    page.value("[...document.querySelectorAll('#views button')].find(b => b.textContent === 'front').click()")
    page.drawn()
    x, y, width, height = page.box("#canvas")
    page.click(x + 0.45 * width, y + 0.5 * height)
    told = page.value("document.getElementById('picked').textContent")
    number, place, value = re.match(
        r"vertex (\d+) at \((.*)\) m: gap (?:about|at least) ([\d.]+) m", told
    ).groups()
    assert np.allclose([float(c) for c in place.split(",")], FLAT[int(number)] - [0, 1, 0], atol=1e-3)
    assert float(value) == pytest.approx(1.0, abs=1 / LEVELS)
    page.click(x + 5, y + 5)
    assert page.value("document.getElementById('picked').textContent") == ""


def hostile_result(folder):
    folder.mkdir()
    mesh = StaticMesh(FLAT, TRIANGLES, group=np.zeros(len(TRIANGLES), int), group_names=(HOSTILE,))
    text = f"[scene]\nname = {json.dumps(HOSTILE)}\ntask = 'statics'\n# {HOSTILE}\n"
    from mpi4py import MPI

    with ResultWriter(folder / "result.vtkhdf", MPI.COMM_SELF, mesh=mesh, scene_text=text) as writer:
        for value in (0.5, 1.0):
            writer.write_step(value, FLAT * value, np.arange(25), scalars={"gravity": value})
    obstacle = {"name": HOSTILE, "vertices": 1, "area": 1.0, "force": [0, 0, 0], "moment": [0, 0, 0]}
    summary = {
        "converged": False,
        "reason": HOSTILE,
        HOSTILE: HOSTILE,
        "notes": [HOSTILE],
        "obstacles": [obstacle],
    }
    write_summary(folder / "summary.json", summary)
    return folder


def test_no_text_of_a_result_runs(browser, tmp_path):
    folder = hostile_result(tmp_path / "run")
    page = report(folder, tmp_path / "a.html").path
    browser.open(page)
    assert (
        browser.value("document.title")
        == HOSTILE
        == browser.value("document.querySelector('h1').textContent")
    )
    assert browser.value("document.querySelectorAll('script').length") == 4
    assert browser.value("document.querySelectorAll('img').length") == 0
    assert browser.value("window.hacked") is None and browser.problems == []
    assert browser.value("document.body.textContent").count("window.hacked=2") >= 5
    # and were a text ever to become a script, the page's own rules would keep it from running
    page.write_text(
        page.read_text().replace(
            "<footer", "<script>window.hacked=3</script><img src=x onerror=window.hacked=4><footer"
        )
    )
    browser.open(page)
    assert browser.value("window.hacked") is None and any("Content Security" in p for p in browser.problems)


def test_a_page_without_a_summary(browser, tmp_path):
    """Of a run that goes on, with one step: no slider, no plots."""
    writer = write(tmp_path / "run", [0.0], close=False)
    browser.open(report(tmp_path / "run", tmp_path / "a.html").path)
    text = browser.value("document.body.innerText")
    assert "the run has not ended" in text and "Plots" not in text
    assert browser.value("document.getElementById('step').hidden") and browser.problems == []
    writer.close()


def wavy(folder, size, steps):
    """A waving sheet of size^2 vertices, with as much in it that does not compress as a drape has."""
    folder.mkdir()
    x, y = (a.ravel() for a in np.meshgrid(np.linspace(0, 1, size), np.linspace(0, 1, size)))
    first = (np.arange(size - 1)[:, None] * size + np.arange(size - 1)).ravel()
    halves = [first, first + 1, first + size + 1], [first, first + size + 1, first + size]
    triangles = np.concatenate([np.column_stack(half) for half in halves])
    noise = np.random.default_rng(1)
    shapes = [
        0.1 * np.sin(7 * x + 0.3 * k) * np.cos(5 * y) + 1e-3 * noise.normal(size=len(x)) for k in range(steps)
    ]
    from mpi4py import MPI

    mesh = StaticMesh(np.column_stack([x, y, shapes[0]]), triangles)
    text = '[scene]\ntask = "dynamics"\n'
    with ResultWriter(folder / "result.vtkhdf", MPI.COMM_SELF, mesh=mesh, scene_text=text) as writer:
        for k, z in enumerate(shapes):
            writer.write_step(0.01 * k, np.column_stack([x, y, z]), np.arange(len(x)))
    return folder


def test_pages_keep_to_their_size(tmp_path, capsys):
    """Steps go first, evenly; then vertices, at 16 steps; both are told in the page and on the command line."""
    folder = wavy(tmp_path / "run", 30, 40)
    whole = report(folder, tmp_path / "whole.html")
    assert whole.steps == (40, 40) and whole.vertices == (900, 900) and whole.size < 5e6
    some = report(folder, tmp_path / "some.html", megabytes=0.8)
    assert 16 <= some.steps[0] < 40 and some.vertices == (900, 900) and 0.75e6 < some.size <= 0.8e6
    thin = report(folder, tmp_path / "thin.html", megabytes=0.7)
    assert thin.steps[0] >= 16 and thin.vertices[0] < 900 and thin.size <= 0.7e6
    assert main(["report", str(folder), "-o", str(tmp_path / "a.html"), "--size", "0.7"]) == 0
    told = capsys.readouterr().out
    assert f"note: {thin.vertices[0]} of 900 vertices in 0.7 MB" in told and told.endswith("a.html\n")
    for made in (some, thin):
        meta = meta_of(made.path)
        assert meta["steps"][0] == "time 0 s" and meta["steps"][-1] == "time 0.39 s"
        assert "evenly spread: the page has room for no more" in made.path.read_text()


def test_a_thin_page_has_vertices_of_the_result(browser, tmp_path):
    """Vertices that stay are where they were, and a click tells their numbers."""
    folder = wavy(tmp_path / "run", 30, 16)
    made = report(folder, tmp_path / "a.html", megabytes=0.7)
    browser.open(made.path)
    points, numbers = browser.value(
        "readArrays().then(read => { const meta = JSON.parse(element('page-data').textContent);"
        "return [Array.from(unpackPoints({values: read(meta.points.data), ...meta.points}, meta.steps.length - 1,"
        " meta.vertices)), Array.from(read(meta.numbers))]; })"
    )
    with read_result(folder) as result:
        assert np.abs(np.reshape(points, (-1, 3)) - result.points()[numbers]).max() < 1e-4
    assert coloured(browser.picture("#stage")) > 0.05 and browser.problems == []


def test_levels():
    values = np.array([-1.0, 0.0, 1.0, 2.0, 5.0, np.nan, np.inf])
    assert levels(values, 0.0, 2.0).tolist() == [0, 0, 127, 254, 254, NO_VALUE, NO_VALUE]


def test_pages_that_cannot_be(run, tmp_path, capsys):
    for arguments, message in (
        ([tmp_path / "none"], "no such result file"),
        ([run, "-o", tmp_path / "a.pdf"], "pages are written as .html"),
        ([run, "-o", tmp_path / "none" / "a.html"], "none/a.html: cannot be written"),
        ([run, "--field", "colour"], "no field 'colour'; allowed: .*gap"),
        (
            [run, "--size", "0.1"],
            r"size = 0.1 MB; allowed: more than the 0.\d+ MB of this page without shapes",
        ),
        ([run, "--size", "nan"], "size = nan MB"),
        ([run, "--size", "inf"], "size = inf MB"),
        ([run, "--size", "-1"], "size = -1 MB"),
    ):
        assert main(["report", *map(str, arguments)]) == 2
        error = capsys.readouterr().err
        assert re.search(message, error) and error.count("\n") == 1
    with pytest.raises(InputError, match="pages are written"):
        report(run, tmp_path / "page")


@pytest.mark.slow
def test_the_library_is_what_npm_has():
    if not shutil.which("npm"):
        pytest.skip("needs npm")
    subprocess.run([ROOT / "scripts" / "vendor-three", "--check"], check=True, timeout=300)


def test_modes_are_shapes_of_the_page(browser, tmp_path):
    """After the equilibrium every mode has its shape and its frequency; the page opens with the first, or that of
    --field."""
    points = np.stack(np.meshgrid(np.arange(6.0), np.arange(4.0), [0.0], indexing="ij"), axis=-1).reshape(
        -1, 3
    )
    corner = (np.arange(5)[:, None] * 4 + np.arange(3)).ravel()[:, None]
    triangles = np.concatenate([corner + np.array([0, 4, 5]), corner + np.array([0, 5, 1])])
    scene = {
        "scene": {"task": "modes"},
        "shell": {"mesh": (0.1 * points, triangles), "young": 1e9, "thickness": 1e-3, "density": 300.0},
        "loads": {"gravity": [0, 0, 0]},
        "modes": {"count": 2},
        "fix": [{"select": {"nodes": [0, 1, 2, 3]}, "clamp": True}],
    }
    result = voile.run(scene, tmp_path / "run")
    for field, mode in ((None, 0), ("mode_001", 1)):
        browser.open(report(tmp_path / "run", tmp_path / "a.html", field=field).path)
        frequency = result.summary["modes"]["frequencies"][mode]
        assert f"{frequency:.4g} Hz" in browser.value("document.getElementById('at').textContent")
        assert browser.value("document.getElementById('field').value") == "mode"
        shown = browser.value(
            "readArrays().then(read => { const meta = JSON.parse(element('page-data').textContent);"
            "const values = read(meta.points.data);"
            "return meta.steps.map((_, k) => Array.from(unpackPoints({values, ...meta.points}, k, meta.vertices))); })"
        )
        moved = np.array(shown[1 + mode]).reshape(-1, 3) - result.positions
        size = np.linalg.norm(np.ptp(result.positions, axis=0))
        assert np.abs(moved - 0.1 * size * result.field(f"mode_{mode:03}")).max() < 0.51 / GRID
        assert browser.problems == []
