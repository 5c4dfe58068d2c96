"""Bodies that deform in time."""

from pathlib import Path

import numpy as np
import pytest
from moving import cloth, move
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation
from test_problem import sheet
from test_runs_in_time import SCENE, scene

from voile.cli import main
from voile.contact.field import distance_field
from voile.contact.frames import Frames
from voile.contact.obstacle import Start
from voile.contact.obstacles import Sphere
from voile.post.contact import surfaces
from voile.results import read_result

__all__ = ["scene"]  # a fixture


def ball(cells: int = 24) -> tuple[np.ndarray, np.ndarray]:
    """A sphere of radius 1 as triangles."""
    return Sphere(center=np.zeros(3), radius=1.0).surface(np.zeros((2, 3)))


def frames_of(places: list[np.ndarray], radii: list[float], step: float = 0.1, fine: float = 0.02) -> Frames:
    points, triangles = ball()
    shapes = np.array([r * points + c for r, c in zip(radii, places, strict=True)])
    return Frames(shapes, step, distance_field(shapes[0], triangles, fine), "ball")


def test_what_touches_a_body_goes_with_it():
    frames = frames_of([np.zeros(3), np.array([0.02, 0.0, 0.0])], [0.2, 0.2])
    p = 0.2 * np.array([[1.0, 0.0, 0.0], [0.0, 0.6, 0.8], [0.0, 0.0, -1.0]])
    moved = frames.carry(p, 0.0, 0.05)
    np.testing.assert_allclose(moved - p, np.tile([0.01, 0.0, 0.0], (3, 1)), atol=1e-12)
    gap, normal, _ = frames.derivatives(moved, 0.05)
    np.testing.assert_allclose(gap, 0.0, atol=2e-3)
    np.testing.assert_allclose(normal, p / 0.2, atol=0.05)
    step = 1e-6 * np.array([0.3, -0.5, 0.8])
    slope = (frames.distance(moved + step, 0.05) - frames.distance(moved - step, 0.05)) / 2.0
    np.testing.assert_allclose(slope, normal @ step, rtol=1e-4, atol=1e-11)


def test_what_lies_off_a_body_turns_with_it():
    """As far off as half a thickness, above faces, edges and corners of a coarse body."""
    points, triangles = coarse_ball()
    turn = Rotation.from_rotvec([0.2, -0.1, 0.15]).as_matrix()
    shapes = np.array([points, points @ turn.T + [0.1, 0.0, 0.05]])
    frames = Frames(shapes, 0.1, distance_field(points, triangles, 0.1), "ball")
    on = np.vstack([points, points[triangles].mean(axis=1), points[triangles[:, :2]].mean(axis=1)])
    off = on * (1.0 + 0.02 / np.linalg.norm(on, axis=1))[:, None]
    np.testing.assert_allclose(frames.carry(off, 0.0, 0.1), off @ turn.T + [0.1, 0.0, 0.05], atol=1e-12)


@pytest.mark.parametrize(
    "radius, way",
    [
        pytest.param(0.2, 0.05, marks=pytest.mark.slow, id="a quarter of its radius"),
        pytest.param(0.02, 0.1, id="past itself"),
    ],
)
def test_a_body_that_only_moves_keeps_its_shape(radius, way):
    frames = frames_of([np.zeros(3), np.array([way, 0.0, 0.0])], [radius, radius], fine=0.1 * radius)
    shape = np.random.default_rng(0).normal(size=(40, 3))
    p = 1.05 * radius * shape / np.linalg.norm(shape, axis=1)[:, None]
    going = np.array([way, 0.0, 0.0])
    start = Start(p + 0.2 * going, 0.02)
    for share in (0.3, 0.5, 0.9):
        near = p + share * going + [0.0, 0.0, 1e-3 * radius]  # slides a little
        moved = frames.derivatives(near, 0.1 * share, start)
        for found, exact in zip(moved, frames.derivatives(near - share * going, 0.0), strict=True):
            np.testing.assert_allclose(found, exact, rtol=1e-9, atol=1e-9 * np.abs(exact).max())


def test_a_body_that_turns_and_swells_keeps_its_surface_and_has_exact_derivatives():
    points, triangles = ball()
    angle = 0.3
    turn = np.array(
        [[np.cos(angle), -np.sin(angle), 0.0], [np.sin(angle), np.cos(angle), 0.0], [0.0, 0.0, 1.0]]
    )
    egg = 0.2 * points * [1.0, 0.7, 0.8]
    shapes = np.array([egg, 1.1 * egg @ turn.T + [0.1, 0.0, 0.05]])
    frames = Frames(shapes, 0.1, distance_field(shapes[0], triangles, 0.01), "egg")
    on = frames.at(0.04)[::7]
    start = Start(on, 0.04)
    there = frames.carry(on, 0.04, 0.07)
    np.testing.assert_allclose(there, frames.at(0.07)[::7], atol=1e-9)
    gap, normal, curvature = frames.derivatives(there, 0.07, start)
    np.testing.assert_allclose(gap, 0.0, atol=2.0 * frames.first.measured)
    step = 1e-5 * np.random.default_rng(1).normal(size=on.shape)
    ahead, behind = (frames.derivatives(there + s * step, 0.07, start) for s in (1.0, -1.0))
    np.testing.assert_allclose(ahead[0] - behind[0], 2.0 * np.einsum("pi,pi->p", normal, step), atol=1e-10)
    bend = 2.0 * np.einsum("pij,pj->pi", curvature, step)
    np.testing.assert_allclose(ahead[1] - behind[1], bend, atol=1e-3 * np.abs(bend).max())


def test_a_ball_that_swells_lifts_a_sheet():
    from voile.contact.obstacles import MeshBody

    places, radii = [np.array([0.0, 0.0, -0.1])] * 3, [0.099, 0.119, 0.119]
    frames = frames_of(places, radii)
    body = MeshBody(**vars(frames.first), friction=0.5, frames=frames)
    points, triangles = sheet(4, 4, 0.1, 0.1)
    points -= np.array([0.05, 0.05, 0.0])
    shell = cloth(points, triangles, young=1e6, thickness=2e-3)
    run = move(shell, "implicit-euler", 5e-3, 0.2, 0.0, [body], tolerance=1e-6)
    assert run.path.converged
    middle = np.argmin(np.abs(points).sum(axis=1))
    assert run.end[middle, 2] == pytest.approx(0.019, abs=2e-3)
    assert run.path.books.totals["obstacles_work"] > 0.0
    assert frames.distance(run.end, 0.2).min() > -1e-9


def coarse_ball() -> tuple[np.ndarray, np.ndarray]:
    """A sphere of radius 1 as 396 triangles: places on a spiral, a golden angle apart."""
    z, turn = np.linspace(-1.0, 1.0, 200), np.pi * (3.0 - np.sqrt(5.0)) * np.arange(200)
    points = np.column_stack([np.sqrt(1.0 - z**2) * np.cos(turn), np.sqrt(1.0 - z**2) * np.sin(turn), z])
    triangles = ConvexHull(points).simplices
    inward = np.linalg.det(points[triangles]) < 0.0
    triangles[inward] = triangles[inward, ::-1]
    return points, triangles


def write_frames(folder: Path, count: int) -> None:
    points, triangles = coarse_ball()
    for k in range(count):
        lines = [
            f"v {x!r} {y!r} {z!r}" for x, y, z in (0.1 * points + [0.5 + 0.01 * k, 0.25, -0.12]).tolist()
        ]
        lines += [f"f {a} {b} {c}" for a, b, c in (triangles + 1).tolist()]
        (folder / f"body_{k:03d}.obj").write_text("\n".join(lines))


def with_frames(text: str) -> str:
    begin, end = text.index("[[obstacle]]"), text.index("[dynamics]")
    body = '[[obstacle]]\nshape = "mesh"\nframes = "body_%03d.obj"\nframe_time = 0.1\nfriction = 0.4\n'
    return text[:begin] + body + text[end:]


def test_a_scene_with_frames(scene, tmp_path, capsys):
    scene.write_text(with_frames(SCENE))
    run = ["run", str(scene), "-o", str(tmp_path / "out")]
    assert main(run) == 2 and "no such file" in capsys.readouterr().err
    write_frames(tmp_path, 2)
    assert main(run) == 2 and "2 frames, the last body_001.obj, last to 0.1 s" in capsys.readouterr().err
    assert (
        main([*run, "--set", "obstacle.0.file=body_000.obj"]) == 2
        and "obstacle.0.frames: not together with file" in capsys.readouterr().err
    )
    alone = 'obstacle.0={shape="mesh", file="body_000.obj", frame_time=0.1}'
    assert main([*run, "--set", alone]) == 2 and "allowed with frames only" in capsys.readouterr().err
    assert main([*run, "--set", "scene.task=statics"]) == 2 and "frames" in capsys.readouterr().err
    write_frames(tmp_path, 3)
    text = (tmp_path / "body_002.obj").read_text()
    (tmp_path / "body_002.obj").write_text(text[: text.rindex("\n")])
    assert main(run) == 2 and "other triangles" in capsys.readouterr().err
    (tmp_path / "body_002.obj").write_text(text.replace("v ", "v -"))
    assert main(run) == 2 and "body_002.obj: the mesh is inside out" in capsys.readouterr().err
    write_frames(tmp_path, 3)
    assert main(run) == 0
    with read_result(tmp_path / "out") as result:  # pictures draw the body as it is at the step's time
        for step in (0, 4, -1):
            (drawn, _), shift = surfaces(result, step)[0], 0.1 * result.values[step]
            np.testing.assert_allclose(drawn, 0.1 * coarse_ball()[0] + [0.5 + shift, 0.25, -0.12], atol=1e-7)
        end = result.points()
    one = """obstacle.0={shape="mesh", file="body_000.obj", move={velocity=[0.1, 0.0, 0.0]}, friction=0.4}"""
    assert main(["run", str(scene), "-o", str(tmp_path / "moved"), "--set", one]) == 0
    with read_result(tmp_path / "moved") as result:
        np.testing.assert_allclose(end, result.points(), atol=1e-9)
