"""Rigid motions that the supports leave: what would make the equilibrium undetermined, said before solving."""

from dataclasses import replace

import numpy as np
import scipy.sparse as sp
from scipy.sparse.csgraph import connected_components

from voile.arrays import Ints, Reals, triangle_areas, triangle_sides, units
from voile.errors import InputError
from voile.problem.shell import Shell

AXES = "xyz"


def check_supports(shell: Shell) -> None:
    """Raises InputError where a piece of the shell (sewn pieces count as one) may move rigidly without its load
    holding it: any translation; the turn about the vertical of a hanging piece; any rotation without a load."""
    found = _loose(shell)
    for vertices, text in found:
        if text:
            which = (
                f"the piece with vertex {vertices[0]} ({len(vertices)} vertices)"
                if len(found) > 1
                else "the shell"
            )
            raise InputError(
                f"fix: {which} is free to move rigidly: {text}; add supports ([[fix]]) that prevent it"
            )


def holds_a_piece(shell: Shell) -> bool:
    """Whether supports hold one of several pieces, on which others may come to rest."""
    found = _loose(shell)
    return len(found) > 1 and not all(text for _, text in found)


def _loose(shell: Shell) -> list[tuple[Ints, str]]:
    """The vertices of each piece and how it may move rigidly without its load holding it, empty where it may not."""
    pieces = pieces_of(shell)
    found: list[tuple[Ints, str]] = []
    for piece in range(pieces.max() + 1):
        vertices = np.flatnonzero(pieces == piece)
        modes = _free_modes(shell, vertices)
        found.append((vertices, _describe(shell, modes) if len(modes) else ""))
    return found


def free_motions(shell: Shell) -> Reals:
    """(n, 3, k) rigid motions that the supports leave to the shell's pieces, about each piece's centre, rotations over
    its size: displacements of order 1."""
    pieces, found = pieces_of(shell), []
    for piece in range(pieces.max() + 1):
        vertices = np.flatnonzero(pieces == piece)
        x = shell.points[vertices]
        arm = (x - x.mean(axis=0)) / max(float(np.ptp(x, axis=0).max()), 1e-300)
        for mode in _free_modes(shell, vertices):
            motion = np.zeros((len(shell.points), 3))
            motion[vertices] = mode[:3] + np.cross(mode[3:], arm)
            found.append(motion)
    return np.stack(found, axis=2) if found else np.zeros((len(shell.points), 3, 0))


def hinged_parts(shell: Shell) -> list[tuple[Ints, Ints]]:
    """Parts of the shell without supports that hang on the rest by one vertex or two alone, about which they turn
    freely: those and all the part's."""
    t, n = shell.triangles, len(shell.points)
    edge = np.unique(triangle_sides(t), axis=0, return_inverse=True)[1].ravel()
    across = sp.csr_matrix((np.ones(len(edge)), (np.repeat(np.arange(len(t)), 3), edge)))
    count, part = connected_components(across @ across.T, directed=False)
    member = sp.csr_matrix((np.ones(t.size), (np.repeat(part, 3), t.ravel())), shape=(count, n)).astype(bool)
    joint = np.asarray(member.sum(axis=0)).ravel() > 1
    joint[np.concatenate([shell.slave, shell.first, shell.second])] = True
    found = []
    for k in range(count if count > 1 else 0):
        vertices = member[k].indices
        at = vertices[joint[vertices]]
        if 1 <= len(at) <= 2 and not shell.fixed[vertices].any():
            found.append((at, vertices))
    return found


def without_flaps(shell: Shell, parts: list[tuple[Ints, Ints]]) -> Shell:
    """The shell with hinged parts out of its balance: they have no stiffness, and their joints carry their weight in
    equal shares. What belongs to nothing else is held where it is."""
    t = shell.triangles
    flap, force = np.zeros(len(t), dtype=bool), np.zeros(shell.points.shape)
    area = triangle_areas(shell.rest_points, shell.rest_triangles)
    for joints, vertices in parts:
        own = np.isin(t, vertices).all(axis=1)
        flap |= own
        mass = float((shell.density * shell.thickness * area)[own].sum())
        force[joints] += mass * np.asarray(shell.gravity) / len(joints)
    kept = np.concatenate([t[~flap].ravel(), shell.slave, shell.first, shell.second])
    idle = np.setdiff1d(t[flap], kept)
    fixed = shell.fixed.copy()
    fixed[idle] = True
    return replace(
        shell,
        young=np.where(flap, 0.0, shell.young),
        density=np.where(flap, 0.0, shell.density),
        fixed=fixed,
        clamped_edges=np.union1d(shell.clamped_edges, shell.topology.triangle_edges[flap]).astype(np.int32),
        force=force if shell.force is None else shell.force + force,
    )


def pieces_of(shell: Shell) -> Ints:
    """(n,) index of each vertex's piece; vertices of no triangle are pieces of their own."""
    n = len(shell.points)
    t = shell.triangles
    pairs = [t[:, [0, 1]], t[:, [1, 2]], np.column_stack([shell.slave, shell.first])]
    pairs.append(np.column_stack([shell.slave, shell.second]))
    if shell.bars is not None:
        pairs.append(shell.bars[:, :2].astype(np.int64))
    pair = np.concatenate(pairs)
    graph = sp.csr_matrix((np.ones(len(pair)), (pair[:, 0], pair[:, 1])), shape=(n, n))
    found: Ints = connected_components(graph, directed=False)[1]
    return found


def _free_modes(shell: Shell, vertices: Ints) -> Reals:
    """(k, 6) basis of the rigid motions (translation, rotation times size) that the supports allow."""
    x = shell.points[vertices]
    centre, size = x.mean(axis=0), max(float(np.ptp(x, axis=0).max()), 1e-300)
    rows = [np.zeros((1, 6))]
    held = shell.held[vertices]
    if shell.springs is not None:
        held = held + (shell.springs[vertices] > 0.0)[:, :, None] * np.eye(3)
    for axis in range(3):
        r = (x - centre) / size
        rows.append(np.column_stack([held[:, axis], np.cross(r, held[:, axis])]))
    edge = shell.topology.edges[shell.clamped_edges]
    edge = edge[np.isin(edge[:, 0], vertices)]
    along = shell.points[edge[:, 1]] - shell.points[edge[:, 0]]
    along /= np.linalg.norm(along, axis=1, keepdims=True) if len(along) else 1.0
    rows.append(np.column_stack([np.zeros_like(along), along]))
    gram = sum(r.T @ r for r in rows)
    values, vectors = np.linalg.eigh(gram)
    found: Reals = vectors[:, values < 1e-12 * max(values[-1], 1.0)].T
    return found


def _describe(shell: Shell, modes: Reals) -> str:
    """What of the free modes the load does not hold; empty if it holds all."""
    gravity = np.asarray(shell.gravity, dtype=float)
    loaded = bool(gravity.any() or shell.pressed or shell.force is not None or shell.moment is not None)
    # combinations of the modes that do not rotate
    u, s, _ = np.linalg.svd(modes[:, 3:])
    still = u[:, np.sum(s > 1e-9) :].T @ modes
    if len(still):
        return "translation along " + ", ".join(sorted(_direction(m[:3]) for m in still))
    if not loaded:
        return (
            "rotation about "
            + ", ".join(_direction(m[3:]) for m in modes)
            + ", and there is no load to hold it"
        )
    if gravity.any() and not (shell.pressed or shell.force is not None or shell.moment is not None):
        down = units(gravity / np.abs(gravity).max())  # the square of gravity may be no number
        turned = np.linalg.lstsq(modes[:, 3:].T, down, rcond=None)[0] @ modes
        if np.linalg.norm(turned[3:] - down) < 1e-9 and abs(turned[:3] @ down) < 1e-9:
            return f"rotation about the direction of gravity, {_direction(down)}"
    return ""


def _direction(v: Reals) -> str:
    v = v / max(float(np.linalg.norm(v)), 1e-300)
    k = int(np.argmax(np.abs(v)))
    if abs(v[k]) > 1.0 - 1e-9:
        return AXES[k]
    return "(" + ", ".join(f"{c:.3g}" for c in v) + ")"
