"""A sheet dropped on a plane with restitution e rises to e^2 of its height; a throw rubs by no more than mu."""

import numpy as np

from voile.validate.bench import Bench
from voile.validate.protocol import Check, Curve, Findings, Plot, close, small
from voile.validate.slopes import GRAVITY, on_slope

TEXT = "sheet dropped with restitution: rebounds to e^2 of its height"
SOURCE = "Newton's impact law and Coulomb's on impulses"
HEIGHT, STEP = 0.2, 1e-3


def run(bench: Bench) -> Findings:
    checks: list[Check] = []
    curves = []
    impact = np.sqrt(2.0 * HEIGHT / GRAVITY)
    for e in [0.5] if bench.quick else [0.25, 0.5, 0.8]:
        dynamics = {"scheme": "moreau-jean", "theta": 0.5, "time_step": STEP}
        dynamics["duration"] = (1.0 + 1.9 * e) * impact
        seen = on_slope(bench, f"drop-{e:g}", 0.0, HEIGHT, dynamics, every=1, restitution=e, friction=0.3)
        before = int(np.argmax(seen.lift > 0.0)) - 1
        checks += [
            close(
                f"speed after the impact [m/s], e = {e:g}",
                float(seen.lift[before + 1]),
                float(GRAVITY * (e * impact - (seen.time[before + 1] - impact))),
                1e-6,
            ),
            Check(
                f"height of the rebound over the drop, e = {e:g}",
                float(seen.height[before + 1 :].max() / HEIGHT),
                e**2,
                1e-4,
                absolute=True,
            ),
            small(f"penetration over the drop, e = {e:g}", max(0.0, -seen.height.min()) / HEIGHT, 1e-9),
        ]
        t = np.linspace(0.0, seen.time[-1], 201)
        rise = e * GRAVITY * impact * (t - impact) - 0.5 * GRAVITY * (t - impact) ** 2
        curves.append(
            Curve(f"exact, e = {e:g}", t, np.where(t < impact, HEIGHT - 0.5 * GRAVITY * t**2, rise))
        )
        curves.append(Curve(f"e = {e:g}", seen.at[::12], seen.height[::12], points=True))
    for speed, mu in ((2.0, 0.3), (0.1, 0.3)):
        dynamics = {"scheme": "moreau-jean", "time_step": STEP, "duration": 0.15}
        seen = on_slope(bench, f"throw-{speed:g}", 0.0, 0.05, dynamics, speed, friction=mu, restitution=0.5)
        before = int(np.argmax(seen.contact > 0)) - 1
        normal = seen.lift[before + 2] - seen.lift[before] + 2.0 * STEP * GRAVITY
        lost = seen.speed[before] - seen.speed[before + 2]
        checks.append(
            close(
                f"speed lost along the plane [m/s], thrown at {speed:g}", lost, min(mu * normal, speed), 1e-6
            )
        )
    return Findings(checks, Plot("time [s]", "height [m]", curves))
