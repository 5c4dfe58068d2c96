"""Which layers of a shell can touch: seams, and the barrier that keeps layers apart on the way to an equilibrium."""

from dataclasses import replace

import numpy as np
from protocols import plate, shell_of
from test_self_contact import pressed_sheets

from voile.contact.pairs import barrier
from voile.problem.contact import shell_layers

CELL, OFFSET = 0.01, 5e-4


def sewn_panels(share: float, apart: float = 0.0):
    """Two panels of 20 by 2 cells side by side, the second `apart` (m) above the first, its edge sewn to the first's
    with each vertex at `share` of an edge; a small patch lies across the seam at half that height."""
    points, triangles = plate(20 * CELL, 2 * CELL, CELL)
    patch, corners = plate(2 * CELL, CELL, CELL)
    width = np.ptp(points[:, 1])
    near, far = (
        np.flatnonzero(np.isclose(points[:, 1], y)) for y in (points[:, 1].max(), points[:, 1].min())
    )
    near, far = (side[np.argsort(points[side, 0])] for side in (near, far))
    moved = points + np.array([share * CELL, width, apart])
    patch = patch - patch.min(axis=0) + np.array([0.1, points[:, 1].max() - 0.4 * CELL, 0.5 * apart or CELL])
    n = len(points)
    return shell_of(
        np.concatenate([points, moved, patch]),
        np.concatenate([triangles, triangles + n, corners + 2 * n]),
        young=1e6,
        thickness=2 * OFFSET,
        density=300.0,
        slave=n + far[:-1],
        first=near[:-1],
        second=near[1:],
        weight=np.full(len(far) - 1, share),
    ), 2 * n


def test_a_seam_does_not_join_its_far_ends():
    """Only what lies on the same few edges cannot touch, not all along a seam."""
    for share in (0.0, 0.3):
        shell, _ = sewn_panels(share)
        excluded = shell_layers(shell, OFFSET, 0.0).excluded
        length = np.linalg.norm(shell.points[excluded[:, 0]] - shell.points[excluded[:, 1]], axis=1)
        pairs = {tuple(pair) for pair in np.sort(excluded, axis=1).tolist()}
        assert all(tuple(sorted(pair)) in pairs for pair in zip(shell.slave, shell.first, strict=True))
        assert length.max() < 2.1 * CELL


def test_what_a_sliver_parts_cannot_touch():
    """A vertex on the other side of a triangle less than a thickness high is near, but not in another layer."""
    points, triangles = plate(6 * CELL, 6 * CELL, CELL)
    inner = np.flatnonzero((np.abs(points[:, :2] - 3 * CELL) < 1.5 * CELL).all(axis=1))
    above = inner[np.isclose(points[inner, 1], points[inner, 1].min())]
    points[above, :2] += [0.5 * CELL, CELL - 0.8 * OFFSET]  # a row of cells is squeezed
    shell = shell_of(points, triangles, young=1e6, thickness=2 * OFFSET, density=300.0)
    layers = shell_layers(shell, OFFSET, 0.0)
    everything = replace(layers, excluded=np.zeros((0, 2), dtype=int))
    assert len(everything.nearer(2.0 * OFFSET)) and not len(layers.nearer(2.0 * OFFSET))


def test_layers_caught_in_a_gaping_seam_cannot_touch():
    """What starts nearer than the seams gape may be on the wrong side of a seam when that closes."""
    gape = 0.4 * OFFSET
    shell, patch = sewn_panels(0.3, gape)
    layers = shell_layers(shell, OFFSET, 0.0)
    assert layers.caught > 0 and len(layers.nearer(0.99 * gape)) == 0
    caught = (layers.excluded >= patch).sum(axis=1) == 1  # with one of the panels
    assert caught.any()
    everything = replace(layers, excluded=np.zeros((0, 2), dtype=int))
    assert len(everything.nearer(0.99 * gape))
    shell, patch = sewn_panels(0.3)
    assert shell_layers(shell, OFFSET, 0.0).caught == 0
    assert not ((shell_layers(shell, OFFSET, 0.0).excluded >= patch).sum(axis=1) == 1).any()


def test_the_barrier_is_none_where_layers_do_not_meet():
    potential, push, stiff = barrier(np.array([1e-3, 0.0, -1e-6, -OFFSET, -0.999 * 2 * OFFSET]), 2 * OFFSET)
    assert not np.any([potential[:2], push[:2], stiff[:2]])
    assert push[2] < 1e-8 and stiff[2] < 1e-2  # to third order
    assert push[3] > 0.5 * OFFSET and push[4] > 100.0 * push[3]
    gap = np.array([-0.3, -0.7, -0.95]) * 2 * OFFSET
    step = 1e-5 * OFFSET
    ahead, back = barrier(gap + step, 2 * OFFSET), barrier(gap - step, 2 * OFFSET)
    here = barrier(gap, 2 * OFFSET)
    assert np.allclose((ahead - back)[0] / (2 * step), -here[1], rtol=1e-7)
    assert np.allclose((ahead - back)[1] / (2 * step), -here[2], rtol=1e-7)


def test_round_off_of_gaps_counts_for_less_in_norms():
    """Layers' mismatch of the laws grows with rho where their gaps are off, and norms take that of obstacles."""
    contact, x = pressed_sheets(0.0)
    firm = contact.mismatch(x, 1.0)
    pairs = contact.measured_pairs(x, 1.0)
    assert pairs[0].rho == contact.stiffness
    assert contact.missed(pairs) < 1e-2 * firm
    assert contact.mismatch(x, 1.0) == firm
