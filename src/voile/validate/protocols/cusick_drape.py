"""Cusick's drape test: a round sheet of 30 cm, held on a round table of 18 cm, drapes over its edge."""

import numpy as np

from voile.arrays import Reals
from voile.mesh.grids import rings
from voile.validate.bench import Bench, Mesh
from voile.validate.protocol import Check, Curve, Findings, Plot, close, small, within
from voile.validate.shapes import clamp, fabric

TEXT = "round sheet over a round table: share of the ring that its shadow covers, by weight over bending"
SOURCE = "stiff: the annular plate's closed form; fabrics: quoted bands, no source found; test: Cusick 1968, ISO 9073-9"
TABLE, SHEET, GRAVITY = 0.09, 0.15, 9.81  # m
THICKNESS, POISSON, WAVE = 3e-4, 0.3, 0.01
# Weight (kg/m^2) and bending stiffness (N m) of the size that Kawabata's instruments measure on such fabrics; the
# band that is quoted for many samples of each, whose source we did not find: Cusick 1968 (J. Text. Inst. 59, 253) and
# ISO 9073-9 define the test and give no bands; folds that the start is waved in.
FABRICS = {
    "silk": (0.06, 1e-6, 0.20, 0.40, 9),
    "cotton": (0.12, 9e-6, 0.60, 0.76, 7),
    "wool": (0.20, 9e-6, 0.40, 0.70, 8),
    "denim": (0.40, 4e-5, 0.70, 0.90, 6),
}
QUICK = ("wool", "denim")  # silk folds finer than so few rings tell


def number(weight: float, stiffness: float) -> float:
    """Gravito-bending number of the overhang."""
    return weight * GRAVITY * (SHEET - TABLE) ** 3 / stiffness


def drape(
    bench: Bench, name: str, weight: float, stiffness: float, nr: int, folds: int
) -> tuple[float, float]:
    """Drape coefficient, and how low the rim hangs on average (m), from a start in waves of 1 cm at the rim: which of
    many equilibria is found would be a matter of the mesh else."""
    around = 12 * nr
    places, triangles = rings([around] * (nr + 1))
    radius, angle = np.repeat(np.linspace(TABLE, SHEET, nr + 1), around), 2.0 * np.pi * np.concatenate(places)
    points = np.column_stack([radius * np.cos(angle), radius * np.sin(angle), 0.0 * angle])
    start = points.copy()
    start[:, 2] = WAVE * ((radius - TABLE) / (SHEET - TABLE)) ** 2 * np.cos(folds * angle)
    flat = Mesh(points, triangles)
    young = 12.0 * stiffness * (1.0 - POISSON**2) / THICKNESS**3
    scene = {
        "shell": {
            "mesh": Mesh(start, triangles),
            "rest": flat,
            **fabric(THICKNESS, young, POISSON, weight / THICKNESS),
        },
        "loads": {"gravity": [0.0, 0.0, -GRAVITY]},
        "fix": [clamp(radius < TABLE + 1e-9)],
        "statics": {"load_steps": 1},
    }
    rim = bench.run(f"{name}-{nr}", scene).positions()[-around:]
    x, y = rim[:, 0], rim[:, 1]
    shadow = 0.5 * abs(float(x @ np.roll(y, -1) - y @ np.roll(x, -1)))
    share = (shadow - np.pi * TABLE**2) / (np.pi * (SHEET**2 - TABLE**2))
    return share, -float(rim[:, 2].mean())


def stiff_rim(weight: float, stiffness: float) -> float:
    """How low the rim of a plate hangs, clamped inside (a) and free outside (b): w = q r^4 / 64 + C1 + C2 ln r
    + C3 r^2 + C4 r^2 ln r over D, with w = w' = 0 at a, no moment and no shear at b."""
    a, b, q = TABLE, SHEET, weight * GRAVITY / stiffness

    def row(r: float, kind: str) -> Reals:
        """Of C1 to C4 and q: w, its slope, or its radial moment over D."""
        log = np.log(r)
        if kind == "w":
            return np.array([1.0, log, r**2, r**2 * log, r**4 / 64.0])
        slope = np.array([0.0, 1.0 / r, 2.0 * r, r * (2.0 * log + 1.0), r**3 / 16.0])
        if kind == "slope":
            return slope
        bend = np.array([0.0, -1.0 / r**2, 2.0, 2.0 * log + 3.0, 3.0 * r**2 / 16.0])
        found: Reals = bend + POISSON * slope / r
        return found

    rows = np.array([row(a, "w"), row(a, "slope"), row(b, "moment")])
    last = -q * b**2 / 8.0  # no shear at b
    c = np.linalg.solve(rows[:, :3], -rows[:, 3] * last - rows[:, 4] * q)
    return float(row(b, "w") @ [*c, last, q])


def run(bench: Bench) -> Findings:
    meshes = [8] if bench.quick else [8, 12, 16]
    nr = meshes[:2][-1]
    light, bending = 0.1, 0.1  # sags by a twentieth of the thickness: linear
    low = drape(bench, "stiff", light, bending, nr, 0)[1]
    checks: list[Check] = [
        close("rim of a stiff sheet [m]", low, stiff_rim(light, bending), 0.03 if bench.quick else 0.015)
    ]
    for name in QUICK if bench.quick else FABRICS:
        weight, stiffness, least, most, folds = FABRICS[name]
        seen = [drape(bench, name, weight, stiffness, n, folds)[0] for n in meshes]
        if name == "wool" and not bench.quick:
            seen.append(drape(bench, name, weight, stiffness, 24, folds)[0])
        checks.append(within(f"drape coefficient of {name}", seen[-1], least, most))
        if not bench.quick:
            last = f"change of {name}'s on the last of {len(seen)} meshes"
            checks.append(small(last, seen[-1] - seen[-2], 0.04))
    stiffnesses = 0.2 * GRAVITY * (SHEET - TABLE) ** 3 / np.geomspace(1.0, 200.0, 2 if bench.quick else 7)
    numbers = [number(0.2, stiffness) for stiffness in stiffnesses]
    shares = [drape(bench, f"number-{k}", 0.2, b, nr, 7)[0] for k, b in enumerate(stiffnesses)]
    checks.append(small("largest rise of the coefficient with the number", max(0.0, *np.diff(shares)), 0.0))
    curves = [Curve("sheets", numbers, shares, points=True)]
    for name, (weight, stiffness, least, most, _) in FABRICS.items():
        curves.append(Curve(f"{name}, quoted", 2 * [number(weight, stiffness)], [least, most]))
    return Findings(checks, Plot("rho g h L^3 / B of the overhang", "drape coefficient", curves, "x"))
