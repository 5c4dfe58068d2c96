"""What a scene's `move` tables describe, as motions in time or along the load path."""

from typing import Any

import numpy as np

from voile.contact.motion import Motion, Spell, Track
from voile.scene.moves import Move, read_path
from voile.scene.schema import Scene


def motion_of(scene: Scene, move: Move) -> Motion:
    """That of a `move` table of the scene. Raises InputError where its file is no table of motion."""
    center, duration = np.array(move.center), scene.dynamics.duration
    if move.path:
        times, rows = read_path(move.path, duration)
        return Track(times=times, rows=rows, center=center)
    parts: dict[str, Any] = {
        "displacement": np.array(move.displacement),
        "rotation": np.array(move.rotation),
        "center": center,
    }
    if not move.in_time:
        return Spell(**parts, end=duration) if scene.scene.task == "dynamics" else Motion(**parts)
    until = duration if move.until is None else move.until
    lasts = until - move.begin
    parts |= {
        "displacement": lasts * np.array(move.velocity),
        "rotation": lasts * np.array(move.angular_velocity),
    }
    return Spell(**parts, begin=move.begin, end=until)
