"""A plate falls on a slope: plastic impact with friction, then a constant acceleration (Ly et al. 2020, figure 5)."""

import numpy as np

from voile.validate.bench import Bench
from voile.validate.protocol import Check, Curve, Findings, Plot, close, small
from voile.validate.slopes import GRAVITY, on_slope

TEXT = "plate falling on a slope: impact with friction, then sliding"
SOURCE = "rigid plate: v = g t (sin a - mu cos a) along the slope after a plastic impact"
ANGLE, FRICTION, HEIGHT, STEP = np.pi / 4, 0.1, 0.2, 1e-3
SCHEMES = ("implicit-euler", "moreau-jean", "bdf2", "generalized-alpha")


def run(bench: Bench) -> Findings:
    checks: list[Check] = []
    share, impact = np.sin(ANGLE) - FRICTION * np.cos(ANGLE), np.sqrt(2.0 * HEIGHT / GRAVITY)
    t = np.linspace(0.0, 0.25, 251)
    exact = GRAVITY * t * np.where(t < impact, np.sin(ANGLE), share)
    curves = [Curve("rigid plate", t, exact)]
    for scheme in SCHEMES[:2] if bench.quick else SCHEMES:
        dynamics = {"scheme": scheme, "time_step": STEP, "duration": 0.25}
        seen = on_slope(bench, scheme, ANGLE, HEIGHT, dynamics, friction=FRICTION)
        first = int(np.argmax(seen.contact > 0))
        after = first + 2  # it lands in one step and is stopped in the next
        slope = (seen.speed[-1] - seen.speed[after]) / (seen.time[-1] - seen.time[after])
        speed = seen.speed[after] / (GRAVITY * share * seen.time[after])
        checks += [
            small(f"time of impact, off by [s], {scheme}", abs(seen.time[first] - impact), STEP),
            close(f"speed after the impact over the exact one, {scheme}", speed, 1.0, 1e-3),
            close(f"acceleration along the slope [m/s^2], {scheme}", slope, GRAVITY * share, 1e-5),
        ]
        curves.append(Curve(scheme, seen.time[::10], seen.speed[::10], points=True))
    return Findings(checks, Plot("time [s]", "speed along the slope [m/s]", curves))
