"""How stiffly hinges bend a mesh, against the plate: regular triangles exactly, others as measured."""

import numpy as np
import pytest

import voile
from voile.cli import main
from voile.elastic.plate import FlatMesh
from voile.validate.shells import mapped

HINGES = ({"model": "discrete-shells"}, {"model": "koiter", "bending": "average"}, {"model": "projective"})


def bent(points, triangles, model, poisson=0.0):
    one = np.ones(len(triangles))
    return FlatMesh(
        points, triangles, thickness=1e-3 * one, young=1e6 * one, poisson=poisson * one, model=model
    ).bending()


def stiffness(points, triangles, model):
    return bent(points, triangles, model).of_cylinders()


def equilateral(n: int) -> tuple[np.ndarray, np.ndarray]:
    """n x n vertices of regular triangles in a rhombus."""
    i, j = np.meshgrid(range(n), range(n), indexing="ij")
    points = np.column_stack([(i + 0.5 * j).ravel(), (np.sqrt(0.75) * j).ravel(), np.zeros(n * n)])
    k = (np.arange(n - 1)[:, None] * n + np.arange(n - 1)).ravel()
    return points, np.concatenate(
        [np.column_stack([k, k + n, k + 1]), np.column_stack([k + 1, k + n, k + n + 1])]
    )


@pytest.mark.parametrize("model", HINGES)
def test_hinges_on_regular_triangles_are_the_plate(model):
    """But for the border, whose edges have no hinge: the error falls with the mesh width."""
    errors = []
    for n in (10, 20, 40):
        low, high = stiffness(*equilateral(n), model)
        errors.append(1.0 - low)
        assert high < 1.0 + 1e-9
    assert errors[2] < 0.03 and errors[0] / errors[1] > 1.8 and errors[1] / errors[2] > 1.8


def test_hinges_have_a_poisson_ratio_of_their_own():
    """Those of regular triangles add up to D (k1^2 + k2^2 - 2 k1 k2 / 3) / 2, whatever nu is: with nu = -1/3. That of
    'average' has the plate's."""
    nu, mesh = 0.3, equilateral(40)
    for model, own in ((HINGES[0], -1.0 / 3.0), (HINGES[1], nu)):
        least, most = bent(*mesh, model, nu).of_all()
        assert least == pytest.approx((1.0 + own) / (1.0 + nu), rel=0.06) and least < (1.0 + own) / (1.0 + nu)
        assert most == pytest.approx((1.0 - own) / (1.0 - nu), rel=0.06)


def test_hinges_on_repeated_cells_are_not():
    """Regression values; docs/solver.md quotes them."""
    found = {}
    for diagonals in ("right", "crossed"):
        u, v, triangles, _ = mapped(32, 32, diagonals)
        points = np.column_stack([u, v, 0.0 * u])
        for model in HINGES[:2]:
            found[diagonals, model["model"]] = stiffness(points, triangles, model)
    assert found["right", "discrete-shells"] == pytest.approx((0.88, 2.56), abs=0.01)
    assert found["crossed", "discrete-shells"] == pytest.approx((0.97, 1.32), abs=0.01)
    assert found["right", "koiter"] == pytest.approx((0.97, 0.99), abs=0.01)
    assert found["crossed", "koiter"] == pytest.approx((1.12, 1.47), abs=0.01)


def test_stretching_is_that_of_sheets_that_are_pulled():
    """Exactly E, nu and h with a material; lengths and areas have moduli of their own, here 4/3 E."""
    u, v, triangles, _ = mapped(6, 6, "right")
    points, one = np.column_stack([u, v, 0.0 * u]), np.ones(len(triangles))
    for model, exact in (("koiter", True), ("discrete-shells", False)):
        form = FlatMesh(
            points, triangles, thickness=1e-3 * one, young=1e6 * one, poisson=0.0 * one, model={"model": model}
            | ({"bending": "tan", "material": "stvk"} if exact else {}),
        ).stretching()  # fmt: skip
        pulled = {
            "shell": {"mesh": (points, triangles), "young": 1e6, "thickness": 1e-3, "density": 1.0}
            | {"poisson": 0.0, "model": model},
            "loads": {
                "gravity": [0, 0, 0],
                "force": [{"select": {"box": [[0.999, -1, -1], [2, 2, 1]]}, "value": [1e-3, 0, 0]}],
            },
            "fix": [
                {"select": {"box": [[-1, -1, -1], [1e-6, 2, 1]]}, "axes": "x"},
                {"select": {"all": True}, "axes": "z"},
                {"select": {"nodes": [0]}},
            ],
        }
        moved = voile.run(pulled).positions - points
        strain = moved[points[:, 0] > 0.999, 0].mean()
        assert strain == pytest.approx(1e-3 * np.linalg.inv(form.mesh)[0, 0], rel=1e-4)
        if exact:
            assert form.of_all() == pytest.approx((1.0, 1.0), abs=1e-9)
        assert 1e-6 / strain == pytest.approx(1.0 if exact else 4.0 / 3.0, rel=1e-4)


def test_explain_says_the_figure(tmp_path, capsys):
    u, v, triangles, _ = mapped(12, 12, "right")
    lines = [f"v {x} 0 {y}" for x, y in zip(u, v, strict=True)] + [
        "f {} {} {}".format(*t) for t in triangles + 1
    ]
    (tmp_path / "mesh.obj").write_text("\n".join(lines))
    text = '[shell]\nmesh = "mesh.obj"\nmodel = "discrete-shells"\nyoung = 1e6\nthickness = 1e-3\ndensity = 300.0\n'
    (tmp_path / "scene.toml").write_text(text + "[[fix]]\nselect = { box = [[0, -1, 0], [0, 1, 1]] }\n")
    assert main(["explain", str(tmp_path / "scene.toml")]) == 0
    told = capsys.readouterr().out
    assert "discrete-shells bends this mesh 0.87 to 2.46 times as stiffly to cylinders" in told
    assert "discrete-shells stretches this mesh 0.34 to 1.40 times as stiffly" in told
    assert main(["explain", str(tmp_path / "scene.toml"), "--set", "shell.model=koiter"]) == 0
    assert "times as stiffly" not in capsys.readouterr().out
