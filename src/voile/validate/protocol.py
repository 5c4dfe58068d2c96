"""What a protocol is, what it finds, and which there are.

A protocol is a file of the folder `protocols`; its name is the file's with dashes. It holds `TEXT` (what is claimed, in
a line), `SOURCE` (of the reference), and `run(bench)`, which runs scenes by `bench.run` and returns `Findings`. Nothing
else needs to know of it.
"""

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from importlib import import_module
from pkgutil import iter_modules

from voile.arrays import Reals
from voile.errors import NotConverged
from voile.validate import protocols
from voile.validate.bench import Bench


@dataclass(frozen=True)
class Check:
    """A figure beside its reference. The deviation is relative, or where `absolute` in the figure's own unit."""

    quantity: str
    value: float
    reference: float
    bound: float
    absolute: bool = False

    @property
    def deviation(self) -> float:
        off = self.value - self.reference
        return off if self.absolute else off / abs(self.reference)

    @property
    def passed(self) -> bool:
        return abs(self.deviation) <= self.bound  # not if nan


def close(quantity: str, value: float, reference: float, bound: float) -> Check:
    """A figure that may deviate by a share `bound` of its reference."""
    return Check(quantity, float(value), float(reference), bound)


def within(quantity: str, value: float, low: float, high: float) -> Check:
    """A figure that has to lie between two others."""
    return Check(quantity, float(value), 0.5 * (low + high), 0.5 * (high - low), absolute=True)


def small(quantity: str, value: float, bound: float) -> Check:
    """A figure that should be zero."""
    return Check(quantity, float(value), 0.0, bound, absolute=True)


def order(
    quantity: str, errors: Sequence[float] | Reals, low: float, high: float, halvings: int = 1
) -> Check:
    """The order of convergence over the last halvings of the cells."""
    ratio = abs(errors[-1 - halvings] / errors[-1])
    return within(f"order of {quantity}", math.log2(ratio) / halvings, low, high)


@dataclass(frozen=True)
class Curve:
    """x, y (k,) of a line, or of points where `points`."""

    label: str
    x: Sequence[float] | Reals
    y: Sequence[float] | Reals
    points: bool = False


@dataclass(frozen=True)
class Plot:
    """The master curve and what was computed; log: axes, of "xy", that are logarithmic."""

    x: str
    y: str
    curves: list[Curve]
    log: str = ""


@dataclass(frozen=True)
class Findings:
    checks: list[Check]
    plot: Plot


@dataclass(frozen=True)
class Protocol:
    name: str
    text: str
    source: str
    run: Callable[[Bench], Findings]


@dataclass(frozen=True)
class Verdict:
    """What came of a protocol; failure: why a run of it ended early, or empty; seconds: CPU time."""

    protocol: Protocol
    checks: list[Check]
    plot: Plot | None
    failure: str
    seconds: float
    notes: list[str] = field(default_factory=list)

    @property
    def passed(self) -> bool:
        return not self.failure and all(check.passed for check in self.checks)


def all_protocols() -> dict[str, Protocol]:
    """Name -> protocol, by name."""
    found = {}
    for stem in sorted(module.name for module in iter_modules(protocols.__path__)):
        if stem.startswith("_"):
            continue
        module, name = import_module(f"{protocols.__name__}.{stem}"), stem.replace("_", "-")
        found[name] = Protocol(name, module.TEXT, module.SOURCE, module.run)
    return found


def perform(protocol: Protocol, bench: Bench) -> Verdict:
    """Runs a protocol; what does not converge is told in its verdict."""
    began = time.process_time()
    checks, plot, failure = [], None, ""
    try:
        findings = protocol.run(bench)
        checks, plot = findings.checks, findings.plot
    except NotConverged as error:
        failure = str(error)
    return Verdict(protocol, checks, plot, failure, time.process_time() - began, bench.notes)
