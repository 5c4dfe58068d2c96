"""Motion in time without contact: free fall, schemes' orders, what is conserved."""

from itertools import pairwise

import numpy as np
import pytest
from moving import cloth, move
from test_problem import sheet

from voile.solver.stepping.schemes import SCHEMES, SchemeOptions

G = 9.81
POINTS, TRIANGLES = sheet(6, 3)
LEFT = np.flatnonzero(POINTS[:, 0] < 1e-9)


@pytest.mark.parametrize(
    ("scheme", "late"), [("implicit-euler", 1), ("moreau-jean", 1), ("generalized-alpha", 0)]
)
def test_free_fall_is_what_the_scheme_makes_of_it(scheme, late):
    h, count = 0.01, 20
    run = move(cloth(POINTS, TRIANGLES), scheme, h, h * count, velocity=np.array([0.3, 0.0, 0.0]))
    assert run.path.converged and run.path.count == count and run.times[-1] == h * count
    fallen = 0.5 * G * h**2 * count * (count + late)  # implicit Euler falls half a step longer
    np.testing.assert_allclose(
        run.end, POINTS + np.array([0.3 * h * count, 0.0, -fallen]), rtol=0, atol=1e-13
    )
    np.testing.assert_allclose(run.velocities[-1], np.tile([0.3, 0.0, -G * h * count], (28, 1)), atol=1e-12)
    assert run.solver.counts.factorisations <= 2  # the last acceleration predicts the step exactly


ORDERS = [
    ("implicit-euler", SchemeOptions(), 1, 6e-3),
    ("bdf2", SchemeOptions(), 2, 1.5e-3),
    ("generalized-alpha", SchemeOptions(), 2, 4e-4),
    ("moreau-jean", SchemeOptions(theta=1.0), 1, 6e-3),
    ("moreau-jean", SchemeOptions(theta=0.5), 2, 4e-4),
]


@pytest.mark.parametrize(("scheme", "asked", "order", "bound"), ORDERS)
def test_a_swinging_sheet_converges_with_the_schemes_order(scheme, asked, order, bound):
    shell = cloth(POINTS, TRIANGLES, LEFT, young=1e5)
    ends = [move(shell, scheme, h, 0.2, asked=asked).end for h in (0.005, 0.0025, 0.00125)]
    coarse, fine = (np.abs(a - b).max() for a, b in pairwise(ends))
    assert coarse < bound
    assert np.log2(coarse / fine) == pytest.approx(order, abs=0.2)


def test_every_scheme_of_the_table_is_a_word_of_scenes():
    from voile.scene.tasks import Dynamics

    assert set(Dynamics.__dataclass_fields__["scheme"].metadata["kind"].values) == set(SCHEMES)
