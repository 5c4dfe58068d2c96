"""The rest shape as unknowns, on the layout of the displacements: dR/dX by the kernels' mixed derivatives."""

from functools import cached_property

import numpy as np
import scipy.sparse as sp
from petsc4py import PETSc

from voile.arrays import Flags, Reals, area_vectors
from voile.problem.matrix import Blocks
from voile.problem.partition import Part
from voile.problem.problem import Problem
from voile.problem.triangles import gather_triangles, spread_triangles

STILL = 0.1  # weight of panels' mean square displacement over the size, beside that of their strain
FABRIC = ("thickness", "young", "poisson")  # the kernels' order


def _fill(z: PETSc.Vec, values: Reals) -> None:
    """Writes rank 0's values, where all of z is. The others write their nothing: PETSc keeps norms of what was not
    written to, and would wait for ranks that have them."""
    z.array[:] = values.ravel()[: z.local_size]


def field_vector(problem: Problem, field: Reals) -> PETSc.Vec:
    """A displacement field (local vertices, 3) on the unknowns: what held and sewn vertices do is left out."""
    vector = problem.create_vector()
    vector.array[:] = problem.layout.along(np.concatenate([field.ravel(), np.zeros(len(problem.part.edge))]))
    return vector


def rest_areas(part: Part) -> tuple[Reals, Reals]:
    """(m,) areas of the rest triangles and (m, 3, 3) their gradients by the corners."""
    x = part.rest_points[part.rest_corners]
    normal = area_vectors(part.rest_points, part.rest_corners)
    size = np.linalg.norm(normal, axis=1)
    unit = normal / np.maximum(size, 1e-300)[:, None]
    opposite = x[:, [2, 0, 1]] - x[:, [1, 2, 0]]
    return 0.5 * size, 0.5 * np.cross(unit[:, None, :], opposite)


def rest_edges(part: Part) -> Reals:
    """(m, 3) lengths of the rest triangles' edges."""
    x = part.rest_points[part.rest_corners]
    found: Reals = np.linalg.norm(x - np.roll(x, 1, axis=1), axis=2)
    return found


class RestDerivative:
    """dR/dX per triangle at the state y, masses included, by the kernels' products.

    left (m, 6, 21): invariants by corners, vertices across edges and directors; right (m, 6, 18): rest invariants by
    rest positions of corners and vertices across; masses (m, 9): of a third of the triangle by its corners (kg/m).
    """

    def __init__(self, problem: Problem, y: PETSc.Vec):
        part, self.kernel = problem.part, problem.kernel
        self.shape = problem.shape(y)
        self.left = self.kernel.invariants_jacobian(*self.shape)
        self.right = self.kernel.rest_jacobian()[:, :, :18]
        thickness, _, _, density = part.fabric
        per_area = thickness * density / 3.0
        self.masses = per_area[:, None] * rest_areas(part)[1].reshape(-1, 9)
        self.gravity = np.tile(problem.loads.gravity_at(problem.time), 3)

    @cached_property
    def middle(self) -> Reals:
        """(m, 6, 6) second derivatives of the energy by the invariants and the rest invariants. They cost more than
        a forward solve's tangent, so `pull` does without, for a gradient alone."""
        found: Reals = self.kernel.mixed(*self.shape)[0]
        return found

    def blocks(self) -> Reals:
        """(m, 21, 21): rows forces, columns rest positions; those of directors are zero."""
        blocks = np.zeros((len(self.left), 21, 21))
        blocks[:, :, :18] = np.matmul(self.left.transpose(0, 2, 1), np.matmul(self.middle, self.right))
        blocks[:, :9, :9] -= self.gravity[:, None] * self.masses[:, None, :]
        return blocks

    def push(self, motion: Reals) -> Reals:
        """(m, 21) forces (N) from rest displacements (m, 18) of corners and vertices across (m)."""
        rate = np.matmul(self.middle, np.matmul(self.right, motion[:, :, None]))
        force: Reals = np.matmul(rate.transpose(0, 2, 1), self.left)[:, 0]
        force[:, :9] -= np.sum(self.masses * motion[:, :9], axis=1)[:, None] * self.gravity
        return force

    def pull(self, motion: Reals) -> Reals:
        """(m, 18): displacements and turns (m, 21) times the derivative."""
        rate = np.matmul(self.left, motion[:, :, None])[:, :, 0]
        if "middle" in self.__dict__:
            rate = np.matmul(rate[:, None], self.middle)[:, 0]
        else:
            rate = self.kernel.mixed_along(*self.shape, rate)
        slope: Reals = np.matmul(rate[:, None], self.right)[:, 0]
        slope[:, :9] -= (motion[:, :9] @ self.gravity)[:, None] * self.masses
        return slope


class RestShape:
    """Rest positions X = base + C z of a problem: sewn as the shell is, and held where it is held.

    z is a vector of the problem's unknowns; its director entries are none of the rest shape's. `base` (local rest
    vertices, 3) is the rest shape at z = 0 (m): the problem's shape at unknowns zero (`target`), or the rest shape that
    it came with.
    """

    def __init__(self, problem: Problem, target: bool = True):
        self.problem = problem
        part = problem.part
        self.vertex = np.empty(len(part.rest_points), dtype=np.int64)  # of the shell, per rest vertex
        self.vertex[part.rest_corners.ravel()] = part.corners.ravel()
        zero = problem.create_vector()
        self.base = problem.positions(zero)[self.vertex] if target else part.rest_points.copy()
        self.is_vertex = np.zeros(part.owned, dtype=bool)
        columns = part.matrix[: 3 * len(part.vertex)].indices
        self.is_vertex[columns[columns < part.owned]] = True
        self.set(zero)
        self._area0, self._edge0 = rest_areas(part)[0], rest_edges(part)
        self._derivative: RestDerivative | None = None
        self._matrix: PETSc.Mat | None = None
        self._assembled = False

    def set(self, z: PETSc.Vec) -> None:
        """Gives the problem the rest shape of z, with its masses."""
        self.problem.set_rest(self.base + self.problem.motion(z)[self.vertex])

    def state(self, z: PETSc.Vec) -> PETSc.Vec:
        """The problem's unknowns at its start shape, with z's director angles."""
        y = z.copy()
        y.array[self.is_vertex] = 0.0
        return y

    def jacobian(self, y: PETSc.Vec, matrix: PETSc.Mat, at_vertices: Blocks = ()) -> None:
        """Writes dR/dX at the state y to a `create_matrix` matrix, masses included; director columns are zero.
        at_vertices: (indices, (p, 3, 3) N/m) to be added."""
        self.problem.assemble(matrix, RestDerivative(self.problem, y).blocks(), at_vertices)

    def fabric_derivative(self, y: PETSc.Vec, name: str) -> PETSc.Vec:
        """dR/dp for one factor p on the thickness, Young's modulus (per unit, absolute), Poisson's ratio or density
        of all triangles: N per unit of p."""
        problem, part = self.problem, self.problem.part
        u, phi = problem.shape(y)
        m = len(part.corners)
        local = np.zeros((m, 21))
        if name in FABRIC:
            _, fabric, _ = problem.kernel.mixed(u, phi)
            local = np.einsum(
                "tki,tk->ti", problem.kernel.invariants_jacobian(u, phi), fabric[:, :, FABRIC.index(name)]
            )
        if name in ("thickness", "density"):
            thickness, _, _, density = part.fabric
            share = rest_areas(part)[0] / 3.0 * (density if name == "thickness" else thickness)
            local[:, :9] -= np.tile(problem.loads.gravity_at(problem.time), 3) * share[:, None]
        return gather_triangles(problem, local)

    def ratios(self) -> tuple[Reals, Reals]:
        """Areas (m,) and edges (m, 3) of rest triangles over those of the base."""
        part = self.problem.part
        return rest_areas(part)[0] / self._area0, rest_edges(part) / self._edge0

    # ---- as design variables ----

    def create(self) -> PETSc.Vec:
        """A zero vector of design variables."""
        return self.problem.create_vector()

    def weight(self) -> PETSc.Vec:
        """Their diagonal metric, of sum 1 in each direction: the lumped mass."""
        weight = self.problem.mass()
        weight.array[~self.is_vertex] = 0.0
        weight.scale(3.0 / weight.sum())
        return weight

    def linearise(self, y: PETSc.Vec) -> None:
        """Takes dR/dX at the state y for `push` and `pull`; assembled where `push` is asked for, as products then
        are."""
        self._derivative, self._assembled = RestDerivative(self.problem, y), False

    def push(self, v: PETSc.Vec) -> PETSc.Vec:
        """dR/dX v (N)."""
        assert self._derivative is not None
        if self._matrix is None:
            self._matrix = self.problem.create_matrix()
            self._matrix.setOption(PETSc.Mat.Option.SYMMETRIC, False)
        if not self._assembled:
            self.problem.assemble(self._matrix, self._derivative.blocks())
            self._assembled = True
        force = v.duplicate()
        self._matrix.mult(v, force)
        return force

    def pull(self, w: PETSc.Vec) -> PETSc.Vec:
        """w^T dR/dX."""
        assert self._derivative is not None
        if self._matrix and self._assembled:
            out = w.duplicate()
            self._matrix.multTranspose(w, out)
        else:
            slope = np.zeros((len(self.problem.part.corners), 21))
            slope[:, :18] = self._derivative.pull(spread_triangles(self.problem, w))
            out = gather_triangles(self.problem, slope)
        out.array[~self.is_vertex] = 0.0
        return out

    def idle(self) -> Flags:
        """(own,) marks entries that are no design variables."""
        return ~self.is_vertex


class PanelRest:
    """Plane panels as rest shape: 2D coordinates base + z, developable by construction and without rest curvature.

    base (p, 2) m: of all panel vertices, on every rank; z holds two numbers for each of them, on rank 0. The problem's
    shell must have the panels as rest shape.
    """

    def __init__(self, problem: Problem, base: Reals):
        self.problem, self.base = problem, base
        self._derivative: RestDerivative | None = None
        self.set(self.create())
        self._area0, self._edge0 = self._signed(), rest_edges(problem.part)

    def create(self) -> PETSc.Vec:
        """A zero vector of design variables."""
        size = self.base.size
        here = size if self.problem.comm.rank == 0 else 0
        return PETSc.Vec().createMPI((here, size), comm=self.problem.comm)

    def coordinates(self, z: PETSc.Vec) -> Reals:
        """(p, 2) the panels' coordinates (m), on every rank."""
        return self.base + self._everywhere(z)

    def take(self, z: PETSc.Vec, coordinates: Reals) -> None:
        """Makes z that of panels with coordinates (p, 2) m."""
        _fill(z, coordinates - self.base)

    def _everywhere(self, z: PETSc.Vec) -> Reals:
        found: Reals = self.problem.comm.bcast(z.array_r.copy()).reshape(self.base.shape)
        return found

    def set(self, z: PETSc.Vec) -> None:
        """Gives the problem the panels of z, with their masses."""
        points = np.zeros((len(self.problem.part.rest_vertex), 3))
        points[:, :2] = self.coordinates(z)[self.problem.part.rest_vertex]
        self.problem.set_rest(points, flat=True)

    def _signed(self) -> Reals:
        part = self.problem.part
        return 0.5 * area_vectors(part.rest_points, part.rest_corners)[:, 2]

    def ratios(self) -> tuple[Reals, Reals]:
        """Areas (m,), negative where turned over, and edges (m, 3) of rest triangles over those of the base."""
        return self._signed() / self._area0, rest_edges(self.problem.part) / self._edge0

    def weight(self) -> PETSc.Vec:
        """Their diagonal metric, of sum 1 in each direction."""
        weight = self.create()
        weight.set(2.0 / self.base.size)
        return weight

    def metric(self) -> PETSc.Mat:
        """Quadratic form of design variables: the mean square of the strain that they put into the panels, with a
        little of their displacements over the size. A wide smooth change is as near in it as a small rough one."""
        form = self.problem.comm.reduce(self._strain_form())
        size = self.base.size
        here = 0 if form is None else size
        still = STILL / (0.5 * size * self.problem.size() ** 2)
        form = sp.csr_matrix((0, size)) if form is None else (form + still * sp.identity(size)).tocsr()
        matrix = PETSc.Mat().createAIJ(
            ((here, size), (here, size)), csr=(form.indptr, form.indices, form.data), comm=self.problem.comm
        )
        matrix.setOption(PETSc.Mat.Option.SPD, True)
        return matrix

    def _strain_form(self) -> sp.csr_matrix:
        """Of this rank's triangles."""
        part = self.problem.part
        corners, area = part.rest_vertex[part.rest_corners], self._area0 * part.weight
        x = self.base[corners]
        opposite = np.roll(x, 1, axis=1) - np.roll(x, -1, axis=1)
        slope = np.stack([-opposite[..., 1], opposite[..., 0]], axis=-1) / (2.0 * self._area0)[:, None, None]
        strain = np.zeros((len(corners), 3, 3, 2))  # e11, e22, sqrt(2) e12 by corner and axis
        strain[:, 0, :, 0], strain[:, 1, :, 1] = slope[..., 0], slope[..., 1]
        strain[:, 2] = slope[..., ::-1] / np.sqrt(2.0)
        strain *= np.sqrt(area / self.problem.comm.allreduce(area.sum()))[:, None, None, None]
        column = np.broadcast_to((2 * corners[:, :, None] + np.arange(2))[:, None], strain.shape)
        row = np.repeat(np.arange(3 * len(corners)), 6)
        by_variable = sp.csr_matrix(
            (strain.ravel(), (row, column.ravel())), shape=(3 * len(corners), self.base.size)
        )
        return (by_variable.T @ by_variable).tocsr()

    def linearise(self, y: PETSc.Vec) -> None:
        """Takes dR/dX at the state y for `push` and `pull`."""
        self._derivative = RestDerivative(self.problem, y)

    def push(self, v: PETSc.Vec) -> PETSc.Vec:
        """dR/dX v (N)."""
        assert self._derivative is not None
        part = self.problem.part
        moved = np.zeros((len(part.corners), 6, 3))
        moved[:, :3, :2] = self._everywhere(v)[part.rest_vertex][part.rest_corners]
        return gather_triangles(self.problem, self._derivative.push(moved.reshape(-1, 18)))

    def pull(self, w: PETSc.Vec) -> PETSc.Vec:
        """w^T dR/dX."""
        assert self._derivative is not None
        part, out = self.problem.part, self.create()
        slope = self._derivative.pull(spread_triangles(self.problem, w))[:, :9].reshape(-1, 3, 3)[:, :, :2]
        slope *= part.weight[:, None, None]  # each triangle on one rank
        total = np.zeros_like(self.base)
        np.add.at(total, part.rest_vertex[part.rest_corners], slope)
        total = self.problem.comm.allreduce(total)
        _fill(out, total)
        return out

    def idle(self) -> Flags:
        """(own,) marks entries that are no design variables: none."""
        return np.zeros(self.base.size if self.problem.comm.rank == 0 else 0, dtype=bool)
