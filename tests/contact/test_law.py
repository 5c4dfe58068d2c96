"""Coulomb's law: the cone's projection, the natural map's derivative, the error."""

import numpy as np
import pytest

from voile.contact import friction_error
from voile.contact.law import OPEN, SLIP, STICK, natural_map, project_on_cone
from voile.errors import InputError


@pytest.fixture
def rng():
    return np.random.default_rng(3)


def test_projection_on_the_cone(rng):
    s, mu = rng.normal(size=(500, 3)), rng.uniform(0.0, 2.0, 500)
    mu[:50] = 0.0
    p = project_on_cone(s, mu)
    assert (np.hypot(p[:, 1], p[:, 2]) <= mu * p[:, 0] + 1e-14).all()
    assert np.allclose(project_on_cone(p, mu), p, atol=1e-14)
    # Moreau: s - p lies in the polar cone and is normal to p.
    rest = s - p
    assert (mu * np.hypot(rest[:, 1], rest[:, 2]) <= -rest[:, 0] + 1e-13).all()
    assert np.abs(np.einsum("ij,ij->i", rest, p)).max() < 1e-13


@pytest.mark.parametrize("rho", [0.1, 1.0, 10.0])
def test_natural_map_taylor(rho, rng):
    c = 400
    r, u, mu = rng.normal(size=(c, 3)), rng.normal(size=(c, 3)), rng.uniform(0.0, 1.5, c)
    dr, du = rng.normal(size=(c, 3)), rng.normal(size=(c, 3))
    F, A, B, state = natural_map(r, u, mu, rho)
    assert {OPEN, STICK, SLIP} == set(state)
    slope = np.einsum("cij,cj->ci", A, dr) + np.einsum("cij,cj->ci", B, du)
    steps = [1e-4, 1e-5]
    smooth = np.ones(
        c, bool
    )  # contacts that change their state within the steps have no second-order remainder
    remainders = []
    for t in steps:
        ahead = natural_map(r + t * dr, u + t * du, mu, rho)
        smooth &= ahead[3] == state
        remainders.append(np.linalg.norm(ahead[0] - F - t * slope, axis=1))
    first, second = (np.linalg.norm(x[smooth]) for x in remainders)
    assert smooth.mean() > 0.95
    assert 80.0 < first / second < 125.0


def test_natural_map_vanishes_where_the_laws_hold():
    r = np.array([[0.0, 0, 0], [2.0, 0.3, -0.4], [2.0, -0.6, 0.8], [1.0, 0, 0]])
    u = np.array([[0.7, 1, 2], [0.0, 0, 0], [0.0, 0.9, -1.2], [0.0, 5, 0]])
    mu = np.array([0.5, 0.5, 0.5, 0.0])
    F, _, _, state = natural_map(r, u, mu, 1.0)
    assert np.abs(F).max() < 1e-15
    assert list(state) == [OPEN, STICK, SLIP, SLIP]
    assert friction_error(np.zeros((12, 12)), u.ravel(), mu, r.ravel()) < 1e-15


def test_error_agrees_with_the_reference(shared, rng):
    names: dict = {}
    exec((shared / "friction" / "fc3d_error.py").read_text(), names)
    for c in (1, 7, 40):
        B = rng.normal(size=(3 * c, 2 * c))
        W, q, mu, r = B @ B.T, rng.normal(size=3 * c), rng.uniform(0, 1, c), rng.normal(size=3 * c)
        assert friction_error(W, q, mu, r) == pytest.approx(names["fc3d_error"](W, q, mu, r), rel=1e-13)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"q": np.zeros(5)}, "q has 5 entries, mu 2"),
        ({"mu": np.array([0.1, -0.2])}, "-0.2 at contact 1"),
        ({"mu": np.array([0.1, np.nan])}, r"mu\[1\] is not finite"),
        ({"W": np.eye(5)}, "W is 5 by 5; 2 contacts need 6 by 6"),
        ({"W": np.full((6, 6), np.inf)}, "W has entries that are not finite"),
        ({"W": 3.0}, "W must be a matrix"),
        ({"q": np.array([0, 0, 0, 0, np.inf, 0])}, r"q\[4\] is not finite"),
        ({"q": np.zeros((2, 3))}, "q must have one dimension"),
        ({"q": ["a"] * 6}, "q must be an array of numbers"),
        ({"r": np.zeros(3)}, "r has 3 entries, q 6"),
    ],
)
def test_bad_problems_are_refused(change, message):
    problem = {"W": np.eye(6), "q": np.ones(6), "mu": np.full(2, 0.3), "r": np.zeros(6)} | change
    with pytest.raises(InputError, match=message):
        friction_error(**problem)
