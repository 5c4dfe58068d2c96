"""Forces, moments, stresses in result files against closed forms: tension, a cylinder under pressure, a bent strip."""

from pathlib import Path

import numpy as np
import pytest
from lo_roof import OPENING, RADIUS, roof

import voile
from voile.cli import main
from voile.elastic.stresses import FIELDS
from voile.results import CELL_FIELDS, read_result, read_summary
from voile.scene.tasks import Output
from voile.validate.shells import mapped

ALL = ["membrane_force", "bending_moment", "strain", "stress", "von_mises", "energy_density"]
YOUNG, POISSON, THICKNESS = 1e7, 0.3, 1e-3


def run(folder: Path, points, triangles, lines: str, *sets: str, fields=ALL, code: int = 0):
    """The result of a scene of one mesh without gravity."""
    text = [f"v {x!r} {y!r} {z!r}" for x, y, z in points.tolist()] + [
        "f {} {} {}".format(*t) for t in triangles + 1
    ]
    (folder / "mesh.obj").write_text("\n".join(text) + "\n")
    head = "[shell]\nmesh = 'mesh.obj'\ndensity = 300.0\n"
    head += f"young = {YOUNG}\npoisson = {POISSON}\nthickness = {THICKNESS}\n"
    lines = "[loads]\ngravity = [0.0, 0.0, 0.0]\n" + lines + f"\n[output]\nfields = {fields}\n"
    (folder / "scene.toml").write_text(head + lines)
    options = [word for each in sets for word in ("--set", each)]
    assert main(["run", str(folder / "scene.toml"), "-o", str(folder / "out"), *options]) == code
    return read_result(folder / "out") if code == 0 else None


def test_the_scene_names_what_the_program_knows():
    (kind,) = (f.metadata["kind"] for f in Output.__dataclass_fields__.values() if f.name == "fields")
    assert kind.item.values == tuple(FIELDS) and set(FIELDS) == {*ALL, "fabric_strain"}
    assert {name for names in FIELDS.values() for name in names} < set(CELL_FIELDS)


@pytest.mark.parametrize(
    "model", ["koiter/stvk", "koiter/neo-hookean", "koiter/tension-field", "membrane/stvk"]
)
def test_uniform_tension(tmp_path, model):
    """Force over the present width; Cauchy's stress is that over the rest thickness, as the model has it. Small strain:
    the second-order terms are 1e-3 of it."""
    u, v, triangles, _ = mapped(6, 3, "right")
    points = np.column_stack([0.2 * u, 0.1 * v, 0.0 * u])
    name, material = model.split("/")
    scene = """[[loads.force]]
select = { box = [[0.199, -1, -1], [1, 1, 1]] }
value = [0.5, 0.0, 0.0]
[[fix]]
select = { box = [[-1, -1, -1], [0.001, 1, 1]] }
axes = "x"
[[fix]]
select = { box = [[-1, -1, -1], [0.001, 0.001, 1]] }
[[fix]]
select = { all = true }
axes = "z"
"""
    fields = [f for f in ALL if f != "bending_moment"] if name == "membrane" else ALL
    sets = [f"shell.model={name}", f"shell.material={material}"]
    result = run(tmp_path, points, triangles, scene, *sets, fields=fields)
    width = np.ptp(result.points()[:, 1])
    assert 1.0 - width / 0.1 == pytest.approx(POISSON * 5e-4, rel=2e-3)
    force, exact = result.field("membrane_force"), 0.5 / width
    np.testing.assert_allclose(force[:, 0], exact, rtol=1e-6)
    np.testing.assert_allclose(force[:, 1:], 0.0, atol=1e-6 * exact)
    np.testing.assert_allclose(
        result.field("principal_membrane_force"), [[exact, 0.0]] * 36, atol=1e-6 * exact
    )
    for side in ("top", "bottom"):
        np.testing.assert_allclose(result.field(f"stress_{side}")[:, 0], exact / THICKNESS, rtol=1e-6)
    np.testing.assert_allclose(result.field("von_mises"), exact / THICKNESS, rtol=1e-6)
    np.testing.assert_allclose(result.field("principal_strain")[:, 0], 5e-4, rtol=2e-3)
    np.testing.assert_allclose(result.field("principal_strain")[:, 1], -POISSON * 5e-4, rtol=2e-3)
    stored = result.field("energy_density")
    np.testing.assert_allclose(stored, 0.5 * 5.0 * 5e-4, rtol=4e-3)
    assert (stored * 0.02 / 36).sum() == pytest.approx(result.scalars()["stretching"], rel=1e-9)
    np.testing.assert_array_equal(
        stored, result.field("stretching_density") + result.field("bending_density")
    )


def cylinder(around: int) -> tuple[np.ndarray, np.ndarray]:
    """Radius 0.1 m, two thirds of it long, about the z axis, normals outwards."""
    rows = around // 8
    i, j = np.meshgrid(np.arange(around), np.arange(rows + 1), indexing="ij")
    angle = 2.0 * np.pi * (i + 0.5 * j) / around
    points = np.stack([0.1 * np.cos(angle), 0.1 * np.sin(angle), 0.07 * j / rows], axis=2).reshape(-1, 3)
    k = (np.arange(around)[:, None] * (rows + 1) + np.arange(rows)).ravel()
    n = (k + rows + 1) % len(points)
    return points, np.concatenate([np.column_stack([k, n, k + 1]), np.column_stack([k + 1, n, n + 1])])


@pytest.mark.parametrize("model", ["koiter", "membrane", "discrete-shells"])
def test_cylinder_under_pressure(tmp_path, model):
    """Ends that slide: hoop force p r, axial force nu p r, with r the present radius; second order in the facets."""
    pressure, errors = 200.0, []
    for around in (16, 32, 64):
        points, triangles = cylinder(around)
        ends = "[[fix]]\nselect = { box = [[-1, -1, %g], [1, 1, %g]] }\naxes = 'z'\n"
        scene = "pressure = 200.0\n" + ends % (-1, 0.001) + ends % (0.069, 1)
        quarter = (len(points) // around) * np.array([0, around // 4, around // 2])
        for k, axis in zip(quarter, "yxy", strict=True):
            scene += f"[[fix]]\nselect = {{ nodes = {k} }}\naxes = '{axis}'\n"
        fields = ["membrane_force", "strain"] if model != "discrete-shells" else ["membrane_force"]
        result = run(tmp_path, points, triangles, scene, f"shell.model={model}", fields=fields)
        radius = np.hypot(*result.points()[:, :2].T)
        assert np.ptp(radius) < 1e-6  # no bending
        exact = pressure * radius.mean()
        hoop = result.field("principal_membrane_force")
        errors.append(np.abs(hoop[:, 0] / exact - 1.0).max())
        if model != "discrete-shells":  # whose Poisson's ratio is its mesh's
            assert np.abs(hoop[:, 1] / exact - POISSON).max() < 2.0 * errors[-1]
    rate = 2.5 if model == "discrete-shells" else 3.5
    assert errors[-1] < 2e-3 and errors[0] / errors[1] > rate and errors[1] / errors[2] > rate


def test_von_mises_at_vertices_of_crossed_diagonals(tmp_path):
    """A thin cylinder with closed ends: p r and p r/2. Where vertices of four and eight triangles alternate, pressure
    leaves shear of both signs in the triangles; what is recovered at vertices converges, away from the ends."""
    pressure, thickness, raw, smooth = 1.0, 1e-4, [], []
    for around in (24, 48):
        u, v, triangles, _ = mapped(around, around // 8, "crossed")
        places = np.column_stack([np.round(u % 1.0, 9), v])
        places, first, of = np.unique(places, axis=0, return_index=True, return_inverse=True)
        turn = 2.0 * np.pi * u[first]
        points = np.column_stack([0.1 * np.cos(turn), 0.1 * np.sin(turn), 0.07 * v[first]])
        scene = f"""pressure = {pressure}
[[loads.force]]
select = {{ nodes = {np.flatnonzero(v[first] == 1.0).tolist()} }}
value = [0.0, 0.0, {pressure * np.pi * 0.01}]
[[fix]]
select = {{ nodes = {np.flatnonzero(v[first] == 0.0).tolist()} }}
axes = "z"
"""
        for quarter, axis in zip((0.0, 0.25, 0.5), "yxy", strict=True):
            node = np.flatnonzero((v[first] == 0.0) & (u[first] == quarter))[0]
            scene += f"[[fix]]\nselect = {{ nodes = {node} }}\naxes = '{axis}'\n"
        sets = [f"shell.thickness={thickness}"]
        result = run(tmp_path, points, of.ravel()[triangles], scene, *sets, fields=["stress", "von_mises"])
        exact = np.sqrt(0.75) * pressure * np.hypot(*result.points()[:, :2].T).mean() / thickness
        inside = np.abs(v[first] - 0.5) < 0.35
        found = voile.read(tmp_path / "out").field("smooth_von_mises")[inside]
        raw.append(np.sqrt(np.mean((result.field("von_mises") / exact - 1.0) ** 2)))
        smooth.append(np.sqrt(np.mean((found / exact - 1.0) ** 2)))
    assert smooth[1] < 2e-3 and smooth[0] > 3.0 * smooth[1]
    assert raw[1] > 0.1


def annulus(rings: int) -> tuple[np.ndarray, np.ndarray]:
    """Radii 0.2 and 1 m in the plane z = 0, normals up."""
    around = 6 * rings
    i, j = np.meshgrid(np.arange(around), np.arange(rings + 1), indexing="ij")
    radius, angle = 0.2 + 0.8 * j / rings, 2.0 * np.pi * i / around
    points = np.stack([radius * np.cos(angle), radius * np.sin(angle), 0.0 * radius], axis=2).reshape(-1, 3)
    k = (np.arange(around)[:, None] * (rings + 1) + np.arange(rings)).ravel()
    n = (k + rings + 1) % len(points)
    return points, np.concatenate([np.column_stack([k, k + 1, n + 1]), np.column_stack([k, n + 1, n])])


def test_annular_plate_under_pressure(tmp_path):
    """Free inside, simply supported outside: w = q r^4/64 D + C1 + C2 ln r + C3 r^2 + C4 r^2 ln r gives both moments
    and the deflection of the inner rim; the supports carry the load."""
    pressure, errors = 1e-9, []
    plate = YOUNG * THICKNESS**3 / 12.0 / (1.0 - POISSON**2)

    def row(r, kind):
        log = np.log(r)
        if kind == "w":
            return np.array([1.0, log, r**2, r**2 * log, r**4 / 64.0])
        if kind == "shear":  # the slope of the Laplacian
            return np.array([0.0, 0.0, 0.0, 4.0 / r, r / 2.0])
        slope = np.array([0.0, 1.0 / r, 2.0 * r, r * (2.0 * log + 1.0), r**3 / 16.0])
        bend = np.array([0.0, -1.0 / r**2, 2.0, 2.0 * log + 3.0, 3.0 * r**2 / 16.0])
        return bend + POISSON * slope / r if kind == "radial" else POISSON * bend + slope / r

    rows = np.array([row(1.0, "w"), row(1.0, "radial"), row(0.2, "radial"), row(0.2, "shear")])
    c = np.append(np.linalg.solve(rows[:, :4], -rows[:, 4]), 1.0) * pressure / plate

    def moment_errors(places, six):
        """Rms over places (k, 3) of both moments' errors over the largest."""
        radius = np.linalg.norm(places, axis=1)
        out, tensor = places / radius[:, None], six[:, [[0, 3, 5], [3, 1, 4], [5, 4, 2]]]
        size, found = 0.0, []
        for kind, unit in (("radial", out), ("hoop", np.cross([0.0, 0.0, 1.0], out))):
            exact = -plate * np.array([row(r, kind) @ c for r in radius])
            found.append(np.einsum("tij,ti,tj->t", tensor, unit, unit) - exact)
            size = max(size, np.abs(exact).max())
        return np.sqrt(np.mean(np.square(found))) / size

    for rings in (8, 16):
        points, triangles = annulus(rings)
        outside, along = rings + (rings + 1) * np.arange(6 * rings), 6 * rings // 4 * (rings + 1) + rings
        scene = f"pressure = {pressure}\n[[fix]]\nselect = {{ nodes = {outside.tolist()} }}\naxes = 'z'\n"
        for node, axis in ((outside[0], "y"), (outside[3 * rings], "y"), (along, "x")):
            scene += f"[[fix]]\nselect = {{ nodes = {node} }}\naxes = '{axis}'\n"
        result = run(tmp_path, points, triangles, scene, fields=["bending_moment"])
        place = points[triangles].mean(axis=1)
        smooth = voile.read(tmp_path / "out").field("smooth_bending_moment")
        off = [
            moment_errors(places, six)
            for places, six in ((place, result.field("bending_moment")), (points, smooth))
        ]
        sunk = result.points()[: rings + 1, 2]
        errors.append([*off, abs(sunk[0] / (row(0.2, "w") @ c) - 1.0)])
    moments, smooth, deflections = np.transpose(errors)
    assert moments[1] < 0.02 and moments[0] > 1.7 * moments[1]  # constant in a triangle
    assert smooth[1] < 0.01 and smooth[0] > 3.0 * smooth[1]  # at the vertices, those of the rims too
    assert deflections[1] < 3e-3 and deflections[0] > 3.5 * deflections[1]
    table = read_summary(tmp_path / "out" / "summary.json")["supports"]
    assert sum(row["force"][2] for row in table) == pytest.approx(-pressure * np.pi * 0.96, rel=5e-3)


def test_strip_bent_to_an_arc(tmp_path):
    """An end moment bends a strip to an arc: moment M/w along, none across, stress 6 M/(w h^2) at the surfaces, tension
    on the outer one. Mean over the triangles, which have a clamp and free edges."""
    errors, moment = [], 2e-5
    for n in (10, 20, 40):
        u, v, triangles, _ = mapped(n, n // 5, "crossed")
        points = np.column_stack([0.2 * u, 0.04 * (v - 0.5), 0.0 * u])
        scene = f"""[[loads.moment]]
select = {{ box = [[0.199, -1, -1], [1, 1, 1]] }}
value = {moment}
[[fix]]
select = {{ box = [[-1, -1, -1], [0.001, 1, 1]] }}
axes = "xz"
clamp = true
[[fix]]
select = {{ box = [[-1, -0.001, -1], [0.001, 0.001, 1]] }}
"""
        result = run(tmp_path, points, triangles, scene, "shell.bending=tan", "shell.poisson=0")
        turned = result.points()[:, 2].max()
        assert abs(turned) > 1e-3
        along, across = result.field("principal_bending_moment").T
        bent = np.where(np.abs(along) > np.abs(across), along, across)
        other = along + across - bent
        exact = moment / 0.04
        sign = np.sign(bent.mean())
        errors.append(np.sqrt(np.mean((sign * bent / exact - 1.0) ** 2 + (other / exact) ** 2)))
        outer = result.field("stress_top" if sign > 0 else "stress_bottom")
        stress = np.trace(outer[:, [[0, 3, 5], [3, 1, 4], [5, 4, 2]]], axis1=1, axis2=2)
        assert stress.mean() == pytest.approx(6.0 * exact / THICKNESS**2, rel=0.02 * (10 / n) ** 2)
        assert result.field("von_mises").mean() == pytest.approx(
            6.0 * exact / THICKNESS**2, rel=0.02 * (10 / n) ** 2
        )

    assert errors[-1] < 1e-5 and errors[0] > 8.0 * errors[1] > 64.0 * errors[2]


def test_two_ranks_write_the_same_fields_in_time(tmp_path, run_on):
    u, v, triangles, _ = mapped(8, 4, "crossed")
    points = np.column_stack([0.2 * u, 0.1 * v, 0.0 * u])
    scene = """pressure = 5.0
[[fix]]
select = { box = [[-1, -1, -1], [0.001, 1, 1]] }
clamp = true
[dynamics]
time_step = 1e-2
duration = 0.05
"""
    sets = ["scene.task=dynamics", "dynamics.tolerance=1e-9"]
    one = run(tmp_path, points, triangles, scene, *sets)
    text = (tmp_path / "scene.toml").read_text().replace("[dynamics]\n", "[dynamics]\ntolerance = 1e-9\n")
    (tmp_path / "scene.toml").write_text("[scene]\ntask = 'dynamics'\n" + text)
    run_on(2, tmp_path / "scene.toml", tmp_path / "two")
    two = read_result(tmp_path / "two")
    assert one.n_steps == two.n_steps == 6
    for name in (name for field in ALL for name in FIELDS[field]):
        mine, other = one.field(name), two.field(name)
        np.testing.assert_allclose(mine, other, atol=1e-6 * np.abs(mine).max())
    assert not np.any(one.field("membrane_force", 0)) and np.any(one.field("membrane_force", 3))
    assert main(["info", str(tmp_path / "two")]) == 0
    assert main(["export", str(tmp_path / "two"), str(tmp_path / "two.vtu")]) == 0


@pytest.mark.parametrize(
    ("sets", "message"),
    [
        (["shell.model=membrane"], 'output.fields: "bending_moment": a membrane has none'),
        (["output.fields=['fabric_strain']"], '"fabric_strain": allowed with shell.material = "orthotropic"'),
        (["output.fields=['forces']"], "'forces' is not allowed; allowed: \"membrane_force\", "),
        (["scene.task=inverse"], "output.fields: allowed with task = statics or dynamics"),
    ],
)
def test_fields_that_there_are_not_are_refused(tmp_path, capsys, sets, message):
    u, v, triangles, _ = mapped(2, 1, "right")
    points = np.column_stack([u, v, 0.0 * u])
    fix = "[[fix]]\nselect = { nodes = [0, 1, 2] }\n"
    run(tmp_path, points, triangles, fix, *sets, code=2)
    assert message in capsys.readouterr().err


def test_pressure_by_group(tmp_path, capsys):
    """A cylinder's halves under 300 and 100 Pa: hoop force p r of each, but for the bending next to their border."""
    points, triangles = cylinder(64)
    ends = "[[fix]]\nselect = { box = [[-1, -1, %g], [1, 1, %g]] }\naxes = 'z'\n"
    quarter = (len(points) // 64) * np.array([0, 16, 32])
    scene = (
        "pressure = 100.0\n[[loads.patch]]\ngroup = 'low'\npressure = 200.0\n"
        + ends % (-1, 0.001)
        + ends % (0.069, 1)
    )
    scene += "".join(
        f"[[fix]]\nselect = {{ nodes = {k} }}\naxes = '{axis}'\n"
        for k, axis in zip(quarter, "yxy", strict=True)
    )
    height = points[triangles, 2].mean(axis=1)
    order = np.argsort(height > 0.035, kind="stable")
    triangles = triangles[order]
    height = height[order]

    def run_groups(*sets: str, code: int = 0):
        lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in points.tolist()]
        for name, mine in (("low", height < 0.035), ("high", height > 0.035)):
            lines += [f"g {name}"] + ["f {} {} {}".format(*t) for t in triangles[mine] + 1]
        run(
            tmp_path, points, triangles, scene, "loads.patch=[]", fields=["membrane_force"]
        )  # writes the scene
        (tmp_path / "mesh.obj").write_text("\n".join(lines) + "\n")
        options = [word for each in sets for word in ("--set", each)]
        assert main(["run", str(tmp_path / "scene.toml"), "-o", str(tmp_path / "out"), *options]) == code
        return read_result(tmp_path / "out") if code == 0 else None

    result = run_groups("shell.bending=average")
    radius = np.hypot(*result.points()[:, :2].T)[triangles].mean(axis=1)
    hoop = result.field("principal_membrane_force")[:, 0]
    for pressure, far in ((300.0, height < 0.015), (100.0, height > 0.055)):
        assert far.sum() > 100
        np.testing.assert_allclose(hoop[far], pressure * radius[far], rtol=0.03)
    run_groups("loads.patch.0.group=lower", code=2)
    assert "loads.patch.0.group = 'lower' is not a group of triangles" in capsys.readouterr().err


def test_scordelis_and_los_roof():
    """Forces and moments of the row of cells at midspan, means of a cell's four triangles, against linear shell theory:
    75.7 kip/ft along the free edge, 2.06 kip along the crown. Its deflection is that of tests/verification/macneal."""
    assert roof(np.array([OPENING]), 25.0)["down"] == pytest.approx(0.300592, rel=1e-4)
    cells, factor = 16, 1e-4  # of the load: linear
    u, v, triangles, side = mapped(cells, cells, "crossed")
    points = RADIUS * np.column_stack([np.sin(OPENING * u), v, np.cos(OPENING * u)])
    held = {"v0": {"axes": "xz"}, "v1": {"axes": "y", "clamp": True}, "u0": {"axes": "x", "clamp": True}}
    found = voile.run(
        {
            "shell": {"mesh": (points, triangles), "young": 4.32e8, "poisson": 0.0, "thickness": 0.25,
                      "density": 360.0},
            "loads": {"gravity": [0.0, 0.0, -factor]},
            "fix": [
                {"select": {"nodes": np.flatnonzero(getattr(side, name)).tolist()}, **keys}
                for name, keys in held.items()
            ],
            "statics": {"load_steps": 1},
            "output": {"fields": ["membrane_force", "bending_moment"]},
        }
    )  # fmt: skip
    angle, along = OPENING * u[triangles].mean(axis=1), v[triangles].mean(axis=1)
    row = np.flatnonzero(along > 1.0 - 1.0 / cells)
    column = (angle[row] / OPENING * cells).astype(int)
    places, which = np.unique(along[row].round(9), return_inverse=True)
    exact = [roof(angle[row], RADIUS * x) for x in places]
    around = np.column_stack([np.cos(angle), 0.0 * angle, -np.sin(angle)])[row]
    for name, field, bound in (("n", "membrane_force", 0.02), ("m", "bending_moment", 0.03)):
        value = found.field(field)[row] / factor
        tensor = value[:, [0, 3, 5, 3, 1, 4, 5, 4, 2]].reshape(-1, 3, 3)
        for axis, mine in (
            ("along", value[:, 1]),
            ("around", np.einsum("tij,ti,tj->t", tensor, around, around)),
        ):
            theirs = np.array([exact[i][f"{name}_{axis}"][k] for k, i in enumerate(which)])
            means = [np.bincount(column, values) / np.bincount(column) for values in (mine, theirs)]
            assert np.abs(means[0] - means[1]).max() < bound * np.abs(theirs).max()
