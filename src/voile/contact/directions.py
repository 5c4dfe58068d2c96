"""Lengths and directions of vectors, where they have one, and cylindrical coordinates."""

import numpy as np

from voile.arrays import Reals

NOWHERE = 1e-12  # of a vector's length: parts of it shorter than this are round-off and have no direction
TINY = 1e-12  # m: least radius of curvature, keeps Hessians finite at centres and axes


def lengths(vectors: Reals) -> Reals:
    """(n,) of rows; a third of the time of numpy's norm where they are few."""
    found: Reals = np.sqrt(np.einsum("ni,ni->n", vectors, vectors))
    return found


def unit(vectors: Reals, otherwise: Reals, least: Reals | float = 0.0) -> tuple[Reals, Reals]:
    """Lengths (n,) and directions (n, 3) of vectors; `otherwise` (3,) or (n, 3) for those not longer than `least`."""
    length = lengths(vectors)
    some = length > least
    return length, np.where(some[:, None], vectors / np.where(some, length, 1.0)[:, None], otherwise)


def normalised(vector: Reals) -> Reals:
    """A vector (3,) of length 1."""
    found: Reals = np.asarray(vector, dtype=float) / np.linalg.norm(vector)
    return found


def perpendicular(axis: Reals) -> Reals:
    """A unit vector normal to a unit axis."""
    other = np.eye(3)[np.argmin(np.abs(axis))]
    return normalised(other - (other @ axis) * axis)


def radial(d: Reals, axis: Reals) -> tuple[Reals, Reals, Reals]:
    """Height z (n,), radius r (n,) and unit radial direction (n, 3) of d (n, 3) in cylindrical coordinates about a unit
    axis; on the axis some definite direction, normal to it as all others."""
    z = d @ axis
    across = d - z[:, None] * axis
    across -= (across @ axis)[:, None] * axis  # once more: near the axis the first difference is round-off
    r, least = lengths(across), NOWHERE * lengths(d)
    if (r > least).all():
        return z, r, across / r[:, None]
    return z, *unit(across, perpendicular(axis), least)
