"""What the tables [[fix]] of a scene hold of its mesh, and how that moves; the cuts of its [[section]]s."""

from dataclasses import replace

import numpy as np

from voile.arrays import Ints, Reals, triangle_areas
from voile.contact.motion import Motion
from voile.errors import InputError
from voile.keys import Vector3
from voile.mesh import Surface, select
from voile.mesh.topology import Topology
from voile.problem.local_axes import Hold, frame_axes
from voile.problem.sections import Section
from voile.scene import Scene
from voile.scene.motion import motion_of
from voile.scene.moves import Move

GLOBAL = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0))
RIGHT = 1e-9  # cosine under which two directions are at right angles
ON_PLANE = 1e-9  # of the size: a vertex so near to a plane lies on it


def supports_of(
    scene: Scene, surface: Surface, topology: Topology, loops: list[Ints]
) -> tuple[list[Hold], Ints]:
    """What each table holds, and the clamped edges."""
    n, holds = len(surface.points), []
    clamped = np.zeros(len(topology.edges), dtype=bool)
    for k, fix in enumerate(scene.fix):
        where = f"{scene.path}: fix.{k}.select"
        vertices = select(surface, loops, fix.select, where)
        frame = frame_axes(fix.frame or GLOBAL)
        directions = frame[["xyz".index(axis) for axis in fix.axes]]
        move = np.zeros(3) if fix.move is None or _by_law(scene, fix.move) else fix.move.displacement @ frame
        holds.append(Hold(fix.name or f"fix {k}", vertices, directions, fix.clamp, move))
        if fix.clamp:
            inside = np.zeros(n, dtype=bool)
            inside[vertices] = True
            edges = inside[topology.edges].all(axis=1)
            if not edges.any():
                raise InputError(f"{where}: clamp = true needs at least one edge with both ends selected")
            clamped |= edges
    return holds, np.flatnonzero(clamped).astype(np.int32)


def sections_of(scene: Scene, surface: Surface, loops: list[Ints]) -> list[Section]:
    """The cuts of the scene's tables [[section]]."""
    sections = []
    for k, table in enumerate(scene.section):
        where = f"{scene.path}: section.{k}"
        areas = np.zeros((2, len(surface.points)))
        if table.select is not None:
            vertices = select(surface, loops, table.select, f"{where}.select")
        else:
            vertices, areas = _beyond(surface, np.array(table.point), np.array(table.normal))
        if not 0 < len(vertices) < len(surface.points):
            raise InputError(
                f"{where} has {len(vertices)} of {len(surface.points)} vertices inside; allowed: some, not all"
            )
        about = None if table.about is None else np.array(table.about)
        sections.append(Section(table.name or f"section {k}", vertices, about, areas))
    return sections


def _beyond(surface: Surface, point: Reals, normal: Reals) -> tuple[Ints, Reals]:
    """Vertices (k,) beyond a plane; areas (2, n) m^2 of those on it beyond, and in all, zero elsewhere."""
    height = (surface.points - point) @ normal / np.linalg.norm(normal)
    on = np.abs(height) < ON_PLANE * np.ptp(surface.points, axis=0).max()
    corners = surface.triangles
    area = np.repeat(triangle_areas(surface.points, corners), 3)
    beyond = area * np.repeat(height[corners].mean(axis=1) > 0.0, 3)
    whole = np.bincount(corners.ravel(), area, len(on))
    areas = np.stack([np.bincount(corners.ravel(), beyond, len(on)), whole])
    return np.flatnonzero((height > 0.0) & ~on), np.where(on, areas, 0.0)


def _by_law(scene: Scene, move: Move | None) -> bool:
    """Whether there is a motion that is no displacement in proportion to the load factor."""
    return move is not None and (scene.scene.task == "dynamics" or any(move.rotation))


def moves_of(scene: Scene, holds: list[Hold]) -> tuple[tuple[Ints, Motion], ...]:
    """The supports that rotate, in time all that move, and how. Raises InputError if two tables move a vertex, neither
    alike nor at right angles."""
    moves = []
    for k, (fix, hold) in enumerate(zip(scene.fix, holds, strict=True)):
        mine = hold.vertices
        for other, before in zip(scene.fix[:k], holds, strict=False):
            both = np.intersect1d(mine, before.vertices)
            across = np.abs(before.directions @ hold.directions.T).max() < RIGHT
            if not len(both) or across or not (_by_law(scene, fix.move) or _by_law(scene, other.move)):
                continue
            if fix.move != other.move or np.abs(before.projection - hold.projection).max() > RIGHT:
                raise InputError(
                    f"{scene.path}: fix.{k}.select: vertex {both[0]} is moved differently by another fix, "
                    f"{before.name}; allowed: the same motion, or directions at right angles"
                )
            mine = np.setdiff1d(mine, both)
        if fix.move and _by_law(scene, fix.move):
            moves.append((mine, motion_of(scene, _along_axes(fix.move, fix.frame))))
    return tuple(moves)


def _along_axes(move: Move, frame: tuple[Vector3, ...] | None) -> Move:
    """A motion along a table's axes, along the global ones."""
    axes = frame_axes(frame or GLOBAL)
    return replace(move, displacement=tuple(move.displacement @ axes), velocity=tuple(move.velocity @ axes))
