"""Square plates under uniform load, with small deflections."""

import numpy as np

from voile.validate.bench import Bench
from voile.validate.protocol import Check, Curve, Findings, Plot, close, order
from voile.validate.shapes import DENSITY, YOUNG, clamp, fabric, nodes, rigidity, sheet

TEXT = "square plates under uniform load, simply supported and clamped: deflection of the centre"
SOURCE = "Timoshenko & Woinowsky-Krieger 1959: w D / (q a^4) = 0.00406235 and 0.00126532"
THICKNESS, POISSON = 0.01, 0.3
EXACT = {"simply supported": 0.00406235, "clamped": 0.00126532}
SAG = 1e-3  # of the thickness: linear


def centre(bench: Bench, support: str, cells: int) -> float:
    """w D / (q a^4) at the centre."""
    mesh = sheet(cells, cells, 1.0, 1.0, "crossed")
    rim = np.abs(mesh.points[:, :2] - 0.5).max(axis=1) > 0.5 - 1e-9
    load = SAG * THICKNESS / EXACT[support] * rigidity(THICKNESS, YOUNG, POISSON)
    scene = {
        "shell": {"mesh": mesh, **fabric(THICKNESS, poisson=POISSON)},
        "loads": {"gravity": [0.0, 0.0, -load / (DENSITY * THICKNESS)]},
        "fix": [clamp(rim) if support == "clamped" else {"select": nodes(rim)}],
        "statics": {"load_steps": 1},
    }
    middle = np.argmin(np.linalg.norm(mesh.points - [0.5, 0.5, 0.0], axis=1))
    sag = -bench.run(f"{support.replace(' ', '-')}-{cells}", scene).displacements[middle, 2]
    return float(sag / (SAG * THICKNESS) * EXACT[support])


def run(bench: Bench) -> Findings:
    checks: list[Check] = []
    curves = []
    meshes = [12, 24, 48]
    for support, exact in EXACT.items():
        found = [centre(bench, support, cells) for cells in meshes]
        limit = (4.0 * found[-1] - found[-2]) / 3.0
        errors = np.array(found) / exact - 1.0
        checks += [
            close(f"{support}, 48x48", found[-1], exact, 6e-3),
            close(f"{support}, cells to 0", limit, exact, 1e-3),
            order(support, errors, 1.9, 2.1),
        ]
        curves.append(Curve(support, [1.0 / cells for cells in meshes], np.abs(errors), points=True))
    sizes = np.array([0.02, 0.1])
    curves.append(Curve("second order", sizes, 3.0 * sizes**2))
    return Findings(checks, Plot("cell over side", "error of the deflection", curves, "xy"))
