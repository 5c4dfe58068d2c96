"""A slit annular plate whose lip is lifted out of its plane (Sze, Liu & Lo 2004)."""

import numpy as np

from voile.validate.bench import Bench
from voile.validate.paths import Measure, beside_path
from voile.validate.protocol import Findings, close, order
from voile.validate.shells import slit_annulus

TEXT = "slit annular plate lifted at its slit: whole path, lip 2.3 times its width up"
SOURCE = "Sze, Liu & Lo 2004, S4R (with shear); limit of refinement: NGSolve's nonlinear Kirchhoff-Love shell"
# Load over the whole; lift of the inner and of the outer vertex.
PUBLISHED = np.array(
    [
        (0.025, 1.305, 1.789),
        (0.05, 2.455, 3.37),
        (0.075, 3.435, 4.72),
        (0.1, 4.277, 5.876),
        (0.125, 5.007, 6.872),
        (0.15, 5.649, 7.736),
        (0.2, 6.725, 9.16),
        (0.25, 7.602, 10.288),
        (0.3, 8.34, 11.213),
        (0.35, 8.974, 11.992),
        (0.4, 9.529, 12.661),
        (0.45, 10.023, 13.247),
        (0.5, 10.468, 13.768),
        (0.55, 10.876, 14.24),
        (0.6, 11.257, 14.674),
        (0.65, 11.62, 15.081),
        (0.7, 11.97, 15.469),
        (0.75, 12.31, 15.842),
        (0.8, 12.642, 16.202),
        (0.85, 12.966, 16.55),
        (0.9, 13.282, 16.886),
        (0.95, 13.59, 17.212),
        (1.0, 13.891, 17.528),
    ]
)  # fmt: skip
LIMIT = 13.85, 17.48
MEASURES = Measure("inner lift", "inner", 2), Measure("outer lift", "outer", 2)


def run(bench: Bench) -> Findings:
    case = slit_annulus(6, 60) if bench.quick else slit_annulus(12, 120)
    bound = 0.02 if bench.quick else 0.01
    at = {0.1: bound, 1.0: bound} if bench.quick else {0.1: bound, 0.25: bound, 0.5: bound, 1.0: bound}
    found = beside_path(bench, case, MEASURES, PUBLISHED[:, 0], PUBLISHED[:, 1:], at)
    if not bench.quick:
        errors = []
        for n in (3, 6, 12):
            fine = slit_annulus(n, 8 * n)
            u = bench.run(f"refined-{n}", fine.scene()).displacements
            errors.append([m.of(fine, u) - limit for m, limit in zip(MEASURES, LIMIT, strict=True)])
        inner = [row[0] for row in errors]
        found.checks.append(
            close("inner lift over its Kirchhoff-Love limit, 12x96", 1.0 + inner[-1] / LIMIT[0], 1.0, 6e-3)
        )
        found.checks.append(order("the inner lift", inner, 1.2, 2.8))
    return found
