"""A sheet slides on a plane, stops, and stays (nosnoc's sliding ball without its fall)."""

import numpy as np

from voile.validate.bench import Bench
from voile.validate.protocol import Check, Curve, Findings, Plot, close, order, small
from voile.validate.slopes import GRAVITY, on_slope

TEXT = "sheet sliding on a plane: when and where it stops, and that it stays"
SOURCE = "Coulomb's law: stops after v / (mu g), way v^2 / (2 mu g)"
FRICTION, SPEED = 0.3, 1.0
STOP, WAY = SPEED / (FRICTION * GRAVITY), 0.5 * SPEED**2 / (FRICTION * GRAVITY)
SCHEMES = ("implicit-euler", "moreau-jean", "bdf2", "generalized-alpha")


def run(bench: Bench) -> Findings:
    checks: list[Check] = []
    t = np.linspace(0.0, 0.4, 161)
    curves = [Curve("exact", t, WAY * (1.0 - np.maximum(1.0 - t / STOP, 0.0) ** 2))]
    for scheme in SCHEMES[:2] if bench.quick else SCHEMES:
        errors = []
        for step in (2e-3, 1e-3) if scheme == SCHEMES[0] else (1e-3,):
            dynamics = {"scheme": scheme, "time_step": step, "duration": 0.4}
            seen = on_slope(bench, f"{scheme}-{step:g}", 0.0, 0.0, dynamics, SPEED, friction=FRICTION)
            errors.append(seen.way[-1] - WAY)
        still = int(np.argmax(seen.fastest < 1e-12))
        checks += [
            small(f"time to its stop, off by [s], {scheme}", abs(seen.time[still] - STOP), step),
            close(f"way [m], {scheme}", seen.way[-1], WAY, 5e-3),
            small(f"speed after its stop [m/s], {scheme}", seen.fastest[still:].max(), 1e-12),
            small(f"way after its stop [m], {scheme}", np.ptp(seen.way[seen.at >= seen.time[still]]), 1e-14),
        ]
        if len(errors) > 1:
            checks.append(order(f"the way in the time step, {scheme}", errors, 0.7, 1.3))
        curves.append(Curve(scheme, seen.at, seen.way, points=True))
    return Findings(checks, Plot("time [s]", "way [m]", curves))
