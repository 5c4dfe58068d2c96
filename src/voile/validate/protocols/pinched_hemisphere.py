"""A hemisphere with a hole, pulled and pushed at its equator: large displacements (Sze, Liu & Lo 2004)."""

import numpy as np

from voile.validate.bench import Bench
from voile.validate.paths import Measure, beside_path
from voile.validate.protocol import Findings, close, order
from voile.validate.shells import pinched_hemisphere

TEXT = "hemisphere with a hole under alternating forces: 0.8 of its radius inward"
SOURCE = "Sze, Liu & Lo 2004, S4R (with shear), 4.067 and 8.178; limit: NGSolve's Kirchhoff-Love shell, 4.073 and 8.143"
MEASURES = Measure("outward", "pulled", 0), Measure("inward", "pushed", 1, -1.0)
LIMIT = 4.073, 8.143


def run(bench: Bench) -> Findings:
    cells = 16 if bench.quick else 32
    case = pinched_hemisphere(cells, cells)
    bound = 0.02 if bench.quick else 0.01
    found = beside_path(bench, case, MEASURES, np.ones(1), np.array([[4.067, 8.178]]), {1.0: bound})
    if not bench.quick:
        errors = []
        for n in (16, 32, 64):
            fine = pinched_hemisphere(n, n, "crossed")
            errors.append(
                MEASURES[1].of(fine, bench.run(f"refined-{n}", fine.scene()).displacements) - LIMIT[1]
            )
        value = 1.0 + errors[-1] / LIMIT[1]
        found.checks.append(close("inward over its Kirchhoff-Love limit, 64x64", value, 1.0, 3e-3))
        found.checks.append(order("the inward displacement", errors, 1.2, 3.2))
    return found
