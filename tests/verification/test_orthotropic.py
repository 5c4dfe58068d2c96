"""Woven fabrics: isotropy as a special case, invariance, strips pulled and bent along warp, bias and weft."""

from pathlib import Path

import numpy as np
import pytest
from commands import run
from kernel_shell import irregular_mesh

from voile.arrays import area_vectors
from voile.cli import main
from voile.elastic import evaluate
from voile.elastic.weave import Woven, isotropic, warp_directions, weave_rows
from voile.errors import InputError
from voile.mesh import build_topology, read_mesh, texture_direction
from voile.mesh.surface import read_rest
from voile.problem.levels import coarsen
from voile.results import read_result, read_summary
from voile.scene.library import MEASURED, fabric
from voile.scene.reader import read_scene
from voile.validate.shells import mapped
from voile.wiring import build_model

YOUNG, WEFT, SHEAR, POISSON, THICKNESS = 1e8, 3e7, 8e6, 0.25, 1e-3
WOVEN = f"""[shell]
mesh = "mesh.obj"
material = "orthotropic"
young = {YOUNG}
young_weft = {WEFT}
shear = {SHEAR}
poisson = {POISSON}
thickness = {THICKNESS}
density = 300.0
warp = [1, 0, 0]
[loads]
gravity = [0.0, 0.0, 0.0]
"""
LENGTH, WIDTH = 0.4, 0.04
CLAMP = "[[fix]]\nselect = { box = [[-1, -1, -1], [0.001, 1, 1]] }\nclamp = true\n"


def woven(angle: float) -> str:
    """The scene with its warp at an angle to x."""
    return WOVEN.replace("[1, 0, 0]", f"[{float(np.cos(angle))!r}, {float(np.sin(angle))!r}, 0.0]")


def write(folder: Path, lines: str, nx: int = 20, ny: int = 2, texture: str = "") -> str:
    """A scene of a strip along x; its path. texture: coordinates per vertex, as OBJ lines of x and y."""
    u, v, triangles, _ = mapped(nx, ny, "crossed")
    text = [f"v {LENGTH * x!r} {WIDTH * (y - 0.5)!r} 0" for x, y in zip(u.tolist(), v.tolist(), strict=True)]
    if texture:
        text += [texture.format(x=x, y=y) for x, y in zip(u.tolist(), v.tolist(), strict=True)]
    corner = "{0}/{0}" if texture else "{0}"
    text += ["f " + " ".join(corner.format(k) for k in t) for t in triangles + 1]
    (folder / "mesh.obj").write_text("\n".join(text) + "\n")
    (folder / "scene.toml").write_text(lines)
    return str(folder / "scene.toml")


def random_state():
    rest, triangles = irregular_mesh(3)
    rng = np.random.default_rng(4)
    current = rest * [1.1, 0.95, 1.0] + 0.02 * rng.normal(size=rest.shape)
    m = len(triangles)
    values = {
        "thickness": 0.1 * (1 + rng.random(m)),
        "young": 1 + rng.random(m),
        "poisson": 0.4 * rng.random(m),
    }
    return rest, current, triangles, values, rng


@pytest.mark.parametrize("bending", ["average", "sin", "tan", "theta"])
@pytest.mark.parametrize("own", [False, True], ids=["by thickness", "own bending"])
def test_an_isotropic_fabric_is_isotropic_whatever_its_warp(bending, own):
    rest, current, triangles, values, rng = random_state()
    warp = rng.normal(size=(len(triangles), 3))
    woven = isotropic(len(triangles))
    if own:
        strip = values["young"] * values["thickness"] ** 3 / 12.0
        woven = Woven(woven.young_weft, woven.shear, strip, strip, strip / (2.0 + 2.0 * values["poisson"]))
    weave = weave_rows(rest, triangles, warp, **values, woven=woven)
    options = {"bending": bending, "hessian": True, "mixed": True, **values}
    one = evaluate(rest, current, triangles, **options)
    other = evaluate(rest, current, triangles, material="orthotropic", weave=weave, **options)
    for name in ("energy", "stretching_energy", "bending_energy"):
        assert getattr(one, name) == pytest.approx(getattr(other, name), rel=1e-13)
    for name in ("gradient", "edge_gradient", "hessian", "mixed"):
        mine, its = getattr(one, name), getattr(other, name)
        assert abs(mine - its).max() <= 3e-13 * abs(mine).max()


def test_turning_shape_rest_and_warp_together_changes_nothing():
    rest, current, triangles, values, rng = random_state()
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    turn *= np.linalg.det(turn)
    warp = rng.normal(size=(len(triangles), 3))
    ones = np.ones(len(triangles))
    woven = Woven(0.3 * ones, 0.2 * ones, 1e-4 * ones, 3e-5 * ones, 2e-5 * ones)
    found = []
    for q in (np.eye(3), turn):
        weave = weave_rows(rest @ q.T, triangles, warp @ q.T, **values, woven=woven)
        e = evaluate(rest @ q.T, current @ turn, triangles, **values, material="orthotropic", weave=weave)
        found.append((e.energy, e.gradient))
    assert found[0][0] == pytest.approx(found[1][0], rel=1e-13)
    assert np.abs(found[0][1] - found[1][1]).max() < 1e-12 * np.abs(found[0][1]).max()


def modulus(angle: float, along: float, across: float, twist: float, poisson: float) -> float:
    """Young's modulus at an angle to the warp (Jones 1999, 2.97), or the bending stiffness of a strip there."""
    c, s = np.cos(angle) ** 2, np.sin(angle) ** 2
    return 1.0 / (c * c / along + s * s / across + c * s * (1.0 / twist - 2.0 * poisson / along))


@pytest.mark.parametrize("degrees", [0, 30, 45, 90])
def test_pulled_strips_have_the_modulus_of_their_angle(tmp_path, degrees):
    """Free to contract and to shear: uniform stress, exact but for the second order in a strain of 1e-7."""
    angle = np.radians(degrees)
    exact = modulus(angle, YOUNG, WEFT, SHEAR, POISSON)
    pull = float(1e-7 * exact * THICKNESS * WIDTH)
    ends = "[[loads.force]]\nselect = {{ box = [[{0}, -1, -1], [{1}, 1, 1]] }}\nvalue = [{2!r}, 0.0, 0.0]\n"
    holds = "[[fix]]\nselect = {{ box = [[{0}, -1, -1], [{1}, {2}, 1]] }}\naxes = '{3}'\n"
    scene = woven(angle).replace("young =", "model = 'membrane'\nyoung =", 1)
    scene += ends.format(-1, 0.001, -pull) + ends.format(0.399, 1, pull)
    scene += holds.format(-1, 0.001, -0.019, "xy") + holds.format(-1, 0.001, 1, "x")
    scene += "[[fix]]\nselect = { all = true }\naxes = 'z'\n"
    scene += "[output]\nfields = ['membrane_force', 'fabric_strain']\n[statics]\nload_steps = 1\ntolerance = 1e-11\n"
    result = run(tmp_path, write(tmp_path, scene))
    moved = result.points() - result.start
    right = result.start[:, 0] > 0.399
    np.testing.assert_allclose(moved[right, 0] / LENGTH, 1e-7, rtol=1e-5)
    stress = pull / WIDTH
    np.testing.assert_allclose(result.field("membrane_force")[:, 0], stress, rtol=1e-5)
    warp, weft, shear = result.field("fabric_strain").T
    pulled = 1e-7 * exact  # Pa, along x: its parts along the axes
    cc, ss, cs = np.cos(angle) ** 2, np.sin(angle) ** 2, np.cos(angle) * np.sin(angle)
    np.testing.assert_allclose(warp, pulled * (cc - POISSON * ss) / YOUNG, atol=1e-12)
    np.testing.assert_allclose(weft, pulled * (ss / WEFT - POISSON * cc / YOUNG), atol=1e-12)
    np.testing.assert_allclose(np.abs(shear), pulled * cs / SHEAR, atol=1e-12)


STRIPS = (2e-3, 5e-4, 4e-4)  # N m: bending along warp and weft, twist


def deflection(folder: Path, degrees: float, nx: int, ny: int = 2) -> float:
    """Of the tip of a strip under an end moment, over M L^2 / 2 B."""
    angle = np.radians(degrees)
    mean = POISSON * np.sqrt(WEFT / YOUNG)
    warp, weft, twist = STRIPS
    stiffness = modulus(angle, warp, weft, twist, mean * np.sqrt(warp / weft))
    moment = float(1e-3 * stiffness * WIDTH / LENGTH)
    scene = woven(angle)
    keys = f"bending_warp = {warp}\nbending_weft = {weft}\nbending_twist = {twist}\n"
    scene = scene.replace("density", keys + "density")
    scene += f"[[loads.moment]]\nselect = {{ box = [[0.399, -1, -1], [1, 1, 1]] }}\nvalue = {moment!r}\n"
    scene += CLAMP
    result = run(folder, write(folder, scene, nx, ny), "statics.load_steps=1")
    tip = result.start[:, 0] > 0.399
    return np.abs(result.points()[tip, 2].mean()) / (0.5 * moment / WIDTH * LENGTH**2 / stiffness)


@pytest.mark.parametrize("degrees", [0, 45, 90])
def test_bent_strips_have_the_stiffness_of_their_angle(tmp_path, degrees):
    """Whatever the thickness. The clamp holds contraction and twist at one end, over about a width of ten."""
    assert deflection(tmp_path, degrees, 40, 4) == pytest.approx(1.0, abs=0.025 if degrees == 45 else 0.005)


def test_bending_converges(tmp_path):
    """Without contraction the strip bends to an arc: M/B of the curvature, second order in the cells."""
    errors = []
    for n in (5, 10, 20):
        scene = WOVEN.replace(f"poisson = {POISSON}", f"poisson = 0.0\nbending_warp = {STRIPS[0]}")
        moment = STRIPS[0] * WIDTH / LENGTH
        scene += f"[[loads.moment]]\nselect = {{ box = [[0.399, -1, -1], [1, 1, 1]] }}\nvalue = {moment!r}\n"
        scene += CLAMP
        result = run(tmp_path, write(tmp_path, scene, n, 1), "shell.young=1e6", "shell.young_weft=1e6")

        tip = result.points()[result.start[:, 0] > 0.399].mean(axis=0)
        exact = LENGTH * np.array([np.sin(1.0), 1.0 - np.cos(1.0)])
        errors.append(np.hypot(tip[0] - exact[0], abs(tip[2]) - exact[1]) / LENGTH)
    assert errors[2] < 2e-3 and errors[0] / errors[1] > 3.0 and errors[1] / errors[2] > 3.0


HUNG = WOVEN.replace("[0.0, 0.0, 0.0]", "[0.0, 0.0, -2.0]") + CLAMP


def test_ranks_levels_time_and_inverse_design_take_the_weave(tmp_path, run_on):
    scene = write(tmp_path, HUNG.replace("[1, 0, 0]", "[1, 1, 0]"), 30, 3)
    tip = run(tmp_path, scene).points()
    assert np.ptp(tip[-4:, 2]) > 0.02 * WIDTH  # the bias twists
    run_on(2, Path(scene), tmp_path / "two")
    np.testing.assert_allclose(read_result(tmp_path / "two").points(), tip, atol=1e-7)
    run(tmp_path, scene, "scene.task=dynamics", "dynamics.duration=0.02")
    surface = read_mesh(tmp_path / "mesh.obj")
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in tip.tolist()]
    lines += ["f " + " ".join(str(k + 1) for k in t) for t in surface.triangles.tolist()]
    (tmp_path / "mesh.obj").write_text("\n".join(lines) + "\n")
    run(tmp_path, scene, "scene.task=inverse")
    summary = read_summary(tmp_path / "out" / "summary.json")
    assert summary["converged"] and summary["inverse"]["sag"] < 1e-6


def test_coarser_levels_keep_the_warp(tmp_path):
    """Two fabrics whose warps stand across each other, on a fine mesh and the next coarser one."""
    u, v, triangles, _ = mapped(24, 24, "crossed")
    lines = [f"v {0.3 * x!r} {0.3 * y!r} 0" for x, y in zip(u.tolist(), v.tolist(), strict=True)]
    middle = u[triangles].mean(axis=1)
    for name, mine in (("a", middle < 0.5), ("b", middle > 0.5)):
        lines += [f"g {name}"] + ["f " + " ".join(map(str, t)) for t in triangles[mine] + 1]
    (tmp_path / "mesh.obj").write_text("\n".join(lines) + "\n")
    text = HUNG + "[[fabric]]\ngroup = 'b'\nwarp = [0, 1, 0]\nbending_warp = 1e-3\n"
    (tmp_path / "scene.toml").write_text(text)
    fine = build_model(read_scene(tmp_path / "scene.toml")).shell
    coarse, _ = coarsen(fine)
    assert len(coarse.triangles) < 0.5 * len(fine.triangles)
    for shell in (fine, coarse):
        warp = warp_directions(shell.rest_points, shell.rest_triangles, shell.weave)
        left = shell.rest_points[shell.rest_triangles, 0].mean(axis=1) < 0.15
        np.testing.assert_allclose(warp[left], [[1.0, 0.0, 0.0]] * left.sum(), atol=1e-12)
        np.testing.assert_allclose(warp[~left], [[0.0, 1.0, 0.0]] * (~left).sum(), atol=1e-12)
        assert (shell.weave[left, 4] == 0.0).all() and (shell.weave[~left, 4] == 1.0).all()
    run(tmp_path, str(tmp_path / "scene.toml"), "loads.gravity=[0, 0, -9.81]", "statics.load_steps=1")


def test_texture_coordinates_give_the_warp(tmp_path):
    """The pattern lies turned by 30 degrees: v of the texture runs at 120 degrees to x."""
    c, s = float(np.cos(np.pi / 6)), float(np.sin(np.pi / 6))
    texture = "vt {x!r} {y!r}"
    scene = write(tmp_path, WOVEN.replace("warp = [1, 0, 0]\n", ""), 4, 2, texture)
    text = (tmp_path / "mesh.obj").read_text().splitlines()
    turned = []
    for line in text:
        if line.startswith("vt"):
            x, y = map(float, line.split()[1:])
            x, y = LENGTH * x, WIDTH * y
            line = f"vt {c * x + s * y!r} {-s * x + c * y!r}"
        turned.append(line)
    (tmp_path / "mesh.obj").write_text("\n".join(turned) + "\n")
    surface = read_mesh(tmp_path / "mesh.obj")
    along = texture_direction(read_rest(None, surface, tmp_path), surface, "v", "shell.warp")
    np.testing.assert_allclose(along, [[-s, c, 0.0]] * len(along), atol=1e-12)
    (tmp_path / "scene.toml").write_text(Path(scene).read_text() + CLAMP)
    given = build_model(read_scene(scene)).shell.weave
    named = build_model(read_scene(scene, [f"shell.warp=[{-s}, {c}, 0]"])).shell.weave
    np.testing.assert_allclose(given, named, atol=1e-12)


@pytest.mark.parametrize("name", MEASURED)
def test_the_librarys_fabrics_are_what_was_measured(tmp_path, name):
    """Back from the keys to the measured stiffnesses, by another way."""
    mass, (weft, coupling, warp, _), (bend_warp, bias, bend_weft) = MEASURED[name]
    keys = fabric(name)
    h = keys["thickness"]
    compliance = np.linalg.inv([[warp, coupling], [coupling, weft]])
    assert keys["young"] * h == pytest.approx(1.0 / compliance[0, 0])
    assert keys["young_weft"] * h == pytest.approx(1.0 / compliance[1, 1])
    assert keys["poisson"] == pytest.approx(-compliance[0, 1] / compliance[0, 0])
    assert keys["density"] * h == pytest.approx(mass)
    mean = keys["poisson"] * np.sqrt(keys["young_weft"] / keys["young"])
    found = modulus(
        np.pi / 4, bend_warp, bend_weft, keys["bending_twist"], mean * np.sqrt(bend_warp / bend_weft)
    )
    assert found == pytest.approx(bias) and keys["bending_warp"] == bend_warp
    text = f'[shell]\nmesh = "mesh.obj"\nfabric = "{name}"\nwarp = [0, 1, 0]\nthickness = 2e-3\n'
    scene = read_scene(write(tmp_path, text + "[[fix]]\nselect = { nodes = [0, 1, 2] }\n"))
    assert scene.shell.material == "orthotropic" and scene.shell.young == keys["young"]
    assert scene.shell.thickness == 2e-3
    assert np.isfinite(build_model(scene).shell.weave).all()


@pytest.mark.parametrize(
    "name, mass, bending",
    [("wool", 16.29, 0.067), ("cotton", 12.38, 0.118), ("polyester-faille", 10.43, 0.019)],
)
def test_wool_has_the_bending_that_was_measured_and_no_moduli(tmp_path, name, mass, bending):
    """Their source: mass in mg/cm^2, bending in gf cm^2/cm; 1 gf is 9.80665e-3 N."""
    text = f'[shell]\nmesh = "mesh.obj"\nfabric = "{name}"\nwarp = [0, 1, 0]\n'
    rest = "[[fix]]\nselect = { nodes = [0, 1, 2] }\n"
    scene = read_scene(write(tmp_path, text + "young = 2e6\n" + rest)).shell
    assert scene.material == "orthotropic" and scene.young == 2e6
    assert scene.density * scene.thickness == pytest.approx(0.01 * mass)
    assert scene.bending_warp == scene.bending_weft == pytest.approx(bending * 9.80665e-3 * 1e-2)
    with pytest.raises(InputError, match='"young" is missing'):
        read_scene(write(tmp_path, text + rest))


def test_the_sources_hinges_bend_as_the_plate_of_a_quarter_of_their_stiffness():
    """A grid on a cylinder of curvature 1/R: sum over hinges of k l^2 theta^2 / (8 a) against area B / (2 R^2)."""
    u, v, triangles, _ = mapped(20, 8, "right")
    radius, x = 0.3, np.column_stack([u, 0.4 * v, 0.0 * u])
    bent = np.column_stack([radius * np.sin(u / radius), 0.4 * v, radius * np.cos(u / radius)])
    top = build_topology(triangles)
    half = np.flatnonzero(top.across.ravel() > np.arange(top.across.size))
    other = top.across.ravel()[half]
    n, area = area_vectors(bent, triangles), np.linalg.norm(area_vectors(x, triangles), axis=1) / 2.0
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    theta = np.arccos(np.clip(np.einsum("ti,ti->t", n[half // 3], n[other // 3]), -1.0, 1.0))
    i, j = top.edges[top.triangle_edges.ravel()[half]].T
    length = np.linalg.norm(x[j] - x[i], axis=1)
    hinges = (length**2 * theta**2 / (8.0 * (area[half // 3] + area[other // 3]))).sum()  # k = 1
    assert hinges == pytest.approx(area.sum() * 0.25 / (2.0 * radius**2), rel=0.06)  # no hinge on the border
    assert MEASURED["cotton-polyester"][2][0] == pytest.approx(125.409805e-6 / 4.0)


@pytest.mark.parametrize(
    ("sets", "message"),
    [
        (["shell.material=stvk"], 'shell.young_weft: allowed with shell.material = "orthotropic"'),
        (
            ["shell.model=discrete-shells"],
            'shell.material: "orthotropic" fits shell.model = "koiter" or "membrane"',
        ),
        (
            ["shell.poisson=0.45", "shell.young_weft=1e9"],
            "allowed: under 0.3162, the root of young over young_weft",
        ),
        (["shell.warp=[0, 0, 1]"], "stands upright on rest triangle 0"),
        (["shell.warp=[0, 0, 0]"], "shell.warp: [0, 0, 0] is not allowed"),
        (["shell.warp=w"], 'shell.warp: \'w\' is not allowed; allowed: "u", "v"'),
        (["shell.warp=u"], 'shell.warp = "u": '),
        (["shell.shear=0"], "shell.shear: 0 is not allowed"),
        (["shell.bending_twist=-1"], "shell.bending_twist: -1 is not allowed"),
        (
            ["shell.fabric=tweed"],
            'shell.fabric: no fabric "tweed" in the library; allowed: denim, cotton-polyester',
        ),
    ],
)
def test_bad_fabrics_are_refused(tmp_path, capsys, sets, message):
    scene = write(tmp_path, HUNG, 4, 1)
    options = [word for each in sets for word in ("--set", each)]
    assert main(["run", scene, "-o", str(tmp_path / "out"), *options]) == 2
    assert message in capsys.readouterr().err
