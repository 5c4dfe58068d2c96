"""A real skirt held at its waist loop: fabrics that are exact and stable, and one that is too soft: a prototype's
values with `average`."""

import json

import pytest
from test_cli_inverse import run

SCENE = """[scene]
task = "inverse"
[shell]
mesh = "{mesh}"
bending = "average"
young = {young}
poisson = 0.3
thickness = {thickness}
density = 300.0
[[fix]]
select = {{ boundary = 1 }}
[inverse]
method = "direct"
"""
CRITICAL = 3.1e6  # Pa, at 1 mm


def solved(shared, folder, young, thickness):
    mesh = shared / "meshes" / "skirt3448.obj"
    (folder / "scene.toml").write_text(SCENE.format(mesh=mesh, young=young, thickness=thickness))
    code, said = run(folder)
    return code, said, json.loads((folder / "out" / "summary.json").read_text())


@pytest.mark.parametrize(
    ("young", "thickness"),
    [
        *(
            pytest.param(young, h, marks=pytest.mark.slow)
            for young, h in ((1e8, 1e-3), (1e7, 1e-3), (1e6, 3e-3))
        ),
        (4e6, 1e-3),
    ],
)
def test_stiff_fabrics_hold_the_skirt_exactly(shared, tmp_path, young, thickness):
    code, said, summary = solved(shared, tmp_path, young, thickness)
    assert code == 0, said
    found = summary["inverse"]
    assert found["stable"] and found["smallest_eigenvalue"] > 0.0 and found["direct_iterations"] <= 11
    assert found["sag"] < 1e-8 and found["sag_disturbed"] < 1e-8
    assert not list((tmp_path / "out").glob("*.png"))  # in one piece: voile export draws it


def test_soft_fabric_loses_stability_and_says_where_and_what_would_keep_it(shared, tmp_path):
    code, said, summary = solved(shared, tmp_path, 1e6, 1e-3)
    assert (
        code == 3
        and "stability is lost between" in said
        and "times the Young's modulus would keep it" in said
    )
    fraction = summary["inverse"]["critical_fraction"]
    assert fraction == pytest.approx(0.33, abs=0.03)
    assert 1e6 / fraction == pytest.approx(CRITICAL, rel=0.05)
