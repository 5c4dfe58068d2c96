"""Shells of the literature as meshes with supports and forces, for protocols and for tests of the solvers."""

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from voile.arrays import Flags, Ints, Reals, sums
from voile.mesh.grids import grid
from voile.validate.bench import Mesh
from voile.validate.shapes import clamp, fabric, nodes, shared_by_length


@dataclass
class Case:
    """fixed (n, 3): axes along which vertices are held; clamped: masks (n,) of lines of vertices, each held along an
    axis at least, whose edges do not turn; force (n, 3) N; material: [shell] keys; marks: vertices by name."""

    mesh: Mesh
    fixed: Flags
    clamped: list[Flags]
    force: Reals
    material: dict[str, float]
    marks: dict[str, int]

    def scene(self, factor: float = 1.0, **shell: Any) -> dict[str, Any]:
        """Under `factor` times the forces; shell: further keys."""
        loaded = np.flatnonzero(self.force.any(axis=1))
        value = factor * self.force[loaded]
        forces = [
            {"select": {"nodes": [int(vertex)]}, "value": each.tolist()}
            for vertex, each in zip(loaded, value, strict=True)
        ]
        fix: list[dict[str, Any]] = [
            {"select": nodes(held), "axes": axis}
            for axis, held in zip("xyz", self.fixed.T, strict=True)
            if held.any()
        ]
        for line in self.clamped:
            axes = [axis for axis, held in zip("xyz", self.fixed.T, strict=True) if held[line].all()]
            fix.append(clamp(line, axes=axes[0]))
        return {
            "shell": {"mesh": self.mesh, **self.material, **shell},
            "loads": {"gravity": [0.0, 0.0, 0.0], "force": forces},
            "fix": fix,
        }


class Sides(NamedTuple):
    """Masks (n,) of the sides of a grid in the parameters u and v."""

    u0: Flags
    u1: Flags
    v0: Flags
    v1: Flags


def mapped(nu: int, nv: int, diagonals: str) -> tuple[Reals, Reals, Ints, Sides]:
    """u, v (n,) in [0, 1], triangles, and the sides of a grid."""
    uv, triangles = grid(nu, nv, diagonals)
    u, v = uv.T
    return u, v, triangles, Sides(u < 1e-9, u > 1 - 1e-9, v < 1e-9, v > 1 - 1e-9)


def only(mask: Flags) -> int:
    """The one vertex of a mask."""
    (vertex,) = np.flatnonzero(mask)
    return int(vertex)


def none(u: Reals) -> Reals:
    return np.zeros(len(u), dtype=bool)


# ---- Sze, Liu & Lo (2004, Finite Elem. Anal. Des. 40, 1551-1569) ----


def slit_annulus(radial: int, around: int, diagonals: str = "crossed") -> Case:
    """Line force 0.8 per length on one lip, the other clamped; marks: inner and outer vertex of the loaded lip."""
    u, v, triangles, side = mapped(radial, around, diagonals)
    radius, angle = 6.0 + 4.0 * u, 2.0 * np.pi * v
    points = np.column_stack([radius * np.cos(angle), radius * np.sin(angle), 0.0 * u])
    force = shared_by_length(points, side.v0, np.array([0.0, 0.0, 0.8 * 4.0]))
    fixed = np.repeat(side.v1[:, None], 3, axis=1)
    marks = {"inner": only(side.v0 & side.u0), "outer": only(side.v0 & side.u1)}
    return Case(Mesh(points, triangles), fixed, [side.v1], force, fabric(0.03, 21e6), marks)


def pulled_cylinder(around: int, along: int, diagonals: str = "right") -> Case:
    """An eighth of the open cylinder pulled by 40000; marks: A under the force, B at 90 degrees, C at the free end."""
    u, v, triangles, side = mapped(around, along, diagonals)
    angle, radius = 0.5 * np.pi * u, 4.953
    points = np.column_stack([radius * np.cos(angle), radius * np.sin(angle), 0.5 * 10.35 * v])
    points[side.u1, 0] = 0.0
    marks = {
        "A": only(side.u0 & side.v0),
        "B": only(side.u1 & side.v0),
        "C": only(side.u1 & side.v1),
    }
    force = np.zeros_like(points)
    force[marks["A"], 0] = 40000.0 / 4.0
    fixed = np.column_stack([side.u1, side.u0, side.v0])
    planes, material = [side.u0, side.u1, side.v0], fabric(0.094, 10.5e6, 0.3125)
    return Case(Mesh(points, triangles), fixed, planes, force, material, marks)


def pinched_hemisphere(around: int, up: int, diagonals: str = "right") -> Case:
    """A quarter of the hemisphere with a hole of 18 degrees under forces of 400; marks: pulled outward (x axis), pushed
    inward (y axis)."""
    u, v, triangles, side = mapped(around, up, diagonals)
    polar, angle = np.radians(90.0 - 72.0 * v), 0.5 * np.pi * u
    points = 10.0 * np.column_stack(
        [np.sin(polar) * np.cos(angle), np.sin(polar) * np.sin(angle), np.cos(polar)]
    )
    points[side.u1, 0] = 0.0
    marks = {"pulled": only(side.u0 & side.v0), "pushed": only(side.u1 & side.v0)}
    fixed = np.column_stack([side.u1, side.u0, none(u)])
    fixed[marks["pulled"], 2] = True  # against sliding up as a whole
    force = np.zeros_like(points)
    force[marks["pulled"], 0], force[marks["pushed"], 1] = 200.0, -200.0
    material = fabric(0.04, 6.825e7, 0.3)
    return Case(Mesh(points, triangles), fixed, [side.u0, side.u1], force, material, marks)


def pinched_semicylinder(around: int, along: int, diagonals: str = "right") -> Case:
    """Half of the clamped semi-cylinder pinched by 2000 at its free end, its long edges free to slide on their plane,
    where they do not turn; marks: A under the force."""
    u, v, triangles, side = mapped(around, along, diagonals)
    angle, radius, length = 0.5 * np.pi * u, 1.016, 3.048
    points = np.column_stack([radius * np.sin(angle), length * v, radius * np.cos(angle)])
    points[side.u1, 2] = 0.0
    marks = {"A": only(side.u0 & side.v1)}
    # u0: crown, in the plane of symmetry; u1: long edge, on the ground; v0: clamped.
    fixed = np.column_stack([side.u0 | side.v0, side.v0, side.u1 | side.v0])
    force = np.zeros_like(points)
    force[marks["A"], 2] = -0.5 * 2000.0
    planes, material = [side.u0, side.u1, side.v0], fabric(0.03, 2.0685e7, 0.3)
    return Case(Mesh(points, triangles), fixed, planes, force, material, marks)


# ---- MacNeal & Harder (1985, Finite Elem. Anal. Des. 1, 3-20) ----

BEAM = {0.32: 1.0, 0.0032: 1e-6}  # thickness -> published load


def twisted_beam(thickness: float, axis: int, along: int, across: int) -> Case:
    """Clamped at x = 0, twisted by 90 degrees to its tip, with a force along the tip's width (axis 2, in plane) or its
    normal (axis 1, out of plane); marks: tip."""
    u, v, triangles, side = mapped(along, across, "crossed")
    turn, place = 0.5 * np.pi * u, 1.1 * (v - 0.5)
    points = np.column_stack([12.0 * u, place * np.cos(turn), place * np.sin(turn)])
    points[side.u1, 1] = 0.0
    force = shared_by_length(points, side.u1, BEAM[thickness] * np.eye(3)[axis])
    marks = {"tip": only(side.u1 & (np.abs(v - 0.5) < 1e-9))}
    fixed = np.repeat(side.u0[:, None], 3, axis=1)
    return Case(Mesh(points, triangles), fixed, [side.u0], force, fabric(thickness, 29e6, 0.22), marks)


def pinched_cylinder(around: int, along: int) -> Case:
    """An eighth of the cylinder: its ends on diaphragms, half-way a pair of opposite unit forces; marks: pinched."""
    u, v, triangles, side = mapped(around, along, "crossed")
    angle = 0.5 * np.pi * u
    points = np.column_stack([300.0 * np.cos(angle), 300.0 * np.sin(angle), 300.0 * v])
    points[side.u1, 0] = 0.0
    fixed = np.column_stack([side.u1 | side.v1, side.u0 | side.v1, side.v0])
    marks = {"pinched": only(side.u0 & side.v0)}
    force = np.zeros_like(points)
    force[marks["pinched"], 0] = -0.25
    planes = [side.u0, side.u1, side.v0]
    return Case(Mesh(points, triangles), fixed, planes, force, fabric(3.0, 3e6, 0.3), marks)


def roof(around: int, along: int) -> Case:
    """A quarter of Scordelis and Lo's roof under 90 per area, its ends on diaphragms; marks: middle of its free
    edge."""
    u, v, triangles, side = mapped(around, along, "crossed")
    angle = np.radians(40.0) * u
    points = np.column_stack([25.0 * np.sin(angle), 25.0 * v, 25.0 * np.cos(angle)])
    fixed = np.column_stack([side.u0 | side.v1, side.v0, side.v1])
    force = areas(points, triangles)[:, None] * np.array([0.0, 0.0, -90.0])
    marks = {"edge": only(side.u1 & side.v0)}
    return Case(Mesh(points, triangles), fixed, [side.u0, side.v0], force, fabric(0.25, 4.32e8), marks)


def areas(points: Reals, triangles: Ints) -> Reals:
    """(n,) m^2 of each vertex: a third of its triangles."""
    a, b, c = (points[triangles[:, k]] for k in range(3))
    third = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 6.0
    return sums(triangles.ravel(), np.repeat(third, 3), len(points))


# ---- the square airbag ----

AIRBAG = 0.8485  # m, side


def airbag(n: int, diagonals: str = "crossed") -> Case:
    """A quarter of one of two square sheets joined at their edges, on its planes of symmetry, its outer edges free to
    slide in the plane z = 0, to be inflated by 5 kPa; marks: centre."""
    u, v, triangles, side = mapped(n, n, diagonals)
    points = 0.5 * AIRBAG * np.column_stack([u, v, np.zeros(len(u))])
    fixed = np.column_stack([side.u0, side.v0, side.u1 | side.v1])
    marks = {"centre": only(side.u0 & side.v0)}
    material = fabric(6e-4, 588e6, 0.4)
    return Case(Mesh(points, triangles), fixed, [side.u0, side.v0], np.zeros_like(points), material, marks)
