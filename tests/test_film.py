"""Films and plots of runs: frames and their times, a fixed view, what is recorded, what is refused."""

import h5py
import numpy as np
import pytest
from mpi4py import MPI
from PIL import Image, ImageSequence

from voile.cli import main
from voile.errors import InputError
from voile.post.camera import DIRECTIONS, outermost
from voile.post.contact import surfaces, turning_marks
from voile.post.film import _Picture, animate
from voile.post.plot import plot
from voile.post.series import Recorded
from voile.results import Body, ResultWriter, StaticMesh, read_result, read_summary

av, pyvista = pytest.importorskip("av"), pytest.importorskip("pyvista")

SIZE = (160, 120)
X, Y = (a.ravel() for a in np.meshgrid(np.linspace(-1, 1, 5), np.linspace(-1, 1, 5)))
FIRST = (np.arange(4)[:, None] * 5 + np.arange(4)).ravel()
TRIANGLES = np.concatenate(
    [np.column_stack([FIRST, FIRST + 1, FIRST + 6]), np.column_stack([FIRST, FIRST + 6, FIRST + 5])]
)
FLAT = np.column_stack([X, Y, 0 * X])
ENERGY = {"kinetic": 2.0, "gravity": -3.0, "stretching": 1e-9}


def turned(angle):
    """Placement after a turn about y."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, 0, s, 0], [0, 1, 0, 0], [-s, 0, c, 0], [0, 0, 0, 1]])


def write(folder, values, task="dynamics", fall=1.0, turn=0.5, close=True):
    """A square that falls by `fall` in all beside a ball that turns, the gap the same all over it and growing; the
    open writer where it is not to be closed."""
    folder.mkdir(exist_ok=True)
    ball = pyvista.Icosphere(radius=0.8, center=(0.0, -2.5, 0.0), nsub=3)
    bodies = (Body("ball", 0.3, np.asarray(ball.points, float), ball.regular_faces),)
    writer = ResultWriter(
        folder / "result.vtkhdf",
        MPI.COMM_SELF,
        mesh=StaticMesh(FLAT, TRIANGLES, bodies=bodies),
        scene_text=f'[scene]\nname = "square"\ntask = "{task}"\n',
    )
    for k, value in enumerate(values):
        share = k / max(len(values) - 1, 1)
        writer.write_step(
            value,
            FLAT - [0.0, fall * share, 0.0],
            np.arange(25),
            point_data={"gap": np.full(25, share), "reaction": np.tile([0.0, share, 0.0], (25, 1))},
            scalars={"residual": 1e-6, **ENERGY},
            placements=turned(turn * share)[None],
        )
    if close:
        writer.close()
    return writer


def frames(path):
    """(k, height, width, 3) and, where the file has them, each frame's ms."""
    if path.suffix == ".mp4":
        with av.open(str(path)) as film:
            return np.array([f.to_ndarray(format="rgb24") for f in film.decode(video=0)]).astype(int), []
    with Image.open(path) as film:
        both = [
            (np.asarray(f.convert("RGB")).astype(int), f.info["duration"])
            for f in ImageSequence.Iterator(film)
        ]
    return np.array([picture for picture, _ in both]), [ms for _, ms in both]


@pytest.mark.parametrize("kind", ["mp4", "gif", "webp"])
def test_a_film_at_real_speed(tmp_path, kind):
    write(tmp_path, np.linspace(0, 0.5, 51))
    film = animate(tmp_path, tmp_path / f"film.{kind}", field="gap", fps=8, size=SIZE)
    seen, ms = frames(film.path)
    assert (film.frames, film.ended, len(seen)) == (5, True, 5) and seen.shape[1:] == (120, 160, 3)
    assert not ms or sum(ms) == pytest.approx(625, abs=10)
    inside = seen[:, 9:, :130]
    for edge in (inside[:, -2:], inside[:, :, :2]):  # falls, and stays in the picture
        assert edge.min() > 225
    blue = [np.ptp(picture, axis=2).max() for picture in inside]
    dark = [picture.min() for picture in inside]
    assert blue[0] < blue[-1] and np.abs(seen[0] - seen[-1]).max() > 100 and dark[-1] < 130
    assert np.abs(seen[0, :7] - seen[2, :7]).max() > 60  # the time written above
    assert {p.name for p in tmp_path.iterdir()} == {"result.vtkhdf", film.path.name}


def test_frames_are_the_nearest_steps_in_time(tmp_path, monkeypatch):
    """Each is drawn once as long as it stays."""
    drawn, told = [], []

    def draw(self, step):
        drawn.append((step, self.titles[step]))
        return np.full((120, 160, 3), 40 * step, np.uint8)

    monkeypatch.setattr(_Picture, "_draw", draw)
    write(tmp_path, [0.0, 0.1, 0.12, 0.5, 1.0])
    film = animate(
        tmp_path, tmp_path / "a.mp4", fps=4, speed=0.5, size=SIZE, on_frame=lambda k, n: told.append((k, n))
    )
    assert film.frames == 9 and told == [(k, 9) for k in range(1, 10)]
    assert [step for step, _ in drawn] == [0, 2, 3, 4]
    assert drawn[1][1] == "square    time 0.12 s    0.5 x real speed"
    shown = frames(film.path)[0].mean(axis=(1, 2, 3)) / 40
    assert np.allclose(shown, [0, 2, 2, 3, 3, 3, 3, 4, 4], atol=0.1)


def test_every_load_step_is_a_frame(tmp_path):
    write(tmp_path, [0.25, 0.5, 1.0], task="statics")
    film = animate(tmp_path, tmp_path / "film.gif", size=SIZE)
    assert (film.frames, film.fps) == (3, 5.0) and frames(film.path)[1] == [200, 200, 200]


def test_a_body_that_turns_shows_it(tmp_path):
    for turn in (0.0, 0.5):
        write(tmp_path / str(turn), [0.0, 0.5, 1.0], fall=0.0, turn=turn)
        seen, _ = frames(animate(tmp_path / str(turn), tmp_path / "a.webp", fps=2, size=SIZE).path)
        ball = seen[:, 70:, :130]
        assert (np.abs(ball[0] - ball[-1]).max() > 8) == (turn > 0)
        with read_result(tmp_path / str(turn)) as result:
            (marks,) = turning_marks(result, np.arange(3))
            assert (marks is not None) == (turn > 0)
            assert np.allclose(surfaces(result, -1)[0][0] @ turned(turn)[:3, :3], result.bodies[0].points)


def test_outermost_points_span_a_cloud():
    cloud = np.random.default_rng(1).normal(size=(5000, 3)) * [1.0, 3.0, 0.1]
    few = outermost(cloud)
    assert len(few) < 257
    away = np.random.default_rng(2).normal(size=(500, 3))
    away /= np.linalg.norm(away, axis=1)[:, None]
    missed = (cloud @ away.T).max(axis=0) - (few @ away.T).max(axis=0)
    assert missed.max() < 0.03 * np.ptp(cloud, axis=0).max() / 2
    assert np.allclose(np.linalg.norm(DIRECTIONS, axis=1), 1)


def test_films_that_cannot_be(tmp_path):
    write(tmp_path / "run", [0.0, 0.5, 1.0])
    write(tmp_path / "one", [1.0], task="statics")
    write(tmp_path / "inverse", [0.0, 1.0], task="inverse")
    write(tmp_path / "load", [0.5, 1.0], task="statics")
    write(tmp_path / "short", [0.0, 1e-3])
    before = sorted(tmp_path.rglob("*"))
    for folder, name, options, message in (
        ("one", "a.gif", {}, "one step only; .*statics.load_steps"),
        ("inverse", "a.gif", {}, "task = inverse has no path"),
        ("short", "a.gif", {}, "0.001 s of motion are not two frames at 25 a second; speed = 0.01"),
        ("load", "a.gif", {"speed": 2.0}, "no time and so no speed"),
        ("run", "a.avi", {}, r"unknown format '.avi'; allowed for films: .mp4, .gif, .webp"),
        ("run", "a.gif", {"fps": 60.0}, "at most 50"),
        ("run", "a.mp4", {"fps": 0.0}, "fps = 0: frames per second above 0"),
        ("run", "a.mp4", {"speed": float("nan")}, "speed = nan"),
        ("run", "a.mp4", {"field": "colour"}, "no field 'colour'; allowed: .*gap"),
        ("run", "a.mp4", {"size": (161, 120)}, "even numbers"),
        ("run", "none/a.mp4", {}, "none/a.mp4: cannot be written"),
    ):
        with pytest.raises(InputError, match=message):
            animate(tmp_path / folder, tmp_path / name, **{"size": SIZE, **options})
    assert sorted(tmp_path.rglob("*")) == before


def test_a_run_that_goes_on(tmp_path, capsys):
    """Its steps so far are shown and this is said; one step is not enough."""
    writer = write(tmp_path / "run", [0.0, 0.25], close=False)
    film = animate(tmp_path / "run", tmp_path / "a.gif", fps=4, size=SIZE)
    assert (film.frames, film.ended) == (2, False)
    assert main(["animate", str(tmp_path / "run"), "--fps", "4", "-o", str(tmp_path / "b.gif")]) == 0
    assert "the run has not ended" in capsys.readouterr().out
    writer.close()
    alone = write(tmp_path / "alone", [0.0], close=False)
    assert main(["animate", str(tmp_path / "alone")]) == 2
    assert "has not ended, wait" in capsys.readouterr().err
    alone.close()


# ---- plots ----


def test_what_is_recorded_of_a_load_path(tmp_path):
    write(tmp_path, [0.25, 0.5, 1.0], task="statics")
    with read_result(tmp_path) as result:
        recorded = Recorded(result, in_time=False)
        energies = recorded.series("energies")
        assert [(s.name, s.unit) for s in energies] == [
            ("gravity", "J"),
            ("kinetic", "J"),
        ]  # the rest is round-off
        (force,), (moved,) = (recorded.series(name) for name in ("contact_force", "max_displacement"))
        assert np.allclose(force.values[:, 1], 25 * np.array([0, 0.5, 1])) and force.unit == "N"
        assert np.allclose(moved.values, [0, 0.5, 1]) and np.array_equal(moved.at, [0.25, 0.5, 1.0])
        (corner,) = recorded.series("displacement:24")
        assert np.allclose(corner.values, np.outer([0, 0.5, 1], [0, -1, 0]))
        (gap,) = recorded.series("gap:3")
        assert np.allclose(gap.values, [0, 0.5, 1]) and gap.unit == "m"
        for name in ("displacement:25", "gap:-1", "gap:x"):
            with pytest.raises(InputError, match="allowed: 0 to 24"):
                recorded.series(name)
        with pytest.raises(InputError, match="'heat'; allowed: energies, contact_force.*displacement:VERTEX"):
            recorded.series("heat")


def test_the_history_of_every_step_comes_first(tmp_path):
    write(tmp_path, [0.0, 0.5])
    with h5py.File(tmp_path / "history.h5", "w") as file:
        group = file.create_group("voile/history")
        group["time"], group["kinetic"] = np.linspace(0.1, 0.5, 5), np.arange(5.0)
        group["friction_dissipated"], group["momentum"] = np.full(5, 2.0), np.ones((5, 3))
    with read_result(tmp_path) as result:
        recorded = Recorded(result, in_time=True)
        assert [len(s.at) for s in recorded.series("energies")] == [2, 5, 5]
        assert recorded.series("momentum")[0].unit == "kg m/s"
        assert [s.name for s in recorded.series("energies")] == ["gravity", "kinetic", "friction_dissipated"]
    (tmp_path / "history.h5").write_bytes(b"broken")
    with pytest.raises(InputError, match="history.h5: no history"):
        plot(tmp_path, tmp_path / "a.png")


def test_plots(tmp_path, capsys):
    write(tmp_path / "run", [0.0, 0.5, 1.0])
    write(tmp_path / "one", [1.0], task="statics")
    assert main(["plot", str(tmp_path / "run")]) == 0
    assert main(["plot", str(tmp_path / "run"), "contact_force", "gap:3"]) == 0
    first, second = capsys.readouterr().out.split()
    assert first.endswith("run/energies.png") and second.endswith("run/contact_force-gap-3.png")
    heights = []
    for path in (first, second):
        picture = np.asarray(Image.open(path).convert("RGB")).astype(int)
        heights.append(len(picture))
        assert 0.002 < (np.ptp(picture, axis=2) > 60).mean() < 0.2  # coloured lines
    assert heights[1] > 1.5 * heights[0]
    for arguments, message in (
        (["run", "heat"], "no quantity 'heat'; allowed: energies"),
        (["one"], "one step only"),
        (["run", "-o", tmp_path / "a.pdf"], "written as .png"),
        (["run", "-o", tmp_path / "none" / "a.png"], "cannot be written"),
    ):
        assert main(["plot", *map(str, [tmp_path / arguments[0], *arguments[1:]])]) == 2
        error = capsys.readouterr().err
        assert message in error and error.count("\n") == 1


# ---- what runs write ----

SCENE = """
[scene]
task = "{task}"
[shell]
mesh = "square.obj"
young = 1e6
thickness = 0.01
density = 300.0
[loads]
gravity = [0.0, 0.0, -9.81]
[[fix]]
select = {{ box = [[-1.1, -1.1, -1], [-0.9, 1.1, 1]] }}
[statics]
load_steps = 3
[dynamics]
time_step = 0.02
duration = 0.1
"""


@pytest.mark.parametrize("task", ["statics", "dynamics"])
def test_runs_are_filmed_and_plotted(tmp_path, task, capsys):
    lines = ["v {} {} {}".format(*p) for p in FLAT.tolist()]
    lines += ["f {} {} {}".format(*t) for t in (TRIANGLES + 1).tolist()]
    (tmp_path / "square.obj").write_text("\n".join(lines))
    (tmp_path / "scene.toml").write_text(SCENE.format(task=task))
    out = tmp_path / "out"
    assert main(["run", str(tmp_path / "scene.toml"), "-o", str(out)]) == 0
    film = animate(out, tmp_path / "film.mp4", size=SIZE)
    assert main(["plot", str(out)]) == 0 and (out / "energies.png").exists()
    with read_result(out) as result:
        recorded = Recorded(result, task == "dynamics")
        energies = {s.name: s for s in recorded.series("energies")}
        (last,) = recorded.series("gravity")
        steps = result.n_steps
    assert steps > 1 and film.ended and film.frames == (3 if task == "dynamics" else steps)
    assert "gravity" in energies and {"bending", "stretching"} <= set(recorded.names)
    assert ("kinetic" in energies) == (task == "dynamics")
    assert last.values[-1] == pytest.approx(read_summary(out / "summary.json")["energy"]["gravity"])
    capsys.readouterr()
