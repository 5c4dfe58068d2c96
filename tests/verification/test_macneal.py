"""MacNeal & Harder's shells: meshes against their Kirchhoff-Love limit, the limit against splines and literature."""

import pytest
from macneal import IN_PLANE, OUT_OF_PLANE, SET, refined, twisted_beam
from shells import rates, solve


@pytest.mark.parametrize("name", SET)
def test_the_limits_are_those_of_splines_and_near_the_published(name):
    case = SET[name]
    assert abs(case.spans(16) / case.limit - 1.0) < 0.006
    assert abs(case.published / case.limit - 1.0) < 0.0065


@pytest.mark.parametrize("name", SET)
def test_meshes_converge_to_the_limit(name):
    """The thick beam in plane is too near on all meshes for a rate; the cylinder's force is concentrated."""
    rows, rate = refined(name), {"pinched cylinder": 1.1, "twisted beam, t = 0.32, in plane": -1.0}
    assert rows[0].error < 0.1 and rows[-1].error < SET[name].bound
    assert min(rates(rows, [4.0, 2.0, 1.0])) > rate.get(name, 1.5)


@pytest.mark.parametrize("axis", [IN_PLANE, OUT_OF_PLANE])
def test_small_loads_converge_to_the_same(axis):
    """Forces of 1e-9 on a shell whose membrane would bear 1e5: more digits than a difference of angles keeps."""
    large, small = (
        solve(shell, load_steps=1).u[vertex, axis] / factor
        for factor in (1.0, 1e-3)
        for shell, vertex, _ in [twisted_beam(0.0032, axis, 48, 8, factor)]
    )
    assert abs(small / large - 1.0) < 1e-5
