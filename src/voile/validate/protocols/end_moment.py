"""A strip rolled up by an end moment: a full circle at M = 2 pi B b / L."""

import numpy as np

from voile.validate.bench import Bench, Outcome
from voile.validate.protocol import Check, Curve, Findings, Plot, close, order, small
from voile.validate.shapes import CLAMP, clamp, fabric, rigidity, strip

TEXT = "clamped strip rolled up by an end moment: circles of radius B b / M"
SOURCE = "pure bending: the radius of curvature is B b / M"
THICKNESS, WIDTH = 1e-2, 0.05
BOUND = 4e-3  # on the mean curvature; 1 % of stiffness is 1 % of it


def roll(bench: Bench, turns: float, nx: int) -> tuple[Outcome, float, float]:
    """The run, its mean curvature over the exact one, and how far the tip is from where it should be."""
    mesh = strip(nx, nx // 20, WIDTH)
    end = mesh.points[:, 0] > 1.0 - CLAMP
    edge = {"box": [[1.0 - CLAMP, -1.0, -1.0], [1.0 + CLAMP, 1.0, 1.0]]}
    moment = 2.0 * np.pi * turns * rigidity(THICKNESS) * WIDTH
    scene = {
        "shell": {"mesh": mesh, **fabric(THICKNESS)},
        "loads": {"gravity": [0.0, 0.0, 0.0], "moment": [{"select": edge, "value": moment}]},
        "fix": [clamp(mesh.points[:, 0] < CLAMP)],
        "statics": {"load_steps": 4},
    }
    done = bench.run(f"turns-{turns:g}-{nx}", scene)
    x, angle = done.positions(), 2.0 * np.pi * turns
    place = np.array([np.sin(angle), 1.0 - np.cos(angle)]) / angle
    away = np.linalg.norm(x[end][:, [0, 2]].mean(axis=0) - place)
    side = mesh.points[:, 1] < CLAMP
    line = x[side][np.argsort(mesh.points[side, 0])][:, [0, 2]]
    step = np.diff(line, axis=0)
    direction = np.unwrap(np.arctan2(step[:, 1], step[:, 0]))
    turned = (direction[-1] - direction[0]) * len(step) / (len(step) - 1)  # from middle to middle of cells
    return done, float(turned / angle), float(away)


def run(bench: Bench) -> Findings:
    checks: list[Check] = []
    curves = []
    for turns in [0.5, 1.0] if bench.quick else [0.25, 0.5, 1.0, 1.5]:
        done, curvature, away = roll(bench, turns, 80)
        checks.append(close(f"curvature over M / (B b), {turns:g} turns", curvature, 1.0, BOUND))
        checks.append(small(f"tip's distance from its place over L, {turns:g} turns", away, 4e-3 * turns))
        arc = np.linspace(0.0, 2.0 * np.pi * turns, 101)
        radius = 0.5 / (np.pi * turns)
        curves.append(Curve(f"circle, {turns:g} turns", radius * np.sin(arc), radius * (1.0 - np.cos(arc))))
        x = done.positions()
        curves.append(Curve("strip", x[:, 0], x[:, 2], points=True))
    if not bench.quick:
        errors = [roll(bench, 1.0, nx)[2] for nx in (20, 40, 80)]
        checks.append(order("the tip's distance, full circle", errors, 1.7, 2.8))
    return Findings(checks, Plot("x [m]", "z [m]", curves))
