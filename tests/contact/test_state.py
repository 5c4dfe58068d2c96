"""Contact's potential and its semismooth equations: derivatives by Taylor tests, laws at hand-made solutions."""

import itertools

import numpy as np
import pytest

from voile.contact.contact import Contact
from voile.contact.obstacles import Plane, Sphere
from voile.contact.pairs import within
from voile.problem.terms import Point
from voile.problem.tied import TiedContact

OFFSET, STIFFNESS, RADIUS = 0.01, 50.0, 0.5


def touching(friction: float = 0.3) -> tuple[Contact, np.ndarray]:
    """Twelve points around a sphere's surface with reactions, bounds and planes as after an update."""
    rng = np.random.default_rng(3)
    x = rng.normal(size=(12, 3))
    x *= ((RADIUS + OFFSET + 0.02 * rng.normal(size=12)) / np.linalg.norm(x, axis=1))[:, None]
    everything = np.ones(len(x), dtype=bool)
    contact = Contact([sphere(friction)], OFFSET, STIFFNESS, everything, everything, 1e-12)
    contact.begin(x + 0.02 * rng.normal(size=x.shape), 0.0)
    contact.adopt(x, 1.0)
    return contact, x + 0.003 * rng.normal(size=x.shape)


def sphere(friction: float = 0.0) -> Sphere:
    return Sphere(name="sphere 0", friction=friction, center=np.zeros(3), radius=RADIUS)


def plane(friction: float) -> Plane:
    return Plane(name="plane 0", friction=friction, point=np.zeros(3), normal=np.array([0.0, 0.0, 1.0]))


def taylor_rates(value, slope, x: np.ndarray, direction: np.ndarray) -> list[float]:
    """Orders at which value(x + t d) - value(x) - t slope.d vanishes."""
    steps = 2.0 ** -np.arange(8, 12)
    rests = [np.linalg.norm(value(x + t * direction) - value(x) - t * slope) for t in steps]
    return [np.log2(a / b) for a, b in itertools.pairwise(rests)]


@pytest.mark.parametrize("friction", [0.0, 0.3, 2.0])
def test_force_is_the_gradient_of_the_energy(friction):
    contact, x = touching(friction)
    direction = 0.01 * np.random.default_rng(4).normal(size=x.shape)
    slope = -np.sum(contact.force(x, 1.0) * direction)
    assert min(taylor_rates(lambda z: contact.energy(z, 1.0), slope, x, direction)) > 1.9


@pytest.mark.parametrize("friction", [0.0, 0.3, 2.0])
def test_blocks_are_the_hessian_of_the_energy(friction):
    contact, x = touching(friction)
    direction = 0.01 * np.random.default_rng(5).normal(size=x.shape)
    slope = np.zeros_like(x)
    for vertex, block in contact.blocks(x, 1.0, convex=False):
        slope[vertex] += np.einsum("pij,pj->pi", block, direction[vertex])
    rates = taylor_rates(lambda z: -contact.force(z, 1.0), slope, x, direction)
    assert min(rates) > 1.8
    for _, block in contact.blocks(x, 1.0, convex=True):
        assert np.linalg.eigvalsh(block).min() >= -1e-12 * STIFFNESS


def at(x: np.ndarray) -> Point:
    """The place x (n, 3) at time 1, of vertices without directors."""
    none = np.zeros(0)
    return Point(x.ravel(), none, x.ravel(), x, 1.0)


def test_tied_contacts_are_springs_that_carry_their_reactions():
    """Force and blocks derive from the energy; where the springs rest, the force is that of the reactions."""
    contact, x = touching(0.3)
    direction = 0.01 * np.random.default_rng(6).normal(size=x.shape)
    tied = TiedContact(contact, x, 1.0)
    (springs,) = tied.springs
    assert tied.active and (springs.reaction != 0.0).any()
    assert np.abs(springs.extension(x)).max() > 1e-4  # m, off where they close without slip
    force = tied.forces(at(x)).reshape(-1, 3)
    slope = -np.sum(force * direction)
    assert min(taylor_rates(lambda z: tied.energies(at(z))["contact"], slope, x, direction)) > 1.9
    slope = np.zeros_like(x)
    for vertex, block in tied.blocks(at(x), "exact"):
        slope[vertex] += np.einsum("pij,pj->pi", block, direction[vertex])
    moved = force - tied.forces(at(x + direction)).reshape(-1, 3)
    assert np.abs(moved - slope).max() < 1e-9 * np.abs(slope).max()
    springs.rest = springs.rest + springs.extension(x)
    resting = np.zeros_like(x)
    resting[springs.vertex[:, 0]] = springs.reaction
    assert np.abs(tied.forces(at(x)).reshape(-1, 3) - resting).max() < 1e-12 * np.abs(resting).max()


def one_vertex(
    friction: float, push: np.ndarray, stiffness: np.ndarray
) -> tuple[np.ndarray, np.ndarray, int]:
    """Position, reaction and iterations of a point on springs pushed against the plane z = 0, by the equations."""
    everything = np.ones(1, dtype=bool)
    contact = Contact([plane(friction)], 0.0, 10.0, everything, everything, 1e-12)
    x = np.zeros((1, 3))
    contact.begin(x, 0.0)
    linear = None
    for iteration in range(1, 20):
        linear = contact.linearise(x, 1.0, linear)
        matrix, dx = stiffness.copy(), np.zeros(3)
        for _, block in linear.blocks():
            matrix = matrix + block[0]
        for _ in range(3):
            residual = stiffness @ x[0] - push - linear.force()[0]
            dx = dx - np.linalg.solve(matrix, residual + matrix @ dx)
            linear.advance(dx[None])
        x = x + dx
        linear.reactions(1.0)
        force = contact.reactions(x, 1.0)
        if np.linalg.norm(stiffness @ x[0] - push - force[0]) + contact.missed(contact.pairs(x, 1.0)) < 1e-12:
            return x[0], force[0], iteration
    raise AssertionError("the equations did not converge")


def test_a_point_sticks_inside_the_cone():
    x, r, _ = one_vertex(0.5, np.array([0.3, 0.2, -1.0]), np.eye(3))
    assert np.abs(x).max() < 1e-14
    assert np.allclose(r, [-0.3, -0.2, 1.0], atol=1e-12)


def test_a_point_slips_on_the_cone():
    """Springs k, push (1, 0, -1), mu = 0.4: r = (-0.4, 0, 1), slip (1 - 0.4) / k."""
    x, r, iterations = one_vertex(0.4, np.array([1.0, 0.0, -1.0]), 2.0 * np.eye(3))
    assert np.allclose(x, [0.3, 0.0, 0.0], atol=1e-12)
    assert np.allclose(r, [-0.4, 0.0, 1.0], atol=1e-12)
    assert iterations <= 4


def test_slip_opposes_friction_on_uneven_springs():
    """The direction of slip is not that of the push: friction is opposed to the slip, with mu times the pressure."""
    x, r, iterations = one_vertex(0.3, np.array([1.0, 0.8, -2.0]), np.diag([1.0, 4.0, 1.0]))
    assert x[2] == pytest.approx(0.0, abs=1e-14)
    assert r[2] == pytest.approx(2.0)
    assert np.allclose(r[:2], -0.3 * r[2] * x[:2] / np.linalg.norm(x[:2]), atol=1e-10)
    assert iterations <= 10


def test_a_point_pulled_away_opens():
    x, r, _ = one_vertex(0.3, np.array([0.5, 0.0, 1.0]), np.eye(3))
    assert np.allclose(x, [0.5, 0.0, 1.0])
    assert not r.any()


def test_round_off_leaves_nothing_off_the_tangent_plane():
    """Times a stiff shell's penalty, 1e14 N/m, it would be a force."""
    normal = np.random.default_rng(3).normal(size=(200, 3))
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    found = within(normal, 1e-3 * normal + 1e-9 * np.roll(normal, 1, axis=1))
    assert np.abs(np.einsum("pi,pi->p", found, normal)).max() < 1e-24


def test_sharp_norms_take_no_larger_rho():
    """A gap that only round-off opens counts with `sharp` in norms, with rho in the laws."""
    contact, x = touching(0.3)
    firm = contact.missed(contact.pairs(x, 1.0))
    pairs = contact.measured_pairs(x, 1.0, 0.01 * STIFFNESS)
    assert pairs[0].rho == 0.01 * STIFFNESS
    assert contact.missed(pairs) < 0.1 * firm
    assert contact.rho(0) == STIFFNESS and contact.missed(contact.pairs(x, 1.0)) == firm


@pytest.mark.parametrize("push", [1.0, 1e12])
def test_what_does_not_pull_sideways_sticks_however_hard_it_is_pressed(push):
    """Its share of friction's bound was computed, though unused: an overflow above 1e8 N."""
    everything = np.ones(1, dtype=bool)
    contact = Contact([plane(0.5)], 0.0, 10.0, everything, everything, 1e-12)
    x = np.zeros((1, 3))
    contact.begin(x, 0.0)
    contact.history.normal[0][0] = push
    with np.errstate(all="raise"):
        normal, tangential = contact.pairs(x, 1.0)[0].project()
    assert normal[0] == push and not tangential.any()
