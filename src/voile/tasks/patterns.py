"""Sewing patterns of inverse results: cut, flatten, write. Rank 0 only."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from voile.errors import InputError, NotConverged
from voile.inverse.flatten import FlatPanels, distortion, flatten
from voile.inverse.panels import split
from voile.inverse.pattern import make_pattern, pattern_summary, sewing, write_rest_obj
from voile.mesh import build_topology
from voile.problem.shell import Shell


def lay_flat(model, shell: Shell, points: np.ndarray) -> FlatPanels:
    """The shell's surface with its vertices at `points` (n, 3) m as flat panels: the mesh's groups, where it has
    several, else pieces cut to discs. Raises InputError or NotConverged where a panel cannot be laid flat."""
    surface = model.surface
    groups = (surface.group, surface.group_names) if len(surface.group_names) > 1 else None
    return flatten(split(shell.triangles, points, groups))


def cut_apart(shell: Shell, flat: FlatPanels) -> Shell:
    """The shell as its panels, sewn as its pattern will be: with copies of the vertices along the cuts, stitches that
    join them and the flat panels as rest shape. Clamps on edges that are cut stay on their first copy."""
    panels = flat.panels
    vertex, joined = panels.vertex, sewing(panels)
    first = first_copies(flat)
    corners = panels.corners.astype(np.int32)
    topology = build_topology(corners)
    pairs = {tuple(sorted(ends)) for ends in shell.topology.edges[shell.clamped_edges].tolist()}
    held = [k for k, ends in enumerate(vertex[topology.edges].tolist()) if tuple(sorted(ends)) in pairs]
    force = None
    if shell.force is not None:
        force = np.zeros((len(vertex), 3))
        force[first] = shell.force
    return replace(
        shell,
        points=shell.points[vertex],
        triangles=corners,
        rest_points=np.column_stack([flat.coordinates, np.zeros(len(flat.coordinates))]),
        rest_triangles=corners,
        flat=True,
        fixed=shell.fixed[vertex],
        motion=shell.motion[vertex],
        clamped_edges=np.array(held, dtype=np.int32),
        slave=np.concatenate([first[shell.slave], joined.slave]).astype(np.int32),
        first=np.concatenate([first[shell.first], joined.first]).astype(np.int32),
        second=np.concatenate([first[shell.second], joined.second]).astype(np.int32),
        weight=np.concatenate([shell.weight, joined.weight]),
        force=force,
        closing=None if shell.closing is None else shell.closing[vertex],
        topology=topology,
    )


def first_copies(flat: FlatPanels) -> np.ndarray:
    """(n,) panel vertex that stands for each vertex of the surface."""
    return np.unique(flat.panels.vertex, return_index=True)[1]


def moved(flat: FlatPanels, coordinates: np.ndarray) -> FlatPanels:
    """The panels with other coordinates (p, 2) m."""
    panels = flat.panels
    stretches = distortion(panels.points[panels.vertex], panels.corners, coordinates)
    return replace(flat, coordinates=coordinates, stretches=stretches)


def write_pattern_files(folder: Path, flat: FlatPanels, allowance: float, up: np.ndarray | None) -> dict:
    """pattern.json, .svg, .dxf and .png; their figures. Raises InputError for a panel that overlaps itself."""
    from voile.post.pattern_dxf import write_dxf
    from voile.post.pattern_picture import draw_pattern
    from voile.post.pattern_svg import write_svg
    from voile.results import write_pattern

    pattern = make_pattern(flat, allowance, None if up is None else up.tolist())
    write_pattern(folder, pattern)
    write_svg(folder / "pattern.svg", pattern)
    write_dxf(folder / "pattern.dxf", pattern)
    draw_pattern(folder / "pattern.png", pattern)
    return pattern_summary(pattern)


def write_sewn_rest(folder: Path, flat: FlatPanels, points: np.ndarray, allowance: float, name: str) -> None:
    """rest.obj of panels: apart, at `points` (n, 3) m of the surface, with their pattern and stitches."""
    pattern = make_pattern(flat, allowance)
    write_rest_obj(folder / "rest.obj", flat.panels, pattern, points, name)


def pattern_of_surface(
    folder: Path, model, shell: Shell, rest: np.ndarray, allowance: float, up: np.ndarray | None
) -> dict:
    """The pattern of a rest surface (n, 3) m laid flat with the least distortion; says why where there is none."""
    try:
        return write_pattern_files(folder, lay_flat(model, shell, rest), allowance, up)
    except (InputError, NotConverged) as reason:
        return {"none": str(reason)}
