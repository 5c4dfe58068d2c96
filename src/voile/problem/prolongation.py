"""From a coarse level of a shell to the fine one: shapes, fields, loads."""

from functools import cached_property

import numpy as np
import scipy.sparse as sp
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import SuperLU, splu

from voile.arrays import Ints, Reals, triangle_areas, units
from voile.mesh.topology import build_topology, inside_out
from voile.problem.shell import Shell

TENSION = 0.01  # of the stiffness of a bend of one edge: makes the form definite, changes no shape
ROUNDS = 4  # of righting; everyday scenes need one, a crumpled dress not even eight


class Prolongation:
    """Carries shapes of a coarse mesh (nc vertices) to the fine one (nf) that it was made of.

    kept (nc,): fine vertex that each coarse one is. Every fine vertex lies at barycentric weights (nf, 3) of coarse
    vertices corners (nf, 3), in the rest shape; triangles (mc, 3): the coarse ones. `interpolate` and `gather` are
    linear in every triangle, `positions` is smooth across them.
    """

    def __init__(self, fine: Shell, kept: Ints, triangles: Ints, corners: Ints, weights: Reals):
        self._fine = fine
        self.kept, self.triangles, self.corners, self.weights = kept, triangles, corners, weights

    def interpolate(self, field: Reals) -> Reals:
        """(nf, ...) a coarse field (nc, ...), linear in every coarse triangle."""
        found: Reals = np.einsum("nk,nk...->n...", self.weights, field[self.corners])
        return found

    def gather(self, load: Reals) -> Reals:
        """(nc, ...) coarse loads that do the work of fine ones (nf, ...): the transpose of `interpolate`."""
        fine = np.repeat(np.arange(len(self.corners)), 3)
        shape = len(self.kept), len(self.corners)
        found: Reals = sp.csr_matrix((self.weights.ravel(), (self.corners.ravel(), fine)), shape=shape) @ load
        return found

    def restrict(self, field: Reals) -> Reals:
        """(nc, ...) a fine field (nf, ...) at the kept vertices."""
        return field[self.kept]

    def positions(self, coarse: Reals, load_factor: float | None = None) -> Reals:
        """(nf, 3) m the fine shape to a coarse one (nc, 3).

        Kept vertices are where the coarse ones are, but for those that would be inside out; between them the surface
        bends least, measured on the fine rest shape. What the start shape has beyond that turns with the surface, so a
        coarse start shape gives the fine one.
        With a load factor what is supported is where its supports take it.
        """
        start = start_shape(self._fine)
        home = start[self.kept]
        beyond = start - self._smooth(home)
        fine: Reals = self._smooth(coarse) + np.einsum("nij,nj->ni", self._turns(home, coarse), beyond)
        fine[self.kept] = coarse
        fine = self._righted(fine, start)
        if load_factor is not None:
            fine = np.where(self._fine.fixed, start + load_factor * self._fine.motion, fine)
        return fine

    def _righted(self, fine: Reals, start: Reals) -> Reals:
        """(nf, 3) a fine shape, but stars of vertices that it turns inside out, as beside a level's sharp folds, moved
        rigidly from the start, and then those around them while there are others: no later step would right them."""
        triangles = self._fine.triangles
        was, moved = inside_out(start, triangles), np.zeros(len(fine), dtype=bool)
        edges = np.roll(triangles, 1, axis=1).ravel(), triangles.ravel()
        near = sp.csr_matrix((np.ones(triangles.size), edges), shape=(len(fine),) * 2)
        near += near.T + sp.identity(len(fine), format="csr")
        turned = inside_out(fine, triangles) != was
        best, fewest = fine, turned.sum()
        for _ in range(ROUNDS):
            if fewest == 0:
                break
            moved = near @ (moved | turned) > 0
            rows, found = np.flatnonzero(moved), fine.copy()
            stars = connected_components(near[rows][:, rows], directed=False)[1]
            for star in range(stars.max() + 1):
                one = rows[stars == star]
                found[one] = _moved(start[one], fine[one])
            turned = inside_out(found, triangles) != was
            if turned.sum() < fewest:
                best, fewest = found, turned.sum()
        return best

    def _turns(self, home: Reals, coarse: Reals) -> Reals:
        """(nf, 3, 3) how the surface at the fine vertices turns from one coarse shape (nc, 3) to another: as the facets
        do, by area averaged at the coarse vertices, by weights between them."""
        before, after = (_bases(points[self.triangles]) for points in (home, coarse))
        area = np.linalg.norm(np.cross(before[:, :, 0], before[:, :, 1]), axis=1)
        facet = area[:, None, None] * _rotation(after @ np.linalg.inv(before))
        share = np.repeat(facet.reshape(-1, 9), 3, axis=0)
        place = sp.csr_matrix(
            (np.ones(self.triangles.size), (self.triangles.ravel(), np.arange(self.triangles.size))),
            shape=(len(coarse), self.triangles.size),
        )
        vertex = _rotation((place @ share).reshape(-1, 3, 3))
        return _rotation(self.interpolate(vertex))

    @cached_property
    def _system(self) -> tuple[Ints, SuperLU, sp.csr_matrix]:
        """Fine vertices that are not kept, the factor of their bending stiffness, its coupling to the kept ones."""
        loose = np.setdiff1d(np.arange(len(self.corners)), self.kept)
        rows = bending_form(self._fine)[loose]
        factor = splu(rows[:, loose].tocsc(), permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True})
        return loose, factor, rows[:, self.kept]

    def _smooth(self, coarse: Reals) -> Reals:
        """(nf, 3) the shape of least bending through coarse points (nc, 3)."""
        loose, factor, coupling = self._system
        fine = np.empty((len(self.corners), 3))
        fine[self.kept], fine[loose] = coarse, factor.solve(-(coupling @ coarse))
        return fine


def start_shape(shell: Shell) -> Reals:
    """(n, 3) where a shell starts: with its seams closed where that has been worked out."""
    return shell.points if shell.closing is None else shell.points + shell.closing


def bending_form(shell: Shell) -> sp.csr_matrix:
    """(n, n) quadratic form of bending of an isometrically deformed shell, on the rest shape's metric (Bergou et al.
    2006, "A quadratic bending model for inextensible surfaces"), with a little tension; linear fields have no energy.
    """
    corners = shell.rest_points[shell.rest_triangles]
    area = triangle_areas(shell.rest_points, shell.rest_triangles)
    one, two = np.roll(corners, -1, axis=1) - corners, np.roll(corners, 1, axis=1) - corners
    cotangent = np.einsum("tkd,tkd->tk", one, two) / (2.0 * area)[:, None]
    n, half = len(shell.points), np.arange(3 * len(area))
    # derivative across the edge opposite a corner, times its length: (e . e_k) / (2 area) by the corners
    ends = np.stack([half, *(3 * (half // 3) + (half + turn) % 3 for turn in (1, 2))], axis=1)
    flat = cotangent.ravel()
    slope = np.stack([-flat[ends[:, 1]] - flat[ends[:, 2]], flat[ends[:, 2]], flat[ends[:, 1]]], axis=1)
    vertex = shell.triangles.ravel()[ends]
    across = np.where(
        shell.topology.across < 0, build_topology(shell.triangles).across, shell.topology.across
    )
    hinge = np.flatnonzero(across.ravel() > half)
    other = across.ravel()[hinge]
    weight = np.sqrt(3.0 / (area[hinge // 3] + area[other // 3]))[:, None]
    values = np.hstack([slope[hinge], slope[other]]) * weight
    columns = np.hstack([vertex[hinge], vertex[other]])
    rows = np.repeat(np.arange(len(hinge)), 6)
    bend = sp.csr_matrix((values.ravel(), (rows, columns.ravel())), shape=(len(hinge), n))
    span = sp.csr_matrix(
        (np.tile([1.0, -1.0], len(half)), (np.repeat(half, 2), vertex[:, 1:].ravel())), shape=(len(half), n)
    )
    pull = TENSION / (2.0 * area.mean()) * flat
    return (bend.T @ bend + span.T @ sp.diags(pull) @ span).tocsr()


def _bases(corners: Reals) -> Reals:
    """(n, 3, 3) columns: two edges and the unit normal of triangles (n, 3, 3); the normal is none where there is no
    area."""
    one, two = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    return np.stack([one, two, units(np.cross(one, two))], axis=2)


def _moved(points: Reals, near: Reals) -> Reals:
    """(n, 3) points moved rigidly, as near as may be to others."""
    middle, there = points.mean(axis=0), near.mean(axis=0)
    rotation = _rotation(((near - there).T @ (points - middle))[None])[0]
    moved: Reals = there + (points - middle) @ rotation.T
    return moved


def _rotation(matrix: Reals) -> Reals:
    """(n, 3, 3) rotations nearest to matrices (n, 3, 3)."""
    left, _, right = np.linalg.svd(matrix)
    left[:, :, 2] *= np.linalg.det(left @ right)[:, None]
    return left @ right
