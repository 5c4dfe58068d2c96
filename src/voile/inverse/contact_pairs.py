"""Where the target touches: its contacts with an obstacle or, in layers, with itself."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import dijkstra

from voile.arrays import Flags, Ints, Reals
from voile.contact.candidates import Layers, closest
from voile.contact.contact import Contact
from voile.contact.interfaces import ObstacleContact, SelfContact
from voile.contact.pairs import Geometry


@dataclass
class ContactPairs:
    """The c contacts with one partner (number `index` of Contact's) at the target, over s vertices each: their
    Geometry, with gaps (m) before any offset; code (c,): what the partner knows them by; own (c,) marks those counted
    on this rank."""

    index: int
    partner: ObstacleContact | SelfContact
    geometry: Geometry
    code: Ints
    own: Flags

    def __len__(self) -> int:
        return len(self.code)

    @property
    def gap(self) -> Reals:
        return self.geometry.gap

    @property
    def gradient_norm(self) -> Reals:
        """(c,) lengths of the gap's gradient."""
        found: Reals = np.linalg.norm(self.geometry.gradient, axis=1)
        return found

    @property
    def normal(self) -> Reals:
        """(c, 3) unit normals."""
        return self.geometry.gradient / self.gradient_norm[:, None]

    def bent(self) -> Reals:
        """(c, 3s, 3s) the gap's Hessian over its gradient's length (1/m)."""
        return self.geometry.curvature / self.gradient_norm[:, None, None]

    @property
    def stencil(self) -> Ints:
        """The vertices that reactions act on: (c,) local ones on an obstacle, else (c, s) of all vertices."""
        vertex = self.geometry.vertex
        return vertex[:, 0] if vertex.shape[1] == 1 else vertex

    def least(self, values: Reals) -> Reals:
        """(local vertices,) the least of the values (c,) of a vertex's contacts, infinite without any."""
        return self.partner.least(self.geometry.vertex, self.geometry.weight, values)

    def along(self) -> Reals:
        """(local vertices,) distance (m) along edges from the nearest contact between layers."""
        partner, vertex = self.partner, self.geometry.vertex[self.geometry.weight != 0.0]
        assert isinstance(partner, SelfContact)
        if not len(vertex):
            return np.full(len(partner.here), np.inf)
        x, (i, j) = partner.layers.points, partner.layers.edges.T
        links = sparse.csr_matrix((np.linalg.norm(x[j] - x[i], axis=1), (i, j)), shape=(len(x), len(x)))
        found: Reals = dijkstra(links, directed=False, indices=np.unique(vertex), min_only=True)[partner.here]
        return found

    def relative(self, field: Reals) -> Reals:
        """(c, 3, ...) of a field (local vertices, 3, ...): its value at a vertex on an obstacle, its jump between
        layers."""
        wide = self.partner.gather(field)
        found: Reals = np.einsum("cs,cs...->c...", self.geometry.weight, wide[self.geometry.vertex])
        return found

    def spread(self, reaction: Reals) -> Reals:
        """(local vertices, 3) forces of reactions (c, 3)."""
        total = np.zeros((len(self.partner.free), 3))
        forces = self.geometry.weight[:, :, None] * reaction[:, None]
        np.add.at(total, self.geometry.vertex, forces)
        return self.partner.restrict(total)

    def over_vertices(self, block: Reals) -> Reals:
        """(c, 3s, 3s) what blocks (c, 3, 3) of `relative` are over the vertices."""
        weight = self.geometry.weight
        size = 3 * weight.shape[1]
        found: Reals = np.einsum("cs,ct,cij->csitj", weight, weight, block).reshape(len(self), size, size)
        return found


def find_contact_pairs(contact: Contact, x: Reals, tolerance: float) -> list[ContactPairs]:
    """What is nearer than `tolerance` (m) to touching at x (local vertices, 3) m, one entry per partner."""
    found = [_on_obstacle(contact, k, x, tolerance) for k in range(len(contact.obstacles))]
    return [*found, _on_itself(contact, x, tolerance)] if contact.itself else found


def _on_obstacle(contact: Contact, k: int, x: Reals, tolerance: float) -> ContactPairs:
    partner, history = contact.partners[k], contact.history
    assert isinstance(partner, ObstacleContact)
    near = np.flatnonzero((partner.gaps(x, 0.0, history) < tolerance) & partner.free)
    geometry = partner.geometry(near, x, 0.0, history)
    geometry.gap += partner.offset[near]
    return ContactPairs(k, partner, geometry, near, partner.counted(near, history))


def _on_itself(contact: Contact, x: Reals, tolerance: float) -> ContactPairs:
    """Of a vertex and triangles only where it is nearest: what surrounds that place holds nothing beside it. And of all
    pairs only as many as are independent."""
    partner = contact.itself
    assert partner is not None
    wide, layers, index = partner.gather(x), partner.layers, len(contact.obstacles)
    found = layers.find(wide, further=tolerance)
    c, split = closest(found, wide), found.faces
    near = (c.distance < layers.thickness + tolerance) & partner.free[found.vertex].any(axis=1)
    near[:split] &= _nearest(found.vertex[:split], c.weight[:split], c.distance[:split])
    rows = np.flatnonzero(near)
    rows = rows[_independent(found.vertex[rows], c.weight[rows], np.count_nonzero(rows < split))]
    history = replace(contact.history, candidates=found)
    geometry = partner.geometry(rows, wide, 0.0, history)
    geometry.gap += layers.thickness
    return ContactPairs(index, partner, geometry, found.code[rows], partner.counted(rows, history))


def _nearest(vertex: Ints, weight: Reals, distance: Reals) -> Flags:
    """(p,) of pairs of a vertex and a triangle (p, 4): none whose closest point another triangle of that vertex has,
    too, and comes nearer, or as near and before it."""
    best: dict[tuple[int, ...], tuple[float, int]] = {}
    mine = []
    for row, (first, *corners) in enumerate(vertex.tolist()):
        for count in range(1, 8):  # each choice of corners
            key = (first, *sorted(c for k, c in enumerate(corners) if count >> k & 1))
            best[key] = min(best.get(key, (np.inf, -1)), (distance[row], row))
        mine.append((first, *sorted(c for c, w in zip(corners, weight[row, 1:], strict=True) if w != 0.0)))
    return np.array([best[key][1] == row for row, key in enumerate(mine)], dtype=bool)


def _independent(vertex: Ints, weight: Reals, faces: int) -> Flags:
    """(p,) marks pairs (p, 4), the first `faces` of a vertex and a triangle, then edges, of which none follows from the
    others: a vertex leans on what does not lean on it, and edges on each other where no such pair joins them.

    As of master and slave in mortar methods (Wriggers 2006), chosen pair by pair.
    """
    leans: set[tuple[int, int]] = set()
    chosen = np.zeros(len(vertex), dtype=bool)
    for row in np.argsort(vertex[:faces, 0], kind="stable"):
        first, *corners = vertex[row].tolist()
        on = [(first, c) for c, w in zip(corners, weight[row, 1:], strict=True) if w != 0.0]
        if leans.isdisjoint((c, first) for _, c in on):
            chosen[row] = True
            leans.update(on)
    for row in range(faces, len(vertex)):
        a, b, c, d = vertex[row].tolist()
        across = [(i, j) for i in (a, b) for j in (c, d)]
        if (weight[row] != 0.0).all() and leans.isdisjoint(across + [(j, i) for i, j in across]):
            chosen[row] = True
            leans.update(across)
    return chosen


def clearances(layers: Layers, x: Reals, clearance: float) -> dict[int, float]:
    """By code, the distance (m) that pairs at x (all n vertices, 3) nearer than their thickness keep: `clearance` (m)
    less than they have."""
    found = layers.find(x, further=clearance)
    distance = closest(found, x).distance - clearance
    near = distance < layers.thickness
    return dict(zip(found.code[near].tolist(), distance[near].tolist(), strict=True))
