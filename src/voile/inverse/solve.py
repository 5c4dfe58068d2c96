"""Inverse design from start to end: rest shape, certificate of stability, and proof by simulation."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from voile.contact.obstacles import Obstacle
from voile.inverse.direct import Direct, DirectPath, DirectStep
from voile.inverse.target import Target
from voile.inverse.verify import Simulation, simulate
from voile.problem.discrete import Problem
from voile.problem.shell import Shell

Progress = Callable[[DirectStep], None]


@dataclass
class InverseOptions:
    """friction: reactions in Coulomb's cones, else along the normal; contact_tolerance (m): target vertices nearer
    than this to an obstacle may carry a reaction; tolerance: residual of simulations over the loads' norm."""

    friction: bool = True
    contact_tolerance: float = 1e-3
    tolerance: float = 1e-8


@dataclass
class InverseResult:
    """A rest shape (`rest`: rest displacements and director angles on the problem's unknowns) and what it is worth.

    residual (N): of the balance at the target; eigenvalue: smallest omega^2 (1/s^2) of the target, negative where it is
    unstable, with its `mode`; simulation and disturbed: statics from the target and from beside it.
    """

    target: Target
    rest: PETSc.Vec
    direct: DirectPath
    residual: float
    eigenvalue: float
    mode: PETSc.Vec
    simulation: Simulation
    disturbed: Simulation

    @property
    def stable(self) -> bool:
        return self.eigenvalue > 0.0

    @property
    def converged(self) -> bool:
        """Whether the target is a stable equilibrium of the rest shape under the full load."""
        return self.direct.converged and self.stable and self.simulation.path.converged

    @property
    def reason(self) -> str:
        if not self.direct.converged:
            return self.direct.reason
        if not self.stable:
            return f"the target is unstable: smallest eigenvalue {self.eigenvalue:.3g} 1/s^2"
        return (
            self.simulation.path.reason
            if not self.simulation.path.converged
            else "target in stable equilibrium"
        )


def solve_inverse(
    problem: Problem,
    shell: Shell | None,
    obstacles: list[Obstacle],
    offset: float,
    options: InverseOptions | None = None,
    on_step: Progress | None = None,
) -> InverseResult:
    """The rest shape that makes the problem's start shape (shell: rank 0's) a stable equilibrium on the obstacles,
    `offset` (m) from the mid-surface. Raises NotConverged where no reactions can hold it."""
    options = options or InverseOptions()
    target = Target(problem, shell, obstacles, offset, options.contact_tolerance, options.friction)
    path = Direct(target).follow(on_step)
    z = path.rest
    eigenvalue, mode = target.smallest(z)
    if path.mode is not None:
        mode = path.mode
    simulation = simulate(target, z, options.tolerance)
    disturbed = simulate(target, z, options.tolerance, disturbed=True)
    return InverseResult(target, z, path, path.residual, eigenvalue, mode, simulation, disturbed)


def inverse_report(result: InverseResult) -> dict:
    """Figures for the summary: see the keys."""
    target, direct = result.target, result.direct
    problem = target.problem
    low, high = target.rest.area_ratios()
    moved = np.linalg.norm(problem.motion(result.rest), axis=1)
    return {
        "load_fraction": direct.fraction,
        "critical_fraction": direct.critical,
        "residual_at_target": result.residual,
        "sag": result.simulation.sag,
        "sag_disturbed": result.disturbed.sag,
        "stable_at_target": result.stable,
        "smallest_eigenvalue_at_target": result.eigenvalue,
        "iterations": direct.iterations,
        "forward_solves": 2,
        "rest_displacement": problem.comm.allreduce(float(moved.max(initial=0.0)), op=MPI.MAX),
        "rest_area_ratio": [low, high],
        "reactions": _reactions(target),
    }


def _reactions(target: Target) -> dict:
    """What holds the target, over all ranks: contacts, those that bear, the least margin to slip (share of friction's
    bound that is left) and the least friction that would do."""
    comm = target.problem.comm
    own = target.problem.own[target.cones.vertex]
    normal, margin = target.margins()
    bears = own & (normal > 0.0)
    return {
        "contacts": comm.allreduce(int(own.sum())),
        "bearing": comm.allreduce(int(bears.sum())),
        "force": comm.allreduce(target.reactions[own].sum(axis=0)),
        "least_margin": comm.allreduce(float(margin[bears].min(initial=1.0)), op=MPI.MIN),
        "least_friction": target.least_friction,
    }
