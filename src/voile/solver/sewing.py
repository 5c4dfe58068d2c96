"""Closing the seams of panels that start apart, before supports and loads act."""

from dataclasses import replace

import numpy as np
from mpi4py import MPI

from voile.problem.problem import Problem
from voile.problem.scales import slow_rate
from voile.problem.shell import Shell, seam_gaps
from voile.solver.linear import use_cholesky
from voile.solver.methods.descent import Descent
from voile.solver.methods.descent import Options as DescentOptions
from voile.solver.methods.method import Workspace
from voile.solver.methods.steps import Step
from voile.solver.multigrid import asked

MODEL = "discrete-shells//"  # finite at any fold and stiffer the sharper it is, no edge unknowns
STIFFENING = 10.0  # of the thickness at equal stretching stiffness: seams close in smooth folds
LOOK_BACK, SETTLED = 5, 0.02  # done when the energy fell by less than this fraction in so many steps
MOST_STEPS = 60


def _edge(shell: Shell) -> float:
    """Mean length of the start shape's edges (m)."""
    ends = shell.points[shell.topology.edges]
    return float(np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1).mean())


def sew(shell: Shell | None, comm: MPI.Comm) -> Shell | None:
    """The shell of rank 0 with the displacement that sews it as `closing`; unchanged if its seams gape less than an
    edge: then it is draped already, and the smallest displacement that closes them will do (see constraints).

    The panels are drawn together smoothly and then relaxed, free of supports and loads, until their elastic energy
    settles; supports later hold their vertices where these have come to be. A start for statics, not an equilibrium.
    """
    open_seams = comm.bcast(seam_gaps(shell).max(initial=0.0) > _edge(shell) if shell else None)
    if not open_seams:
        return shell
    loose = None
    if shell is not None:
        loose = replace(
            shell,
            model=MODEL,
            thickness=STIFFENING * shell.thickness,
            young=shell.young / STIFFENING,
            density=shell.density / STIFFENING,
            fixed=np.zeros_like(shell.fixed),
            motion=np.zeros_like(shell.motion),
            clamped_edges=np.zeros(0, dtype=np.int32),
            gravity=np.zeros(3),
            pressure=0.0,
            patch_pressure=None,
            force=None,
            moment=None,
            springs=None,
            bars=None,
            welds=None,
        )
    # Panels that are drawn together lie through each other at first.
    problem = Problem(loose, comm).with_passing_hinges()
    work = Workspace(problem)
    if asked():  # levels are for load steps, of the sewn shell
        use_cholesky(work.symmetric.ksp.pc)
    descent = Descent(work, DescentOptions(shift=slow_rate(problem)))
    y = problem.create_vector()
    descent.run(problem, y, 0.0, MOST_STEPS, settled=_settled)
    u, _ = problem.local(y)
    own = problem.part.owned_vertices
    pieces = comm.gather((problem.part.vertex[own], u.reshape(-1, 3)[own]))
    if shell is None or pieces is None:
        return None
    closing = np.zeros_like(shell.points)
    for index, displacement in pieces:
        closing[index] = displacement
    return replace(shell, closing=closing)


def _settled(steps: list[Step]) -> bool:
    if len(steps) <= LOOK_BACK:
        return False
    before, now = steps[-1 - LOOK_BACK].energy, steps[-1].energy
    return before - now < SETTLED * abs(now)
