"""Load paths of shells beside published ones."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from voile.arrays import Reals
from voile.validate.bench import Bench
from voile.validate.protocol import Check, Curve, Findings, Plot, close
from voile.validate.shells import Case


@dataclass(frozen=True)
class Measure:
    """A displacement: of a mark of the case along an axis (0 to 2), counted in a sign."""

    label: str
    mark: str
    axis: int
    sign: float = 1.0

    def of(self, case: Case, displacements: Reals) -> float:
        return float(self.sign * displacements[case.marks[self.mark], self.axis])


def beside_path(
    bench: Bench,
    case: Case,
    measures: Sequence[Measure],
    loads: Reals,
    published: Reals,
    at: dict[float, float],
    steps: int = 10,
) -> Findings:
    """A case at shares of its load, and along the path to the whole, beside displacements (loads, measures).

    at: load -> bound. steps: of the path, at least."""
    checks: list[Check] = []
    found: list[list[float]] = []
    for load, bound in at.items():
        u = bench.run(f"load-{load:g}", case.scene(load)).displacements
        found.append([measure.of(case, u) for measure in measures])
        row = published[np.flatnonzero(np.isclose(loads, load))[0]]
        checks += [
            close(f"{measure.label} at {load:g} of the load", value, reference, bound)
            for measure, value, reference in zip(measures, found[-1], row, strict=True)
        ]
    whole = case.scene() | {"statics": {"load_steps": steps}}
    result = bench.run("path", whole).result
    moved = [result.points(k) - result.start for k in range(result.n_steps)]
    curves = [
        Curve(f"published: {measure.label}", [0.0, *values], [0.0, *loads])
        for measure, values in zip(measures, published.T, strict=True)
    ] + [
        Curve(measure.label, [measure.of(case, u) for u in moved], result.values, points=True)
        for measure in measures
    ]
    return Findings(checks, Plot("displacement", "load over the whole", curves))
