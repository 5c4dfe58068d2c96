"""pattern.dxf: a sewing pattern for apparel CAD, in millimetres, with the layers of ASTM D6673 (AAMA)."""

from __future__ import annotations

import io
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from voile.arrays import Reals
from voile.files import replace
from voile.post.pattern_svg import fabric_corners, name_height, seam_labels, slope
from voile.results import Pattern, Piece

if TYPE_CHECKING:
    from ezdxf.layouts import BaseLayout, BlockLayout

CUT, TURN, NOTCH, GRAIN, INTERNAL, SEW, TEXT = "1", "2", "4", "7", "8", "14", "15"
LETTER = 8.0  # mm
NAME = 31  # characters of a block's name in R12


def write_dxf(path: str | Path, pattern: Pattern) -> None:
    """Write the pattern as DXF R12 (AC1009): one BLOCK for each piece, inserted once at the origin.

    Layers: 1 cut line, 2 turn points, 4 notches (a point on the sew line), 7 grain line, 14 sew line, 15 text; 8
    the edges of the fabric, if the pieces are laid on one. Raises InputError if the file cannot be written.
    """
    from ezdxf.document import Drawing

    document = Drawing.new("R12")  # ezdxf.new would set units, which R12 cannot hold
    for layer in (CUT, TURN, NOTCH, GRAIN, INTERNAL, SEW, TEXT):
        document.layers.add(layer)
    names = _block_names([piece.name for piece in pattern.pieces])
    space = document.modelspace()
    blocks = [document.blocks.new(name) for name in names]
    for piece, block, name in zip(pattern.pieces, blocks, names, strict=True):
        _draw(block, piece)
        space.add_blockref(name, (0, 0), dxfattribs={"layer": CUT})
    for k, label, at, inward, height in seam_labels(pattern):
        letters = min(1.0, 1e3 * height / LETTER)
        _write(blocks[k], 1e3 * at + 4 * letters * LETTER * inward, f"Seam: {label}", letters, slope(inward))
    if pattern.fabric:
        cloth = 1e3 * fabric_corners(pattern)
        space.add_polyline2d(cloth.tolist(), close=True, dxfattribs={"layer": INTERNAL})
    _write(space, [0.0, -3 * LETTER], "Units: METRIC")
    text = io.StringIO()
    document.write(text)
    replace(path, text.getvalue().encode("cp1252", errors="replace"))


def _block_names(names: list[str]) -> list[str]:
    """Names as R12 allows them: capital letters, digits, - and _; numbered where they would be alike."""
    plain = [
        "".join(c if (c.isascii() and c.isalnum()) or c in "-_" else "_" for c in n.upper()) for n in names
    ]
    short = [name[:NAME] for name in plain]
    return [f"{n[: NAME - 4]}-{k:03d}" if short.count(n) > 1 else n for k, n in enumerate(short, 1)]


def _draw(block: BlockLayout, piece: Piece) -> None:
    for layer, line in (*((CUT, ring) for ring in piece.cut), (SEW, piece.points[piece.outline])):
        block.add_polyline2d((1e3 * line).tolist(), close=True, dxfattribs={"layer": layer})
    for layer, points in ((TURN, piece.points[piece.turns]), (NOTCH, piece.notches.points)):
        for point in (1e3 * points).tolist():
            block.add_point(point, dxfattribs={"layer": layer})
    low, high = (1e3 * piece.grain).tolist()
    block.add_line(low, high, dxfattribs={"layer": GRAIN})
    notches = piece.notches
    for point, inward, label in zip(1e3 * notches.points, notches.inward, notches.labels, strict=True):
        _write(block, point + 2 * LETTER * inward, f"Notch: {label}", 0.5)
    middle = 1e3 * piece.grain.mean(axis=0)
    lines = (f"Piece Name: {piece.name}", "Quantity: 1")
    letters = min(1.0, 1e3 * name_height(piece, len(lines[0])) / LETTER)
    for k, text in enumerate(lines):
        _write(block, middle - np.array([0.0, 1.5 * k * letters * LETTER]), text, letters)


def _write(
    space: BaseLayout, at: Reals | list[float], text: str, letters: float = 1.0, angle: float = 0.0
) -> None:
    """Text centred at a point (mm), turned by an angle (degrees)."""
    from ezdxf.enums import TextEntityAlignment

    place = (float(at[0]), float(at[1]))
    line = space.add_text(text, height=letters * LETTER, dxfattribs={"layer": TEXT, "rotation": angle})
    line.set_placement(place, align=TextEntityAlignment.MIDDLE_CENTER)
