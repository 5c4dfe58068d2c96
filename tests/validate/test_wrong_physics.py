"""A material or law that is 1 % off makes its protocols miss their bounds."""

import pytest

from voile.validate import Bench, all_protocols, perform


def scaled(table: str, key: str, factor: float):
    """Alters scenes: a key of a table, or of each of an array of tables, times a factor."""

    def change(scene):
        for each in scene[table] if isinstance(scene[table], list) else [scene[table]]:
            each[key] = factor * each[key]

    return change


def stiffer(factor: float):
    """Bends stiffer by a factor, E h^3, with E h and rho h as they are."""
    root = factor**0.5

    def change(scene):
        shell = scene["shell"]
        scene["shell"] = shell | {
            "thickness": shell["thickness"] * root,
            "young": shell["young"] / root,
            "density": shell["density"] / root,
        }

    return change


SHORT = [
    ("end-shear", "shell", "young"),
    ("end-moment", "shell", "young"),
    ("lifted-strip", "shell", "density"),
    ("incline", "obstacle", "friction"),
    ("capstan", "obstacle", "friction"),
]
LONG = [
    ("bend-twist", "shell", "young"),
    ("cantilever", "shell", "young"),
    ("cantilever", "shell", "density"),
    ("lateral-buckling", "shell", "young"),
    ("plates", "shell", "young"),
    ("falling-plate", "obstacle", "friction"),
    ("sliding-sheet", "obstacle", "friction"),
    ("stick-slip", "obstacle", "friction"),
    ("friction-pad", "obstacle", "friction"),
]


@pytest.mark.parametrize("factor", [0.99, pytest.param(1.01, marks=pytest.mark.slow)])
@pytest.mark.parametrize(
    ("name", "table", "key"), [*SHORT, *(pytest.param(*case, marks=pytest.mark.slow) for case in LONG)]
)
def test_one_per_cent_is_noticed(name, table, key, factor, tmp_path):
    verdict = perform(all_protocols()[name], Bench(tmp_path, quick=True, change=scaled(table, key, factor)))
    assert not verdict.failure
    assert [check for check in verdict.checks if not check.passed]


@pytest.mark.parametrize("factor", [0.99, pytest.param(1.01, marks=pytest.mark.slow)])
@pytest.mark.parametrize("name", ["end-moment", "end-shear"])
def test_bending_alone_that_is_one_per_cent_off_is_noticed(name, factor, tmp_path):
    verdict = perform(all_protocols()[name], Bench(tmp_path, quick=True, change=stiffer(factor)))
    assert not verdict.failure
    assert not any(check.passed for check in verdict.checks)
