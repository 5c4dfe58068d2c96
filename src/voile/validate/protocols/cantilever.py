"""A heavy strip clamped level: drop over reach by gamma = rho g h L^3 / B (Romero et al. 2021)."""

import numpy as np

from voile.validate.bench import Bench
from voile.validate.protocol import Check, Curve, Findings, Plot, close, order
from voile.validate.references.elastica import cantilever
from voile.validate.shapes import CLAMP, DENSITY, clamp, fabric, rigidity, sheet, strip

TEXT = "heavy strip clamped level: drop over reach by rho g h L^3 / B"
SOURCE = "inextensible elastica, a boundary value problem solved by collocation"
THICKNESS, WIDTH = 1e-3, 0.05
BOUND = 4e-3  # 1 % of stiffness is 0.6 % of H/W at gamma = 100, where it matters least
HINGED = 0.13  # as measured: hinges bend as their triangles lie, 2 to 12 % off on crossed cells of any size
HEAVY = 200.0  # strips beyond it bend within a few cells of 80
BENDING = ("tan", "sin", "theta", "average")
KINDS = {name: {"bending": name} for name in BENDING} | {
    name: {"model": name} for name in ("projective", "discrete-shells")
}
NOTE = "discrete-shells bends as its triangles lie: its deviation is the model's, which finer cells keep"


def ratio(bench: Bench, gamma: float, kind: str, nx: int, ny: int) -> float:
    """Drop over reach of the tip; cells are finer towards the clamp, where heavy strips bend; square under hinges."""
    hinged = kind == "discrete-shells"
    mesh = sheet(nx, ny, 1.0, WIDTH, "crossed") if hinged else strip(nx, ny, WIDTH, uniform=0.3)
    scene = {
        "shell": {"mesh": mesh, **fabric(THICKNESS), **KINDS[kind]},
        "loads": {"gravity": [0.0, 0.0, -gamma * rigidity(THICKNESS) / (DENSITY * THICKNESS)]},
        "fix": [clamp(mesh.points[:, 0] < CLAMP)],
    }
    tip = mesh.points[:, 0] > 1.0 - CLAMP
    x = bench.run(f"{kind}-{gamma:g}-{nx}", scene).positions()[tip].mean(axis=0)
    return float(-x[2] / x[0])


def run(bench: Bench) -> Findings:
    bench.notes.append(NOTE)
    gammas = (
        [1.0, 10.0, 100.0] if bench.quick else [0.1, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0, 300.0, 1e3]
    )
    exact = [_exact(gamma) for gamma in gammas]
    checks: list[Check] = []
    many = np.geomspace(0.1, 1e3, 41)
    curves = [Curve("elastica", many, [_exact(gamma) for gamma in many])]
    for kind in KINDS:
        found = [ratio(bench, gamma, kind, *((80, 4) if gamma < HEAVY else (160, 8))) for gamma in gammas]
        rows = zip(gammas, found, exact, strict=True)
        bound = HINGED if kind == "discrete-shells" else BOUND
        checks += [close(f"H/W at {gamma:g}, {kind}", value, each, bound) for gamma, value, each in rows]
        curves.append(Curve(kind, gammas, found, points=True))
    if not bench.quick:
        errors = [ratio(bench, 10.0, "tan", nx, nx // 20) - _exact(10.0) for nx in (20, 40, 80)]
        checks.append(order("H/W at 10, tan", errors, 1.7, 2.6))
    return Findings(checks, Plot("gravito-bending number rho g h L^3 / B", "H/W", curves, "xy"))


def _exact(gamma: float) -> float:
    found = cantilever(gamma, heavy=True)
    return found.drop / found.reach
