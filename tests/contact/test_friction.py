"""The friction solver: one contact by hand, real problems, perturbed problems, problems without end."""

import subprocess
import sys

import numpy as np
import pytest
import scipy.sparse as sp

from voile.contact import friction_error
from voile.contact.law import OPEN, SLIP, STICK, contact_states
from voile.errors import InputError
from voile.results.friction import read_problem
from voile.solver import solve_friction
from voile.solver.friction import FrictionNotConverged

PROBLEMS = [
    "BoxesStack1-i100000-32",
    "Capsules-i100-1090",
    "Capsules-i103-990",
    "Capsules-i122-1617",
    "Confeti-ex13-4contact-Fc3D-SBM",
    "Confeti-ex13-Fc3D-SBM",
    "FC3D_Example1",
    "FC3D_Example1_SBM",
    "FrictionContact3D_1c",
    "FrictionContact3D_RR_1c",
    "GFC3D_TwoRods1-condensed",
    "KaplasTower-i1061-4",
    "NESpheres_10_1",
    "OneObject-i100000-316",
    "RockPile_tob1",
    *(f"Rover{k}" for k in (1039, 1040, 11035, 11211, 3865, 4144, 4396, 4493, 4516, 4613, 4622, 9770)),
]


def load(shared, name):
    return read_problem(shared / "friction" / f"{name}.h5")


# ---- one contact: u = w r + q ----


@pytest.mark.parametrize(
    ("q", "reaction", "state"),
    [
        ([1.0, 2.0, 3.0], [0.0, 0.0, 0.0], OPEN),
        ([-4.0, 0.6, -0.8], [2.0, -0.3, 0.4], STICK),
        # Slips against (0.6, 0.8), with r_N = 2 and |r_T| = mu r_N.
        ([-4.0, 6.0, 8.0], [2.0, -0.36, -0.48], SLIP),
    ],
)
@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e6])
def test_one_contact(q, reaction, state, scale):
    W, mu = 2.0 * np.eye(3), np.array([0.3])
    r, info = solve_friction(scale * W, scale * np.array(q), mu, tol=1e-12)
    assert r == pytest.approx(reaction, abs=max(1e-9, 4e-12 / scale))  # the error counts u and r alike
    assert info.error <= 1e-12
    assert contact_states(scale * W, scale * np.array(q), mu, r)[0] == state


def test_without_friction_and_without_contacts():
    r, _ = solve_friction(np.eye(3), [-1.0, 2.0, 0.0], [0.0])
    assert r == pytest.approx([1.0, 0.0, 0.0], abs=1e-8)
    r, info = solve_friction(np.zeros((0, 0)), [], [])
    assert r.shape == (0,) and info.error == 0.0


def test_redundant_contacts_share_the_weight():
    """A block (mass 2, push p in x) on four coplanar contacts: W has rank 3; forces balance."""
    H = np.tile(np.eye(3), (4, 1))
    for push, sticks in ((1.0, True), (40.0, False)):
        q = H @ np.array([-9.81, push, 0.0])
        r, info = solve_friction(sp.csr_matrix(H @ H.T / 2.0), q, np.full(4, 0.5), tol=1e-11)
        total = r.reshape(4, 3).sum(axis=0)
        assert info.error <= 1e-11
        assert total[0] == pytest.approx(2 * 9.81, rel=1e-8)
        assert total[1] == pytest.approx(-2.0 if sticks else -0.5 * 2 * 9.81, rel=1e-8)


# ---- real problems ----


@pytest.mark.parametrize("name", PROBLEMS)
def test_real_problems(name, shared):
    W, q, mu = load(shared, name)
    r, info = solve_friction(W, q, mu)
    assert info.error <= 1e-8
    assert friction_error(W, q, mu, r) == info.error
    assert len(info.history) == info.iterations + 1


def test_every_problem_is_listed(shared):
    assert sorted(PROBLEMS) == sorted(p.stem for p in (shared / "friction").glob("*.h5"))


@pytest.mark.slow
@pytest.mark.parametrize("name", PROBLEMS)
@pytest.mark.parametrize("variant", ["1e-11", "q", "mu 0.8", "mu 0.6"])
def test_variants_of_real_problems(name, variant, shared):
    W, q, mu = load(shared, name)
    if variant == "q":
        noise = W @ np.random.default_rng(1).normal(size=len(q))
        q = q + 1e-3 * np.linalg.norm(q) / np.linalg.norm(noise) * noise
    elif variant != "1e-11":
        mu = mu * float(variant.split()[1])
    tol = 1e-11 if variant == "1e-11" else 1e-8
    assert friction_error(W, q, mu, solve_friction(W, q, mu, tol=tol)[0]) <= tol


def test_runs_repeat_and_formats_agree(shared):
    W, q, mu = load(shared, "OneObject-i100000-316")
    first = solve_friction(W, q, mu)[0]
    for form in (sp.csr_matrix, sp.csc_matrix, sp.coo_matrix, sp.bsr_matrix, sp.csr_array):
        assert (solve_friction(form(W), q, mu)[0] == first).all()


# ---- generated problems ----


def pile(rng, bodies, contacts):
    """Hyperstatic contacts of free bodies, loaded such that a solution exists: q = -W r, r in the cones."""
    H = sp.lil_matrix((3 * contacts, 6 * bodies))
    for k in range(contacts):
        pair = rng.choice(bodies, 2, replace=False)
        turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        for sign, b in zip((1.0, -1.0), pair, strict=True):
            arm = np.cross(np.eye(3), rng.uniform(-1, 1, 3))
            H[3 * k : 3 * k + 3, 6 * b : 6 * b + 6] = sign * turn @ np.hstack([np.eye(3), arm])
    H = H.tocsr()
    W = (H @ sp.diags(10.0 ** rng.uniform(-1, 1, 6 * bodies)) @ H.T).tocsr()
    mu = rng.uniform(0.1, 1.0, contacts)
    r = np.column_stack([rng.uniform(0.1, 1, contacts), rng.normal(size=(contacts, 2))])
    r[:, 1:] *= (rng.uniform(0, 0.95, contacts) * mu * r[:, 0] / np.linalg.norm(r[:, 1:], axis=1))[:, None]
    return W, -W @ r.ravel(), mu


@pytest.mark.parametrize("seed", range(6))
def test_generated_hyperstatic_piles(seed):
    rng = np.random.default_rng(seed)
    W, q, mu = pile(rng, 12 + 4 * seed, 40 + 20 * seed)
    assert solve_friction(W, q, mu)[1].error <= 1e-8
    # A load off the interior solution: some contacts open, some slip.
    q = q + 0.3 * W @ rng.normal(size=len(q))
    r, info = solve_friction(W, q, mu)
    assert info.error <= 1e-8
    assert len(set(contact_states(W, q, mu, r))) >= 2


# ---- what cannot be solved ----


def test_an_impossible_problem_says_so():
    """A body between walls that come closer: r = (t, t), t to infinity, makes the error as small as one likes."""
    H = np.vstack([np.eye(3), -np.eye(3)])
    with pytest.raises(FrictionNotConverged, match="grow without bound") as caught:
        solve_friction(H @ H.T, [-1.0, 0, 0, -1.0, 0, 0], [0.3, 0.3])
    assert caught.value.reaction.shape == (6,)
    assert np.isfinite(caught.value.reaction).all()


def test_too_few_iterations_keep_the_best(shared):
    W, q, mu = load(shared, "Capsules-i103-990")
    with pytest.raises(FrictionNotConverged, match="above the tolerance") as caught:
        solve_friction(W, q, mu, max_iterations=5)
    info = caught.value.info
    assert info.iterations == 5 and info.error == pytest.approx(min(info.history), rel=1e-9)
    assert friction_error(W, q, mu, caught.value.reaction) == info.error


@pytest.mark.parametrize("setting", [{"tol": 0.0}, {"tol": np.nan}, {"max_iterations": 0}])
def test_bad_settings(setting):
    with pytest.raises(InputError, match=next(iter(setting))):
        solve_friction(np.eye(3), np.ones(3), [0.1], **setting)


def test_importing_the_solver_does_not_import_petsc():
    code = "import sys; from voile.solver import solve_friction; assert 'petsc4py' not in sys.modules"
    subprocess.run([sys.executable, "-c", code], check=True)
