"""Pressure that follows the surface, at load factor 1."""

from typing import NamedTuple

import numpy as np

from voile.arrays import Ints, Reals, area_vectors, sums
from voile.mesh.stitches import join
from voile.problem.partition import Part
from voile.problem.shell import Shell


class Rim(NamedTuple):
    """Where pressure ends, or changes: half edges (k,) 3 triangle + corner, input's numbers; jump (k,) Pa, that of
    their side less that of the other; origin (3,) m of volumes; potential: whether pressure has one."""

    half: Ints
    jump: Reals
    origin: Reals
    potential: bool

    def here(self, part: Part) -> tuple[Ints, Reals, Reals]:
        """Local ends (k, 2) and jumps (k,) of those that count on this rank, and the origin."""
        order = np.argsort(part.triangle, kind="stable")
        last = max(len(order) - 1, 0)
        own = order[np.minimum(np.searchsorted(part.triangle, self.half // 3, sorter=order), last)]
        counts = (part.triangle[own] == self.half // 3) & (part.weight[own] > 0.0)
        corner = self.half[counts, None] % 3 + [1, 2]
        return part.corners[own[counts, None], corner % 3], self.jump[counts], self.origin


def pressure_rim(shell: Shell) -> Rim:
    """The rim of a shell's pressure. Sewn borders with the same pressure on both sides are none.

    Pressure has the potential -p V, V the volume between the surface and its start, where no motion of the rim sweeps
    volume: each of its edges stays in a plane, as on planes of symmetry, or its ends slide along one axis at most, as
    those of a tube held across. Not looked for where supports hold along local axes.
    """
    n, corners = len(shell.points), shell.triangles
    label: Ints = np.arange(n)
    if len(shell.slave):
        label, _ = join(shell.stitches, n)
    start, end = corners[:, [1, 2, 0]].ravel(), corners[:, [2, 0, 1]].ravel()
    ends = np.sort(label[np.column_stack([start, end])].astype(np.int64), axis=1)
    pressure = shell.pressure + (0.0 if shell.patch_pressure is None else shell.patch_pressure)
    along = np.where(label[start] < label[end], 1.0, -1.0) * np.repeat(
        np.broadcast_to(pressure, len(corners)), 3
    )
    _, half, edge = np.unique(ends[:, 0] * n + ends[:, 1], return_index=True, return_inverse=True)
    jump: Reals = sums(edge.ravel(), along, edge.max() + 1)
    half, jump = half[jump != 0.0], jump[jump != 0.0]
    jump = np.where(label[start[half]] < label[end[half]], jump, -jump)
    rim = np.column_stack([start[half], end[half]])
    fixed, x = shell.fixed[rim], shell.points[rim]
    still = fixed & (shell.motion[rim] == 0.0)
    held = fixed.all(axis=(1, 2))
    plane = (still.all(axis=1) & (x[:, 0] == x[:, 1])).any(axis=1)
    line = (~still).any(axis=1).sum(axis=1) <= 1
    potential = bool((held | plane | line).all()) and shell.axes is None
    return Rim(half, jump, shell.points.mean(axis=0), potential)


def conservative(shell: Shell) -> bool:
    """Whether all loads have a potential; end moments never do."""
    return shell.moment is None and not (shell.pressed and not pressure_rim(shell).potential)


def pressure_energy(x: Reals, part: Part, rim: tuple[Ints, Reals, Reals]) -> float:
    """-p V (J), V up to a constant the volume between this rank's surface at x (vertices, 3) and its start: that of
    cones from the origin over its triangles, the sum of x0.(x1 x x2)/6, and over the ribbons that the rim sweeps. rim:
    as `Rim.here` has it."""
    ends, jump, origin = rim
    a, b = ends.T
    now, was = x - origin, part.points - origin
    return -float(
        (part.pressure * part.weight) @ _cones(*now[part.corners.T])
        + 0.5 * (jump @ (_ribbon(now[a], now[b], was[a], was[b]) - _ribbon(now[b], now[a], was[b], was[a])))
    )


def _ribbon(a: Reals, b: Reals, was_a: Reals, was_b: Reals) -> Reals:
    """(m,) volumes of cones over the two triangles that an edge sweeps, cut from b's new place to a's old one. Cut the
    other way a warped ribbon sweeps another volume, so which end counts first would tell: take the mean of both."""
    return _cones(b, a, was_a) + _cones(b, was_a, was_b)


def _cones(a: Reals, b: Reals, c: Reals) -> Reals:
    """(m,) signed volumes of tetrahedra with one corner at 0, the others (m, 3)."""
    volumes: Reals = np.einsum("ti,ti->t", a, np.cross(b, c)) / 6.0
    return volumes


def pressure_force(x: Reals, part: Part) -> Reals:
    """(3 vertices,) forces p A n / 3 at each corner (N)."""
    share = area_vectors(x, part.corners) * (part.pressure / 6.0)[:, None]
    force = np.zeros((len(part.vertex), 3))
    for k in range(3):
        np.add.at(force, part.corners[:, k], share)
    return force.ravel()
