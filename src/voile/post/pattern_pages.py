"""A pattern on sheets of paper to print and glue: SVG pages and one PDF, at true scale.

Sheets overlap. Crosses in the overlaps are printed on both sheets: glued cross on cross, the lines go on. The first
sheet has a square of 10 cm to check the print with, and a map of the others.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any
from xml.sax.saxutils import escape, quoteattr

import numpy as np
import shapely

from voile.arrays import Reals
from voile.errors import InputError
from voile.files import made, replace, replacing
from voile.post.pattern_svg import LAYERS, arrows, mark_length, name_height, notch_lines, seam_labels, slope
from voile.results import Pattern

PAPERS = {"a4": (210.0, 297.0), "a3": (297.0, 420.0), "letter": (215.9, 279.4), "a0": (841.0, 1189.0)}  # mm
MARGIN = 10.0  # mm that printers leave white
OVERLAP = 15.0  # mm of two sheets, to glue
SQUARE = 100.0  # mm
CROSS = 4.0  # mm, arm of a registration mark
LETTER = 4.0  # mm
MOST = 1000  # sheets: a pattern that needs more is a mistake in its unit
WIDTHS = {"cut": 0.5, "sew": 0.3, "mark": 0.2}  # mm
INK = "#1b1f24"


@dataclass(frozen=True)
class Line:
    """A polyline (k, 2) in millimetres, y down."""

    points: Reals
    layer: str


@dataclass(frozen=True)
class Label:
    """Text centred at a point (mm), turned by an angle (degrees)."""

    at: Reals
    text: str
    height: float
    angle: float = 0.0


@dataclass(frozen=True)
class Sheet:
    """What is on a sheet, in millimetres from its upper left corner."""

    name: str
    lines: list[Line]
    labels: list[Label]


def write_pages(folder: str | Path, pattern: Pattern, paper: str = "a4") -> list[Path]:
    """Write pages.pdf and a file page-NAME.svg for each sheet into a folder; their paths, the PDF first.

    Raises InputError for paper that is not known, or a file that cannot be written.
    """
    if paper not in PAPERS:
        raise InputError(f"--pages {paper}; allowed: {', '.join(PAPERS)}")
    folder, size = Path(folder), np.array(PAPERS[paper])
    sheets = sheets_of(pattern, size)
    written = [made(folder) / "pages.pdf"]
    with replacing(written[0]) as file:
        _write_pdf(file, sheets, size)
    for sheet in sheets:
        written.append(folder / f"page-{sheet.name}.svg")
        replace(written[-1], _svg(sheet, size).encode())
    return written


def sheets_of(pattern: Pattern, size: Reals) -> list[Sheet]:
    """The sheets of a pattern on paper of `size` (mm), the one with the square and the map first; those that lie
    on no piece are left out."""
    low = 1e3 * np.min([piece.cut[0].min(axis=0) for piece in pattern.pieces], axis=0)
    high = 1e3 * np.max([piece.cut[0].max(axis=0) for piece in pattern.pieces], axis=0)
    lines, labels = _drawing(pattern, np.array([low[0], high[1]]))
    room, step = size - 2 * MARGIN, size - 2 * MARGIN - OVERLAP
    count = np.maximum(1, np.ceil((high - low - OVERLAP) / step).astype(int))
    if count.prod() > MOST:
        raise InputError(
            f"--pages: {count.prod()} sheets; allowed: up to {MOST}, so larger paper or a smaller pattern"
        )
    shapes = [shapely.LineString(line.points) for line in lines]
    tree = shapely.STRtree(shapes)
    pieces = shapely.union_all(
        [shapely.Polygon(s) for s, line in zip(shapes, lines, strict=True) if line.layer == "cut"]
    )
    sheets = []
    for row in range(count[1]):
        for column in range(count[0]):
            corner = step * [column, row]
            frame = shapely.box(*corner, *(corner + room))
            here = [
                Line(part + MARGIN - corner, lines[k].layer)
                for k in sorted(tree.query(frame).tolist())
                for part in _clipped(shapes[k], frame)
            ]
            if pieces.intersects(frame):  # also amid a piece, whose other sheets are glued to it
                inside = [
                    label for label in labels if ((label.at > corner) & (label.at < corner + room)).all()
                ]
                moved = [Label(t.at + MARGIN - corner, t.text, t.height, t.angle) for t in inside]
                name = f"{_letter(row)}{column + 1}"
                sheets.append(Sheet(name, here + list(_marks(size, row, column, count)), moved))
    pages = len(sheets) + 1
    titled = [
        _titled(sheet, f"sheet {sheet.name}, page {k} of {pages}", size) for k, sheet in enumerate(sheets, 2)
    ]
    return [_titled(_cover(lines, sheets, step, room, size), f"page 1 of {pages}", size), *titled]


def _drawing(pattern: Pattern, corner: Reals) -> tuple[list[Line], list[Label]]:
    """Everything on one endless sheet, from its upper left corner (mm, y up in the pattern)."""
    lines: list[Line] = []

    def place(points: Reals) -> Reals:
        return (1e3 * points - corner) * [1.0, -1.0]

    def add(layer: str, points: Reals, closed: bool = False) -> None:
        lines.append(Line(place(np.vstack([points, points[:1]]) if closed else points), layer))

    labels = []
    for piece in pattern.pieces:
        mark = mark_length(piece, 0.008)
        for ring in piece.cut:
            add("cut", ring, closed=True)
        add("sew", piece.points[piece.outline], closed=True)
        for points in notch_lines(piece, min(mark, 0.004)):
            add("notch", points)
        for points in (piece.grain, *arrows(piece.grain, mark)):
            add("grain", points)
        height = min(8.0, 1e3 * name_height(piece, len(piece.name)))
        labels.append(Label(place(piece.grain.mean(axis=0)), piece.name, height))
    for _, text, at, inward, height in seam_labels(pattern):
        size = min(5.0, 1e3 * height)
        labels.append(Label(place(at + 1.2e-3 * size * inward), text, size, slope(inward)))
    return lines, labels


def _clipped(line: shapely.LineString, frame: shapely.Polygon) -> Iterator[Reals]:
    """The parts (k, 2) of a line inside a frame."""
    inside = line.intersection(frame)
    for part in shapely.get_parts(inside):
        if part.geom_type == "LineString" and not part.is_empty:  # only their boxes may meet
            yield shapely.get_coordinates(part)


def _marks(size: Reals, row: int, column: int, count: Reals) -> Iterator[Line]:
    """Frame and registration marks: in the middle of each overlap, at the sheet's corners and halfway along it."""
    low, high = np.full(2, MARGIN), size - MARGIN
    yield Line(np.array([low, [high[0], low[1]], high, [low[0], high[1]], low]), "mark")
    near, far = low + 0.5 * OVERLAP, high - 0.5 * OVERLAP
    middle = 0.5 * (near + far)
    for x in (near[0], middle[0], far[0]):
        for y in (near[1], middle[1], far[1]):
            side = (x == near[0] and column > 0) or (x == far[0] and column < count[0] - 1)
            end = (y == near[1] and row > 0) or (y == far[1] and row < count[1] - 1)
            if side or end:
                yield Line(np.array([[x - CROSS, y], [x + CROSS, y]]), "mark")
                yield Line(np.array([[x, y - CROSS], [x, y + CROSS]]), "mark")


def _cover(lines: list[Line], sheets: list[Sheet], step: Reals, room: Reals, size: Reals) -> Sheet:
    """The test square, and below it a map: where each sheet goes."""
    low = np.array([0.5 * (size[0] - SQUARE), MARGIN + 4 * LETTER])
    square = low + SQUARE * np.array([[0, 0], [1, 0], [1, 1], [0, 1], [0, 0]])
    drawn = [Line(square, "cut")]
    labels = [Label(low + 0.5 * SQUARE, "10 cm x 10 cm: print at 100 %, then measure", LETTER)]
    places = [_place(sheet.name) for sheet in sheets]
    whole = step * np.max(places, axis=0) + room
    top = low[1] + SQUARE + 3 * LETTER
    scale = min((size[0] - 2 * MARGIN) / whole[0], (size[1] - MARGIN - 2 * LETTER - top) / whole[1])
    corner = np.array([0.5 * (size[0] - scale * whole[0]), top])
    drawn += [Line(corner + scale * line.points, "sew") for line in lines if line.layer == "cut"]
    for sheet, place in zip(sheets, places, strict=True):
        box = np.array([[0, 0], [1, 0], [1, 1], [0, 1], [0, 0]]) * room
        drawn.append(Line(corner + scale * (step * place + box), "mark"))
        middle = corner + scale * (step * place + 0.5 * room)
        labels.append(Label(middle, sheet.name, min(LETTER, 0.3 * scale * room[0])))
    return Sheet("cover", drawn, labels)


def _titled(sheet: Sheet, title: str, size: Reals) -> Sheet:
    at = np.array([0.5 * size[0], MARGIN - 0.9 * LETTER])
    return Sheet(sheet.name, sheet.lines, [*sheet.labels, Label(at, title, LETTER)])


def _letter(k: int) -> str:
    return (_letter(k // 26 - 1) if k >= 26 else "") + chr(ord("A") + k % 26)


def _place(name: str) -> Reals:
    """Column and row of a sheet by its name."""
    row = 0
    letters = name.rstrip("0123456789")
    for letter in letters:
        row = 26 * row + ord(letter) - ord("A") + 1
    return np.array([int(name[len(letters) :]) - 1, row - 1])


def _style(layer: str) -> tuple[str, float]:
    """Colour, and width in mm."""
    return (LAYERS[layer][1] if layer in LAYERS else INK), WIDTHS.get(layer, WIDTHS["sew"])


def _svg(sheet: Sheet, size: Reals) -> str:
    width, height = size
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width:g}mm" height="{height:g}mm" '
        f'viewBox="0 0 {width:g} {height:g}" font-family="Helvetica, Arial, sans-serif">',
        f"<title>Sewing pattern, {escape(sheet.name)}, true scale, millimetres</title>",
    ]
    for line in sheet.lines:
        colour, stroke = _style(line.layer)
        path = " L ".join(f"{x:.4f},{y:.4f}" for x, y in line.points)
        parts.append(
            f'<path class="{line.layer}" d="M {path}" fill="none" stroke="{colour}" stroke-width="{stroke}"/>'
        )
    for t in sheet.labels:
        x, y = t.at
        turn = f"rotate({-t.angle:.2f} {x:.3f} {y:.3f})"
        parts.append(
            f'<text x="{x:.3f}" y="{y + 0.35 * t.height:.3f}" font-size="{t.height:.2f}" text-anchor="middle" '
            f"transform={quoteattr(turn)}>{escape(t.text)}</text>"
        )
    return "\n".join([*parts, "</svg>\n"])


def _write_pdf(file: IO[bytes], sheets: list[Sheet], size: Reals) -> None:
    from matplotlib.backends.backend_pdf import PdfPages
    from matplotlib.figure import Figure

    point = 72 / 25.4
    with PdfPages(file) as pdf:
        for sheet in sheets:
            figure = Figure(figsize=tuple(size / 25.4))
            axes: Any = figure.add_axes((0.0, 0.0, 1.0, 1.0))
            axes.set_xlim(0.0, size[0])
            axes.set_ylim(size[1], 0.0)
            axes.axis("off")
            for line in sheet.lines:
                colour, width = _style(line.layer)
                axes.plot(*line.points.T, color=colour, linewidth=point * width)
            for t in sheet.labels:
                text = axes.text(*t.at, t.text, fontsize=point * t.height, color=INK, rotation=t.angle)
                text.set(rotation_mode="anchor", ha="center", va="center")
            pdf.savefig(figure)
