"""Scordelis & Lo's roof (1964; feet and pounds): forces and moments of linear Koiter theory in Fourier series."""

import numpy as np
from numpy.polynomial import legendre

LENGTH, RADIUS, THICKNESS, YOUNG, WEIGHT, OPENING = 50.0, 25.0, 0.25, 4.32e8, 90.0, np.radians(40.0)
DEGREE, HARMONICS = 18, 24  # to five digits


def _polynomials(angle: np.ndarray, derivative: int) -> np.ndarray:
    """(DEGREE, k) Legendre polynomials over the opening, or derivatives."""
    rows = np.eye(DEGREE)
    rows = [legendre.legder(row, derivative) if derivative else row for row in rows]
    return np.array([legendre.legval(angle / OPENING, row) for row in rows]) / OPENING**derivative


def _strains(angle: np.ndarray, wave: float):
    """Of displacements u cos(wave x), v, w sin(wave x), along, around and outwards, with polynomials in the angle for
    u, v, w: membrane strains along, around, shear; changes of curvature along, around, twist (Sanders 1959); v, w."""
    p, dp, ddp = (_polynomials(angle, k) for k in range(3))
    u, v, w = (lambda q, k=k: np.concatenate([q if i == k else 0.0 * q for i in range(3)]) for k in range(3))
    membrane = -wave * u(p), (v(dp) + w(p)) / RADIUS, u(dp) / RADIUS + wave * v(p)
    twist = -wave * w(dp) / RADIUS + 0.75 * wave * v(p) / RADIUS - u(dp) / (4.0 * RADIUS**2)
    return *membrane, wave**2 * w(p), (v(dp) - w(ddp)) / RADIUS**2, twist, v(p), w(p)


def roof(angle: np.ndarray, x: float) -> dict[str, np.ndarray]:
    """At angles (k,) from the crown, x from a diaphragm: how far it goes `down`, forces and moments per length."""
    gauss, weight = legendre.leggauss(40)
    nodes, weight = OPENING * gauss, OPENING * RADIUS * weight
    stretching, bending = YOUNG * THICKNESS, YOUNG * THICKNESS**3 / 12.0
    found = dict.fromkeys(("down", "n_along", "n_around", "m_along", "m_around"), np.zeros(len(angle)))
    for m in range(1, 2 * HARMONICS, 2):
        wave = m * np.pi / LENGTH
        e1, e2, g, k1, k2, t, v, w = _strains(nodes, wave)
        stiffness = stretching * (e1 * weight @ e1.T + e2 * weight @ e2.T + 0.5 * g * weight @ g.T)
        stiffness += bending * (k1 * weight @ k1.T + k2 * weight @ k2.T + 2.0 * t * weight @ t.T)
        load = 4.0 * WEIGHT / (m * np.pi) * (v * np.sin(nodes) - w * np.cos(nodes)) @ weight
        amplitude = np.linalg.solve(stiffness, load)
        e1, e2, _, k1, k2, _, v, w = _strains(angle, wave)
        parts = {
            "down": v * np.sin(angle) - w * np.cos(angle),
            "n_along": stretching * e1,
            "n_around": stretching * e2,
            "m_along": bending * k1,
            "m_around": bending * k2,
        }
        found = {name: found[name] + np.sin(wave * x) * (amplitude @ parts[name]) for name in found}
    return found
