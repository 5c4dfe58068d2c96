"""Numbers of a page: unsigned integers, differences of neighbours, compressed, as text. viewer.js undoes it."""

from __future__ import annotations

import base64
import zlib
from dataclasses import dataclass, field
from typing import Any, TypeAlias

import numpy as np

from voile.arrays import Reals

Unsigned: TypeAlias = np.ndarray[Any, np.dtype[np.unsignedinteger[Any]]]

NO_VALUE = 255  # in place of numbers that are not finite
LEVELS = 254  # colours between the ends of a scale, one byte a value
GRID = 65535  # places along the longest side of a box: 15 micrometres of a metre


@dataclass
class Arrays:
    """Arrays one after the other. `add` returns where one is, for the page's JSON."""

    parts: list[bytes] = field(default_factory=list)
    length: int = 0

    def add(self, values: Unsigned) -> dict[str, Any]:
        """values (rows, columns) unsigned: rows are followed by rows like them, the first by its columns."""
        difference = values.copy()
        difference[1:] -= values[:-1]
        difference[:1, 1:] -= values[:1, :-1]
        planes = difference.view(np.uint8).reshape(-1, values.itemsize).T  # high bytes are alike
        place = {"at": self.length, "bytes": values.itemsize, "rows": len(values), "columns": values.shape[1]}
        self.parts.append(np.ascontiguousarray(planes).tobytes())
        self.length += values.nbytes
        return place

    def text(self) -> str:
        """All of them, deflated, in base 64."""
        return base64.b64encode(zlib.compress(b"".join(self.parts), 6)).decode("ascii")


def places(points: Reals) -> tuple[Unsigned, dict[str, Any]]:
    """(rows, n, 3) m as (rows, 3n) 16-bit numbers, all x first, with the corner and spacing of their grid (m)."""
    corner = points.min(axis=(0, 1))
    spacing = float((points.max(axis=(0, 1)) - corner).max() or 1.0) / GRID
    steps = np.round((points - corner) / spacing).astype("<u2")
    flat = steps.transpose(0, 2, 1).reshape(len(points), -1)
    return flat, {"corner": corner.tolist(), "spacing": spacing}


def levels(values: Reals, low: float, high: float) -> Unsigned:
    """Values as 0 (low and below) to LEVELS (high and above); NO_VALUE where there is none."""
    share = (values - low) / (high - low)
    known = np.isfinite(share)
    shades = np.round(np.clip(np.where(known, share, 0.0), 0.0, 1.0) * LEVELS)
    return np.where(known, shades, NO_VALUE).astype(np.uint8)
