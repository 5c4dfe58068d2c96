"""An open cylinder pulled out by two forces: bending, then a snap, then stretching (Sze, Liu & Lo 2004)."""

import numpy as np

from voile.validate.bench import Bench
from voile.validate.paths import Measure, beside_path
from voile.validate.protocol import Findings, close
from voile.validate.shells import pulled_cylinder

TEXT = "open cylinder pulled out by two forces: whole path, through the snap at half the load"
SOURCE = "Sze, Liu & Lo 2004, S4R (with shear); at the whole load: NGSolve's nonlinear Kirchhoff-Love shell"
# Load over the whole; A outward under the force, B inward at 90 degrees, C the same at the free end.
PUBLISHED = np.array(
    [
        (0.025, 0.819, 0.864, 0.872),
        (0.05, 1.26, 1.471, 1.493),
        (0.075, 1.527, 1.901, 1.946),
        (0.1, 1.707, 2.217, 2.293),
        (0.15, 1.936, 2.641, 2.792),
        (0.2, 2.079, 2.904, 3.106),
        (0.25, 2.18, 3.087, 3.31),
        (0.3, 2.257, 3.227, 3.452),
        (0.35, 2.321, 3.342, 3.556),
        (0.4, 2.376, 3.443, 3.632),
        (0.45, 2.425, 3.539, 3.688),
        (0.5, 2.473, 3.653, 3.718),
        (0.525, 2.543, 4.061, 3.58),
        (0.55, 2.577, 4.171, 3.518),
        (0.6, 2.618, 4.274, 3.452),
        (0.65, 2.648, 4.338, 3.41),
        (0.7, 2.672, 4.385, 3.378),
        (0.75, 2.692, 4.423, 3.353),
        (0.8, 2.71, 4.455, 3.332),
        (0.85, 2.726, 4.483, 3.313),
        (0.9, 2.741, 4.508, 3.297),
        (0.95, 2.755, 4.53, 3.283),
        (1.0, 2.768, 4.551, 3.269),
    ]
)  # fmt: skip
LIMIT = 2.736, 4.554, 3.287
MEASURES = (
    Measure("A outward", "A", 0),
    Measure("B inward", "B", 1, -1.0),
    Measure("C inward", "C", 1, -1.0),
)


def run(bench: Bench) -> Findings:
    cells = 16 if bench.quick else 24
    case = pulled_cylinder(cells, cells)
    at = {0.25: 0.015, 1.0: 0.02} if bench.quick else {0.1: 0.01, 0.25: 0.01, 0.5: 0.01, 1.0: 0.0125}
    found = beside_path(bench, case, MEASURES, PUBLISHED[:, 0], PUBLISHED[:, 1:], at)
    whole = found.checks[-3:]
    bound = 0.01 if bench.quick else 5e-3
    found.checks.extend(
        [
            close(f"{measure.label} at the whole load, Kirchhoff-Love", check.value, limit, bound)
            for measure, check, limit in zip(MEASURES, whole, LIMIT, strict=True)
        ]
    )
    return found
