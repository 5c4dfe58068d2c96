"""What inverse design found: the rest shape with its proof, what to say of it, and its figures."""

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from voile.arrays import Reals
from voile.inverse.adjoint import NEAR, REASON, TIME, AdjointPath
from voile.inverse.bounds import area_range
from voile.inverse.direct import DirectPath
from voile.inverse.nearest_path import NearestPath
from voile.inverse.target import Target
from voile.inverse.verify import TIMED_OUT, Simulation
from voile.inverse.verify import sag as distance
from voile.problem.rest import PanelRest

FAR = 0.1  # sizes: a simulation that ends further from the target has nothing to do with it
STILL = 1e-6  # sizes, that a simulation from the nearest answer may move
SPREAD = 1e-3  # sizes, between equilibria that simulations from the target and from beside it find


@dataclass
class InverseResult:
    """A rest shape (`rest`: rest displacements and director angles on the problem's unknowns) and what it is worth.

    residual (N): of the balance at the target; nearest, adjoint: where the target itself is not stable, the search for
    the nearest stable answer; eigenvalue: smallest omega^2 (1/s^2), at the target or at that answer, with its `mode`,
    nan where none is found; simulation and disturbed: statics from the target and from beside it, `held` from the
    nearest answer under the full load, `closed` as a scene of statics, where that may end elsewhere, all to `tolerance`
    of the loads' norm; hovers: the first three keep gaps that matter; spread: sizes between the ends of the first two;
    seconds: of the search (`inverse`) and of certificate and simulations (`proof`).
    """

    target: Target
    rest: PETSc.Vec
    direct: DirectPath
    adjoint: AdjointPath | None
    residual: float
    eigenvalue: float
    mode: PETSc.Vec
    simulation: Simulation
    disturbed: Simulation
    seconds: dict[str, float]
    panels: PanelRest | None = None
    trade: list[dict[str, float | None]] | None = None
    nearest: NearestPath | None = None
    held: Simulation | None = None
    closed: Simulation | None = None
    hovers: bool = False
    guess: Reals | None = None
    tolerance: float = 0.0
    spread: float = field(init=False)

    def __post_init__(self) -> None:
        ends = self.simulation.path, self.disturbed.path
        both = ends[0].converged and ends[1].converged
        self.spread = distance(self.target, ends[1].state, ends[0].state) if both else 0.0

    @property
    def exact(self) -> bool:
        """Whether the target itself is in equilibrium with the rest shape."""
        return self.direct.converged and not (self.nearest or self.adjoint)

    @property
    def stable(self) -> bool:
        return self.eigenvalue > 0.0

    @property
    def converged(self) -> bool:
        """Whether the rest shape's simulation ends stable: in the target, or as near to it as was found."""
        found = self.direct.converged or self.nearest is not None or self.adjoint is not None
        fails = self._drifts or self._far or self._short
        return found and self.stable and self.simulation.stable and not fails

    @property
    def timed_out(self) -> bool:
        """Whether time ended any of the proof's simulations."""
        runs = self.simulation, self.disturbed, self.held, self.closed
        return any(run is not None and run.timed_out for run in runs)

    @property
    def _far(self) -> bool:
        return (self.nearest or self.simulation).sag > FAR

    @property
    def _drifts(self) -> bool:
        """Whether the nearest answer is none to the simulation, friction and contact included."""
        return self.held is not None and not (self.held.stable and self.held.sag <= STILL)

    @property
    def _short(self) -> bool:
        """Whether the nearest answer is one under a part of the load."""
        return self.nearest is not None and self.nearest.fraction < 1.0

    @property
    def reason(self) -> str:
        said, end, bounds = self._finding(), _end(self.simulation), self.target.bounds
        if self._far and end not in said:
            said += f"; it ends {end}"
        said += self._beside() + self._as_scene() + self._ended()
        return said if self.exact or bounds.last in said else said + bounds.told()

    def _beside(self) -> str:
        """Where the simulation from beside the target ends, if that is elsewhere."""
        if self.spread > SPREAD:
            return f"; the simulation from beside it ends elsewhere, {_end(self.disturbed)}"
        if self.disturbed.path.converged or not self.simulation.path.converged:
            return ""
        without = f"; {TIMED_OUT} from beside it", "; the simulation from beside it did not settle"
        return without[not self.disturbed.timed_out]

    def _as_scene(self) -> str:
        """Where a scene of statics ends, if that is farther off."""
        scene, closes = self.closed, " closes gaps and" * self.hovers
        if scene is None or (scene.stable and scene.sag <= self.simulation.sag + SPREAD):
            return ""
        if scene.timed_out:
            return f"; {TIMED_OUT} as a scene of statics"
        levels = any("nested" in method for method in scene.path.methods)
        what = "a scene of statics" + " by coarser levels (statics.nested)" * levels + closes
        return f"; {what} " + (f"ends {_end(scene)}" if scene.stable else "finds no stable equilibrium")

    def _ended(self) -> str:
        """That time ended the search, and how far the load got."""
        if self.adjoint and self.adjoint.reason == TIME:
            return "; inverse.max_seconds ended the search"
        if not (self.nearest and self.nearest.timed_out):
            return ""
        return f"; inverse.max_seconds ended the search at {self.nearest.fraction:.4g} of the load"

    def _finding(self) -> str:
        if not self.simulation.path.converged:
            without = "" if self.direct.converged else f"{self.direct.reason}; {self._kept()}; simulated, "
            why = f"{TIMED_OUT} from the target" if self.simulation.timed_out else self.simulation.path.reason
            return without + why
        leaves = "" if self.stays else "; a simulation from the target leaves it"
        if self.panels or self.trade:
            what = "flat panels" if self.panels else "developable rest shape"
            kind = "a stable" if self.stable else "an unstable"
            where = f"{_end(self.simulation)}{leaves}"
            return f"{what} with {kind} equilibrium {where}{self._more()}"
        leaves += f" and ends {_end(self.simulation)}" if leaves else ""
        if self.direct.converged:
            unstable = f"the target is unstable: {self._unstable()}"
            return "target in stable equilibrium" if self.stable else unstable
        if self.nearest:
            part = f" under {self.nearest.fraction:.4g} of the load" if self._short else ""
            size = f"sag {self.nearest.sag:.2e}, margin {self.nearest.margin:g} g/L"
            found = f"nearest stable answer found{part}, with {size}"
            if not self.nearest.fraction:
                found = "the search has not left the target without load, which is its own rest shape there"
            where = "; a simulation from it leaves it" if self._drifts else leaves
            if self.held and self.held.timed_out:
                where = f"; {TIMED_OUT} from it"
            return f"{found}{where}; exactly, {self.direct.reason}"
        if self.adjoint is None:
            return f"{self.direct.reason}; {self._kept()}"
        if not self.stable:
            return f"{self.direct.reason}; the nearest equilibrium found is unstable: {self._unstable()}"
        sag = f"with sag {self.adjoint.trail[-1].sag if leaves else self.simulation.sag:.2e}"
        return f"nearest stable answer found, {sag}{leaves}; exactly, {self.direct.reason}"

    def _kept(self) -> str:
        if self.nearest or self.adjoint:
            return "kept is the nearest found"
        return f"kept is the rest shape at {self.direct.fraction:.4g} of the load"

    def _more(self) -> str:
        reason = self.adjoint.reason if self.adjoint else None
        if reason == REASON.DIVERGED_MAXITS:
            return "; more inverse.iterations may come nearer"
        return (
            "; the search ended where further steps win little" if reason == REASON.CONVERGED_STEPTOL else ""
        )

    @property
    def stays(self) -> bool:
        """Whether a simulation from the target ends in the answer that a search found beside it."""
        sag = self.nearest.sag if self.nearest else self.adjoint.trail[-1].sag if self.adjoint else np.inf
        return self.simulation.sag <= NEAR * sag

    def _unstable(self) -> str:
        if math.isnan(self.eigenvalue):
            return "its smallest eigenvalue is not found"
        return f"smallest eigenvalue {self.eigenvalue:.3g} 1/s^2"


def _end(run: Simulation) -> str:
    """Where a simulation ends."""
    return f"{run.sag:.2g} sizes from the target"


def inverse_report(result: InverseResult) -> dict[str, Any]:
    """Figures for the summary: see the keys."""
    target, direct, adjoint = result.target, result.direct, result.adjoint
    problem = target.problem
    rest = problem.motion(result.rest)
    moved = np.linalg.norm(rest, axis=1)
    off = np.zeros(0) if result.guess is None else np.linalg.norm(rest - result.guess, axis=1)
    return {
        "load_fraction": direct.fraction,
        "critical_fraction": direct.critical,
        "residual_at_target": result.residual if result.exact else None,
        "sag": result.simulation.settled_sag,
        "sag_disturbed": result.disturbed.settled_sag,
        "sag_closed": (result.closed or result.simulation).settled_sag,
        "proof_timed_out": result.timed_out,
        "disturbance": result.disturbed.disturbance,
        "stable": result.stable,
        "smallest_eigenvalue": None if math.isnan(result.eigenvalue) else result.eigenvalue,
        "direct_iterations": direct.iterations,
        "nearest": _nearest(result),
        "adjoint_iterations": len(adjoint.steps) - 1 if adjoint else 0,
        "forward_solves": (adjoint.forward_solves if adjoint else 0) + 2,
        "adjoint_solves": adjoint.adjoint_solves if adjoint else 0,
        "rest_displacement": problem.comm.allreduce(float(moved.max(initial=0.0)), op=MPI.MAX),
        "rest_distance_to_guess": problem.comm.allreduce(float(off.max(initial=0.0)), op=MPI.MAX),
        "rest_area_ratio": area_range(result.panels or target.rest),
        "bounds": {"turned_away": target.bounds.breaches, "last": target.bounds.last or None},
        "reactions": _reactions(result),
        **(
            {"developability": result.trade, "largest_defect": result.trade[-1]["defect"]}
            if result.trade
            else {}
        ),
    }


def _nearest(result: InverseResult) -> dict[str, Any] | None:
    nearest, held = result.nearest, result.held
    if not nearest:
        return None
    return {
        "sag": nearest.sag,
        "margin": nearest.margin,
        "steps": len(nearest.steps),
        "moved": held.sag if held else None,
        "reached": result.simulation.stable and result.stays,
        "load_fraction": nearest.fraction,
        "timed_out": nearest.timed_out,
    }


def _reactions(result: InverseResult) -> dict[str, Any]:
    """What holds the target, or the nearest stable shape, over all ranks: contacts, active ones, least and largest
    of their gaps in the target (m), which simulations keep, the least margin to slip (share of friction's bound that is
    left) and the least friction that would do. Answers of the adjoint method have the simulation's reactions only."""
    target, comm = result.target, result.target.problem.comm
    own, body = target.own, target.on_obstacles()
    known = {"contacts": comm.allreduce(int(own.sum())), "least_friction": target.least_friction}
    if result.adjoint:
        return known | dict.fromkeys(("gaps", "bearing", "force", "least_margin"))
    normal, margin = target.margins()
    active = own & (normal > 0.0)
    return known | {
        "gaps": _range(target.gaps()[active], comm),
        "bearing": comm.allreduce(int(active.sum())),
        "force": comm.allreduce(target.reactions[own & body].sum(axis=0)),
        "least_margin": comm.allreduce(float(margin[active].min(initial=1.0)), op=MPI.MIN),
    }


def _range(values: Reals, comm: MPI.Comm) -> list[float]:
    """Least and largest over all ranks, at most and at least 0."""
    low, high = float(values.min(initial=0.0)), float(values.max(initial=0.0))
    return [comm.allreduce(low, op=MPI.MIN), comm.allreduce(high, op=MPI.MAX)]
