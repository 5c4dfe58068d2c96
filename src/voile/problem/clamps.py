"""Clamped edges: the unit vector that keeps a director from turning."""

import numpy as np

from voile.arrays import Flags, Ints, Reals, area_vectors, units
from voile.elastic import model_of
from voile.errors import InputError
from voile.problem.local_axes import principal
from voile.problem.shell import Shell

LEVEL = 1e-6  # sine of an angle between normals that are one
IN_PLACE = 1e-9  # of the shell's size: the rest shape lies where the start shape does


def held_directors(shell: Shell, directors: bool = True) -> tuple[Reals, Reals]:
    """What holds the directors of both sides of every clamped edge: (k, 7) rows of half edge, flags conormal and at
    rest (see Clamp in elastic.hpp), unit vector, angle; and the director angles (edges,) of the start shape.

    The director is that of the start shape (on an inner edge the bisector of the two normals). A boundary whose
    rest shape lies where the start shape is held is at rest in the clamp as it lies there. With all
    axes of the edge's ends supported it cannot move; with some free (a plane of symmetry, a guided edge)
    what is held is the director or the edge's in-plane normal, whichever lies along the supported axes. An
    edge in a plane of symmetry keeps the angle at which the start shape meets that plane (triangles
    inscribed in a curved shell never meet it at a right angle): the axis is held, the director angle makes
    up the difference, which needs a model with directors. Raises InputError where nothing suits.
    """
    topology = shell.topology
    angles = np.zeros(len(topology.edges))
    if not (len(shell.clamped_edges) and model_of(shell.model).bends):
        return np.zeros((0, 7)), angles
    clamped = np.zeros(len(topology.edges), dtype=bool)
    clamped[shell.clamped_edges] = True
    stiff = np.repeat(shell.young > 0.0, 3)  # what has no stiffness holds nothing
    half = np.flatnonzero(clamped[topology.triangle_edges.ravel()] & stiff)
    angle = np.zeros(len(half))
    normal = units(area_vectors(shell.points, shell.triangles))
    triangle, corner = half // 3, half % 3
    start = shell.triangles[triangle, (corner + 1) % 3]
    end = shell.triangles[triangle, (corner + 2) % 3]
    along = units(shell.points[end] - shell.points[start])
    other = topology.across.ravel()[half]
    neighbour = normal[np.where(other >= 0, other // 3, triangle)]
    director = units(normal[triangle] + neighbour)
    at_rest = (other < 0) & _lies_at_rest(shell, triangle, corner)
    conormal = np.cross(along, director)
    # in axes of what both ends leave free
    axes, free = principal(2.0 * np.eye(3) - shell.held[start] - shell.held[end])
    along, director, conormal = (np.einsum("kai,ki->ka", axes, v) for v in (along, director, conormal))
    slides = free.any(axis=1)
    loose_director = np.abs(director * free).max(axis=1)
    loose_conormal = np.abs(conormal * free).max(axis=1)
    use_conormal = ~slides | (loose_conormal < loose_director)
    if directors:
        axis, meets = _plane_of_symmetry(free, along, conormal, np.minimum(loose_conormal, loose_director))
        tilt = np.arctan2(np.einsum("ij,ij->i", axis, -director), np.einsum("ij,ij->i", axis, conormal))
        angle[meets] = -tilt[meets]
        angles[topology.triangle_edges.ravel()[half[meets]]] = (topology.signs.ravel()[half] * angle)[meets]
        conormal[meets], loose_conormal[meets], use_conormal[meets] = axis[meets], 0.0, True
    loose = np.where(use_conormal, loose_conormal, loose_director)
    if (slides & (loose > 1e-6)).any():
        k = np.flatnonzero(slides & (loose > 1e-6))[0]
        raise InputError(
            f"fix: the edge between vertices {start[k]} and {end[k]} is clamped but may slide, and neither "
            "its normal nor its in-plane normal lies along the supported axes; support all axes there, or "
            "only that across a plane of symmetry that holds the edge (a shell that does not meet it at a right "
            "angle needs bending = sin, tan or theta)"
        )
    vector = np.einsum("kai,ka->ki", axes, np.where(use_conormal[:, None], conormal, director))
    return np.column_stack([half, use_conormal, at_rest, vector, angle]), angles


def clamp_laws(shell: Shell, clamps: Reals) -> Reals:
    """Rows (k, 8) of clamps, those of `held_directors` and the index in shell.moves of the motion that they turn with,
    -1 where none does: where it rotates both ends of their edges. Raises InputError where the rest shape is at rest in
    such a clamp but not level in it."""
    law, half = np.full(len(clamps), -1), clamps[:, 0].astype(np.int64)
    ends = np.column_stack([shell.triangles[half // 3, (half + turn) % 3] for turn in (1, 2)])
    for k, (vertices, motion) in enumerate(shell.moves):
        if motion.turns:
            law[np.isin(ends, vertices).all(axis=1)] = k
    clamps = np.column_stack([clamps, law])
    turned = np.flatnonzero((law >= 0) & (clamps[:, 2] > 0.0))
    if len(turned):
        start, rest = (
            units(area_vectors(x, t)[half[turned] // 3])
            for x, t in ((shell.points, shell.triangles), (shell.rest_points, shell.rest_triangles))
        )
        if np.abs(start - rest).max() > LEVEL:
            raise InputError(
                f"fix: the clamp of vertices {ends[turned[0]].tolist()} rotates; allowed: with a rest shape that "
                "starts level in it"
            )
        clamps[turned, 2] = 0.0  # level: it has no angle to the clamp
    return clamps


def _lies_at_rest(shell: Shell, triangle: Ints, corner: Ints) -> Flags:
    """(k,) whether both ends of an edge are held on all axes and lie in the rest shape where they start."""
    near = IN_PLACE * np.ptp(shell.points, axis=0).max()
    there = np.ones(len(triangle), dtype=bool)
    for k in (1, 2):
        vertex = shell.triangles[triangle, (corner + k) % 3]
        rest = shell.rest_points[shell.rest_triangles[triangle, (corner + k) % 3]]
        off = np.abs(rest - shell.points[vertex]).max(axis=1, initial=0.0)
        there &= shell.fixed[vertex].all(axis=1) & (off <= near)
    return there


def _plane_of_symmetry(free: Flags, along: Reals, conormal: Reals, loose: Reals) -> tuple[Reals, Flags]:
    """The one supported axis towards the conormal (k, 3), and where (k,) an edge lies in the plane across it
    at an angle that is not right (nothing else to hold: loose) but less than 45 degrees off."""
    axis = ~free * np.where(conormal < 0.0, -1.0, 1.0)
    across = np.abs(np.einsum("ij,ij->i", axis, along)) < 1e-6
    steep = np.einsum("ij,ij->i", axis, conormal) > np.sqrt(0.5)
    return axis, (free.sum(axis=1) == 2) & across & steep & (loose > 1e-12)
