"""How a body walks in place: its mesh bent smoothly about its joints, y up, front to +z."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike


@dataclass(frozen=True)
class Limbs:
    """Of a standing body, in m. hip, knee, shoulder: (x, y, z) of the left one (+x), the right one mirrored at x = 0.
    legs, arms (n, 2): how far each point goes with the left and the right one, from 0 to 1. bend: half the length of
    leg over which a knee bends."""

    hip: tuple[float, float, float]
    knee: tuple[float, float, float]
    bend: float
    legs: np.ndarray
    shoulder: tuple[float, float, float] = (0.0, 0.0, 0.0)
    arms: np.ndarray | None = None


@dataclass(frozen=True)
class Gait:
    """Two steps in a period (s); swings of thighs and arms, flexion of knees (degrees); from rest, whole after
    `start` s."""

    period: float = 1.0
    thigh: float = 20.0
    knee: float = 35.0
    arm: float = 12.0
    start: float = 0.4


def walk(points: np.ndarray, limbs: Limbs, gait: Gait, time: float) -> np.ndarray:
    """Points (n, 3) of the standing body at a time (s). Legs turn about the axis through the hips, knees bend while
    their leg comes forward; arms stretched to the sides turn about upright axes, each against its leg."""
    grown, moved = gait_share(time / gait.start), points
    low = gait_share((limbs.knee[1] + limbs.bend - points[:, 1]) / (2.0 * limbs.bend))
    for side, sign in enumerate((1.0, -1.0)):
        turn = 2.0 * np.pi * (time / gait.period + 0.5 * side)
        swing, flexion = grown * np.sin(turn), grown * max(np.cos(turn), 0.0) ** 2
        leg = limbs.legs[:, side]
        moved = _turn(moved, limbs.knee, [1.0, 0.0, 0.0], np.radians(gait.knee) * flexion * leg * low)
        moved = _turn(moved, limbs.hip, [1.0, 0.0, 0.0], -np.radians(gait.thigh) * swing * leg)
        if limbs.arms is not None:
            x, y, z = limbs.shoulder
            angle = sign * np.radians(gait.arm) * swing * limbs.arms[:, side]
            moved = _turn(moved, (sign * x, y, z), [0.0, 1.0, 0.0], angle)
    return moved


def gait_share(s: ArrayLike) -> np.ndarray:
    """From 0 at 0 to 1 at 1, level at both ends and beyond."""
    s = np.clip(s, 0.0, 1.0)
    return s**2 * (3.0 - 2.0 * s)


def _turn(points: np.ndarray, centre: ArrayLike, axis: ArrayLike, angle: np.ndarray) -> np.ndarray:
    """Points (n, 3) turned about an axis (unit vector) through a centre, each by its angle (n,)."""
    away, axis = points - np.asarray(centre), np.asarray(axis)
    along = (away @ axis)[:, None] * axis
    across, aside = away - along, np.cross(axis, away)
    return centre + along + np.cos(angle)[:, None] * across + np.sin(angle)[:, None] * aside
