"""Sheets on planes and spheres for tests of steps in time."""

import numpy as np
import protocols
from marching import ALWAYS

from voile.contact.motion import Motion
from voile.contact.obstacles import Plane, Sphere
from voile.problem.contact import with_obstacles
from voile.problem.problem import Problem

G = protocols.GRAVITY


class Slope:
    """A plane through the origin at an angle (rad): unit normal, and down along it."""

    def __init__(self, angle: float):
        self.angle = angle
        self.normal = np.array([np.sin(angle), 0.0, np.cos(angle)])
        self.down = np.array([np.cos(angle), 0.0, -np.sin(angle)])

    def plane(self, friction: float) -> Plane:
        return Plane(name="slope", friction=friction, point=np.zeros(3), normal=self.normal)

    def sheet(self, size: float = 0.2, cell: float = 0.02, lift: float = 0.0, **given) -> "protocols.Shell":
        """A square (m) on it, or lifted (m)."""
        points, triangles = protocols.plate(size, size, cell)
        across = np.array([0.0, 1.0, 0.0])
        points = points[:, :1] * self.down + points[:, 1:2] * across + [0.0, 0.0, lift]
        return cloth(points, triangles, **given)

    def problem(self, friction: float, **given) -> Problem:
        return with_obstacles(Problem(self.sheet(**given)), [self.plane(friction)], 0.0)


def cloth(points, triangles, **given):
    given = {"young": 1e5, "thickness": 1e-3, "density": 300.0, "model": "projective//"} | given
    return protocols.shell_of(points, triangles, load_laws=ALWAYS, **given)


def turning_sphere(friction: float, radius: float, top: float, rate: float) -> Sphere:
    """Its top at a height (m), turning about the vertical (rad/s)."""
    center = np.array([0.0, 0.0, top - radius])
    motion = Motion(rotation=np.array([0.0, 0.0, rate]), center=center)
    return Sphere(name="sphere", friction=friction, center=center, radius=radius, motion=motion)
