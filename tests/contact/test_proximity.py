"""Parts of a surface that come near each other, against a search among all pairs."""

import numpy as np
import pytest
from test_self_contact import two_sheets

from voile import _kernels
from voile.contact.closest import closest_of_edges, closest_to_triangle


def test_pairs_that_come_near():
    """Of two crumpled sheets, among all pairs: those within reach, and on a way all that are there at some time."""
    x, triangles, edges = two_sheets()
    rng = np.random.default_rng(6)
    x = x + 0.3 * np.ptp(x[edges], axis=1).max() * rng.normal(size=x.shape)
    moved = x + 0.002 * rng.normal(size=x.shape)
    face, vertex = (a.ravel() for a in np.mgrid[: len(triangles), : len(x)])
    corner = np.column_stack([vertex, triangles[face]])
    first, second = np.triu_indices(len(edges), 1)
    ends = np.column_stack([edges[first], edges[second]])
    corner, ends = (s[[len(set(row)) == 4 for row in s.tolist()]] for s in (corner, ends))

    def to_edge(p: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
        along = np.sum((p - a) * (b - a), axis=1) / np.sum((b - a) ** 2, axis=1)
        return np.linalg.norm(a + np.clip(along, 0.0, 1.0)[:, None] * (b - a) - p, axis=1)

    def distances(z: np.ndarray) -> np.ndarray:
        a, b, c, d = (z[column] for column in ends.T)
        at_ends = [to_edge(a, c, d), to_edge(b, c, d), to_edge(c, a, b), to_edge(d, a, b)]
        of_edges = np.min([closest_of_edges(z[ends]).distance, *at_ends], axis=0)
        return np.concatenate([closest_to_triangle(z[corner]).distance, of_edges])

    def found(start: np.ndarray, end: np.ndarray, reach: float) -> set[tuple[int, ...]]:
        face, edge = _kernels.Proximity(x, triangles, edges).pairs(start, end, reach)
        assert (np.diff(face) > 0).all() and (np.diff(edge) > 0).all()
        parts = [np.column_stack([face % len(x), triangles[face // len(x)]])]
        parts.append(edges[np.column_stack(np.divmod(edge, len(edges)))].reshape(-1, 4))
        return set(map(tuple, np.concatenate(parts).tolist()))

    everything = np.concatenate([corner, ends])
    for reach in (0.0, 0.0005, 0.002):
        near = everything[distances(moved) <= reach]
        assert found(moved, moved, reach) == set(map(tuple, near.tolist()))
    assert 100 < len(near) < 0.5 * len(everything)
    for share in np.linspace(0.0, 1.0, 9):
        there = everything[distances(x + share * (moved - x)) <= 0.0003]
        assert set(map(tuple, there.tolist())) <= found(x, moved, 0.0003)
    with pytest.raises(ValueError, match="index out of range"):
        _kernels.Proximity(x[:3], triangles, edges)
