"""What a mechanician reads of a shape, per triangle: membrane forces, bending moments, strains, stresses.

Forces and moments come from the derivatives of the model's own energy (Elastic::stresses), so they hold for every model
and material. With W_s the stretching energy of a triangle of rest area A, a its first form and d_1, d_2 its edges from
the first corner, n^ab = (2/A) dW_s/da_ab is the second Piola-Kirchhoff membrane force and n^ab d_a d_b A/area Cauchy's.
Moments take the second form in place of a/2; they are positive where they bend the side of the normals outwards.
"""

import numpy as np
from petsc4py import PETSc

from voile.arrays import Array, Ints, Reals
from voile.problem.problem import Problem

TENSOR = ((0, 1, 2, 0, 1, 0), (0, 1, 2, 1, 2, 2))  # VTK's order: xx yy zz xy yz xz


def shell_fields(problem: Problem, y: PETSc.Vec, names: tuple[str, ...]) -> tuple[dict[str, Reals], Ints]:
    """The cell fields of FIELDS' `names` at the triangles (k,) that count on this rank, and the triangles' indices in
    the input."""
    part, at = problem.part, problem.point(y)
    own = part.weight > 0.0
    energy, tension, moment = np.split(problem.kernel.stresses(at.u, at.phi), [2, 5], axis=1)
    _, angles = problem.kernel.invariants(at.u, at.phi)
    edges = _edges(at.positions[part.corners])
    rest = _edges(part.rest_points[part.rest_corners])
    area, rest_area = _area(edges), _area(rest)
    lengths = np.sqrt(np.einsum("eti,eti->te", edges, edges))
    slope = _slopes(problem.model.split("/")[1], angles)
    moment = moment * lengths / (4.0 * area[:, None] * slope)  # dW_b/dII_i, II_i = 2 altitude_i f(alpha_i)
    # a_11 = l_3, a_22 = l_2, 2 a_12 = l_2 + l_3 - l_1; b_11 = II_1 + II_2, b_12 = II_1, b_22 = II_1 + II_3
    n = 2.0 * np.stack([tension[:, 0] + tension[:, 2], tension[:, 0] + tension[:, 1], -tension[:, 0]], axis=1)
    m = np.stack([moment[:, 1], moment[:, 2], 0.5 * (moment[:, 0] - moment[:, 1] - moment[:, 2])], axis=1)
    force, bending = (_in_space(part_, edges) / area[:, None, None] for part_ in (n, m))
    thickness = part.fabric[0][:, None, None]
    surface = [force / thickness + side * 6.0 * bending / thickness**2 for side in (1.0, -1.0)]
    frame = _frame(edges)
    found: dict[str, Array] = {}
    if "membrane_force" in names:
        found |= {"membrane_force": _six(force), "principal_membrane_force": _principal(force, frame)}
    if "bending_moment" in names:
        found |= {"bending_moment": _six(bending), "principal_bending_moment": _principal(bending, frame)}
    if "strain" in names:
        found["principal_strain"] = _principal(_green(edges, rest), _frame(rest))
    if "fabric_strain" in names:
        found["fabric_strain"] = _along_axes(_green(edges, rest), rest, part.weave[:, :2])
    if "stress" in names:
        found |= dict(zip(("stress_top", "stress_bottom"), map(_six, surface), strict=True))
    if "von_mises" in names:
        found["von_mises"] = np.max([_von_mises(_principal(s, frame)) for s in surface], axis=0)
    if "energy_density" in names:
        parts = energy / rest_area[:, None]
        found["energy_density"] = parts.sum(axis=1)
        found["stretching_density"], found["bending_density"] = parts.T
    return {name: values[own] for name, values in found.items()}, part.triangle[own]


def _edges(corner: Reals) -> Reals:
    """(3, m, 3) the edges of triangles (m, 3, 3), each across from its corner."""
    return np.stack([corner[:, 2] - corner[:, 1], corner[:, 0] - corner[:, 2], corner[:, 1] - corner[:, 0]])


def _area(edges: Reals) -> Reals:
    found: Reals = 0.5 * np.linalg.norm(np.cross(edges[2], -edges[1]), axis=1)
    return found


def _frame(edges: Reals) -> Reals:
    """(m, 2, 3) an orthonormal basis of each triangle, the first along its edge from corner 0 to 1."""
    first = edges[2] / np.linalg.norm(edges[2], axis=1, keepdims=True)
    second = -edges[1] - np.einsum("ti,ti->t", -edges[1], first)[:, None] * first
    return np.stack([first, second / np.linalg.norm(second, axis=1, keepdims=True)], axis=1)


def _slopes(bending: str, angles: Reals) -> Reals:
    """(m, 3) f'(alpha) of a variant of bending; of other models, which are linear in small angles, 1."""
    cosine = np.cos(angles)
    return {"average": cosine, "sin": cosine, "tan": cosine**-2}.get(bending, np.ones_like(angles))


def _in_space(n: Reals, edges: Reals) -> Reals:
    """(m, 3, 3) n^ab d_a d_b of components (m, 3) 11, 22, 12."""
    d = np.stack([edges[2], -edges[1]], axis=1)
    found: Reals = np.einsum("tab,tai,tbj->tij", n[:, [[0, 2], [2, 1]]], d, d)
    return found


def _green(edges: Reals, rest: Reals) -> Reals:
    """(m, 3, 3) Green's strain, in space at the rest shape."""
    now, home = (np.stack([e[2], -e[1]], axis=1) for e in (edges, rest))
    metric = np.einsum("tai,tbi->tab", home, home)
    grown = 0.5 * (np.einsum("tai,tbi->tab", now, now) - metric)
    dual = np.linalg.solve(metric, home)
    found: Reals = np.einsum("tab,tai,tbj->tij", grown, dual, dual)
    return found


def _along_axes(strain: Reals, rest: Reals, warp: Reals) -> Reals:
    """(m, 3) extension along the warp, with components (m, 2) in the edges from the first corner, and along the weft,
    and the change of their angle."""
    first, side = warp[:, :1] * rest[2] - warp[:, 1:] * rest[1], np.cross(rest[2], -rest[1])
    second = np.cross(side, first)
    w, f = (v / np.linalg.norm(v, axis=1, keepdims=True) for v in (first, second))
    pairs = ((w, w, 1.0), (f, f, 1.0), (w, f, 2.0))
    return np.column_stack([factor * np.einsum("tij,ti,tj->t", strain, a, b) for a, b, factor in pairs])


def _principal(tensor: Reals, frame: Reals) -> Reals:
    """(m, 2) principal values of tensors (m, 3, 3) in the planes of frames (m, 2, 3), the larger first."""
    plane = np.einsum("tij,tai,tbj->tab", tensor, frame, frame)
    mean, half = 0.5 * (plane[:, 0, 0] + plane[:, 1, 1]), 0.5 * (plane[:, 0, 0] - plane[:, 1, 1])
    radius = np.hypot(half, plane[:, 0, 1])
    return np.column_stack([mean + radius, mean - radius])


def _von_mises(principal: Reals) -> Reals:
    first, second = principal.T
    found: Reals = np.sqrt(first**2 - first * second + second**2)
    return found


def _six(tensor: Reals) -> Reals:
    return tensor[:, *TENSOR]
