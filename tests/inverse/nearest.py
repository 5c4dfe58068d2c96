"""Prints sag, smallest eigenvalue and largest rest displacement of a soft skirt's nearest stable shape."""

from inverse_shells import folded_skirt
from mpi4py import MPI

from voile.inverse.result import inverse_report
from voile.inverse.solve import InverseOptions, solve_inverse
from voile.problem.problem import Problem


def main() -> None:
    comm = MPI.COMM_WORLD
    shape = folded_skirt(24, 4, young=1e7) if comm.rank == 0 else None
    result = solve_inverse(Problem(shape, comm), shape, [], 0.0, InverseOptions())
    assert result.nearest is not None
    figures = result.nearest.sag, result.eigenvalue, inverse_report(result)["rest_displacement"]
    if comm.rank == 0:
        print(*(f"{figure:.12e}" for figure in figures))


if __name__ == "__main__":
    main()
