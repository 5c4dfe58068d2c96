"""A bar dropped along its axis on a rigid wall bounces on its own waves (Doyen, Ern & Piperno 2011)."""

import numpy as np

from voile.arrays import Reals
from voile.validate.bench import Bench
from voile.validate.protocol import Curve, Findings, Plot, close, small
from voile.validate.shapes import fabric, nodes, sheet

TEXT = "elastic bar dropped on a wall: when it touches, leaves, and touches again"
SOURCE = "Doyen, Ern & Piperno 2011, equations 28-31: waves run the length in tau; 3, 5, 11, 13 tau"
# Scaled from their E = 900 to strains under 1e-3, where the shell is linear.
LENGTH, GRAVITY, YOUNG = 10.0, 10.0, 9e5
TAU = LENGTH / np.sqrt(YOUNG)
HEIGHT = 0.5 * GRAVITY * (3.0 * TAU) ** 2
EVENTS = ("first contact", "leaves", "second contact", "leaves again")


def bounce(bench: Bench, cells: int, steps: int) -> tuple[Reals, Reals, Reals, float]:
    """Times over tau at which contact begins or ends; times, and the lower end's height over the drop; energy lost over
    the first."""
    mesh = sheet(cells, 1, LENGTH, LENGTH / cells)
    mesh.points[:, 0] += HEIGHT
    low = mesh.points[:, 0] < HEIGHT + 1e-9
    scene = {
        "scene": {"task": "dynamics"},
        "shell": {"mesh": mesh, "bending": "average", **fabric(1.0, YOUNG, 0.0, 1.0)},
        "loads": {"gravity": [-GRAVITY, 0.0, 0.0]},
        "fix": [{"select": nodes(np.ones(len(mesh.points), dtype=bool)), "axes": "yz"}],
        "obstacle": [{"shape": "plane", "point": [0.0, 0.0, 0.0], "normal": [1.0, 0.0, 0.0]}],
        "contact": {"offset": 0.0},
        "dynamics": {
            "scheme": "moreau-jean",
            "theta": 0.5,
            "time_step": TAU / steps,
            "duration": 15.0 * TAU,
            "tolerance": 1e-8,
        },
        "output": {"every": 10},
    }
    done = bench.run(f"{cells}-cells-{steps}", scene)
    bears, time = done.history["active"] > 0, done.history["time"] / TAU
    changes = time[np.flatnonzero(np.diff(bears.astype(int))) + 1]
    energy = done.summary["dynamics"]["energy"]
    lost = energy["scheme_dissipated"] + energy["impact_dissipated"]
    mass = LENGTH * LENGTH / cells
    end = [done.result.points(k)[low, 0].mean() / HEIGHT for k in range(done.result.n_steps)]
    return changes, done.result.values / TAU, np.array(end), lost / (mass * GRAVITY * HEIGHT)


def run(bench: Bench) -> Findings:
    changes, time, end, lost = bounce(bench, 25, 50) if bench.quick else bounce(bench, 100, 100)
    rows = zip(EVENTS, changes[:4], (3.0, 5.0, 11.0, 13.0), strict=True)
    checks = [
        close(f"{event}, over tau", at, exact, 0.04 if bench.quick else 0.02) for event, at, exact in rows
    ]
    checks.append(small("energy lost over the first", lost, 0.05))
    fall = np.linspace(0.0, 3.0, 61)
    curves = [
        Curve("free fall and contact", [*fall, 5.0], [*(1.0 - (fall / 3.0) ** 2), 0.0]),
        Curve("lower end", time, end, points=True),
    ]
    return Findings(checks, Plot("time / tau", "height of the lower end over the drop", curves))
