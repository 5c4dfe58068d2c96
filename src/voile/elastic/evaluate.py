"""One shape, one call: energy and derivatives without a scene, for checks and for other programs."""

from dataclasses import dataclass, field

import numpy as np
import scipy.sparse

from voile import _kernels
from voile.arrays import Ints, Reals
from voile.elastic.models import model_name
from voile.errors import InputError
from voile.mesh.topology import Topology, build_topology


@dataclass
class Evaluation:
    """Elastic energy (J) of a shape and its derivatives; see `evaluate` for n, m, edges."""

    energy: float
    stretching_energy: float
    bending_energy: float
    gradient: Reals  # (n, 3), N
    edge_gradient: Reals  # (edges,), N m per radian
    edges: Ints  # (edges, 2)
    hessian: scipy.sparse.csr_matrix | None = None
    """(3n + edges) square; unknown 3*vertex + axis, then edges"""
    mixed: scipy.sparse.csr_matrix | None = None
    """d2E/dx dX, (3n + edges, 3n): rest coordinates in the columns"""
    parameters: dict[str, Reals] = field(default_factory=dict)
    """dE/dp per triangle (m,) for p = thickness, young, poisson"""
    mixed_parameters: dict[str, scipy.sparse.csr_matrix] = field(default_factory=dict)
    """d2E/dx dp, (3n + edges, m)"""


def evaluate(
    rest: Reals,
    current: Reals,
    triangles: Ints,
    *,
    thickness: float | Reals,
    young: float | Reals,
    poisson: float | Reals,
    model: str = "koiter",
    bending: str = "tan",
    material: str = "stvk",
    weave: Reals | None = None,
    edge_angles: Reals | None = None,
    hessian: bool | str = False,
    mixed: bool = False,
) -> Evaluation:
    """Elastic energy of `current` (n, 3) against `rest` (n, 3), both in metres, with the same `triangles` (m, 3).

    thickness (m), young (Pa) and poisson are numbers or one value per triangle; edge_angles (edges,) are the
    director angles phi in radians, None means zero; edges are sorted by their smaller, then their larger vertex.
    weave (m, 9): for material = "orthotropic", as `weave_rows` gives it; None: isotropic for poisson = 0.
    hessian: True for the exact one, "safe" for the positive semidefinite one. mixed adds the derivatives with
    respect to the rest coordinates and the material parameters.

    Energies as in Chen et al. (2018), "Physical simulation of environmentally induced thin shell deformation".
    Raises InputError for wrong shapes, values out of range and meshes that are not edge-manifold and oriented.
    """
    rest, current = _points("rest", rest), _points("current", current)
    given, triangles = np.asarray(triangles), np.ascontiguousarray(triangles, dtype=np.int32)
    if (given != triangles).any():
        raise InputError("triangles are not all integers below 2^31; indices of vertices from 0 are expected")
    if rest.shape != current.shape:
        raise InputError(f"rest has shape {rest.shape}, current {current.shape}: the same is expected")
    if triangles.ndim != 2 or triangles.shape[1] != 3 or not len(triangles):
        raise InputError(f"triangles have shape {triangles.shape}; (m, 3) with m > 0 is expected")
    if triangles.min() < 0 or triangles.max() >= len(rest):
        raise InputError(f"triangles refer to vertices outside 0..{len(rest) - 1}")
    topology = build_topology(triangles)
    _check_manifold(topology)
    kernel = _kernels.Elastic(
        model_name(model, bending, material),
        triangles,
        topology.triangle_edges,
        topology.signs,
        topology.across,
        len(topology.edges),
        rest,
    )
    kernel.set_rest(rest, triangles, False)
    kernel.set_fabric(*_fabric(len(triangles), thickness, young, poisson))
    if weave is not None:
        kernel.set_weave(np.ascontiguousarray(weave, dtype=float))
    u = current - rest
    phi = np.zeros(len(topology.edges)) if edge_angles is None else np.array(edge_angles, dtype=float)
    if phi.shape != (len(topology.edges),):
        raise InputError(f"edge_angles have shape {phi.shape}; ({len(topology.edges)},) is expected")
    if np.any(phi) and not kernel.directors:
        raise InputError(f"edge_angles: model {model!r} with bending {bending!r} has no director angles")
    gradient, edge_gradient = np.zeros_like(rest), np.zeros(len(phi))
    stretching, bent = kernel.gradient(u, phi, gradient, edge_gradient)
    result = Evaluation(stretching + bent, stretching, bent, gradient, edge_gradient, topology.edges)
    if hessian:
        result.hessian = _hessian(kernel, u, phi, "safe" if hessian == "safe" else "exact")
    if mixed:
        _add_mixed(result, kernel, u, phi, triangles, topology)
    return result


def _points(name: str, points: Reals) -> Reals:
    points = np.array(points, dtype=float)
    if points.ndim != 2 or points.shape[1] != 3:
        raise InputError(f"{name} has shape {points.shape}; (n, 3) is expected")
    if not np.isfinite(points).all():
        raise InputError(
            f"{name}: vertex {np.flatnonzero(~np.isfinite(points).all(axis=1))[0]} is not finite"
        )
    return points


def _check_manifold(topology: Topology) -> None:
    """Each half edge's twin must name it back, run the other way, and no edge may have a third triangle."""
    count = np.bincount(topology.triangle_edges.ravel(), minlength=len(topology.edges))
    direction = np.bincount(topology.triangle_edges.ravel(), weights=topology.signs.ravel())
    for bad, what in (
        (count > 2, "more than two triangles"),
        ((count == 2) & (direction != 0), "two triangles of opposite orientation"),
    ):
        if bad.any():
            i, j = topology.edges[np.flatnonzero(bad)[0]]
            raise InputError(f"triangles: the edge between vertices {i} and {j} has {what}")


def _fabric(
    count: int, thickness: Reals | float, young: Reals | float, poisson: Reals | float
) -> list[Reals]:
    values = []
    for name, value, low, high in (
        ("thickness", thickness, 0.0, np.inf),
        ("young", young, 0.0, np.inf),
        ("poisson", poisson, -1.0, 0.5),
    ):
        array = np.asarray(value, dtype=float)
        if array.shape not in ((), (count,)):
            raise InputError(f"{name} has shape {array.shape}; a number or ({count},) is expected")
        if not ((array > low) & (array < high)).all():
            raise InputError(f"{name}: between {low:g} and {high:g} (exclusive) is allowed")
        values.append(np.ascontiguousarray(np.broadcast_to(array, count)))
    return values


def _hessian(kernel: _kernels.Elastic, u: Reals, phi: Reals, kind: str) -> scipy.sparse.csr_matrix:
    """The Hessian in all degrees of freedom: the assembly of the solver with nothing eliminated."""
    size = u.size + len(phi)
    identity = np.arange(size + 1, dtype=np.int32)
    scatter = _kernels.Scatter(kernel, kernel.directors, size, identity, identity[:-1], np.ones(size))
    start, column = scatter.pattern(np.arange(size))
    start, values, none = start.astype(np.int32), np.zeros(len(column)), np.zeros(0, dtype=np.int32)
    scatter.bind(start, column, values, none, none, np.zeros(0), none)
    kernel.hessian(u, phi, kind, scatter)
    return scipy.sparse.csr_matrix((values, column, start), shape=(size, size))


def _jacobian(
    values: Reals, corners: Ints, triangles: Ints, topology: Topology, columns: int
) -> scipy.sparse.csr_matrix:
    """Per-triangle dq/dx (m, 6, 21) as a sparse (6m, columns) matrix; `corners` numbers the vertices."""
    m, vertices = len(triangles), int(corners.max()) + 1
    other = corners.ravel()[np.maximum(topology.across, 0)]  # without a neighbour the values are zero
    nodes = np.concatenate([corners, other], axis=1)
    dofs = np.concatenate(
        [
            (3 * nodes[:, :, None] + np.arange(3)).reshape(m, 18),
            columns - len(topology.edges) + topology.triangle_edges,
        ],
        axis=1,
    )
    if columns <= 3 * vertices:  # rest shape: no directors
        dofs, values = dofs[:, :18], values[:, :, :18]
    row = np.broadcast_to(np.arange(6 * m).reshape(m, 6, 1), values.shape)
    column = np.broadcast_to(dofs[:, None, :], values.shape)
    return scipy.sparse.csr_matrix((values.ravel(), (row.ravel(), column.ravel())), shape=(6 * m, columns))


def _add_mixed(
    result: Evaluation, kernel: _kernels.Elastic, u: Reals, phi: Reals, triangles: Ints, topology: Topology
) -> None:
    """d2E/dx dX = J(x)^T W_(q q_rest) J(X); the same with W_(q p) for the parameters p."""
    m = len(triangles)
    q_rest, q_fabric, fabric = kernel.mixed(u, phi)
    j = _jacobian(kernel.invariants_jacobian(u, phi), triangles, triangles, topology, u.size + len(phi))
    j_rest = _jacobian(kernel.rest_jacobian(), triangles, triangles, topology, u.size)
    blocks = scipy.sparse.bsr_matrix((q_rest, np.arange(m), np.arange(m + 1)), shape=(6 * m, 6 * m))
    result.mixed = (j.T @ blocks @ j_rest).tocsr()
    for k, name in enumerate(("thickness", "young", "poisson")):
        result.parameters[name] = fabric[:, k]
        column = scipy.sparse.bsr_matrix(
            (q_fabric[:, :, k : k + 1], np.arange(m), np.arange(m + 1)), shape=(6 * m, m)
        )
        result.mixed_parameters[name] = (j.T @ column).tocsr()
