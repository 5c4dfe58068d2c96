"""The rest shape as unknowns, on the layout of the displacements: dR/dX by the kernels' mixed derivatives."""

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from voile.problem.discrete import Blocks, Problem

FABRIC = ("thickness", "young", "poisson")  # the kernels' order


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
        self._area0 = self._areas(self.base)[0]
        self.set(zero)

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
        self.problem.assemble(matrix, self._blocks(y), at_vertices)

    def fabric_derivative(self, y: PETSc.Vec, name: str) -> PETSc.Vec:
        """dR/dp for one factor p on the thickness, Young's modulus (per unit, absolute), Poisson's ratio or density
        of all triangles: N per unit of p."""
        problem, part = self.problem, self.problem.part
        u, phi = problem._shape(y)
        m = len(part.corners)
        local = np.zeros((m, 21))
        if name in FABRIC:
            _, fabric, _ = problem.kernel.mixed(u, phi)
            local = np.einsum(
                "tki,tk->ti", problem.kernel.invariants_jacobian(u, phi), fabric[:, :, FABRIC.index(name)]
            )
        if name in ("thickness", "density"):
            thickness, _, _, density = part.fabric
            share = self._areas(part.rest_points)[0] / 3.0 * (density if name == "thickness" else thickness)
            local[:, :9] -= np.tile(problem.load_factor * problem.gravity, 3) * share[:, None]
        return problem.gather_triangles(local)

    def _blocks(self, y: PETSc.Vec) -> np.ndarray:
        """(m, 21, 21) per triangle: rows forces, columns rest positions of its corners and those across."""
        problem, part = self.problem, self.problem.part
        u, phi = problem._shape(y)
        kernel = problem.kernel
        q_rest, _, _ = kernel.mixed(u, phi)
        rest = kernel.rest_jacobian()
        rest[:, :, 18:] = 0.0
        blocks = np.matmul(kernel.invariants_jacobian(u, phi).transpose(0, 2, 1), np.matmul(q_rest, rest))
        thickness, _, _, density = part.fabric
        per_area = problem.load_factor * thickness * density / 3.0
        gradient = self._areas(part.rest_points)[1].reshape(-1, 9)
        force = np.tile(problem.gravity, 3)
        blocks[:, :9, :9] -= per_area[:, None, None] * force[None, :, None] * gradient[:, None, :]
        return np.ascontiguousarray(blocks)

    def _areas(self, rest: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(m,) areas of rest triangles and (m, 3, 3) their gradients by the corners."""
        x = rest[self.problem.part.rest_corners]
        normal = np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0])
        size = np.linalg.norm(normal, axis=1)
        unit = normal / np.maximum(size, 1e-300)[:, None]
        opposite = x[:, [2, 0, 1]] - x[:, [1, 2, 0]]
        return 0.5 * size, 0.5 * np.cross(unit[:, None, :], opposite)

    def area_ratios(self) -> tuple[float, float]:
        """Least and largest area of a rest triangle over that of the base."""
        ratio = self._areas(self.problem.part.rest_points)[0] / self._area0
        comm = self.problem.comm
        return comm.allreduce(float(ratio.min()), op=MPI.MIN), comm.allreduce(float(ratio.max()), op=MPI.MAX)
