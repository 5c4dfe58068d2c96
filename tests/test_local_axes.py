"""Supports in local axes: the same shell, turned as a whole with the axes of its supports, does the same."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from test_python import sheet

import voile
from voile.errors import InputError
from voile.problem.local_axes import Hold, combined, frame_axes, inverse, principal

TURN = Rotation.from_rotvec([0.4, -0.7, 0.5]).as_matrix()
SIZE = 0.1


def shell(turn: np.ndarray, **more) -> dict:
    """A bent sheet that slides down a wall: its left edge is hinged, its right edge slides in the plane across z and is
    moved along x, its back edge is clamped in a plane of symmetry, one corner only slides along y. Turned."""
    points, triangles = sheet(6, SIZE)
    points[:, 2] = 0.3 * points[:, 0] * (SIZE - points[:, 0]) / SIZE
    frame = None if (turn == np.eye(3)).all() else [list(turn[:, 0]), list(turn[:, 1])]
    nodes = {
        name: np.flatnonzero(np.abs(points[:, axis] - at) < 1e-9).tolist()
        for name, axis, at in (("left", 0, 0.0), ("right", 0, SIZE), ("back", 1, SIZE))
    }
    fixes = [
        {"name": "left", "select": {"nodes": nodes["left"]}, "axes": "xz"},
        {"name": "right", "select": {"nodes": nodes["right"]}, "axes": "xz",
         "move": {"displacement": [-0.02 * SIZE, 0, 0]}},
        {"name": "back", "select": {"nodes": nodes["back"]}, "axes": "y", "clamp": True},
    ]  # fmt: skip
    return {
        "shell": {"mesh": (points @ turn.T, triangles), "young": 1e7, "thickness": 1e-3, "density": 300.0},
        "loads": {"gravity": (turn @ [0.5, -2.0, -9.81]).tolist()},
        "fix": [fix if frame is None else {**fix, "frame": frame} for fix in fixes],
        "statics": {"tolerance": 1e-12},
        **more,
    }


def test_statics_and_reactions_turn_with_the_axes():
    one, other = (voile.run(shell(turn)) for turn in (np.eye(3), TURN))
    assert abs(one.positions - one.start).max() > 0.01 * SIZE
    assert abs(other.positions - one.positions @ TURN.T).max() < 1e-10 * SIZE
    weight = 300.0 * 1e-3 * 9.81 * SIZE**2
    for mine, theirs in zip(one.summary["supports"], other.summary["supports"], strict=True):
        assert np.linalg.norm(mine["force"]) > 0.01 * weight
        assert np.allclose(TURN @ mine["force"], theirs["force"], rtol=0.0, atol=1e-9 * weight)
        assert np.allclose(TURN @ mine["moment"], theirs["moment"], rtol=0.0, atol=1e-9 * weight * SIZE)


@pytest.mark.parametrize("scheme", ["generalized-alpha", "moreau-jean"])
def test_motion_turns_with_the_axes(scheme):
    clock = {"time_step": 0.002, "duration": 0.01, "scheme": scheme, "tolerance": 1e-11}
    if scheme == "moreau-jean":
        clock["damping"] = {"mass": 1.0, "stiffness": 1e-4}
    scenes = [shell(turn, scene={"task": "dynamics"}, dynamics=clock) for turn in (np.eye(3), TURN)]
    if scheme == "generalized-alpha":  # where an oblique support moves, its vertices follow implicit Euler
        for scene in scenes:
            del scene["fix"][1]["move"]
    one, other = map(voile.run, scenes)
    assert abs(one.positions - one.start).max() > 1e-4 * SIZE
    assert abs(other.positions - one.positions @ TURN.T).max() < 1e-10 * SIZE


def test_modes_turn_with_the_axes():
    scenes = [shell(turn, scene={"task": "modes"}) for turn in (np.eye(3), TURN)]
    one, other = (voile.run(scene).summary["modes"]["frequencies"] for scene in scenes)
    assert np.allclose(one, other, rtol=1e-9)


def test_a_sheet_slides_down_an_inclined_plane_on_two_ranks(tmp_path, run_on):
    """Held across the plane alone (one direction is enough) and pulled up it by a line of vertices held along it: their
    reaction is the weight's share along the plane, the plane bears the rest."""
    (tmp_path / "sheet.obj").write_text(_obj(*sheet(6, SIZE)))
    slope, text = np.radians(30.0), "[scene]\ntask = 'statics'\n[shell]\nmesh = 'sheet.obj'\nyoung = 1e6\n"
    down, normal = (float(np.sin(slope)), 0.0, -float(np.cos(slope))), (0.0, 0.0, 1.0)
    text += f"thickness = 1e-3\ndensity = 1000.0\n[loads]\ngravity = {[9.81 * v for v in down]}\n"
    text += f"[[fix]]\nname = 'plane'\nselect = {{ all = true }}\naxes = 'x'\nframe = [{list(normal)}]\n"
    text += "[[fix]]\nname = 'rope'\nselect = { box = [[-1, -1, -1], [1e-6, 1, 1]] }\naxes = 'x'\n"
    oblique = [float(np.cos(0.3)), 0.0, float(np.sin(0.3))]  # together with the plane: no motion along x
    text += f"frame = [{oblique}]\n[[fix]]\nselect = {{ nodes = [0] }}\naxes = 'y'\n"
    (tmp_path / "scene.toml").write_text(text)
    for ranks in (1, 2):
        run_on(ranks, tmp_path / "scene.toml", tmp_path / str(ranks))
        found = {row["name"]: row["force"] for row in voile.read(tmp_path / str(ranks)).summary["supports"]}
        weight = 9.81 * SIZE**2
        rope = -weight * np.sin(slope) / oblique[0]  # of which the plane takes what is across it
        assert np.allclose(found["rope"], rope * np.array(oblique), atol=1e-6 * weight)
        assert np.allclose(found["plane"][:2], 0.0, atol=1e-6 * weight)
        assert found["plane"][2] == pytest.approx(weight * np.cos(slope) - rope * oblique[2], rel=1e-6)
    one, two = (voile.read(tmp_path / name).positions for name in "12")
    assert abs(one - two).max() < 1e-9 * SIZE


def test_oblique_supports_agree_or_are_refused():
    """Two directions at 60 degrees hold a plane; what they prescribe is met exactly."""
    a, b = np.array([1.0, 0.0, 0.0]), np.array([0.5, np.sqrt(0.75), 0.0])
    goal = np.array([0.3, -0.2, 0.0])
    holds = [Hold(str(k), np.array([0]), d[None], False, (d @ goal) * d) for k, d in enumerate((a, b))]
    axes, fixed, motion = combined(holds, 1, "fix")
    assert axes is not None and fixed.sum() == 2
    assert np.allclose(motion[0], goal, atol=1e-14)
    forms = np.sum([hold.projection for hold in holds], axis=0)[None]
    assert np.allclose(inverse(forms)[0] @ forms[0], np.diag([1.0, 1.0, 0.0]), atol=1e-14)
    assert (principal(np.eye(3)[None])[0] == np.eye(3)).all()
    clash = Hold("2", np.array([0]), a[None], False, 0.1 * a)
    with pytest.raises(InputError, match="moved differently"):
        combined([*holds, clash], 1, "fix")


@pytest.mark.parametrize(
    ("fix", "message"),
    [
        ({"frame": [[0, 0, 0]]}, "not all zero"),
        ({"frame": [[1, 0, 0], [2, 0, 0]]}, "parallel"),
        ({"frame": [[1, 0, 0]], "axes": "xy"}, "a second one"),
        ({"frame": [[1, 0, 0]], "axes": "yz", "move": {"displacement": [0, 0.1, 0]}}, "a second one"),
        ({"frame": [[1, 0, 0]], "axes": "x", "move": {"displacement": [0, 0.1, 0]}}, "along x"),
        ({"frame": [[1, 0, 0], [0, 1, 0]], "move": {"rotation": [0, 0.1, 0]}}, "without rotation"),
    ],
)
def test_frames_that_are_none(fix, message):
    scene = shell(np.eye(3))
    scene["fix"] = [{"select": {"all": True}, **fix}]
    with pytest.raises(InputError, match=message):
        voile.load(scene)


@pytest.mark.parametrize("length", [1e300, 1e-300])
def test_directions_are_of_any_length(length):
    scene = shell(np.eye(3))
    scene["fix"] = [{"select": {"all": True}, "frame": [[0.0, 3 * length, 4 * length]]}]
    (direction,) = voile.load(scene).fix[0].frame
    axes = frame_axes([direction])
    assert np.allclose(axes[0], [0.0, 0.6, 0.8], atol=1e-14) and np.allclose(axes @ axes.T, np.eye(3))


def _obj(points: np.ndarray, triangles: np.ndarray) -> str:
    lines = ["v " + " ".join(f"{c:.17g}" for c in x) for x in points]
    return "\n".join(lines + ["f " + " ".join(str(i + 1) for i in t) for t in triangles]) + "\n"


@pytest.mark.parametrize("clamp", [False, True])
def test_a_support_that_rotates_takes_a_shell_along(clamp):
    """A sheet on one rotating edge, clamped in it, or on three rotating corners: it turns by 1 rad as it is."""
    points, triangles = sheet(4, SIZE)
    turn, center = Rotation.from_rotvec([0.6, 0.8, 0.0]).as_matrix(), np.array([0.0, 0.02, 0.01])
    edge = {"box": [[-1, -1, -1], [1e-6, 1, 1]]}
    corners = {"nodes": [0, 4, 24]}
    fix = {"select": edge if clamp else corners, "clamp": clamp}
    fix["move"] = {"rotation": [0.6, 0.8, 0.0], "center": center.tolist()}
    result = voile.run(
        {
            "shell": {"mesh": (points, triangles), "young": 1e7, "thickness": 1e-3, "density": 300.0},
            "loads": {"gravity": [0, 0, 0]},
            "fix": [fix],
        }
    )
    assert abs(result.positions - ((points - center) @ turn.T + center)).max() < 1e-9 * SIZE
    assert abs(sum(result.summary["energy"].values())) < 1e-15


def test_a_clamp_that_rotates_bends_a_strip():
    """Both ends clamped, one turned by theta about the edge: moments 4 and 2 E I theta / L, force 6 E I theta / L^2."""
    length, width, theta = 0.2, 0.02, 1e-4
    points, triangles = sheet(40, length)
    points[:, 1] *= width / length
    points, triangles = _coarsened(points, triangles, 40, 10)
    ends = {"box": [[-1, -1, -1], [1e-6, 1, 1]]}, {"box": [[length - 1e-6, -1, -1], [1, 1, 1]]}
    move = {"rotation": [0.0, theta, 0.0], "center": [length, 0.0, 0.0]}
    result = voile.run(
        {
            "shell": {"mesh": (points, triangles), "young": 1e9, "poisson": 0.0, "thickness": 1e-3, "density": 1.0},
            "loads": {"gravity": [0, 0, 0]},
            "fix": [{"select": ends[0], "clamp": True}, {"select": ends[1], "clamp": True, "move": move}],
        }
    )  # fmt: skip
    still, turned = result.summary["supports"]
    stiffness = 1e9 * width * 1e-9 / 12.0 * theta / length
    assert turned["moment"][1] == pytest.approx(4.0 * stiffness, rel=0.02)
    assert still["moment"][1] == pytest.approx(2.0 * stiffness, rel=0.02)
    assert abs(turned["force"][2]) == pytest.approx(6.0 * stiffness / length, rel=0.02)


def _coarsened(points, triangles, count, keep):
    """The first strips of a sheet of count x count cells, `keep` of them over its whole width."""
    column = np.arange(count + 1) % (count // keep) == 0
    x = points.reshape(count + 1, count + 1, 3)[:, column]
    rows, columns = x.shape[:2]
    corner = (np.arange(rows - 1)[:, None] * columns + np.arange(columns - 1)).ravel()
    right, both = corner + columns, corner + columns + 1
    lower, upper = np.stack([corner, right, both], 1), np.stack([corner, both, corner + 1], 1)
    return x.reshape(-1, 3), np.concatenate([lower, upper])


def test_a_clamp_that_rotates_ever_faster_bends_a_strip_by_its_inertia(tmp_path):
    """By a t^2 / 2 about the edge: once vibrations are damped the tip lags by 11 m a L^5 / 120 B, m the mass and B the
    bending stiffness per area and width; the clamp's moment is a m b L^3 / 3 and its work becomes kinetic energy."""
    length, width, mass, rate, until = 0.3, 0.05, 1.0, 0.05, 2.0
    points, triangles = sheet(20, length)
    points[:, 1] *= width / length
    points, triangles = _coarsened(points, triangles, 20, 2)
    at = np.linspace(0.0, until, 401)
    zero = 0.0 * at
    rows = np.column_stack([at, zero, zero, zero, zero, -0.5 * rate * at**2, zero])
    np.savetxt(tmp_path / "turn.csv", rows, delimiter=",")
    result = voile.run(
        {
            "scene": {"task": "dynamics"},
            "shell": {"mesh": (points, triangles), "young": 1e9, "poisson": 0.0, "thickness": 1e-3, "density": 1e3},
            "loads": {"gravity": [0, 0, 0]},
            "dynamics": {"time_step": 0.02, "duration": until, "damping": {"stiffness": 0.09}},
            "fix": [{"select": {"box": [[-1, -1, -1], [1e-6, 1, 1]]}, "clamp": True,
                     "move": {"path": str(tmp_path / "turn.csv")}}],
        }
    )  # fmt: skip
    angle, speed = 0.5 * rate * until**2, rate * until
    tip = result.positions[result.start[:, 0] > length - 1e-9].mean(axis=0)
    lag = -tip @ [-np.sin(angle), 0.0, np.cos(angle)]
    assert lag == pytest.approx(11.0 * mass * rate * length**5 / (120.0 * 1.0 / 12.0), rel=0.01)
    inertia = mass * width * length**3 / 3.0
    assert result.summary["supports"][0]["moment"][1] == pytest.approx(-rate * inertia, rel=0.01)
    energy = result.summary["dynamics"]["energy"]
    assert energy["kinetic"] == pytest.approx(
        0.5 * inertia * speed**2, rel=0.03
    )  # implicit Euler's velocity lags
    kept = energy["kinetic"] + energy["bending"] + energy["stretching"]
    assert energy["supports_work"] == pytest.approx(
        kept + energy["damping_dissipated"] + energy["scheme_dissipated"], rel=1e-6
    )
    assert 0.0 < energy["damping_dissipated"] + energy["scheme_dissipated"] < 0.05 * kept


def test_modes_have_no_rotating_clamps():
    scene = shell(np.eye(3), scene={"task": "modes"})
    scene["fix"] = [
        {"select": {"box": [[-1, -1, -1], [1e-6, 1, 1]]}, "clamp": True, "move": {"rotation": [0, 0.1, 0]}}
    ]
    with pytest.raises(InputError, match=r"fix\.0\.move\.rotation: allowed with task = statics or dynamics"):
        voile.run(scene)
