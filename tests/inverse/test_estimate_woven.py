"""Warp and weft from one drape; what it does not show is refused."""

import numpy as np
import pytest
from inverse_shells import hanging_sheet

import voile
from voile.errors import InputError
from voile.mesh.grids import grid

EXACT = {"young": 3e5, "young_weft": 1e5}


def scene(**shell) -> dict:
    """A sheet that hangs from two columns of vertices at one side, by its own weight, the warp across it."""
    of = hanging_sheet()
    rest = (of.points, of.triangles)
    fabric = {"material": "orthotropic", "poisson": 0.2, "thickness": 1e-3, "density": 300.0, "shear": 5e4}
    return {
        "shell": {"mesh": rest, "bending": "average", "warp": [1, 1, 0], **fabric, **EXACT, **shell},
        "loads": {"gravity": [0.0, 0.0, -9.81]},
        "fix": [{"select": {"nodes": np.flatnonzero(of.fixed.all(axis=1)).tolist()}}],
        "statics": {"tolerance": 1e-11},
    }


def estimated(given: dict, guess: dict, names: list[str]) -> dict:
    draped = voile.run(given).positions
    shell = {**given["shell"], **guess, "rest": given["shell"]["mesh"]}
    shell["mesh"] = (draped, given["shell"]["mesh"][1])
    task = {"task": "inverse"}
    return voile.run({**given, "scene": task, "shell": shell, "inverse": {"estimate": names}}).summary[
        "inverse"
    ]


def test_one_drape_gives_warp_and_weft():
    found = estimated(scene(), {"young": 5e5, "young_weft": 0.7e5}, list(EXACT))
    assert found["misfit"] < 1e-8
    for name, value in EXACT.items():
        assert found["estimate"][name]["value"] == pytest.approx(value, rel=0.01)


def test_bending_stiffnesses_of_both_directions():
    own = {"bending_warp": 4e-5, "bending_weft": 1e-5, "bending_twist": 8e-6}
    found = estimated(
        scene(**own), {"bending_warp": 2e-5, "bending_weft": 2e-5}, ["bending_warp", "bending_weft"]
    )
    for name in ("bending_warp", "bending_weft"):
        assert found["estimate"][name]["value"] == pytest.approx(own[name], rel=0.01)


@pytest.mark.parametrize("own", [{"bending_weft": 1e-5}, {}])
def test_what_follows_by_a_rule_goes_along(own):
    """Shear, weft and twist that no key gives stayed those of the first guess: moduli came out 2 per cent off."""
    given = scene(bending_warp=4e-5, **own)
    del given["shell"]["shear"]
    found = estimated(given, {"young": 5e5, "young_weft": 0.7e5}, list(EXACT))
    assert found["misfit"] < 1e-8
    for name, value in EXACT.items():
        assert found["estimate"][name]["value"] == pytest.approx(value, rel=1e-6)


def test_a_direction_that_nothing_strains_is_refused():
    """Held at both ends and pulled in its plane along the warp, without Poisson's effect."""
    given = scene(poisson=0.0, warp=[1, 0, 0])
    places, triangles = grid(6, 4, "right")
    points = np.column_stack([0.3 * places[:, 0], 0.2 * places[:, 1], np.zeros(len(places))])
    given["shell"]["mesh"] = points, triangles
    given["fix"] = [{"select": {"nodes": np.flatnonzero((places[:, 0] % 1.0) == 0.0).tolist()}}]
    given["loads"]["gravity"] = [0.5, 0.0, 0.0]  # it does not buckle
    with pytest.raises(InputError, match="does not depend on young_weft"):
        estimated(given, {}, ["young", "young_weft"])


def test_parameters_of_fabrics_that_have_none():
    with pytest.raises(InputError, match="bending stiffnesses of its own"):
        estimated(scene(), {}, ["bending_weft"])
    given = scene()
    for name in ("material", "young_weft", "shear", "warp"):
        del given["shell"][name]
    given["shell"]["rest"] = given["shell"]["mesh"]
    with pytest.raises(InputError, match='"young_weft": allowed with shell.material = "orthotropic"'):
        voile.load({**given, "scene": {"task": "inverse"}, "inverse": {"estimate": ["young_weft"]}})
