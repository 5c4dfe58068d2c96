"""The least friction that holds a rigid body: against linear programs on pyramids inside and around Coulomb's cones."""

import numpy as np
import pytest
from scipy.optimize import linprog

from voile.inverse.reactions import Balance, Cones, least_friction

FACETS = 64


def cap(count: int, tilt: float, seed: int = 3) -> tuple[Cones, Balance]:
    """Contacts of a cap on a unit sphere, at random, tilted by an angle off its top, under their weights."""
    random = np.random.default_rng(seed)
    angle, turn = 0.6 * np.sqrt(random.random(count)), 2.0 * np.pi * random.random(count)
    x = np.stack([np.sin(angle) * np.cos(turn), np.sin(angle) * np.sin(turn), np.cos(angle)], axis=1)
    c, s = np.cos(tilt), np.sin(tilt)
    x = x @ np.array([[c, 0.0, -s], [0.0, 1.0, 0.0], [s, 0.0, c]])
    weight = 1e-3 * (0.5 + random.random(count))
    load = np.outer(weight, [0.0, 0.0, -1.0])
    modes = np.zeros((count, 3, 6))
    modes[:, :, :3] = np.eye(3)
    for axis in range(3):
        modes[:, :, 3 + axis] = np.cross(np.eye(3)[axis], x)
    resultant = np.einsum("cik,ci->k", modes, load)
    own = np.ones(count, dtype=bool)
    balance = Balance(weight, load, modes, resultant, float(weight.sum()), own, lambda total: total)
    return Cones(x, np.ones(count)), balance


def feasible(cones: Cones, balance: Balance, friction: float) -> bool:
    """Whether reactions in pyramids with so many facets, inscribed in the cones, balance the loads."""
    normal = cones.normal
    one = np.cross(normal, [0.3, -0.8, 0.52])
    one /= np.linalg.norm(one, axis=1)[:, None]
    two = np.cross(normal, one)
    turn = 2.0 * np.pi * np.arange(FACETS) / FACETS
    rays = normal[:, None] + friction * (
        np.cos(turn)[None, :, None] * one[:, None] + np.sin(turn)[None, :, None] * two[:, None]
    )
    rows = np.einsum("cfi,cik->kcf", rays, balance.modes).reshape(6, -1)
    scale = balance.scale
    done = linprog(np.zeros(rows.shape[1]), A_eq=rows, b_eq=-balance.resultant / scale, method="highs")
    return done.status == 0


@pytest.mark.parametrize("tilt", [0.02, 0.3, 0.9])
def test_least_friction_lies_between_pyramids_inside_and_around_the_cones(tilt):
    cones, balance = cap(40, tilt)
    least = least_friction(balance, cones)
    assert least is not None and least > 1e-3
    assert feasible(cones, balance, 1.001 * least / np.cos(np.pi / FACETS))
    assert not feasible(cones, balance, 0.999 * least)
    r = balance.solve(cones.scaled(least))
    normal = np.einsum("ci,ci->c", cones.normal, r)
    tangential = np.linalg.norm(r - normal[:, None] * cones.normal, axis=1)
    assert (tangential <= least * normal + 1e-12 * balance.scale).all()
    total = np.einsum("cik,ci->k", balance.modes, r) + balance.resultant
    assert np.linalg.norm(total) < 1e-12 * balance.scale


def test_it_takes_few_evaluations(monkeypatch):
    """Hopeless friction is proved so by a motion that nothing resists, not by patience."""
    evaluations = []
    once = Balance._dual
    monkeypatch.setattr(Balance, "_dual", lambda self, *args: evaluations.append(1) or once(self, *args))
    cones, balance = cap(300, 0.3)
    assert least_friction(balance, cones) is not None
    assert len(evaluations) < 2500
