"""The square airbag inflated from flat: two square sheets joined at their edges, of which a quarter of one is modelled.

Side 0.8485 m (diagonal 1.2 m), E = 588 MPa, nu = 0.4, h = 0.6 mm, p = 5 kPa. Published heights of the centre: 0.205 to
0.218 m (Contri & Schrefler 1988, Eng. Comput. 5, 121-130, and after them), 0.217 m with wrinkling as tension field.
"""

from collections.abc import Callable
from functools import partial

import numpy as np
from mpi4py import MPI
from shells import Row, of_case, row

from voile.problem.problem import Problem
from voile.problem.shell import Shell
from voile.solver.path import Path, require
from voile.solver.statics import solve_statics
from voile.validate import shells as cases

HEIGHT = 0.217
MESHES = (8, 16, 32)


def airbag(
    n: int, model: str, material: str, diagonals: str = "crossed", pressure: float = 5e3
) -> tuple[Shell, int]:
    """A quarter of n x n cells on its planes of symmetry, its outer edges free to slide in the plane z = 0; centre."""
    case = cases.airbag(n, diagonals)
    if model != "koiter":
        case.clamped = []
    return of_case(case, model=model, material=material, pressure=pressure), case.marks["centre"]


def inflate(
    n: int, model: str, material: str, diagonals: str = "crossed", pressure: float = 5e3
) -> tuple[float, float, Path]:
    """Height of the centre (m), potential (J) and the path, with every setting at its default; raises NotConverged."""
    shell, centre = airbag(n, model, material, diagonals, pressure)
    problem = Problem(shell, MPI.COMM_SELF)
    path = require(solve_statics(problem))
    height = problem.positions(path.state)[np.flatnonzero(problem.part.vertex == centre)[0], 2]
    return float(height), sum(path.steps[-1].energies.values()), path


def refined(model: str, material: str, meshes=MESHES) -> list[Row]:
    """Height of the centre on finer and finer meshes."""
    name = f"square airbag, height ({model}, {material})"
    return [row(name, f"{n}x{n} crossed", inflate(n, model, material)[0], HEIGHT) for n in meshes]


CASES: dict[str, Callable[[], list[Row]]] = {
    f"square airbag: {model}, {material}": partial(refined, model, material)
    for material in ("tension-field", "stvk")
    for model in ("membrane", "koiter")
}
