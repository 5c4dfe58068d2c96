"""`voile render`: a picture of a result, drawn off screen with PyVista."""

from __future__ import annotations

import os
import textwrap
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from voile.arrays import Array, Ints, Reals
from voile.errors import InputError
from voile.files import replacing
from voile.post import contact, swing
from voile.post.camera import Camera, look, parse_scene, upright
from voile.post.edges import boundary_edges, hinges
from voile.post.quantities import (
    Quantity,
    hinge_angles,
    known,
    quantity,
    vertex_curvature,
)
from voile.results import Result, opened

if TYPE_CHECKING:
    import pyvista
    from PIL.Image import Image

FEATURE_ANGLE = np.radians(55.0)  # a closed start shape is outlined by the edges sharper than this
GHOST = 0.02  # a displacement of this fraction of the size makes the start shape worth a light surface
BAR_TITLE = 16  # letters that fit beside the shape
INK, LINE = "#1b1f24", "#5b6570"
SEQUENTIAL, DIVERGING = "YlGnBu", "RdBu_r"  # pale where little happens, so that folds show


def render(result: str | os.PathLike[str] | Result, out_png: str | os.PathLike[str], **how: Any) -> Path:
    """Draw a step of a result into `out_png`, `how` as of `picture`; returns the picture's path. InputError for a file
    that cannot be written."""
    out = Path(out_png)
    if out.suffix.lower() != ".png":
        raise InputError(f"{out}: pictures are written as .png")
    with replacing(out) as file:
        picture(result, **how).save(file, "png")
    return out


def picture(
    source: str | os.PathLike[str] | Result,
    *,
    field: str = "displacement",
    step: int = -1,
    view: str | tuple[float, float] | None = None,
    size: tuple[int, int] = (1600, 1200),
    outline: bool = True,
    shape: str = "step",
) -> Image:
    """A step of a result, open or at a path, coloured by `field`, drawn without an X server.

    field: displacement, strain, curvature, mean_curvature or any stored point or cell field (vectors by
    magnitude); contact, gap and reaction come with the reactions as arrows, contact in three colours.
    view: see `voile.post.camera.look`. size: width, height in pixels. outline: also draw the
    undeformed shape's boundary, and its surface as a light ghost where it is far from the drawn one
    and no obstacle is in the picture.
    shape: "rest" draws the rest shape in place of the step's, without obstacles.
    Raises InputError for a field, view or step that is not there.
    """
    check_size(size)
    with opened(source) as result:
        if not -result.n_steps <= step < result.n_steps:
            raise InputError(
                f"{result.path}: no step {step}; allowed: 0 to {result.n_steps - 1}, or -1 for the last"
            )
        check_field(result, field)
        scene = parse_scene(result.scene_text)
        points, shown = result.points(step), quantity(result, field, step)
        if swing.is_mode(field):
            points = swing.displaced(result, field, step)
        bodies = contact.surfaces(result, step)
        if shape == "rest":
            points, bodies = _rest(result), []
            if shown.name == "curvature" and shown.location == "point":
                shown = replace(shown, values=vertex_curvature(points, result.triangles)[1])
        everything = np.concatenate([points, result.start]) if outline else points
        camera = look(contact.framed(everything, bodies), upright(scene), view, size)
        plotter = open_plotter(size)
        try:
            contact.draw_bodies(plotter, bodies)
            draw_shape(plotter, points, result.triangles, shown, size, colour_scale(magnitude(shown)))
            if shape != "rest" and field in contact.ARROWS and "reaction" in result.point_fields:
                contact.draw_reactions(plotter, points, result.field("reaction", step))
            if outline:
                _draw_start(plotter, result.start, points, result.triangles, ghost=not bodies)
            said = "rest shape" if shape == "rest" else ""
            if swing.is_mode(field):
                said = swing.figure(result, field, step)
            write_title(plotter, _title(result, scene, step, said), size)
            aim(plotter, camera)
            return _image(plotter)
        finally:
            plotter.close()


def check_size(size: tuple[int, int]) -> None:
    """InputError for a picture of width, height (pixels) that nothing fits in."""
    if min(size) < 100:
        raise InputError(f"picture size {size[0]} x {size[1]} pixels; at least 100 x 100 expected")


def check_field(result: Result, field: str) -> None:
    """InputError for a field that a result does not have."""
    if field not in known(result):
        raise InputError(f"{result.path}: no field {field!r}; allowed: {', '.join(known(result))}")


def _rest(result: Result) -> Reals:
    """(n, 3) rest positions; InputError where the rest shape has vertices of its own."""
    if result.rest_triangles is not result.triangles and not np.array_equal(
        result.rest_triangles, result.triangles
    ):
        raise InputError(f"{result.path}: the rest shape is flat panels: see the pattern's pictures")
    return result.rest


def open_plotter(size: tuple[int, int]) -> Any:
    """A white scene with lights for a picture of width, height (pixels); draws off screen."""
    import pyvista
    from vtkmodules.vtkCommonCore import vtkLogger

    # VTK warns of the missing X server, then does without
    vtkLogger.SetStderrVerbosity(vtkLogger.VERBOSITY_ERROR)
    plotter: Any = pyvista.Plotter(off_screen=True, window_size=list(size), lighting="none")
    plotter.set_background("white")
    # key light over the viewer's left shoulder, fill from the right: folds show, nothing is black
    for place, strength in (((-0.5, 0.6, 1.0), 0.8), ((0.9, 0.1, 0.8), 0.3)):
        light = pyvista.Light(position=place, intensity=strength, light_type="camera light")
        plotter.add_light(light)
    plotter.enable_anti_aliasing("ssaa")
    return plotter


def aim(plotter: Any, camera: Camera) -> None:
    """Looks from a camera at what is drawn."""
    plotter.camera_position = [tuple(camera.position), tuple(camera.focus), tuple(camera.up)]
    plotter.camera.view_angle = camera.angle
    plotter.reset_camera_clipping_range()


def magnitude(shown: Quantity) -> Array:
    """The numbers that colours stand for: values, and lengths of vectors."""
    return shown.values if shown.values.ndim == 1 else np.linalg.norm(shown.values, axis=1)


def draw_shape(
    plotter: Any,
    points: Reals,
    triangles: Ints,
    shown: Quantity,
    size: tuple[int, int],
    colours: tuple[tuple[float, float], str],
) -> None:
    """The surface of points (n, 3) m with its outline, coloured by a quantity on a colour scale (`colour_scale`) that
    its bar explains; size: the picture's, in pixels."""
    shape = _surface(points, triangles)
    scale = size[1] / 1200
    _draw_lines(plotter, points, boundary_edges(triangles), INK, 2.2 * scale, 1.0)
    (shape.point_data if shown.location == "point" else shape.cell_data)["shown"] = magnitude(shown)
    shape = shape.compute_normals(cell_normals=False, split_vertices=False, consistent_normals=False)
    limits, scale_name = colours
    unit = f" [{shown.unit}]" if shown.unit else ""
    title = textwrap.fill(shown.name.replace("_", " ") + unit, BAR_TITLE)
    bar: dict[str, Any] = {
        "title": f"{title}\n", "vertical": True, "position_x": 0.875, "position_y": 0.2, "width": 0.055,
        "height": 0.55, "n_labels": 5, "fmt": "  %.3g", "color": INK, "font_family": "arial",
        "title_font_size": int(30 * scale), "label_font_size": int(26 * scale),
    }  # fmt: skip
    if shown.name == "contact":
        contact.draw_states(plotter, points, triangles, shape["Normals"], shown.values, bar)
        return
    plotter.add_mesh(
        shape, scalars="shown", cmap=scale_name, clim=limits, scalar_bar_args=bar, smooth_shading=True,
        interpolate_before_map=True, ambient=0.38, diffuse=0.7, specular=0.08, specular_power=12,
        nan_color="lightgrey",
    )  # fmt: skip


def _draw_start(plotter: Any, start: Reals, points: Reals, triangles: Ints, ghost: bool) -> None:
    lines = boundary_edges(triangles)
    if len(lines) == 0:  # a closed shape shows its sharp edges instead; on an open one they are stray strokes
        hinge = hinges(triangles)
        lines = hinge[np.abs(hinge_angles(start, triangles, hinge)) > FEATURE_ANGLE, :2]
    _draw_lines(plotter, start, lines, LINE, 1.6, 1.0)
    if ghost and np.linalg.norm(points - start, axis=1).max() > GHOST * np.ptp(start, axis=0).max():
        plotter.add_mesh(_surface(start, triangles), color="#8fa3b8", opacity=0.12, lighting=False)


def _draw_lines(plotter: Any, points: Reals, pairs: Ints, colour: str, width: float, opacity: float) -> None:
    import pyvista

    if len(pairs) == 0:
        return
    lines = pyvista.PolyData(points, lines=np.column_stack([np.full(len(pairs), 2), pairs]).ravel())
    plotter.add_mesh(lines, color=colour, line_width=width, opacity=opacity, lighting=False)


def colour_scale(values: Array) -> tuple[tuple[float, float], str]:
    """Range and colour map: symmetric about zero for both signs; the outermost percent saturates."""
    finite = values[np.isfinite(values)]
    if len(finite) == 0:
        return (0.0, 1.0), SEQUENTIAL
    low, high = (float(x) for x in np.percentile(finite, [1, 99]))
    if low == high:  # what only a few have is no outlier
        low, high = float(finite.min()), float(finite.max())
    if low < 0 < high and min(-low, high) > 0.25 * max(-low, high):
        limit = _round_up(max(-low, high))
        return (-limit, limit), DIVERGING
    if -0.05 * high < low < 0.2 * high:
        return (0.0, _round_up(high)), SEQUENTIAL
    if not high - low > 1e-9 * max(abs(low), abs(high)):
        high = low + (abs(low) or 1.0)  # one value all over still has a colour
    return (low, high), SEQUENTIAL + "_r" * (high <= 0)


def _round_up(limit: float) -> float:
    """The next number whose quarters, the labels of the colour bar, are short."""
    power = 10.0 ** np.floor(np.log10(limit))
    steps = np.array([1, 1.2, 1.6, 2, 2.4, 2.8, 3.2, 4, 4.8, 6, 8, 10])
    return float(power * steps[np.searchsorted(steps, limit / power * (1 - 1e-9))])


def _title(result: Result, scene: dict[str, Any], step: int, shape: str) -> str:
    name = scene.get("scene", {}).get("name", "")
    named = shape and scene.get("scene", {}).get("task") in ("inverse", "modes")
    at = shape if named else progress(result, scene, step)
    return f"{name}    {at}" if name else at


def progress(result: Result, scene: dict[str, Any], step: int) -> str:
    """Where in the run a step is: its time, its load factor, or what of an inverse design it is."""
    value, task = result.values[step], scene.get("scene", {}).get("task")
    if task == "inverse":
        return "target" if value == 0.0 else "simulated"
    return f"time {value:.4g} s" if task == "dynamics" else f"load factor {value:.4g}"


def write_title(plotter: Any, title: str, size: tuple[int, int]) -> None:
    """A line above the picture of width, height (pixels)."""
    plotter.add_text(
        title,
        position=(0.03, 0.94),
        viewport=True,
        font_size=max(6, int(15 * size[1] / 1200)),
        color=INK,
        font="arial",
    )


def _surface(points: Reals, triangles: Ints) -> pyvista.PolyData:
    import pyvista

    return pyvista.PolyData.from_regular_faces(points, triangles)


def _image(plotter: Any) -> Image:
    from PIL import Image

    return Image.fromarray(plotter.screenshot(return_img=True))
