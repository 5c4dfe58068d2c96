"""pattern.svg: a sewing pattern in millimetres at true scale, one group of each kind of line, named as in the DXF."""

from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from voile.arrays import Reals
from voile.files import replace
from voile.results import Pattern, Piece, SewnSeam

MARGIN = 20.0  # mm
LETTER = 0.011  # height of seam labels, of the drawing's size
LABEL = 0.22  # of a seam: clear of its notches, and of names and grain lines in the middle of pieces
CLOTH = "#f6f3ea"
BAR = 100.0  # mm, the scale bar to check a print with
NOTCH = 4e-3  # m, into a piece without seam allowance
WIDEST = 0.8  # mm, of a line
FABRIC = {"fill": "none", "stroke": "#5b6570", "stroke-width": "0.8", "stroke-dasharray": "12 4"}
# layer: (number of ASTM D6673, colour, width in drawing sizes / 1000)
LAYERS = {
    "cut": (1, "#1b1f24", 1.1),
    "notch": (4, "#b3261e", 1.1),
    "grain": (7, "#5b6570", 0.8),
    "internal": (8, "#5b6570", 0.6),
    "sew": (14, "#1f5fa8", 0.8),
    "text": (15, "#1b1f24", 0.0),
}


def write_svg(path: str | Path, pattern: Pattern) -> None:
    """Write the pattern to a file, as `svg` has it. Raises InputError if it cannot be written."""
    replace(path, svg(pattern))


def svg(pattern: Pattern) -> bytes:
    """The pattern as an SVG document.

    One user unit is a millimetre; the groups `cut`, `notch`, `grain`, `internal` (turn points), `sew` and `text` hold
    an element for each piece, `cut-NAME` and so on.
    """
    everything = np.concatenate([*(piece.cut[0] for piece in pattern.pieces), fabric_corners(pattern)])
    low, size = 1e3 * everything.min(axis=0), 1e3 * np.ptp(everything, axis=0)
    letter = LETTER * max(size)
    width, height = size + 2 * MARGIN + [0, 3 * letter]
    attributes = {
        "width": f"{width:.3f}mm", "height": f"{height:.3f}mm", "viewBox": f"0 0 {width:.3f} {height:.3f}",
        "xmlns": "http://www.w3.org/2000/svg", "font-family": "Helvetica, Arial, sans-serif",
    }  # fmt: skip
    root = ElementTree.Element("svg", attributes)
    ElementTree.SubElement(root, "title").text = "Sewing pattern, true scale, millimetres"
    page = _Page(root, low, size[1], letter, max(size))
    for piece, key in zip(pattern.pieces, _keys(pattern), strict=True):
        page.draw(piece, key)
    page.seams(pattern)
    page.bar(height)
    if pattern.fabric:
        page.path("text", "fabric", [fabric_corners(pattern)], closed=True, **FABRIC)
    text: bytes = ElementTree.tostring(root, encoding="utf-8", xml_declaration=True)
    return text


def _keys(pattern: Pattern) -> list[str]:
    """Names as they may be part of an XML id, numbered where they would be alike."""
    names = ["".join(c if c.isalnum() or c in "-_." else "_" for c in piece.name) for piece in pattern.pieces]
    return [f"{name}-{k}" if names.count(name) > 1 else name for k, name in enumerate(names, 1)]


class _Page:
    """The drawing: metres, y up, become millimetres from the upper left corner, y down."""

    def __init__(self, root: ElementTree.Element, low: Reals, height: float, letter: float, size: float):
        self.low, self.height, self.letter = low, height, letter
        self.layers = {}
        for name, (number, colour, width) in LAYERS.items():
            style = (
                {"fill": colour, "stroke": "none"} if name == "text" else {"fill": "none", "stroke": colour}
            )
            style |= {"stroke-width": f"{min(width * size / 1000, WIDEST):.3f}"} if width else {}
            layer = {"id": name, "data-layer": str(number), "stroke-linejoin": "round", **style}
            self.layers[name] = ElementTree.SubElement(root, "g", layer)

    def millimetres(self, points: Reals) -> Reals:
        x = 1e3 * np.reshape(points, (-1, 2)) - self.low
        return np.column_stack([x[:, 0], self.height - x[:, 1]]) + MARGIN

    def path(self, layer: str, key: str, lines: list[Reals], closed: bool = False, **style: str) -> None:
        """One path of several polylines (metres)."""
        text = " ".join(
            "M "
            + " L ".join(f"{x:.4f},{y:.4f}" for x, y in self.millimetres(line))
            + (" Z" if closed else "")
            for line in lines
        )
        ElementTree.SubElement(self.layers[layer], "path", {"id": f"{layer}-{key}", "d": text, **style})

    def write(self, at: Reals, text: str, letters: float, angle: float, **style: str) -> None:
        """Text centred at a point (metres), turned by an angle (degrees)."""
        x, y = self.millimetres(at)[0]
        size = letters * self.letter
        if angle:
            style["transform"] = f"rotate({-angle:.2f} {x:.3f} {y:.3f})"
        place = {"x": f"{x:.3f}", "y": f"{y + 0.35 * size:.3f}", "font-size": f"{size:.2f}", **style}
        ElementTree.SubElement(self.layers["text"], "text", {"text-anchor": "middle", **place}).text = text

    def draw(self, piece: Piece, key: str) -> None:
        """Lines, marks and name of a piece."""
        mark = mark_length(piece, 1e-3 * self.letter)
        self.path("cut", key, list(piece.cut), closed=True, **{"fill": CLOTH, "fill-rule": "evenodd"})
        self.path("sew", key, [piece.points[piece.outline]], closed=True)
        self.path("notch", key, notch_lines(piece, min(mark, NOTCH)))
        turns = piece.points[piece.turns]
        cross = 0.4 * mark * np.array([[-1, -1], [1, 1], [-1, 1], [1, -1]])
        self.path("internal", key, [t + cross[[i, i + 1]] for t in turns for i in (0, 2)])
        self.path("grain", key, [piece.grain, *arrows(piece.grain, mark)])
        letters = min(1.5, 1e3 * name_height(piece, len(piece.name)) / self.letter)
        # not by paint-order, which some converters do not know: they hide the name behind its own halo
        halo = {"stroke": CLOTH, "stroke-width": f"{0.3 * letters * self.letter:.3f}", "aria-hidden": "true"}
        for style in (halo, {}):
            self.write(piece.grain.mean(axis=0), piece.name, letters, 0.0, **{"font-weight": "bold", **style})

    def seams(self, pattern: Pattern) -> None:
        """The label of each seam inside both its sides, smaller where there is little room."""
        for _, label, at, inward, height in seam_labels(pattern):
            letters = min(1.0, 1e3 * height / self.letter)
            place = at + 1.2e-3 * letters * self.letter * inward
            self.write(place, label, letters, slope(inward), fill=LAYERS["sew"][1])

    def bar(self, height: float) -> None:
        """Scale bar at the lower left, in page coordinates."""
        y = height - MARGIN
        line = {
            "id": "scale-bar",
            "d": f"M {MARGIN},{y:.3f} h {BAR} m 0,-3 v 6 m {-BAR},0 v -6",
            "stroke": "#1b1f24",
            "stroke-width": "0.5",
        }
        ElementTree.SubElement(self.layers["text"], "path", line)
        note = {"x": f"{MARGIN + BAR + 5}", "y": f"{y + 3:.3f}", "font-size": "10"}
        ElementTree.SubElement(self.layers["text"], "text", note).text = f"{BAR:g} mm"


def fabric_corners(pattern: Pattern) -> Reals:
    """(4, 2) corners of the fabric that the pieces lie on, (0, 2) without."""
    if pattern.fabric is None:
        return np.zeros((0, 2))
    return np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]]) * pattern.fabric


def mark_length(piece: Piece, length: float) -> float:
    """Length of notches and arrow heads (m): the one given, less in a narrow piece."""
    return min(length, 0.12 * float(np.ptp(piece.points, axis=0).min()))


def name_height(piece: Piece, letters: int) -> float:
    """Height (m) of a line of so many letters that there is room for in the middle of a piece."""
    width, height = np.ptp(piece.points, axis=0)
    return float(min(0.45 * width / (0.6 * letters), 0.15 * height))


def notch_lines(piece: Piece, length: float) -> list[Reals]:
    """A stroke (2, 2) for each notch: from the sew line through the seam allowance, where a snip does no harm, or
    without one inwards, `length` long (m)."""
    n = piece.notches
    reaches = np.where(n.allowance > 0, -n.allowance, length)
    return [np.array([p, p + r * d]) for p, d, r in zip(n.points, n.inward, reaches, strict=True)]


def arrows(line: Reals, length: float) -> list[Reals]:
    """Arrow heads (3, 2) at both ends of an upright line (2, 2), `length` long (m)."""
    head = length * np.array([[-0.35, -1.0], [0.0, 0.0], [0.35, -1.0]])
    return [line[1] + head, line[0] - head]


def slope(inward: Reals) -> float:
    """Angle (degrees) of a text along a seam with this normal (2,), never upside down."""
    angle = float(np.degrees(np.arctan2(-inward[0], inward[1])))
    return (angle + 89.0) % 180.0 - 89.0


def seam_texts(seam: SewnSeam, allowance: float) -> tuple[str, str]:
    """What is written on either side: the label, its allowance (mm) where it is not the pattern's (m), and the ease on
    the longer side."""
    width = f" | {1e3 * seam.allowance:g} mm" if seam.allowance != allowance else ""
    ease = f" | ease {1e3 * abs(seam.ease):g} mm" if seam.ease else ""
    return (
        seam.label + width + (ease if seam.ease > 0 else ""),
        seam.label + width + (ease if seam.ease < 0 else ""),
    )


def seam_labels(pattern: Pattern) -> Iterator[tuple[int, str, Reals, Reals, float]]:
    """For both sides of every seam the piece, the seam's label, the point of the side where it is written, the unit
    normal (2,) there, into the piece, and the height (m) of letters that there is room for."""
    for seam in pattern.seams:
        texts = seam_texts(seam, pattern.allowance)
        # the first side follows its outline, which is counter-clockwise, the second goes against it
        for index, side, length, left, text in zip(
            seam.pieces, seam.sides, seam.lengths, (1, -1), texts, strict=True
        ):
            points = pattern.pieces[index].points
            run = points[side]
            along = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(run, axis=0), axis=1)))
            at = np.array([np.interp(LABEL * length, along, run[:, i]) for i in (0, 1)])
            edge = int(np.searchsorted(along, LABEL * length))
            tangent = run[edge] - run[edge - 1]
            inward = left * np.array([-tangent[1], tangent[0]]) / np.linalg.norm(tangent)
            narrow = np.ptp(points, axis=0).min()
            room = min(0.35 * length, 0.18 * narrow, 0.5 * length / len(text))
            yield index, text, at, inward, room
