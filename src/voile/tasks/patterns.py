"""Sewing patterns of inverse results: cut, flatten, write. Rank 0 only."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from voile.arrays import Flags, Ints, Reals
from voile.errors import InputError, NotConverged, on_root
from voile.inverse.ease import add_ease
from voile.inverse.flatten import FlatPanels, distortion, flatten
from voile.inverse.overlaps import split_overlaps
from voile.inverse.panels import Groups, Panels, split
from voile.inverse.pattern import make_pattern, pattern_summary, sewing
from voile.inverse.rules import NO_RULES, PanelRule, Rules, SeamRule, check_rules
from voile.inverse.stitched import add_stitches
from voile.inverse.symmetric import middle_of, mirror_map, mirrored_rules, symmetrised
from voile.mesh import Pattern, Surface, build_topology, select, surface_loops
from voile.problem.shell import Shell
from voile.scene.pattern import AXES
from voile.scene.schema import Scene
from voile.wiring import Model

if TYPE_CHECKING:
    from mpi4py import MPI


def lay_flat(model: Model, shell: Shell, scene: Scene, points: Reals, cut_overlaps: bool) -> FlatPanels:
    """The shell's surface with its vertices at `points` (n, 3) m as flat panels: the mesh's groups, where it has
    several, cut along the scene's seams and open to discs, with the mesh's stitches as seams. cut_overlaps:
    panels that overlap themselves in the plane are cut further. Raises InputError or NotConverged where a panel cannot
    be laid flat."""
    if not cut_overlaps:
        return flatten(_cut(model, shell, scene, points))
    surface = model.surface
    middle = _middle(shell, scene)
    flat = split_overlaps(shell.triangles, points, _groups(surface), model.cuts, cut_open=True, middle=middle)
    if surface.stitches is None:
        return flat
    return replace(flat, panels=add_stitches(flat.panels, surface.stitches))


def _cut(model: Model, shell: Shell, scene: Scene, points: Reals) -> Panels:
    surface, middle = model.surface, _middle(shell, scene)
    panels = split(shell.triangles, points, _groups(surface), model.cuts, cut_open=True, middle=middle)
    return panels if surface.stitches is None else add_stitches(panels, surface.stitches)


def _middle(shell: Shell, scene: Scene) -> Flags | None:
    """(n,) where surfaces are cut open if they can be: in the plane of symmetry that is asked for, so that one panel
    mirrors itself."""
    axis = scene.pattern.symmetric
    return middle_of(shell.points, shell.triangles, AXES.index(axis)) if isinstance(axis, str) else None


def _groups(surface: Surface) -> Groups | None:
    return (surface.group, surface.group_names) if len(surface.group_names) > 1 else None


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
        slave=joined.slave.astype(np.int32),
        first=joined.first.astype(np.int32),
        second=joined.second.astype(np.int32),
        weight=joined.weight,
        force=force,
        closing=None if shell.closing is None else shell.closing[vertex],
        topology=topology,
    )


def first_copies(flat: FlatPanels) -> Ints:
    """(n,) panel vertex that stands for each vertex of the surface."""
    return np.unique(flat.panels.vertex, return_index=True)[1]


def moved(flat: FlatPanels, coordinates: Reals) -> FlatPanels:
    """The panels with other coordinates (p, 2) m."""
    panels = flat.panels
    stretches = distortion(panels.points[panels.vertex], panels.corners, coordinates)
    return replace(flat, coordinates=coordinates, stretches=stretches)


def check_wishes(model: Model, shell: Shell | None, scene: Scene) -> None:
    """Raises InputError, before anything is solved, where the scene's pattern does not fit the target's panels."""
    rules = wishes(scene, model)
    if rules == NO_RULES or shell is None:
        return
    panels = _cut(model, shell, scene, shell.points)
    check_rules(panels, rules.panels, rules.seams)
    mirrored_rules(panels, rules)


def evenly(flat: FlatPanels | None, scene: Scene, comm: "MPI.Comm") -> Callable[[Reals], Reals] | None:
    """What makes coordinates (p, 2) of the panels (rank 0) symmetric, on all ranks; None where not asked for."""
    if not isinstance(scene.pattern.symmetric, str):
        return None
    axis = AXES.index(scene.pattern.symmetric)
    mirror = on_root(comm, lambda: flat and mirror_map(flat.panels, axis))

    def even(x: Reals) -> Reals:
        found: Reals = comm.bcast(symmetrised(flat.panels, x, mirror)[0] if flat else None)
        return found

    return even


def gathered_in(
    flat: FlatPanels | None, scene: Scene, model: Model | None, comm: "MPI.Comm"
) -> Callable[[Reals], Reals] | None:
    """What gives coordinates (p, 2) of the panels (rank 0) the ease of their seams, on all ranks; None where none is
    asked for."""
    if not any(seam.ease for seam in scene.pattern.seam):
        return None

    rules = on_root(
        comm, lambda: mirrored_rules(flat.panels, wishes(scene, model)) if flat and model else None
    )

    def ease(x: Reals) -> Reals:
        longer = on_root(comm, lambda: add_ease(moved(flat, x), rules.seams) if flat and rules else None)
        found: Reals = comm.bcast(longer.coordinates if longer else None)
        return found

    return ease


def wishes(scene: Scene, model: Model) -> Rules:
    """What the scene's pattern asks of panels and seams. Raises InputError for a selection of nothing."""
    wish, surface = scene.pattern, model.surface
    loops = surface_loops(surface, model.shell.topology)

    def vertices(k: int) -> Ints | None:
        spec, where = wish.seam[k].select, f"{scene.path}: pattern.seam.{k}.select"
        return None if spec is None else select(surface, loops, spec, where)

    return Rules(
        tuple(PanelRule(panel.panel, panel.grain) for panel in wish.panel),
        tuple(SeamRule(s.between, s.allowance, s.ease, vertices(k)) for k, s in enumerate(wish.seam)),
        AXES.index(wish.symmetric) if isinstance(wish.symmetric, str) else None,
    )


def draw(flat: FlatPanels, scene: Scene, model: Model, up: Reals | None) -> Pattern:
    """The pattern of flat panels as the scene asks, its grain along `up` in space. Raises InputError for one that
    overlaps itself, or that does not fit the scene's keys."""
    allowance = scene.inverse.seam_allowance
    return make_pattern(flat, allowance, None if up is None else up.tolist(), rules=wishes(scene, model))


def write_pattern_files(folder: Path, pattern: Pattern, picture: bool = True) -> dict[str, Any]:
    """pattern.json, .svg, .dxf and with `picture` .png; the pattern's figures."""
    from voile.post.pattern_dxf import write_dxf
    from voile.post.pattern_svg import write_svg
    from voile.results import write_pattern

    write_pattern(folder, pattern)
    write_svg(folder / "pattern.svg", pattern)
    write_dxf(folder / "pattern.dxf", pattern)
    if picture:
        from voile.post.pattern_picture import draw_pattern

        draw_pattern(folder / "pattern.png", pattern)
    return pattern_summary(pattern)


def pattern_of_surface(
    folder: Path,
    model: Model,
    shell: Shell,
    rest: Reals,
    scene: Scene,
    up: Reals | None,
    picture: bool,
) -> tuple[dict[str, Any], Reals | None, Ints | None]:
    """The pattern of a rest surface (n, 3) m laid flat with the least distortion, drawn where `picture` or it has
    several pieces: its figures, and its points (p, 2) m with those of each triangle's corners (m, 3). Says why where
    there is none."""
    try:
        flat = lay_flat(model, shell, scene, rest, cut_overlaps=False)
        pattern = draw(flat, scene, model, up)
    except (InputError, NotConverged) as reason:
        return {"none": str(reason)}, None, None
    points = np.concatenate([piece.points for piece in pattern.pieces])
    figures = write_pattern_files(folder, pattern, picture or len(pattern.pieces) > 1)
    return figures, points, flat.panels.corners
