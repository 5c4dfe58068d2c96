"""The scene's `move` table, of obstacles and of supports."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from voile.arrays import Reals
from voile.errors import InputError
from voile.keys import File, Number, Rejected, Vector3, key, vector

STILL = (0.0, 0.0, 0.0)
COLUMNS = "t, x, y, z or t, x, y, z, rx, ry, rz, the same in all lines"


@dataclass(frozen=True, kw_only=True)
class Move:
    displacement: Vector3 = key(
        vector("m"), "displacement reached at the end of the load path, or of the duration", default=STILL
    )
    rotation: Vector3 = key(
        vector("rad"),
        "rotation vector reached at the end of the load path, or of the duration",
        default=STILL,
    )
    center: Vector3 = key(vector("m"), "point about which it rotates", default=STILL)
    velocity: Vector3 = key(vector("m/s"), "dynamics: constant velocity", default=STILL)
    angular_velocity: Vector3 = key(
        vector("rad/s"), "dynamics: constant rotation about center", default=STILL
    )
    begin: float = key(Number("s", least=0), "dynamics: when the velocities begin", word="from", default=0.0)
    until: float | None = key(
        Number("s", above=0), "dynamics: when they end; default: with the duration", default=None
    )
    path: Path | None = key(
        File(),
        "dynamics: table (csv) of t, x, y, z[, rx, ry, rz]: displacement (m) and rotation vector (rad) about center, "
        "linear between",
        default=None,
    )

    def check(self, given: set[str]) -> None:
        ways = {
            "displacement": {"displacement", "rotation"},
            "velocity": {"velocity", "angular_velocity"},
            "path": {"path"},
        }
        used = [way for way, keys in ways.items() if keys & given]
        allowed = "allowed: one of displacement or rotation, velocity or angular_velocity, path"
        if not used:
            raise Rejected(f'the key "displacement" is missing; {allowed}')
        if len(used) > 1:
            raise Rejected(f"{' and '.join(used)} do not go together; {allowed}")
        for name in sorted({"from", "until"} & given):
            if used != ["velocity"]:
                raise Rejected("allowed with velocity or angular_velocity only", (name,))
        if self.until is not None and self.until <= self.begin:
            raise Rejected(f"{self.until:g} s is not after from = {self.begin:g} s", ("until",))

    @property
    def in_time(self) -> bool:
        """Whether only time can tell where it is."""
        return bool(self.path or any(self.velocity) or any(self.angular_velocity))


def read_path(path: Path, duration: float) -> tuple[Reals, Reals]:
    """Times (k,) s and rows (k, 6) of displacement (m) and rotation vector (rad) of a table of motion (csv), of which
    the first line may be a heading. Raises InputError where it is none, runs backwards, starts with a jump, or does not
    last from 0 to the duration (s)."""
    try:
        lines = path.read_text(encoding="utf-8-sig").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or "not UTF-8 text"
        raise InputError(f"{path}: cannot be read: {reason}") from None
    rows = []
    for number, line in enumerate(lines, 1):
        cells = [cell.strip() for cell in line.split(",")]
        if not any(cells) or line.lstrip().startswith("#"):
            continue
        try:
            rows.append([float(cell) for cell in cells])
        except ValueError:
            if rows or number > 1:
                raise InputError(f"{path}, line {number}: not numbers; allowed: {COLUMNS}") from None
            continue
        if len(cells) not in (4, 7) or len(rows[-1]) != len(rows[0]):
            raise InputError(f"{path}, line {number}: {len(cells)} numbers; allowed: {COLUMNS}")
        if not np.isfinite(rows[-1]).all():
            raise InputError(f"{path}, line {number}: not finite; allowed: {COLUMNS}")
        if len(rows) > 1 and rows[-1][0] <= rows[-2][0]:
            raise InputError(f"{path}, line {number}: t = {rows[-1][0]:g} s is not after the line before")
    if not rows or rows[0][0] > 0.0 or rows[-1][0] < duration:
        lasts = f"lasts from {rows[0][0]:g} to {rows[-1][0]:g} s" if rows else "is empty"
        raise InputError(f"{path}: {lasts}; allowed: from 0 to dynamics.duration = {duration:g} s at least")
    table = np.array(rows)
    start = [float(np.interp(0.0, table[:, 0], column)) for column in table[:, 1:].T]
    if any(start):
        moved = ", ".join(f"{value:g}" for value in start)
        raise InputError(f"{path}: at t = 0 it has moved by {moved} already; allowed: no motion at t = 0")
    return table[:, 0], np.pad(table[:, 1:], ((0, 0), (0, 7 - table.shape[1])))
