"""`voile animate`: a film of a run over time or load, one fixed camera and colour scale for all frames."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from voile.arrays import Ints, Reals
from voile.errors import InputError
from voile.post import contact, swing
from voile.post.camera import look, outermost, parse_scene, upright
from voile.post.quantities import quantity
from voile.post.reel import check_film, write_film
from voile.post.render import (
    aim,
    check_field,
    check_size,
    colour_scale,
    draw_shape,
    magnitude,
    open_plotter,
    write_title,
)
from voile.results import Result, opened

IN_TIME, ALONG_LOAD = 25.0, 5.0  # frames a second: smooth; slow enough to see each load step
SWINGS = 2.0  # s a period of a mode takes in a film
SCALED_BY = 40  # steps, evenly over the film, whose values choose its colour scale
PATHS = {
    "dynamics": "time",
    "statics": "load",
}  # tasks whose steps follow one another, and what they go along


@dataclass(frozen=True)
class Film:
    """What was written: frames, fps of them a second; ended: False where the run goes on or was killed."""

    path: Path
    frames: int
    fps: float
    ended: bool


def animate(
    source: str | os.PathLike[str] | Result,
    out: str | os.PathLike[str],
    *,
    field: str = "strain",
    fps: float | None = None,
    speed: float | None = None,
    view: str | tuple[float, float] | None = None,
    size: tuple[int, int] = (960, 720),
    on_frame: Callable[[int, int], None] | None = None,
) -> Film:
    """Draw the steps of the result, open or at a path, as `render` does one, into a film (.mp4, .gif or .webp).

    In time, frames show the stored step nearest to theirs: fps frames (25 by default) are `speed` seconds of the run
    (1 by default, real speed). Along a load path every stored step is a frame, 5 a second by default. A mode
    (`mode_000`) swings once, in 2 s whatever its frequency.
    on_frame: told how many frames are drawn of how many.
    Raises InputError for results without a path of several steps, and for what `render` refuses.
    """
    out = Path(out)
    check_size(size)
    with opened(source) as result:
        scene = parse_scene(result.scene_text)
        check_field(result, field)
        if swing.is_mode(field):
            return _swing(result, scene, out, field, fps or IN_TIME, view, size, on_frame)
        along = _followed(result, scene)
        fps = (IN_TIME if along == "time" else ALONG_LOAD) if fps is None else fps
        check_film(out, fps)
        steps = _steps_in_time(result, fps, speed) if along == "time" else _steps_along_load(result, speed)
        shown = np.unique(steps)
        titles = _titles(result, scene, shown, along, speed)
        picture = _Picture(result, shown, titles, field, view, size, upright(scene))
        try:
            write_film(out, lambda frame: picture(int(steps[frame])), len(steps), fps, size, on_frame)
        finally:
            picture.close()
        return Film(out, len(steps), fps, result.ended)


def _swing(
    result: Result,
    scene: dict[str, Any],
    out: Path,
    field: str,
    fps: float,
    view: str | tuple[float, float] | None,
    size: tuple[int, int],
    on_frame: Callable[[int, int], None] | None,
) -> Film:
    """The film of one period of a mode."""
    check_film(out, fps)
    frames = max(round(SWINGS * fps), 2)
    name = scene.get("scene", {}).get("name", "")
    title = (f"{name}    " if name else "") + swing.figure(result, field)
    shown = np.arange(frames)
    picture = _Swinging(result, shown, dict.fromkeys(range(frames), title), field, view, size, upright(scene))
    try:
        write_film(out, picture, frames, fps, size, on_frame)
    finally:
        picture.close()
    return Film(out, frames, fps, result.ended)


def _followed(result: Result, scene: dict[str, Any]) -> str:
    """What the result's steps go along: "time" or "load". InputError where there is no film in them."""
    task = scene.get("scene", {}).get("task", "statics")
    if task == "modes":
        raise InputError(
            f"{result.path}: task = modes has no path to film; allowed: a mode, --field mode_000"
        )
    if task not in PATHS:
        raise InputError(f"{result.path}: task = {task} has no path to film; allowed: {', '.join(PATHS)}")
    if result.n_steps < 2:
        why = "a film needs several: lower output.every"
        if not result.ended:
            why = "the run has not ended, wait for its second"
        elif task == "statics":
            why = "a film needs several: set statics.load_steps"
        raise InputError(f"{result.path}: one step only; {why}")
    return PATHS[task]


def _steps_in_time(result: Result, fps: float, speed: float | None) -> Ints:
    """(frames,) the stored step nearest to each frame's time."""
    speed = 1.0 if speed is None else speed
    if not 0 < speed < np.inf:
        raise InputError(f"speed = {speed:g}: a factor on real speed above 0 expected")
    times = result.values
    span = float(times[-1] - times[0])
    count = round(span / speed * fps) + 1
    if count < 2:
        raise InputError(
            f"{result.path}: {span:g} s of motion are not two frames at {fps:g} a second; "
            f"speed = {span * fps / result.n_steps:.1g} would show every step"
        )
    at = times[0] + np.arange(count) * speed / fps
    found: Ints = np.searchsorted((times[1:] + times[:-1]) / 2, at)
    return found


def _steps_along_load(result: Result, speed: float | None) -> Ints:
    if speed is not None:
        raise InputError(
            f"{result.path}: a load path has no time and so no speed; fps says how fast it is shown"
        )
    return np.arange(result.n_steps)


def _titles(
    result: Result, scene: dict[str, Any], shown: Ints, along: str, speed: float | None
) -> dict[int, str]:
    """What each step's frame says: as many decimals as tell the frames apart."""
    values = result.values[shown]
    decimals = int(np.clip(np.ceil(-np.log10(np.ptp(values) / len(shown))), 2, 9)) if np.ptp(values) else 2
    slow = f"    {speed:g} x real speed" if speed not in (None, 1.0) else ""
    name = scene.get("scene", {}).get("name", "")
    before = (f"{name}    " if name else "") + ("time" if along == "time" else "load factor")
    unit = " s" if along == "time" else ""
    return {int(k): f"{before} {v:.{decimals}f}{unit}{slow}" for k, v in zip(shown, values, strict=True)}


class _Picture:
    """Draws the steps `shown` of a result with one camera, colour scale and plotter; keeps the last picture."""

    def __init__(
        self,
        result: Result,
        shown: Ints,
        titles: dict[int, str],
        field: str,
        view: str | tuple[float, float] | None,
        size: tuple[int, int],
        up: Reals,
    ):
        self.result, self.titles, self.field, self.size = result, titles, field, size
        everything = [
            outermost(contact.framed(self._points(step), contact.surfaces(result, self._stored(step))))
            for step in shown
        ]
        self.camera = look(np.concatenate(everything), up, view, size)
        some = shown[np.unique(np.linspace(0, len(shown) - 1, SCALED_BY).round().astype(int))]
        self.colours = colour_scale(
            np.concatenate([magnitude(quantity(result, field, self._stored(k))) for k in some])
        )
        self.marks = contact.turning_marks(result, np.unique([self._stored(k) for k in shown]))
        self.plotter = open_plotter(size)
        self.last: tuple[int, Ints] | None = None

    def __call__(self, step: int) -> Ints:
        """(height, width, 3) uint8."""
        if self.last is None or self.last[0] != step:
            self.last = step, self._draw(step)
        return self.last[1]

    def _draw(self, step: int) -> Ints:
        plotter, result = self.plotter, self.result
        plotter.clear_actors()
        plotter.scalar_bars.clear()
        points, shown = self._points(step), quantity(result, self.field, self._stored(step))
        contact.draw_bodies(plotter, contact.surfaces(result, self._stored(step)), self.marks)
        draw_shape(plotter, points, result.triangles, shown, self.size, self.colours)
        if self.field in contact.ARROWS and "reaction" in result.point_fields:
            contact.draw_reactions(plotter, points, result.field("reaction", self._stored(step)))
        write_title(plotter, self.titles[step], self.size)
        aim(plotter, self.camera)
        found: Ints = plotter.screenshot(return_img=True)
        return found

    def _stored(self, step: int) -> int:
        """The result's step of a frame."""
        return step

    def _points(self, step: int) -> Reals:
        return self.result.points(step)

    def close(self) -> None:
        self.plotter.close()


class _Swinging(_Picture):
    """Frames of one period of a mode about the last step."""

    def _stored(self, step: int) -> int:
        return self.result.n_steps - 1

    def _points(self, step: int) -> Reals:
        phase = np.sin(2.0 * np.pi * step / len(self.titles))
        return swing.displaced(self.result, self.field, phase=float(phase))
