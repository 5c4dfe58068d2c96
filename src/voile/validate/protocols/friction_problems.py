"""Discrete frictional contact problems: FCLIB's and others' where the checkout's neighbour has them, three own ones."""

from pathlib import Path

import numpy as np
import scipy.sparse as sp

import voile
from voile.contact.law import friction_error
from voile.results.friction import FrictionProblem, read_problem
from voile.solver.friction import FrictionNotConverged, solve_friction
from voile.validate.bench import Bench
from voile.validate.protocol import Check, Curve, Findings, Plot, small

TEXT = "discrete frictional contact problems: the laws of Signorini and Coulomb to 1e-8"
SOURCE = "natural map of Alart & Curnier, measured apart from the solver (voile.contact.law.friction_error)"
FILES = Path(voile.__file__).parents[3] / "shared" / "friction"
TOLERANCE = 1e-8


def block_on_a_slope(angle: float, friction: float) -> FrictionProblem:
    """A rigid block on three points: an impulse over 1 s; frames (normal, down the slope, across)."""
    feet = np.array([[0.0, 0.1, 0.05], [0.0, -0.1, 0.05], [0.0, 0.0, -0.1]])
    rows = []
    for foot in np.add(feet, [-0.02, 0.0, 0.0]):  # the centre is 2 cm above them
        for axis in np.eye(3):
            rows.append(np.concatenate([axis, np.cross(foot, axis) / 0.05]))
    jacobian = np.array(rows)
    pull = np.concatenate([9.81 * np.array([-np.cos(angle), np.sin(angle), 0.0]), np.zeros(3)])
    return FrictionProblem(sp.csr_matrix(jacobian @ jacobian.T), jacobian @ pull, np.full(3, friction))


def random_stack(contacts: int, freedoms: int) -> FrictionProblem:
    """Contacts among few freedoms, so that W is singular; q in its range, so that there is a solution."""
    rng = np.random.default_rng(11)
    jacobian = rng.normal(size=(3 * contacts, freedoms))
    q = jacobian @ rng.normal(size=freedoms)
    return FrictionProblem(sp.csr_matrix(jacobian @ jacobian.T), q, rng.uniform(0.1, 0.9, contacts))


OWN = {
    "block that sticks": block_on_a_slope(0.3, 0.5),
    "block that slides": block_on_a_slope(0.6, 0.5),
    "30 contacts, 60 freedoms": random_stack(30, 60),
}


def run(bench: Bench) -> Findings:
    problems = dict(OWN)
    files = sorted(FILES.glob("*.h5")) if FILES.is_dir() else []
    problems |= {path.stem: read_problem(path) for path in files}
    if not files:
        bench.notes.append(f"{FILES} is not there: own problems only")
    errors, sizes = [], []
    for W, q, mu in problems.values():
        try:
            r, _ = solve_friction(W, q, mu, tol=TOLERANCE)
        except FrictionNotConverged as error:
            r = error.reaction
        errors.append(friction_error(W, q, mu, r))
        sizes.append(len(mu))
    checks: list[Check] = [
        small(f"error of {name}, {size} contacts", error, TOLERANCE)
        for name, error, size in zip(problems, errors, sizes, strict=True)
    ]
    checks.append(small("sliding block: speed less that of the closed form [m/s]", _sliding_error(), 1e-6))
    curves = [
        Curve("found", sizes, np.maximum(errors, 1e-18), points=True),
        Curve("tolerance", [1, max(sizes)], [TOLERANCE, TOLERANCE]),
    ]
    return Findings(checks, Plot("contacts", "error", curves, "xy"))


def _sliding_error() -> float:
    """Of the mean velocity down the slope of the block that slides: g (sin - mu cos) t, t = 1 s, without rotation."""
    W, q, mu = OWN["block that slides"]
    r, _ = solve_friction(W, q, mu, tol=1e-12)
    velocity = W @ r + q
    return float(abs(float(velocity.reshape(-1, 3)[:, 1].mean()) - 9.81 * (np.sin(0.6) - 0.5 * np.cos(0.6))))
