"""Sewing patterns of inverse results: cut, flatten, write. Rank 0 only."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from voile.errors import InputError, NotConverged
from voile.inverse.flatten import FlatPanels, distortion, flatten
from voile.inverse.panels import split
from voile.inverse.pattern import make_pattern, pattern_summary, write_rest_obj
from voile.problem.shell import Shell


def lay_flat(model, shell: Shell, points: np.ndarray) -> FlatPanels:
    """The shell's surface with its vertices at `points` (n, 3) m as flat panels: the mesh's groups, where it has
    several, else pieces cut to discs. Raises InputError or NotConverged where a panel cannot be laid flat."""
    surface = model.surface
    groups = (surface.group, surface.group_names) if len(surface.group_names) > 1 else None
    return flatten(split(shell.triangles, points, groups))


def on_panels(shell: Shell, flat: FlatPanels) -> Shell:
    """The shell with flat panels as rest shape."""
    points = np.column_stack([flat.coordinates, np.zeros(len(flat.coordinates))])
    return replace(shell, rest_points=points, rest_triangles=flat.panels.corners.astype(np.int32), flat=True)


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
