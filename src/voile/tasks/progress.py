"""What a run says while it runs."""

from __future__ import annotations

import os
import sys
import time
from typing import TYPE_CHECKING

from voile.errors import printable

if TYPE_CHECKING:
    from mpi4py import MPI

    from voile.inverse.adjoint import AdjointStep
    from voile.inverse.direct import DirectStep
    from voile.inverse.nearest_path import NearestStep
    from voile.solver.path import LoadStep
    from voile.solver.path_in_time import TimeStep


class Progress:
    """Live on a terminal, plain lines (at most one every few seconds between steps) elsewhere."""

    QUIET = 5.0  # s between lines of a batch log

    def __init__(self, comm: MPI.Comm, quiet: bool = False):
        self.comm = comm
        self.parameter = "load"  # what problems are at
        self.quiet = quiet or comm.rank != 0
        self.live = sys.stdout.isatty() and comm.size == 1  # mpirun lends its ranks a terminal
        self.began = self.last = time.perf_counter()

    def line(self, text: str) -> None:
        """A line that stays."""
        if not self.quiet:
            self._print(("\r\033[K" if self.live else "") + printable(text))

    def _print(self, text: str, end: str = "\n") -> None:
        """A run goes on when nobody reads what it says any more, or the disk of its log is full."""
        try:
            print(text, end=end, flush=True)
        except OSError:
            self.quiet = True
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())

    def iteration(self, factor: float, iteration: int, residual: float) -> None:
        """One Newton iteration at a load factor."""
        now = time.perf_counter()
        if self.quiet or (not self.live and now - self.last < self.QUIET):
            return
        self.last = now
        text = (
            f"{self.parameter} {factor:.4f}  Newton {iteration:3d}  residual {residual:.2e} N  "
            f"{now - self.began:.1f} s"
        )
        self._print(f"\r\033[K{text}" if self.live else f"  ... {text}", "" if self.live else "\n")

    def time_step(self, step: TimeStep, duration: float) -> None:
        """One step in time, at most one line a while but for the last."""
        now = time.perf_counter()
        if self.quiet or (step.time < duration and now - self.last < (0.1 if self.live else self.QUIET)):
            return
        self.last, speed = now, step.time / (now - self.began)
        text = (
            f"time {step.time:.4g} of {duration:.4g} s  step {step.length:.2e} s  Newton {step.iterations}  residual "
            f"{step.residual:.2e} N (<= {step.tolerance:.2e})  fastest {step.speed:.3g} m/s  {_touching(step)}"
            f"{speed:.3g} s/s, {(duration - step.time) / speed:.0f} s to go"
        )
        if self.live and step.time < duration:
            self._print(f"\r\033[K{text}", "")
        else:
            self.line(text)

    def fraction(self, step: DirectStep) -> None:
        """One step of the rest shape's continuation."""
        self.line(
            f"load {step.fraction:.4f}  rest shape in {step.iterations} iterations  residual {step.residual:.2e} N  "
            f"stable  {time.perf_counter() - self.began:.1f} s"
        )

    def nearest(self, step: NearestStep) -> None:
        """One step to the nearest stable shape."""
        self.line(
            f"load {step.fraction:.4f}  nearest stable shape  sag {step.sag:.2e}  smallest eigenvalue "
            f"{step.eigenvalue:.3g} 1/s^2  {time.perf_counter() - self.began:.1f} s"
        )

    def optimisation(self, step: AdjointStep) -> None:
        """One iteration of the adjoint method."""
        self.line(
            f"adjoint {step.iteration:3d}  objective {step.objective:.3e}  gradient {step.gradient:.2e}  "
            f"sag {step.sag:.2e}  {time.perf_counter() - self.began:.1f} s"
        )

    def estimate(self, iteration: int, misfit: float, values: dict[str, float]) -> None:
        """One iteration of an estimation."""
        shown = ", ".join(f"{name} = {value:.6g}" for name, value in values.items())
        self.line(
            f"estimate {iteration:3d}  misfit {misfit:.3e} m  {shown}  {time.perf_counter() - self.began:.1f} s"
        )

    def step(self, step: LoadStep) -> None:
        """One converged load step."""
        energy = sum(step.energies.values())
        self.line(
            f"load {step.factor:.4f}  Newton {step.iterations:3d}  residual {step.residual:.2e} N "
            f"(<= {step.tolerance:.2e})  energy {energy:.6e} J  {_touching(step)}"
            f"{time.perf_counter() - self.began:.1f} s"
        )


def _touching(step: LoadStep | TimeStep) -> str:
    """What a step's contact is, for a line of progress; empty without."""
    c = step.contact
    return f"contact {c['active']} ({c['slip']} slip, {step.method})  " if c else ""
