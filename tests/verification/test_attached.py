"""Springs, elastic foundations, bands, ties and masses against closed forms."""

from pathlib import Path

import numpy as np
import pytest
from commands import run
from scipy.linalg import eigh
from scipy.optimize import brentq

import voile
from voile.cli import main
from voile.errors import InputError
from voile.results import read_result, read_summary
from voile.validate.shells import mapped

YOUNG, THICKNESS, LENGTH, WIDTH, GRAVITY = 1e8, 1e-3, 0.4, 0.04, 9.81
HEAD = f"""[shell]
mesh = "mesh.obj"
young = {YOUNG}
poisson = 0.0
thickness = {THICKNESS}
density = 300.0
[loads]
gravity = [0.0, 0.0, 0.0]
"""
MASS = 300.0 * THICKNESS * LENGTH * WIDTH
ALL = "{ all = true }"
LEFT = "{ box = [[-1, -1, -1], [0.001, 1, 1]] }"
RIGHT = "{ box = [[0.399, -1, -1], [1, 1, 1]] }"


def table(name: str, select: str, **keys) -> str:
    lines = [f"{key} = {value!r}" for key, value in keys.items()]
    return "\n".join([f"[[{name}]]", f"select = {select}", *lines]).replace("True", "true") + "\n"


def write(folder: Path, text: str, nx: int = 20, ny: int = 2) -> str:
    """A scene of a strip along x; its path."""
    u, v, triangles, _ = mapped(nx, ny, "crossed")
    lines = [f"v {LENGTH * x!r} {WIDTH * (y - 0.5)!r} 0" for x, y in zip(u.tolist(), v.tolist(), strict=True)]
    lines += ["f " + " ".join(map(str, t)) for t in triangles + 1]
    (folder / "mesh.obj").write_text("\n".join(lines) + "\n")
    (folder / "scene.toml").write_text(text)
    return str(folder / "scene.toml")


def summary(folder: Path) -> dict:
    return read_summary(folder / "out" / "summary.json")


def test_a_sheet_on_an_elastic_foundation_sinks_evenly(tmp_path):
    """p/k, exactly; the foundation holds the sheet alone."""
    text = HEAD.replace("0.0, 0.0, 0.0", f"0.0, 0.0, -{GRAVITY}")
    result = run(tmp_path, write(tmp_path, text + table("spring", ALL, stiffness=5000.0, per="area")))
    sunk = result.points() - result.start
    np.testing.assert_allclose(sunk[:, 2], -300.0 * THICKNESS * GRAVITY / 5000.0, rtol=1e-9)
    energy = summary(tmp_path)["energy"]
    assert energy["springs"] == pytest.approx(-0.5 * energy["gravity"], rel=1e-9)
    assert energy["gravity"] == pytest.approx(-MASS * GRAVITY * -sunk[0, 2] * -1.0 * -1.0, rel=1e-9)


def test_a_beam_on_an_elastic_foundation_under_a_line_load(tmp_path):
    """Hetenyi 1946: w0 = q b/(2 k), b = (k/(4 D))^(1/4), of an infinite strip; this one is 15/b long."""
    flexural, foundation, load = YOUNG * THICKNESS**3 / 12.0, 6e4, 1e-3
    b = (foundation / (4.0 * flexural)) ** 0.25
    exact, errors = load * b / (2.0 * foundation), []
    assert b * LENGTH > 14.0
    middle = "{ box = [[0.1999, -1, -1], [0.2001, 1, 1]] }"
    text = HEAD + table("spring", ALL, stiffness=foundation, per="area", axes="z")
    text += table("loads.force", middle, value=[0.0, 0.0, load], per="length")
    text += table("fix", LEFT, axes="xy")
    for n in (20, 40, 80):
        result = run(
            tmp_path, write(tmp_path, text, n, n // 10), "shell.bending=tan", "statics.tolerance=1e-9"
        )
        at = np.abs(result.start[:, 0] - 0.2) < 1e-6
        errors.append(abs((result.points()[at, 2]).mean() / exact - 1.0))
    assert errors[2] < 6e-3 and errors[0] / errors[1] > 3.0 and errors[1] / errors[2] > 3.0


def test_a_spring_under_the_tip_of_a_cantilever(tmp_path):
    """The tip's force over the sum of both stiffnesses, 3 D w/L^3 and the spring's."""
    beam = 3.0 * YOUNG * THICKNESS**3 / 12.0 * WIDTH / LENGTH**3
    text = HEAD + table("fix", LEFT, clamp=True) + table("spring", RIGHT, stiffness=2.0 * beam, axes="z")
    text += table("loads.force", RIGHT, value=[0.0, 0.0, 1e-3 * beam])
    result = run(tmp_path, write(tmp_path, text, 40))
    tip = result.start[:, 0] > 0.399
    assert result.points()[tip, 2].mean() == pytest.approx(1e-3 / 3.0, rel=3e-3)


SLIDES = (
    table("fix", LEFT, axes="x")
    + table("fix", "{ box = [[-1, -1, -1], [0.001, -0.019, 1]] }")
    + table("fix", ALL, axes="z")
)
CORNER = "{ box = [[-1, -1, -1], [0.001, -0.019, 1]] }"
SIDES = ("{ box = [[-1, -1, -1], [1, -0.0199, 1]] }", "{ box = [[-1, 0.0199, -1], [1, 1, 1]] }")


def test_bands_along_edges_share_the_pull(tmp_path):
    """(E h w + 2 EA) strain, with the band's own length and shorter ones: exact in the dead force."""
    band, pull = 300.0, 4.0
    for rest in (1.0, 0.9995):
        text = HEAD + SLIDES + "".join(table("band", side, stiffness=band, rest=rest) for side in SIDES)
        if rest == 1.0:
            text += table("loads.force", RIGHT, value=[pull, 0.0, 0.0])
        result = run(tmp_path, write(tmp_path, text), "shell.model=membrane", "statics.tolerance=1e-11")
        moved = (result.points() - result.start)[result.start[:, 0] > 0.399, 0].mean()

        def balance(strain, rest=rest):
            green = strain + 0.5 * strain**2
            inner = YOUNG * THICKNESS * WIDTH * green * (1.0 + strain) + 2.0 * band * (
                (1.0 + strain) / rest - 1.0
            )
            return inner - (pull if rest == 1.0 else 0.0)

        strain = brentq(balance, -0.01, 0.01, xtol=1e-15)
        # the ends of a band pull at two vertices: strain is even in the middle only, where the mean is taken
        middle = np.abs(result.start[:, 0] - np.array([[0.1], [0.3]])) < 1e-6
        x = result.points()[:, 0]
        assert (x[middle[1]].mean() - x[middle[0]].mean()) / 0.2 - 1.0 == pytest.approx(strain, rel=5e-3)
        assert np.sign(moved) == np.sign(strain)


def test_ties_hang_a_sheet_on_its_neighbour(tmp_path, run_on):
    """Two sheets, the lower on two bars: each carries half its weight over its stiffness, on any number of ranks."""
    u, v, triangles, _ = mapped(4, 4, "crossed")
    upper = np.column_stack([0.1 * u, 0.0 * u, 0.1 * v])
    lower = upper - [0.0, 0.0, 0.15]
    n = len(u)
    lines = ["v {} {} {}".format(*p) for p in np.concatenate([upper, lower]).tolist()]
    lines += ["f " + " ".join(map(str, t)) for t in np.concatenate([triangles, triangles + n]) + 1]
    (tmp_path / "mesh.obj").write_text("\n".join(lines) + "\n")
    corners = [
        np.flatnonzero((upper[:, 0] == x) & (upper[:, 2] == z))[0] for z in (0.0, 0.1) for x in (0.0, 0.1)
    ]
    text = HEAD.replace("0.0, 0.0, 0.0", f"0.0, 0.0, -{GRAVITY}")
    text += table("fix", "{ box = [[-1, -1, 0.0], [1, 1, 1]] }")
    for k in range(2):
        text += f"[[tie]]\nnodes = [{corners[k]}, {n + corners[2 + k]}]\nstiffness = 40.0\n"
    text += table("mass", "{ box = [[-1, -1, -0.151], [1, 1, -0.149]] }", value=0.03, per="length")
    (tmp_path / "scene.toml").write_text(text)
    result = run(tmp_path, str(tmp_path / "scene.toml"), "shell.model=koiter", "statics.tolerance=1e-10")
    weight = (300.0 * THICKNESS * 0.01 + 0.03 * 0.1) * GRAVITY
    sunk = result.points()[n:][[corners[2], corners[3]], 2] - lower[[corners[2], corners[3]], 2]
    np.testing.assert_allclose(sunk, -weight / 80.0, rtol=1e-3)
    (held,) = summary(tmp_path)["supports"]
    both = weight + 300.0 * THICKNESS * 0.01 * GRAVITY
    assert held["force"][2] == pytest.approx(both, rel=1e-6)
    run_on(2, tmp_path / "scene.toml", tmp_path / "two")
    np.testing.assert_allclose(read_result(tmp_path / "two").points(), result.points(), atol=1e-6)


def test_a_sheet_on_springs_swings_with_its_mass(tmp_path):
    """Twice the mass by [[mass]]: omega = sqrt(k/m); the books close."""
    stiffness, omega = 2.0 * MASS * 400.0, 20.0
    text = HEAD.replace("[loads]", "velocity = [0.0, 0.0, 0.2]\n[loads]")
    text += table("spring", ALL, stiffness=stiffness) + table("mass", ALL, value=MASS)
    text = (
        "[scene]\ntask = 'dynamics'\n" + text + "[dynamics]\nscheme = 'generalized-alpha'\nduration = 0.1\n"
    )
    errors = []
    for step in (0.01, 0.005, 0.0025):
        result = run(
            tmp_path, write(tmp_path, text), f"dynamics.time_step={step}", "dynamics.tolerance=1e-10"
        )
        errors.append(np.abs(result.points()[:, 2] - 0.2 / omega * np.sin(omega * 0.1)).max() / (0.2 / omega))
        books = summary(tmp_path)["dynamics"]
        total = sum(books["energy"][name] for name in ("kinetic", "stretching", "bending", "springs"))
        lost = sum(value for name, value in books["energy"].items() if name.endswith("_dissipated"))
        assert total + lost == pytest.approx(0.5 * 2.0 * MASS * 0.04, rel=1e-7)
    assert errors[2] < 5e-3 and errors[0] / errors[1] > 3.5 and errors[1] / errors[2] > 3.5


def test_what_is_attached_vibrates_with_the_shell():
    """A cantilever on a foundation, omega^2 = own + k/m; one with its own mass at the tip; a sheet that hangs on two
    bars, which are taut by its weight: sqrt(g/l) along it, a compound pendulum's across."""
    u, v, triangles, _ = mapped(20, 2, "crossed")
    strip = np.column_stack([LENGTH * u, WIDTH * v, 0.0 * u])
    shell = {
        "mesh": (strip, triangles),
        "young": YOUNG,
        "poisson": 0.0,
        "thickness": THICKNESS,
        "density": 300.0,
    }
    ends = {x: {"nodes": np.flatnonzero(strip[:, 0] == x).tolist()} for x in (0.0, LENGTH)}
    held = [{"select": ends[0.0], "clamp": True}, {"select": {"all": True}, "axes": "xy"}]
    spring = {"select": {"all": True}, "stiffness": 60.0, "per": "area", "axes": "z"}
    tables = {"scene": {"task": "modes"}, "modes": {"count": 1}, "shell": shell, "fix": held}
    tables["loads"] = {"gravity": [0.0, 0.0, 0.0]}
    unit = YOUNG * THICKNESS**3 / 12.0 * WIDTH / (MASS * LENGTH**3)
    assert _omega({**tables, "spring": [spring]})[0] == pytest.approx(
        np.sqrt(1.8751**4 * unit + 60.0 / (300.0 * THICKNESS)), rel=1e-3
    )
    tip = {"select": ends[LENGTH], "value": MASS}
    assert _omega({**tables, "mass": [tip]})[0] == pytest.approx(1.2479**2 * np.sqrt(unit), rel=1e-3)
    u, v, triangles, _ = mapped(4, 4, "crossed")
    upper = np.column_stack([0.1 * u, 0.0 * u, 0.1 * v])
    two = np.concatenate([upper, upper - [0.0, 0.0, 0.5]])
    shell |= {"mesh": (two, np.concatenate([triangles, triangles + len(u)]))}
    tie = [
        {
            "nodes": [int(np.flatnonzero((two == [x, 0.0, z]).all(axis=1))[0]) for z in (0.0, -0.4)],
            "stiffness": 1e5,
        }
        for x in (0.0, 0.1)
    ]
    tables |= {
        "fix": [{"select": {"nodes": list(range(len(u)))}}],
        "loads": {"gravity": [0.0, 0.0, -GRAVITY]},
    }
    tables |= {"tie": tie, "modes": {"count": 2}}
    swing = eigh(GRAVITY * np.diag([0.4, 0.05]), [[0.16, 0.02], [0.02, 0.01 / 3]], eigvals_only=True)
    assert _omega(tables) == pytest.approx([np.sqrt(swing[0]), np.sqrt(GRAVITY / 0.4)], rel=2e-3)
    with pytest.raises(InputError, match="tie: allowed with modes.buckling = false"):
        _omega({**tables, "modes": {"buckling": True}})


def _omega(tables: dict) -> np.ndarray:
    return 2.0 * np.pi * np.array(voile.run(tables).summary["modes"]["frequencies"])


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        (table("spring", ALL, stiffness=-1.0), "spring.0.stiffness: -1.0 is not allowed"),
        (table("spring", RIGHT, stiffness=1.0, per="area"), 'spring.0.per = "area": vertex'),
        (
            table("spring", ALL, stiffness=1.0, per="area", share="length"),
            'spring.0.share: "length"; allowed with per',
        ),
        (table("band", "{ nodes = [3] }", stiffness=1.0), "band.0.select: no edge has both ends selected"),
        ("[[tie]]\nnodes = [3, 3]\nstiffness = 1.0\n", "tie.0.nodes: vertex 3 twice"),
        ("[[tie]]\nnodes = [3, 3000]\nstiffness = 1.0\n", "tie.0.nodes.nodes: vertex 3000, allowed: 0 to"),
        ("[[tie]]\nnodes = [3]\nstiffness = 1.0\n", "tie.0.nodes: [3] has length 1"),
        (table("mass", ALL, value=0.0), "mass.0.value: 0.0 is not allowed"),
        (
            "[scene]\ntask = 'inverse'\n" + table("spring", ALL, stiffness=1.0),
            "spring: allowed with task = statics or",
        ),
        (
            "[scene]\ntask = 'dynamics'\n[dynamics]\nsolver = 'local-global'\n"
            + table("spring", ALL, stiffness=1.0),
            'spring: allowed with dynamics.solver = "newton"',
        ),
    ],
)
def test_bad_tables_are_refused(tmp_path, capsys, lines, message):
    text = HEAD + lines + table("fix", LEFT, clamp=True)
    if "local-global" in lines:
        text = text.replace("poisson", "model = 'projective'\npoisson")
    assert main(["run", write(tmp_path, text, 4, 1), "-o", str(tmp_path / "out")]) == 2
    assert message in capsys.readouterr().err


def test_a_free_sheet_shrinks_as_a_whole(tmp_path):
    text = (
        HEAD.replace("[loads]", "shrink = 0.02\n[loads]")
        + table("fix", CORNER)
        + table("fix", LEFT, axes="xz")
    )
    result = run(tmp_path, write(tmp_path, text + table("spring", ALL, stiffness=1e-3, axes="z")))
    np.testing.assert_allclose(np.ptp(result.points(), axis=0)[:2], [0.98 * LENGTH, 0.98 * WIDTH], rtol=1e-9)
    assert summary(tmp_path)["energy"]["stretching"] < 1e-12


@pytest.mark.parametrize("shrink", [0.01, 0.03])
def test_held_strips_pull_as_they_shrink(tmp_path, shrink):
    """Ends held 0.4 m apart: the pull of Green's strain over the shrunk width. Where the halves shrink by different
    shares their widths meet only by shear, near their border."""
    u, _, triangles, _ = mapped(20, 2, "crossed")
    text = HEAD.replace("[loads]", "shrink = 0.01\nmodel = 'membrane'\n[loads]")
    text += table("fix", RIGHT, axes="x") + SLIDES + f"[[fabric]]\ngroup = 'b'\nshrink = {shrink}\n"
    scene = write(tmp_path, text)
    lines = [line for line in (tmp_path / "mesh.obj").read_text().splitlines() if line.startswith("v")]
    left = u[triangles].mean(axis=1) < 0.5
    for name, mine in (("a", left), ("b", ~left)):
        lines += [f"g {name}"] + ["f " + " ".join(map(str, t)) for t in triangles[mine] + 1]
    (tmp_path / "mesh.obj").write_text("\n".join(lines) + "\n")
    result = run(tmp_path, scene, "statics.tolerance=1e-11", "loads.gravity=[0,0,-1]")
    one, other = 0.99, 1.0 - shrink

    def pull(stretch):  # over the width at rest
        return YOUNG * THICKNESS * WIDTH * 0.5 * (stretch**2 - 1.0) * stretch

    middle = brentq(
        lambda x: one * pull(5.0 * x / one) - other * pull(5.0 * (0.4 - x) / other), 0.15, 0.25, xtol=1e-15
    )
    exact = shrink == 0.01
    at = np.abs(result.start[:, 0] - 0.2) < 1e-9
    assert result.points()[at, 0].mean() == pytest.approx(middle, rel=1e-9 if exact else 2e-3)
    end = summary(tmp_path)["supports"][0]
    assert end["force"][0] == pytest.approx(one * pull(5.0 * middle / one), rel=1e-7 if exact else 3e-2)
    mass = -sum(each["force"][2] for each in summary(tmp_path)["supports"])
    assert abs(mass) == pytest.approx(MASS, rel=1e-9)  # shrinking loses none


@pytest.mark.parametrize(
    ("sets", "message"),
    [
        (["shell.shrink=1"], "shell.shrink: 1 is not allowed"),
        (["shell.shrink=0.1", "scene.task=inverse"], "shell.shrink: allowed with task = inverse: 0"),
    ],
)
def test_bad_shrinks_are_refused(tmp_path, capsys, sets, message):
    scene = write(tmp_path, HEAD + table("fix", LEFT, clamp=True), 4, 1)
    options = [word for each in sets for word in ("--set", each)]
    assert main(["run", scene, "-o", str(tmp_path / "out"), *options]) == 2
    assert message in capsys.readouterr().err
