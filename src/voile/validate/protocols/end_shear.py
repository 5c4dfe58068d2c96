"""A weightless strip clamped level under a dead tip force."""

import numpy as np

from voile.validate.bench import Bench
from voile.validate.protocol import Check, Curve, Findings, Plot, close, order
from voile.validate.references.elastica import cantilever
from voile.validate.shapes import CLAMP, clamp, fabric, line_forces, rigidity, strip

TEXT = "clamped strip under a dead tip force: shortening and deflection by P L^2 / (B b)"
SOURCE = "inextensible elastica, a boundary value problem solved by collocation"
THICKNESS, WIDTH = 1e-3, 0.05
BOUND = 2e-3  # 1 % of stiffness is 0.3 % of the deflection at alpha = 4


def tip(bench: Bench, alpha: float, nx: int, ny: int) -> tuple[float, float]:
    """Shortening and deflection of the tip."""
    mesh = strip(nx, ny, WIDTH)
    end = mesh.points[:, 0] > 1.0 - CLAMP
    force = [0.0, 0.0, alpha * rigidity(THICKNESS) * WIDTH]
    scene = {
        "shell": {"mesh": mesh, **fabric(THICKNESS)},
        "loads": {"gravity": [0.0, 0.0, 0.0], "force": line_forces(mesh.points, end, np.array(force))},
        "fix": [clamp(mesh.points[:, 0] < CLAMP)],
    }
    x = bench.run(f"alpha-{alpha:g}-{nx}", scene).positions()[end].mean(axis=0)
    return float(1.0 - x[0]), float(x[2])


def run(bench: Bench) -> Findings:
    alphas = [1.0, 4.0] if bench.quick else [0.5, 1.0, 2.0, 4.0, 6.0, 8.0, 16.0]
    found = [tip(bench, alpha, 64, 4) for alpha in alphas]
    checks: list[Check] = []
    for alpha, (shortening, deflection) in zip(alphas, found, strict=True):
        exact = cantilever(alpha, heavy=False)
        checks.append(close(f"shortening at {alpha:g}", shortening, 1.0 - exact.reach, BOUND))
        checks.append(close(f"deflection at {alpha:g}", deflection, exact.drop, BOUND))
    if not bench.quick:
        exact = cantilever(4.0, heavy=False)
        errors = [tip(bench, 4.0, nx, nx // 20)[1] - exact.drop for nx in (20, 40, 80)]
        checks.append(order("deflection at 4", errors, 1.7, 2.6))
    many = np.linspace(0.05, max(alphas), 41)
    exacts = [cantilever(alpha, heavy=False) for alpha in many]
    curves = [
        Curve("elastica: shortening", many, [1.0 - each.reach for each in exacts]),
        Curve("elastica: deflection", many, [each.drop for each in exacts]),
        Curve("shortening", alphas, [each[0] for each in found], points=True),
        Curve("deflection", alphas, [each[1] for each in found], points=True),
    ]
    return Findings(checks, Plot("P L^2 / (B b)", "over the length", curves))
