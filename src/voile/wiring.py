"""From a scene to arrays: reads the meshes a scene names and lays out shell, supports and loads. For commands only."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from voile.arrays import Flags, Ints, Reals, diagonal, triangle_areas
from voile.contact.frames import Frames
from voile.contact.motion import Motion
from voile.contact.obstacles import SHAPES, MeshBody, Obstacle
from voile.elastic import has_directors, model_name
from voile.elastic.weave import Woven, warp_of, weave_rows
from voile.errors import InputError
from voile.held import moves_of, sections_of, supports_of
from voile.mesh import (
    Attached,
    RawMesh,
    Rest,
    Surface,
    inner_lines,
    read_mesh,
    read_rest,
    refine,
    select,
    shrunk,
    surface_loops,
)
from voile.mesh.topology import Topology, build_topology
from voile.mesh.welds import welds
from voile.problem.load import History, Load
from voile.problem.loads import LOADS
from voile.problem.local_axes import Hold, combined
from voile.problem.sections import Section
from voile.problem.shell import Shell, seam_gaps
from voile.problem.supports import check_supports, free_motions, holds_a_piece
from voile.results import Body, StaticMesh
from voile.scene import Scene
from voile.scene.motion import motion_of
from voile.scene.pattern import check_names
from voile.scene.schema import Fabric

DEEPEST = 0.05  # of the shell's size: how deep a start may be inside an obstacle
SUNK = 0.01  # the same of a target of inverse design, or this many contact tolerances
SUNK_TOLERANCES = 5.0
FABRIC = ("thickness", "young", "poisson", "density")
WOVEN = ("young_weft", "shear", "bending_warp", "bending_weft", "bending_twist")
CLOSED, GAPING = 1e-6, 0.01  # of the size: seams of a target that are closed, and those that do not close


@dataclass
class Model:
    """A scene's shell as arrays, with what results and `explain` say of it."""

    shell: Shell
    surface: Surface
    rest: Rest
    notes: list[str]
    obstacles: list[Obstacle]
    offset: float  # m, from the mid-surface to the surface that touches
    cuts: Ints  # (k, 2) vertices of the edges along which the scene cuts the surface into panels
    holds: list[Hold]  # what each [[fix]] holds
    sections: list[Section]  # of which the summary tells the forces


def build_model(scene: Scene) -> Model:
    """Reads and checks everything a scene names; raises InputError with the scene's key in question."""
    spec = scene.shell
    surface = read_mesh(spec.mesh, spec.scale, spec.seams, spec.joints)
    surface = refine(surface, spec.refine, f"{scene.path}: shell.refine", spec.refine_smooth)
    rest = read_rest(spec.rest, surface, Path(scene.path).parent, spec.scale)
    topology = build_topology(surface.triangles)
    loops = surface_loops(surface, topology)
    holds, clamped = supports_of(scene, surface, topology, loops)
    on = Attached(surface, topology, loops, str(scene.path))
    shell, rest = _shell(scene, rest, on, holds, clamped)
    bodies = build_obstacles(scene)
    offset = scene.contact.offset
    if offset is None:
        offset = 0.5 * float(shell.thickness.max())
    notes = [*surface.notes, *_checked(scene, shell, surface, bodies, offset)]
    cuts = inner_lines(surface, topology, scene.inverse.seams, f"{scene.path}: inverse.seams")
    notes += [f"obstacle {body.name}: {body.blurred}" for body in bodies if body.blurred]
    return Model(shell, surface, rest, notes, bodies, offset, cuts, holds, sections_of(scene, surface, loops))


def _shell(scene: Scene, rest: Rest, on: Attached, holds: list[Hold], clamped: Ints) -> tuple[Shell, Rest]:
    """The shell, held and clamped along edges, with what is `on` its surface, and its rest shape, shrunk."""
    spec, loads, surface = scene.shell, scene.loads, on.surface
    moves = moves_of(scene, holds)
    axes, fixed, motion = combined(holds, len(surface.points), f"{scene.path}: fix")
    thickness, young, poisson, density = (_fabric(scene, surface, name) for name in FABRIC)
    shrink = _fabric(scene, surface, "shrink")
    weave = _weave(scene, surface, rest, thickness, young, poisson)
    if shrink.any():
        rest, density = shrunk(rest, 1.0 - shrink, f"{scene.path}: shrink"), density / (1.0 - shrink) ** 2
    shell = Shell(
        points=surface.points,
        triangles=surface.triangles,
        rest_points=rest.points,
        rest_triangles=rest.triangles,
        flat=rest.flat,
        model=model_name(spec.model, spec.bending, spec.material),
        thickness=thickness,
        young=young,
        poisson=poisson,
        density=density,
        fixed=fixed,
        axes=axes,
        motion=motion,
        moves=moves,
        clamped_edges=clamped,
        gravity=np.array(loads.gravity, dtype=float),
        pressure=float(loads.pressure),
        patch_pressure=on.patches(loads.patch),
        force=on.total("loads.force", [(force, np.array(force.value)) for force in loads.force]),
        moment=_moments(scene, surface, on.topology, list(on.loops)),
        topology=on.topology,
        seam_bending=spec.seam_bending,
        load_laws=_load_laws(scene),
        springs=on.springs(scene.spring),
        bars=on.bars(scene.band, scene.tie),
        welds=welds(surface, on.topology, spec.joint_stiffness, _plate(thickness, young, poisson, weave)),
        extra_mass=on.total("mass", [(mass, mass.value) for mass in scene.mass]),
        weave=weave,
        **_seams(surface),
    )
    return shell, rest


def _checked(
    scene: Scene, shell: Shell, surface: Surface, bodies: list[Obstacle], offset: float
) -> list[str]:
    """What a user should know of a shell and its obstacles. Raises InputError for what cannot be computed."""
    task, inverse, size = scene.scene.task, scene.inverse, diagonal(shell.points)
    notes: list[str] = []
    if inverse.developable and shell.fixed.all():
        raise InputError(
            f"{scene.path}: fix holds every vertex; allowed with inverse.developable: some that are free"
        )
    _check_unknowns(shell, f"{scene.path}: fix")
    check_names(scene, surface.group_names, size)
    if task == "inverse" and not inverse.estimate:
        notes += _gaping(shell, size, scene.shell.mesh)
    if bodies:
        deepest = DEEPEST * size
        if task == "inverse":
            deepest = max(SUNK * size, SUNK_TOLERANCES * inverse.contact_tolerance)
            notes += _sunk(bodies, shell, offset, inverse.contact_tolerance)
        check_depth(bodies, shell, offset, f"{scene.path}: obstacle", deepest)
    if task == "modes":
        _check_modes(scene, shell, bodies)
    elif task != "dynamics":
        carried = bodies or (scene.contact.self_contact and holds_a_piece(shell))
        if not (carried and _pressed(shell, bodies)):
            check_supports(shell)
    return notes


def _load_laws(scene: Scene) -> dict[str, Load]:
    """In time loads act as they are; else in proportion to the load factor."""
    if scene.scene.task != "dynamics":
        return {}
    history = np.array(scene.loads.history)
    return dict.fromkeys(LOADS, History(*history.T) if len(history) else History())


def _check_unknowns(shell: Shell, where: str) -> None:
    """Raises InputError, naming the key `where`, if the supports leave nothing to solve for."""
    free = ~shell.fixed
    free[shell.slave] = False  # they follow what they are sewn to
    angles = has_directors(shell.model) and len(shell.clamped_edges) < len(shell.topology.edges)
    if not (free.any() or angles):
        raise InputError(f"{where} holds every vertex and edge; allowed: supports that leave something free")


def _pressed(shell: Shell, bodies: list[Obstacle]) -> bool:
    """Whether anything may press the shell on obstacles, so that they hold it."""
    loads = (shell.gravity, shell.pressed, shell.force, shell.moment, shell.motion)
    loaded = any(load is not None and np.any(load) for load in loads)
    strained = not np.array_equal(shell.points[shell.triangles], shell.rest_points[shell.rest_triangles])
    return loaded or strained or bool(shell.moves) or any(body.moves for body in bodies)


def _check_modes(scene: Scene, shell: Shell, bodies: list[Obstacle]) -> None:
    """Raises InputError where a shell has no equilibrium to vibrate about, or nothing to buckle. A free one that
    nothing loads has rigid modes."""
    loaded = _pressed(shell, bodies)
    if scene.modes.buckling:
        if not loaded:
            raise InputError(
                f"{scene.path}: modes.buckling = true without a load; allowed: with loads.gravity, pressure, force or "
                "fix.move"
            )
        if free_motions(shell).shape[2]:
            raise InputError(
                f"{scene.path}: fix: modes.buckling = true needs supports that hold the shell, without its loads, "
                "against all rigid motions"
            )
    elif loaded and not bodies:
        try:
            check_supports(shell)
        except InputError as error:
            raise InputError(f"{error}, or loads.gravity = [0, 0, 0] and no other load, to free it") from None


def _sunk(bodies: list[Obstacle], shell: Shell, offset: float, tolerance: float) -> list[str]:
    """What a user should know of a target that is further inside an obstacle than contact_tolerance (m)."""
    notes = []
    for obstacle in bodies:
        gap = obstacle.gap(shell.points, 0.0) - offset
        worst = int(np.argmin(gap))
        if gap[worst] < -tolerance:
            count = int((gap < -tolerance).sum())
            notes.append(
                f"the target is up to {-gap[worst]:.4g} m inside {obstacle.name} (vertex {worst}), {count} vertices "
                f"more than inverse.contact_tolerance = {tolerance:g} m: it is taken to touch there as it is"
            )
    return notes


def _gaping(shell: Shell, size: float, mesh: Path | RawMesh) -> list[str]:
    """What a user should know of a target whose seams are open. Raises InputError where that makes it no target."""
    gaps = seam_gaps(shell)
    if gaps.max(initial=0.0) <= CLOSED * size:
        return []
    worst, count = int(gaps.argmax()), int((gaps > CLOSED * size).sum())
    ends = sorted({int(shell.first[worst]), int(shell.second[worst])})
    where = (
        f"{count} of {len(gaps)} sewn vertices lie off their seam, up to {gaps[worst]:.4g} m "
        f"(vertex {shell.slave[worst]} from {' and '.join(map(str, ends))})"
    )
    if gaps[worst] > GAPING * size:
        allowed = f"{GAPING * size:.4g} m, {GAPING:.0%} of its size"
        raise InputError(f"{mesh}: the target's seams do not close: {where}; allowed: {allowed}")
    return [f"{where}: the target is closed there first, and sag counts from the closed shape"]


def _seams(surface: Surface) -> dict[str, Any]:
    s = surface.stitches
    return {} if s is None else {"slave": s.slave, "first": s.first, "second": s.second, "weight": s.weight}


def _fabric(scene: Scene, surface: Surface, name: str) -> Reals:
    """(m,) a value per triangle: [shell]'s, NaN where it gives none, overridden by [[fabric]] per group."""
    value = getattr(scene.shell, name)
    values = np.full(len(surface.triangles), np.nan if value is None else float(value))
    for chosen, fabric in _groups(scene, surface):
        if getattr(fabric, name) is not None:
            values[chosen] = getattr(fabric, name)
    return values


def _groups(scene: Scene, surface: Surface) -> Iterator[tuple[Flags, Fabric]]:
    """(m,) the triangles of each [[fabric]], and the fabric."""
    for k, fabric in enumerate(scene.fabric):
        if fabric.group not in surface.group_names:
            raise InputError(
                f"{scene.path}: fabric.{k}.group = {fabric.group!r} is not a group of {surface.source}; "
                f"there are: {', '.join(surface.group_names) or 'none'}"
            )
        yield surface.group == surface.group_names.index(fabric.group), fabric


def _weave(scene: Scene, surface: Surface, rest: Rest, *fabric: Reals) -> Reals | None:
    """(m, 9) of an orthotropic shell (elastic/weave.py) with thickness, young and poisson."""
    if scene.shell.material != "orthotropic":
        return None
    woven = Woven(*(_fabric(scene, surface, name) for name in WOVEN))
    try:
        warp = warp_on(scene, surface, rest)
        return weave_rows(rest.points, rest.triangles, warp, *fabric, woven=woven)
    except InputError as error:
        raise InputError(f"{scene.path}: {error}") from None


def warp_on(scene: Scene, surface: Surface, rest: Rest) -> Reals:
    """(m, 3) warp directions that the scene gives a rest shape."""
    warps = [(np.ones(len(surface.triangles), dtype=bool), scene.shell.warp or "v", "shell.warp")]
    groups = enumerate(_groups(scene, surface))
    warps += [(chosen, each.warp, f"fabric.{k}.warp") for k, (chosen, each) in groups if each.warp]
    return warp_of(rest, surface, warps)


def _plate(thickness: Reals, young: Reals, poisson: Reals, weave: Reals | None) -> Reals:
    """(m,) bending stiffness (N m), the mean of warp and weft of what is woven."""
    if weave is not None:
        return np.asarray(young * weave[:, [5, 7]].mean(axis=1))
    return np.asarray(young * thickness**3 / (12.0 * (1.0 - poisson**2)))


def _moments(scene: Scene, surface: Surface, topology: Topology, loops: list[Ints]) -> Reals | None:
    """(3m,) moments per boundary half edge; a total is shared by length over the selection's boundary edges."""
    if not scene.loads.moment:
        return None
    total = np.zeros(topology.across.size)
    for k, moment in enumerate(scene.loads.moment):
        where = f"{scene.path}: loads.moment.{k}.select"
        inside = np.zeros(len(surface.points), dtype=bool)
        inside[select(surface, loops, moment.select, where)] = True
        edge = topology.triangle_edges.ravel()
        rim = (topology.across.ravel() < 0) & inside[topology.edges[edge]].all(axis=1)
        if not rim.any():
            raise InputError(f"{where}: no boundary edge has both ends selected")
        ends = surface.points[topology.edges[edge[rim]]]
        length = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
        total[rim] += moment.value * length / length.sum()
    return total


def build_obstacles(scene: Scene) -> list[Obstacle]:
    """The scene's obstacles in the order of the file."""
    found: list[Obstacle] = []
    for k, spec in enumerate(scene.obstacle):
        motion = Motion() if spec.move is None else motion_of(scene, spec.move)
        body = SHAPES[spec.shape]
        laws = {"friction": spec.friction, "restitution": spec.restitution}
        found.append(body.build(spec.geometry(), name=f"{spec.shape} {k}", motion=motion, **laws))
        _check_frames(scene, k, found[-1])
    return found


def _frames_of(body: Obstacle) -> Frames | None:
    """Of a body that deforms in time."""
    return body.frames if isinstance(body, MeshBody) else None


def _check_frames(scene: Scene, k: int, body: Obstacle) -> None:
    """Raises InputError where a body that deforms in time ends early."""
    frames = _frames_of(body)
    if frames is None:
        return
    duration = scene.dynamics.duration
    if frames.lasts < duration * (1.0 - 1e-9):
        raise InputError(
            f"{scene.path}: obstacle.{k}.frames: {len(frames.points)} frames, the last {Path(frames.source).name}, "
            f"last to {frames.lasts:g} s; allowed: to dynamics.duration = {duration:g} s at least"
        )


def check_depth(bodies: list[Obstacle], shell: Shell, offset: float, where: str, limit: float) -> None:
    """Raises InputError, naming the key `where`, if a vertex that can move starts deeper inside an obstacle than limit
    (m)."""
    free = ~shell.fixed.all(axis=1)
    for k, obstacle in enumerate(bodies):
        gap = np.where(free, obstacle.gap(shell.points, 0.0) - offset, np.inf)
        worst = int(np.argmin(gap))
        if gap[worst] < -limit:
            x = ", ".join(f"{c:.4g}" for c in shell.points[worst])
            raise InputError(
                f"{where}.{k}: the shell starts {-gap[worst]:.4g} m deep inside {obstacle.name} at vertex {worst} "
                f"({x}), {int((gap < -limit).sum())} vertices deeper than {limit:.4g} m; move the obstacle or the "
                f"shell apart, or let the obstacle come by obstacle.move"
            )


def static_mesh(model: Model, shell: Shell, directors: bool) -> StaticMesh:
    """What the result file holds once; shell: the model's, sewn."""
    bounds = np.array([shell.points.min(axis=0), shell.points.max(axis=0)])
    return StaticMesh(
        shell.points,
        shell.triangles,
        rest=shell.rest_points,
        rest_triangles=None if shell.rest_triangles is shell.triangles else shell.rest_triangles,
        edges=shell.topology.edges if directors else None,
        group=model.surface.group,
        group_names=model.surface.group_names,
        point_data={"input_vertex": model.surface.input_vertex},
        bodies=tuple(_body(o, bounds) for o in model.obstacles),
    )


def _body(obstacle: Obstacle, bounds: Reals) -> Body:
    """As it is drawn, near the shell's bounds (2, 3) m."""
    frames = _frames_of(obstacle)
    deforms = () if frames is None else (frames.points, frames.step)
    return Body(obstacle.name, obstacle.friction, *obstacle.surface(bounds), *deforms)


def weight(shell: Shell) -> float:
    """Mass of the shell (kg)."""
    return float(shell.density * shell.thickness @ triangle_areas(shell.rest_points, shell.rest_triangles))
