"""A pad on a spring and a plane loses the same way in each swing and sticks off its middle (Code_Aster SDND100)."""

from itertools import pairwise

import numpy as np

from voile.arrays import Reals
from voile.validate.bench import Bench, Mesh
from voile.validate.protocol import Check, Curve, Findings, Plot, close, small
from voile.validate.shapes import sheet

TEXT = "pad on a spring: amplitudes fall by 2 mu N / k a half swing until it sticks"
SOURCE = "Coulomb's law; Code_Aster V5.01.100, SDND100: 4.25, -3.25, 2.25, -1.25, 0.25 times 2 mu N / k"
CELLS, GRAVITY, THICKNESS, FRICTION, SOFT, DENSITY = 6, 10.0, 1e-3, 0.001, 1e5, 6e3
AMPLITUDES = np.array([4.25, -3.25, 2.25, -1.25, 0.25])


def swing(bench: Bench, steps: int) -> tuple[Reals, Reals, float]:
    """A stiff pad at the end of a soft strip: times over half a period, displacements of the pad over 2 mu N / k, and
    its speed at the end (m/s)."""
    width = 1.0 / CELLS
    flat = sheet(CELLS + 1, 1, 1.0 + width, width)
    pad = flat.points[flat.triangles].mean(axis=1)[:, 0] > 1.0
    soft = flat.points[:, 0] < 1.0 - 1e-9
    flat.points[soft, 2] = 1e-5  # off the plane
    stiffness, mass = SOFT * THICKNESS * width, DENSITY * THICKNESS * width**2
    fall, half = 2.0 * FRICTION * mass * GRAVITY / stiffness, np.pi * np.sqrt(mass / stiffness)
    start = flat.points.copy()
    start[:, 0] += AMPLITUDES[0] * fall * np.minimum(start[:, 0], 1.0)
    groups = pad.astype(np.int32), ("spring", "pad")
    plane = {"shape": "plane", "point": [0.0, 0.0, 0.0], "normal": [0.0, 0.0, 1.0], "friction": FRICTION}
    scene = {
        "scene": {"task": "dynamics"},
        "shell": {
            "mesh": Mesh(start, flat.triangles, groups),
            "rest": Mesh(flat.points, flat.triangles, groups),
            "bending": "average",
            "young": SOFT,
            "poisson": 0.0,
            "thickness": THICKNESS,
            "density": 1e-2,
        },
        "fabric": [{"group": "pad", "young": 1e9, "density": DENSITY}],
        "loads": {"gravity": [0.0, 0.0, -GRAVITY]},
        "fix": [
            {"select": {"all": True}, "axes": "y"},
            {"select": {"nodes": np.flatnonzero(soft).tolist()}, "axes": "z"},
            {"select": {"nodes": np.flatnonzero(start[:, 0] < 1e-9).tolist()}, "axes": "x"},
        ],
        "obstacle": [plane],
        "contact": {"offset": 0.0},
        "dynamics": {
            "scheme": "moreau-jean",
            "theta": 0.5,
            "time_step": half / steps,
            "duration": 4.5 * half,
            "tolerance": 1e-9,
        },
        "output": {"every": max(1, steps // 25)},
    }
    done = bench.run(f"steps-{steps}", scene)
    end = flat.points[:, 0] > 1.0 + 1e-9
    away = [(done.result.points(k) - flat.points)[end, 0].mean() / fall for k in range(done.result.n_steps)]
    return done.result.values / half, np.array(away), float(np.abs(done.result.field("velocity")[end]).max())


def exact(time: Reals) -> Reals:
    """Displacement over 2 mu N / k at times over half a period: cosines about +-1/2, until it sticks."""
    k = np.minimum(time.astype(int), len(AMPLITUDES) - 1)
    middle = 0.5 * (AMPLITUDES[k] + AMPLITUDES[np.minimum(k + 1, len(AMPLITUDES) - 1)])
    moving = middle + (AMPLITUDES[k] - middle) * np.cos(np.pi * (time - k))
    return np.where(time >= len(AMPLITUDES) - 1, AMPLITUDES[-1], moving)


def run(bench: Bench) -> Findings:
    checks: list[Check] = []
    missed, curves = [], []
    for steps in (18, 36, 72) if bench.quick else (100, 200, 400):
        time, away, speed = swing(bench, steps)
        near = [np.abs(time - k) < 0.15 for k in range(len(AMPLITUDES))]
        peaks = np.array([away[each][np.abs(away[each]).argmax()] for each in near])
        missed.append(peaks - AMPLITUDES)
        curves.append(Curve(f"{steps} steps a half swing", time, away, points=True))
    # Implicit Euler damps in proportion to its step: three steps give the limit, by Richardson's extrapolation twice.
    once = [2.0 * fine - coarse for coarse, fine in pairwise(missed)]
    limit = AMPLITUDES + (4.0 * once[1] - once[0]) / 3.0
    bound = 0.02 if bench.quick else 5e-3
    for k, value in enumerate(limit[:-1]):
        checks.append(close(f"amplitude {k} over 2 mu N / k, step to 0", value, AMPLITUDES[k], bound))
    checks.append(small("its speed at the end [m/s]", speed, 1e-12))
    many = np.linspace(0.0, 4.5, 226)
    return Findings(
        checks,
        Plot(
            "time over half a period",
            "displacement / (2 mu N / k)",
            [Curve("exact", many, exact(many)), *curves[-1:]],
        ),
    )
